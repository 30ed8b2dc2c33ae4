"""Decks: fields, INCLUDE, coordinate systems against hand-made positions, groups, and decks with faults."""

import numpy as np
import pytest

from updyn.errors import FormatError
from updyn.io.nastran.deck import geometry_of, read_deck, values

DECK = """SOL 103
CEND
TITLE = frame
SPC = 1
METHOD = 1
BEGIN BULK
$ the frame
EIGRL,1,,,4
GRID,1,,0.,0.,0.
GRID    2               1.0     0.0     0.0
GRID*                  3                             1.0             1.0
*                    0.0
grid,4,,.0,1.+0,0.
CBAR,11,1,1,2,0.,0.,1.
CBAR,12,1,2,3,0.,0.,1.
CQUAD4,13,2,1,2,3,4
CELAS1,14,3,1,1,2,1
CONM2,15,3,,2.5
PBAR,1,1,1.-4,1.-8,1.-8,2.-8
PSHELL,2,1,0.01,1,,1
PELAS,3,1000.,0.02,,4,10.
MAT1,1,2.1+11,,0.3,7850.,,,0.01
SPC1,1,123456,1,4
ENDDATA
nothing here
"""


@pytest.fixture
def deck(tmp_path):
    def make(text=DECK, **options):
        (tmp_path / "d.bdf").write_text(text)
        return read_deck(tmp_path / "d.bdf", **options)

    return make


def test_groups_are_properties(deck):
    found = deck()
    assert list(found.groups) == ["PBAR 1", "PSHELL 2", "PELAS 3", "CONM2 15"]
    assert found.group("PSHELL 2").lines[0].number == 20
    assert found.selected("SPC", None) == 1
    assert found.selected("MPC", None) == 0


def test_positions_and_edges(deck):
    geometry = geometry_of(deck())
    np.testing.assert_array_equal(geometry.nodes, [1, 2, 3, 4])
    np.testing.assert_array_equal(geometry.xyz, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert geometry.lines.tolist() == [[1, 2], [1, 4], [2, 3], [3, 4]]
    assert geometry.faces.tolist() == [[1, 2, 3, 4]]
    assert geometry.axes is None
    np.testing.assert_array_equal(geometry_of(deck(), unit="mm").xyz[2], [1e-3, 1e-3, 0])


SYSTEMS = """CORD2R,1,0,1.,2.,3.,1.,2.,4.,
,1.,3.,3.
CORD2C,2,0,0.,0.,0.,0.,0.,1.,
,1.,0.,0.
CORD2S,3,1,0.,0.,0.,0.,0.,1.,+S
+S,1.,0.,0.
CORD1R,4,10,11,12,5,10,12,11
GRDSET,,2,,,,1
GRID,1,1,1.,2.,3.,0
GRID,2,2,2.,90.,5.,2
GRID,3,3,2.,90.,90.,3
GRID,4,,1.,180.,0.
GRID,5,4,1.,0.,0.,5
GRID,10,,0.,0.,0.
GRID,11,0,0.,0.,2.
GRID,12,0,0.,3.,0.
"""


def test_coordinate_systems(deck):
    geometry = geometry_of(deck(SYSTEMS))
    # System 1 stands at (1, 2, 3) with its x along Y, its z along Z, so y along -X.
    expected = {
        1: [1 - 2, 2 + 1, 3 + 3],
        2: [0, 2, 5],
        # in system 3, along its y (90 degrees from the pole, turned by 90): 2 along -X
        3: [1 - 2, 2, 3],
        4: [-1, 0, 0],
        # system 4: z from 10 to 11 is Z, x towards 12 is Y
        5: [0, 1, 0],
        10: [0, 0, 0],
        11: [0, 0, 2],
        12: [0, 3, 0],
    }
    np.testing.assert_allclose(geometry.xyz, [expected[n] for n in geometry.nodes], atol=1e-12)
    turned = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    axes = dict(zip(geometry.nodes.tolist(), geometry.axes, strict=True))
    np.testing.assert_allclose(
        axes[1], np.eye(3), atol=1e-12
    )  # a zero is no empty field: no default of GRDSET
    np.testing.assert_allclose(axes[4], turned, atol=1e-12)
    np.testing.assert_allclose(
        axes[2], [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12
    )  # radial Y, tangential -X
    np.testing.assert_allclose(axes[3], [[-1, 0, 0], [0, 0, -1], [0, -1, 0]], atol=1e-12)
    # system 5: z from 10 to 12 is Y, x towards 11 is Z
    np.testing.assert_allclose(axes[5], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12)


def test_included_files(deck, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "grids.bdf").write_text("GRID,1,,0.,0.,0.\ninclude 'more.bdf'\n")
    (tmp_path / "parts" / "more.bdf").write_text("GRID,2,,1.,0.,0.\n")
    assert sorted(deck('INCLUDE "parts/\n   grids.bdf"\nGRID,3,,1.,1.,1.\n').grids) == [1, 2, 3]
    (tmp_path / "parts" / "more.bdf").write_text("$\nINCLUDE 'grid.bdf'\n")
    with pytest.raises(
        FormatError, match=r"more.bdf:2: INCLUDE: no such file 'grid.bdf'; did you mean 'grids.bdf'"
    ):
        deck("INCLUDE parts\\grids.bdf\n")
    (tmp_path / "parts" / "more.bdf").write_text("INCLUDE 'grids.bdf'\n")
    with pytest.raises(
        FormatError, match=r"more.bdf:1: INCLUDE 'grids.bdf': the file includes itself"
    ):
        deck("INCLUDE 'parts/grids.bdf'\n")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("CQUAD4,13", "CQUAD5,13", r"d.bdf:16: card CQUAD5 is not known.*did you mean 'CQUAD"),
        (
            "CQUAD4,13,2,1,2,3,4",
            "CQUAD4,13,2,1,2,3,7",
            r"d.bdf:16: CQUAD4 13: no grid 7; nearest: 2, 3, 4",
        ),
        (
            "CBAR,12,1,",
            "CBAR,12,2,",
            r"d.bdf:15: CBAR 12: property 2 is a PSHELL; expected PBAR or PBARL",
        ),
        (
            "CBAR,12,1,",
            "CBAR,12,5,",
            r"d.bdf:15: CBAR 12: no property 5; nearest: 3, 4, 2|nearest: 2, 3, 4",
        ),
        ("PBAR,1,1,", "PBAR,1,9,", r"d.bdf:19: PBAR 1: no material 9 among MAT1, MAT2.*nearest: 1"),
        ("GRID,1,,0.", "GRID,2,,0.", r"d.bdf:10: grid|d.bdf:10: GRID 2 stands twice: also d.bdf:9"),
        (
            "1.0     0.0     0.0",
            "1.x     0.0     0.0",
            r"d.bdf:10: GRID: field 4 is '1.X'; expected a number",
        ),
        ("GRID,1,,0.", "GRID,1,8,0.", r"d.bdf:9: GRID 1: no coordinate system 8"),
        (
            "SPC1,1,123456,1,4",
            "SPC1,1,123456,1,9",
            r"d.bdf:23: SPC1: field 5 names grid 9; nearest: 2, 3, 4",
        ),
        (
            "MAT1,1,2.1+11,,0.3,7850.,,,0.01",
            "MAT1,1,2.1+11,,0.3,7850.,,,0.01,5.",
            r"d.bdf:22: '5.' in field 10; at most",
        ),
        (
            "SPC1,1,",
            "MPC,5,1,1,1.,77,1,1.\nSPC1,1,",
            r"d.bdf:23: MPC: field 6 names grid 77; nearest",
        ),
        (
            "SPC1,1,",
            "RBE3,5,,1,123,1.,123,2,3,\n,66\nSPC1,1,",
            r"d.bdf:23: RBE3: field 10 names grid 66; nearest",
        ),
        (
            "SPC1,1,",
            "RBE2,5,1,123,2,3,55,.01\nSPC1,1,",
            r"d.bdf:23: RBE2: field 7 names grid 55; nearest",
        ),
    ],
)
def test_faults(deck, old, new, message):
    assert old in DECK
    with pytest.raises(FormatError, match=message):
        geometry_of(deck(DECK.replace(old, new)))


