"""The study of benchmarks/locate.py: its elements are at places that the force moves."""

from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("name", "count"), [("chain", 23), ("building", 7)])
def test_elements_are_at_places_that_the_force_moves(monkeypatch, name, count):
    """A force along X moves the building along X alone."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    import levels
    import locate

    s = levels.make_structures()[name]()
    moved = locate.list_moved(s)
    assert len(moved) == count
    assert all(":X" in place for place in moved)
    assert set(moved) <= set(locate.list_candidates(s))
