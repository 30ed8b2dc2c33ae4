"""docs/plots.md: its code runs, its table lists every function, its text is what comes out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pages import ROOT, blocks, run_python
from updyn import plots

PAGE = ROOT / "docs" / "plots.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_code_runs_and_prints_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/plots.md", namespace)
    said = next(block.text for block in blocks(PAGE) if block.language == "text")
    assert capsys.readouterr().out == said
    assert {path.name for path in tmp_path.iterdir()} == {"frf.png", "page.png"}


def test_every_function_is_in_the_table() -> None:
    assert set(re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE)) == set(plots.__all__)


def test_there_are_as_many_colours_as_the_page_says() -> None:
    from updyn.style import CATEGORIES

    assert len(CATEGORIES) == 4