def test_sets_that_are_not_told(deck):
    with pytest.raises(
        FormatError, match=r"SPC sets 1, but case control selects none; say which with spc="
    ):
        deck(DECK.replace("SPC = 1\n", "")).selected("SPC", None)
    with pytest.raises(FormatError, match=r"no SPC set 2; there are: 1"):
        deck().selected("SPC", 2)
    with pytest.raises(
        FormatError, match=r"d.bdf:5: SPC sets 1, 3 in one deck; say which with spc="
    ):
        deck(DECK.replace("METHOD = 1", "SPC = 3")).selected("SPC", None)
    assert deck().selected("SPC", 0) == 0


def test_cards_left_out(deck):
    text = DECK.replace("CONM2", "CVISC,20,5,1,2\nCONM2")
    with pytest.raises(FormatError, match=r'd.bdf:18: card CVISC is not known.*ignore=\["CVISC"\]'):
        deck(text)
    assert "CONM2 15" in deck(text, ignore=["cvisc"]).groups


@pytest.mark.parametrize(
    ("card", "stiffness", "mass", "loss"),
    [
        ("PBARL,1,1,,BOX,,,,,.1,.1,.01,.01,.5", (), (12,), ()),
        ("PBEAM,1,1,1.,1.,1.,,1.,7.,1.,0.,,,,,,,YES,1.,1.,1.,1.,,1.,8.", (), (7, 23, 36, 37), ()),
        ("PBEAM,1,1,1.,1.,1.,,1.,7.,NO,1.,1.,1.,1.,,1.,8.", (), (7, 15, 20, 21), ()),
        ("PBUSH,1,K,1.,2.,,,,5.,,GE,.1", (2, 3, 7), (), (10,)),
    ],
)
def test_fields_that_hold_stiffness_mass_and_damping(tmp_path, card, stiffness, mass, loss):
    from updyn.io.nastran.cards import lines_of, parse

    cells = card.replace("\n", "").split(",")
    rows = [cells[1:][i : i + 8] for i in range(0, len(cells) - 1, 8)]
    (tmp_path / "c.bdf").write_text(
        "".join(",".join([cells[0] if not i else "", *r]) + "\n" for i, r in enumerate(rows))
    )
    (found,) = parse(lines_of(tmp_path / "c.bdf"))
    got = values(found)
    assert (got.stiffness, got.mass, got.loss) == (stiffness, mass, loss)
