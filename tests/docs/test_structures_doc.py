"""docs/structures.md: its blocks run, and its tables name the fields that there are."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from meshes import MSH
from pages import ROOT, blocks, run_python
from updyn.elements import structure as package
from updyn.elements.structure import structure_from_table

PAGE = ROOT / "docs" / "structures.md"


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("table.msh").write_text(MSH, encoding="utf-8")
    namespace: dict[str, Any] = {"__name__": "page"}
    run = [
        run_python(block, PAGE.name, namespace)
        for block in blocks(PAGE)
        if block.language == "python"
    ]
    assert len(run) == 2


def test_the_job_of_the_page_builds() -> None:
    (block,) = [b for b in blocks(PAGE) if b.language == "toml"]
    model = structure_from_table(tomllib.loads(block.text)["model"])
    assert list(model.groups) == ["root", "end", "tip"]


@pytest.mark.parametrize("name", ["Beam", "Truss", "Shell", "Solid", "Spring", "PointMass"])
def test_every_field_is_named(name: str) -> None:
    (row,) = re.findall(
        rf"^\| `{name}` \| (.*) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert set(re.findall(r"`(\w+)`", row)) == {
        f.name for f in dataclasses.fields(getattr(package, name))
    }
