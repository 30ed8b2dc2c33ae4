"""The page on noise runs as it stands, and says the truth about what it prints."""

from __future__ import annotations

from typing import Any

import pytest

from pages import ROOT, blocks, run_python


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    namespace: dict[str, Any] = {"__name__": "page"}
    ran = 0
    for block in blocks(ROOT / "docs/noise.md"):
        if block.language == "python":
            run_python(block, "docs/noise.md", namespace)
            ran += 1
    assert ran == 3
    return namespace


def test_the_robust_fit_names_the_lines(page: dict[str, Any]) -> None:
    assert page["robust"].noise["down_weighted_lines"] == pytest.approx([50.0, 100.0, 150.0])
    assert page["robust"].std["shaft.stiffness"] < 0.4 * page["plain"].std["shaft.stiffness"]


def test_the_mean_of_three_is_known_better_than_one(page: dict[str, Any]) -> None:
    assert page["averaged"].noise["kind"] == "variance"
    single = page["updyn"].update(page["start"], page["measure"](), page["unknowns"])
    assert page["averaged"].std["shaft.stiffness"] == pytest.approx(
        single.std["shaft.stiffness"] / 3**0.5, rel=0.15
    )
    assert page["averaged"].values["shaft.stiffness"] == pytest.approx(1.25, rel=0.005)


def test_the_parts_are_what_the_page_says(page: dict[str, Any]) -> None:
    assert [part.values.shape for part in page["parts"]] == [(91, 1, 1), (70, 1, 1)]
    assert page["parts"][0].source == "run 3; 1 of 2 channels misses 21 of 91 lines"
    assert page["joint"].status == "converged"
    assert page["joint"].values["shaft.stiffness"] == pytest.approx(1.25, rel=0.01)
