"""docs/candidates.md: its example runs, and its attributes exist."""

from __future__ import annotations

import re
from typing import Any

import pytest

from pages import ROOT, blocks, run_python
from updyn.candidates.result import CandidateRow, ModelComparison

PAGE = ROOT / "docs" / "candidates.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_example_finds_structural_damping(capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, Any] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/candidates.md", namespace)
    found = namespace["found"]
    assert found.best == "structural"
    assert found.distinguishable
    assert "structural is first by evidence" in capsys.readouterr().out


def test_every_attribute_exists() -> None:
    rows = re.findall(r"^\| (`\..*?) \|", TEXT, re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`\.(\w+)", row)}
    assert len(names) > 8
    assert names <= set(dir(ModelComparison)) | set(ModelComparison.__dataclass_fields__)
    of_row = set(re.findall(r"`\.(\w+)`", TEXT.split("A row has")[1].split("##")[0]))
    assert of_row <= set(dir(CandidateRow)) | set(CandidateRow.__dataclass_fields__)
