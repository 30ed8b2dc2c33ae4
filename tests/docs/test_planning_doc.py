"""docs/planning.md: its example and its commands run, and its criteria are those that there are."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from pages import ROOT, blocks, run_console, run_python, save_toml
from updyn.planning import CRITERIA

PAGE = ROOT / "docs" / "planning.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_page_runs(
    tmp_path: Path,
    chain_inputs: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copyfile(chain_inputs / "chain.h5", tmp_path / "chain.h5")
    names: dict[str, Any] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, PAGE.name, names)
        elif block.language == "toml":
            assert save_toml(block)
        elif block.language == "console":
            assert run_console(block, PAGE.name) == 2
    assert "effective-independence" in capsys.readouterr().out
    assert "Layout" in (tmp_path / "plan.html").read_text(encoding="utf-8")
    for folder in ("plan-plan", "plans"):
        assert (tmp_path / folder / "plan.json").exists()


def test_criteria_are_those_that_there_are() -> None:
    table = TEXT.split("| criterion | chooses | source |")[1].split("\n\n")[0]
    assert re.findall(r"^\| `([a-z-]+)`", table, re.MULTILINE) == list(CRITERIA)
