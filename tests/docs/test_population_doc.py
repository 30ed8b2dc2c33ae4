"""docs/population.md: its example runs, and its attributes exist."""

from __future__ import annotations

import re
from typing import Any

import pytest

from pages import ROOT, blocks, run_python
from updyn.population.result import PopulationResult, Specimen

PAGE = ROOT / "docs" / "population.md"
TEXT = PAGE.read_text(encoding="utf-8")


def test_the_example_finds_the_scatter() -> None:
    namespace: dict[str, Any] = {"__name__": "page"}
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/population.md", namespace)
    found = namespace["population"]
    low, high = found.std_intervals()["part1.stiffness"]
    assert low < 0.1 < high
    assert found.mean["part1.stiffness"] == pytest.approx(1.0, abs=0.1)


def test_every_attribute_exists() -> None:
    rows = re.findall(r"^\| (`\..*?) \|", TEXT, re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`\.(\w+)", row)}
    assert len(names) > 10
    assert names <= set(dir(PopulationResult)) | set(PopulationResult.__dataclass_fields__)
    others = set(re.findall(r"`\.(\w+)`", TEXT)) - names
    assert others <= set(Specimen.__dataclass_fields__) | set(PopulationResult.__dataclass_fields__)
