"""What docs/formats.md says of CalculiX, against the code."""

from __future__ import annotations

import inspect
import re

import pytest

from places import ROOT
from updyn.io.calculix import read_model
from updyn.io.consistent_units import UNITS
from updyn.io.keyword_deck.structure import POINTS, SOLIDS

SECTION = (
    (ROOT / "docs" / "formats.md").read_text(encoding="utf-8").split('<a id="calculix"></a>')[1]
)
SECTION = SECTION.split("\n<a id=")[0]


def test_options_and_units_are_named() -> None:
    options = [
        p.name
        for p in inspect.signature(read_model).parameters.values()
        if p.kind is p.KEYWORD_ONLY
    ]
    said = re.search(r"Options of reading: (.*)\n", SECTION)
    assert said is not None
    assert re.findall(r"`(\w+)`", said[1]) == options
    for unit in UNITS.values():
        assert f'`"{unit.name}"` ({unit.description.split(",")[0]}' in SECTION


def test_elements_are_those_that_are_read() -> None:
    row = re.search(r"\| elements \| (.*) \|", SECTION)
    assert row is not None
    named = re.findall(r"\w+", row[1])
    assert set(named) <= {*SOLIDS, *POINTS}
    assert set(POINTS) <= set(named)


@pytest.mark.parametrize("kind", ["B31", "S4R", "M3D4", "CPS4"])
def test_what_is_refused_is_not_among_the_elements(kind: str) -> None:
    assert kind not in {*SOLIDS, *POINTS}
