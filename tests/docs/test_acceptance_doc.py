"""docs/acceptance.md: its examples run, its limits are those of the code, its attributes exist."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import updyn
from pages import ROOT, blocks, run_python
from updyn.acceptance.limits import LIMIT_NAMES
from updyn.acceptance.standards import STANDARDS

PAGE = ROOT / "docs" / "acceptance.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/acceptance.md", namespace)
    assert (tmp_path / "acceptance.html").is_file()
    assert namespace["found"].limits.changed == ("frequency",)


def test_the_limits_are_those_of_the_standards() -> None:
    rows = re.findall(r"^\| [^|]* \| `(\w+)` \| (\S+) \| (\S+) \|$", TEXT, re.MULTILINE)
    shown = dict.fromkeys(STANDARDS, None)
    for column, name in enumerate(shown, 1):
        stated = {row[0]: float(row[column]) for row in rows if row[column] != "-"}
        assert stated == STANDARDS[name].stated
    assert {row[0] for row in rows} <= set(LIMIT_NAMES)


def test_every_attribute_exists() -> None:
    table = TEXT.split("| attribute | value |")[1].split("\n\n")[0]
    known: set[str] = set()
    for kind in (updyn.Acceptance, updyn.AcceptanceLimits, updyn.Requirement):
        known |= set(dir(kind)) | set(kind.__dataclass_fields__)
    names = set(re.findall(r"`\.(\w+)", table))
    assert len(names) > 12
    assert names <= known
