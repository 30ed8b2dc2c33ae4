"""docs/modes.md: its example runs, its table is what comes out, its limits are those of the source."""

from __future__ import annotations

import inspect
from typing import Any

import pytest

from pages import ROOT, blocks, run_python
from updyn.correlation import ModeCorrelation
from updyn.correlation.modes import correlate_modes
from updyn.updating.judge.settings import EFFORT

PAGE = ROOT / "docs" / "modes.md"
TEXT = PAGE.read_text(encoding="utf-8")
WORDS = " ".join(TEXT.split())


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Run the blocks in a folder with the page's table of frequencies."""
    namespace: dict[str, Any] = {"__name__": "page"}
    folder = tmp_path_factory.mktemp("page")
    (table,) = (b.text for b in blocks(PAGE) if b.language == "text" and b.text.startswith("#"))
    (folder / "frequencies.csv").write_text(table, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in blocks(PAGE):
            if block.language == "python":
                run_python(block, "docs/modes.md", namespace)
    return namespace


def test_the_table_is_that_of_the_example(page: dict[str, Any]) -> None:
    shown = next(b.text for b in blocks(PAGE) if b.language == "text")
    assert shown.strip() == page["table"].text()


def test_limits_are_those_of_the_source() -> None:
    options = inspect.signature(correlate_modes).parameters
    for name in ("gate", "least_mac"):
        assert f"`{name}` ({options[name].default:g})" in WORDS
    assert f"within {100 * options['close'].default:g} % of frequency (`close`)" in WORDS
    assert f"above {EFFORT.most_dofs:,} DOFs" in WORDS


def test_figures_of_the_table_are_there() -> None:
    for name in ("mac", "subspaces", "auto_mac", "comac", "ecomac", "cross_orthogonality"):
        assert hasattr(ModeCorrelation, name)
        assert f"`.{name}" in TEXT
