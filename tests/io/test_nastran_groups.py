"""Groups of Nastran decks merged by name, range, material and set, and their updated cards."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError
from updyn.io.nastran.cards import parse, read_lines
from updyn.io.nastran.fields import NastranLine
from updyn.io.nastran.sets import read_sets

#: Springs between scalar points and the ground, with masses: k by property, rods of two materials.
DECK = """SET 5 = 1 THRU 4 EXCEPT 3, 12
SET 6 = 3
SET 7 = 11, 12,
13
BEGIN BULK
SPOINT,1,2,3
CELAS1,1,21,1
CELAS1,2,21,2
CELAS1,3,22,3
CELAS1,4,23,1,,2
PELAS,21,100.
PELAS,22,200.
PELAS,23,300.
CMASS2,11,1.5,1
CMASS2,12,2.5,2
CMASS2,13,3.5,3
GRID,7,,0.,0.,0.,,123456
GRID,8,,1.,0.,0.,,23456
CROD,31,31,7,8
CROD,32,32,7,8
PROD,31,1,1.-4
PROD,32,2,2.-4
MAT1,1,2.+11,,.3,7850.
MAT1,2,7.+10,,.3,2700.
ENDDATA
"""


@pytest.fixture
def deck(tmp_path) -> Path:
    path = tmp_path / "springs.bdf"
    path.write_text(DECK)
    return path


def sets(text: str) -> list[list[int]]:
    lines = [NastranLine(line, Path("a.bdf"), n) for n, line in enumerate(text.splitlines(), 1)]
    return [sorted(found.select(range(40))) for found in read_sets(lines)]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("SET 1 = 5", [[5]]),
        ("set 1=5,7 THRU 9", [[5, 7, 8, 9]]),
        ("SET 1 = 1 THRU 10 EXCEPT 2, 3, 12", [[1, 4, 5, 6, 7, 8, 9, 10, 12]]),
        ("SET 1 = 1 THRU 3, \n 30,\n31\nSET 2 = 4", [[1, 2, 3, 30, 31], [4]]),
        ("SET 1 = 1\nSET 1 = 2", [[2]]),
        ("SET 1 = ALL\nSET 2 INCLUDE CBAR\nTITLE = SET", []),
    ],
)
def test_sets_of_case_control(text, numbers):
    assert sets(text) == numbers


@pytest.mark.parametrize(
    ("pattern", "members"),
    [
        ("PELAS 22-23", ["PELAS 22", "PELAS 23"]),
        ("MAT1 2", ["PROD 32"]),
        ("SET 7", ["CMASS2 11", "CMASS2 12", "CMASS2 13"]),
        (["SET 6", "CMASS2 13"], ["PELAS 22", "CMASS2 13"]),
        ("SET 5", ["PELAS 21", "PELAS 23", "CMASS2 12"]),
    ],
)
def test_groups_of_a_deck_are_merged(deck, pattern, members):
    model = updyn.read_model(deck, groups={"part": pattern})
    plain = updyn.read_model(deck)
    assert list(model.group("part").origin.members) == members
    assert len(model.groups) == len(plain.groups) - len(members) + 1
    for what in ("stiffness", "mass"):
        whole, before = getattr(model, what), getattr(plain, what)
        np.testing.assert_allclose(whole.toarray(), before.toarray(), rtol=1e-15)


def test_a_set_that_divides_a_property_is_refused(tmp_path):
    path = tmp_path / "springs.bdf"
    path.write_text("SET 9 = 1\n" + DECK)
    with pytest.raises(FormatError, match="'SET 9' contains only a part of group 'PELAS 21'"):
        updyn.read_model(path, groups={"part": "SET 9"})


def test_an_unknown_pattern_names_the_file_and_the_nearest_group(deck):
    with pytest.raises(FormatError, match=r"springs.bdf: groups: a: no group 'PELAS 24-29'; did"):
        updyn.read_model(deck, groups={"a": "PELAS 24-29"})


def test_an_update_of_a_merged_group_writes_the_cards_of_its_members(deck, tmp_path):
    model = updyn.read_model(deck, groups={"springs": "PELAS *", "masses": "SET 7"})
    truth = model.scaled({"springs": {"stiffness": 1.25}, "masses": {"mass": 0.8}})
    freq = np.linspace(0.5, 3.0, 40)
    frf = updyn.response(truth, freq, ["1:X", "2:X", "3:X"], ["1:X", "3:X"], quantity="receptance")
    unknowns = updyn.parameters(model, stiffness="springs", mass="masses")
    result = updyn.update(model, frf, unknowns)
    target = tmp_path / "new.bdf"
    updyn.write_properties(result, deck, target)
    assert result.values["springs.stiffness"] == pytest.approx(1.25, rel=1e-6)
    assert result.values["masses.mass"] == pytest.approx(0.8, rel=1e-6)
    cards = list(parse(read_lines(target)))
    written = {f"{card.name} {card.text(0)}": card.real(1) for card in cards}
    expected = {f"PELAS {n}": 1.25 * k for n, k in ((21, 100.0), (22, 200.0), (23, 300.0))}
    expected |= {f"CMASS2 {n}": 0.8 * m for n, m in ((11, 1.5), (12, 2.5), (13, 3.5))}
    assert written == pytest.approx(expected, rel=1e-6)
