"""Decks: fields, INCLUDE, coordinate systems against hand-made positions, groups, and decks with faults."""

import time

import numpy as np
import pytest

from updyn.errors import FormatError, InputError
from updyn.io.nastran.bdf import write_deck, write_properties
from updyn.io.nastran.deck import build_geometry, read_deck, values

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
    assert found.select_set("SPC", None) == 1
    assert found.select_set("MPC", None) == 0


def test_positions_and_edges(deck):
    geometry = build_geometry(deck())
    np.testing.assert_array_equal(geometry.nodes, [1, 2, 3, 4])
    np.testing.assert_array_equal(geometry.xyz, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert geometry.lines.tolist() == [[1, 2], [1, 4], [2, 3], [3, 4]]
    assert geometry.faces.tolist() == [[1, 2, 3, 4]]
    assert geometry.axes is None
    np.testing.assert_array_equal(build_geometry(deck(), unit="mm").xyz[2], [1e-3, 1e-3, 0])


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
    geometry = build_geometry(deck(SYSTEMS))
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
        (
            "GRID,1,,0.",
            "GRID,2,,0.",
            r"d.bdf:10: grid|d.bdf:10: GRID 2 is defined twice: also d.bdf:9",
        ),
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
            r"d.bdf:22: '5.' in field 10; expected at most",
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
        build_geometry(deck(DECK.replace(old, new)))


def test_sets_that_are_not_told(deck):
    with pytest.raises(
        FormatError, match=r"SPC sets 1, but case control selects none; select one with spc="
    ):
        deck(DECK.replace("SPC = 1\n", "")).select_set("SPC", None)
    with pytest.raises(FormatError, match=r"no SPC set 2; available: 1"):
        deck().select_set("SPC", 2)
    with pytest.raises(
        FormatError, match=r"d.bdf:5: SPC sets 1, 3 in one deck; select one with spc="
    ):
        deck(DECK.replace("METHOD = 1", "SPC = 3")).select_set("SPC", None)
    assert deck().select_set("SPC", 0) == 0


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
    from updyn.io.nastran.cards import parse, read_lines

    cells = card.replace("\n", "").split(",")
    rows = [cells[1:][i : i + 8] for i in range(0, len(cells) - 1, 8)]
    (tmp_path / "c.bdf").write_text(
        "".join(",".join([cells[0] if not i else "", *r]) + "\n" for i, r in enumerate(rows))
    )
    (found,) = parse(read_lines(tmp_path / "c.bdf"))
    got = values(found)
    assert (got.stiffness, got.mass, got.loss) == (stiffness, mass, loss)


def fields(*cells, width=8):
    return "".join(f"{cell:<{width}}" for cell in cells).rstrip() + "\n"


def positions(found):
    """Return positions by grid, of cards in the basic system."""
    return {number: card.reals((2, 3, 4), 0.0) for number, card in found.grids.items()}


LARGE = (
    f"{'GRID*':<8}{2:<16}{'':<16}{'1.5':<16}{'45.':<16}*A2\n"
    f"{'GRID*':<8}{3:<16}{'':<16}{'1.':<16}{'2.':<16}*A3\n"
    "*A3     3.\n*A2     .5\n"
)


def test_continuations_belong_to_the_line_with_their_mark(deck):
    assert positions(deck(LARGE)) == {2: [1.5, 45.0, 0.5], 3: [1.0, 2.0, 3.0]}
    swapped = (
        "CORD2R,5,,0.,0.,0.,0.,0.,1.,+C1\nCORD2R,6,,9.,0.,0.,9.,0.,1.,+C2\n"
        "+C2,9.,7.,0.\n+C1,1.,0.,0.\nGRID,1,5,1.,0.,0.\nGRID,2,6,1.,0.,0.\n"
    )
    np.testing.assert_allclose(build_geometry(deck(swapped)).xyz, [[1, 0, 0], [9, 1, 0]])
    # The lines of a card are in its order, not in that of the deck.
    card = deck(swapped).cards_named("CORD2R")[0]
    assert [line.number for line in card.lines] == [1, 4]


def test_marks_that_are_used_again_hold_for_the_next_line(deck):
    text = "".join(
        f"CORD2R,{n},,{n}.,0.,0.,{n}.,0.,1.,+A\n+A,{n + 1}.,0.,0.\nGRID,{n},{n},1.,0.,0.\n"
        for n in (5, 6)
    )
    np.testing.assert_allclose(build_geometry(deck(text)).xyz, [[6, 0, 0], [7, 0, 0]])
    # Sequence numbers in field 10 are no marks.
    numbered = fields("GRID", 3, "", "1.", "2.", "3.", "", "", "", "00000001")
    assert positions(deck(numbered)) == {3: [1.0, 2.0, 3.0]}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "GRID,2,,1.5,45.,1.\n+A2,.5\n",
            r"d.bdf:2: continuation '\+A2': no line has this mark in field 10; no line has a mark",
        ),
        (
            fields("GRID", 2, "", "1.", "", "", "", "", "", "+A1") + "+A2     .5\n",
            r"d.bdf:2: continuation '\+A2': .*; did you mean '\+A1'",
        ),
        ("+A,1.\nGRID,1\n", r"d.bdf:1: continuation '\+A'"),
        (",1.\nGRID,1\n", r"d.bdf:1: a continuation without a card before it"),
        (
            LARGE.replace("A3", "A2"),
            r"d.bdf:3: continuation '\*A2': the mark is in field 10 of lines 1, 2 and on 2",
        ),
        (LARGE + "*A2     .7\n", r"d.bdf:4: .*the mark is in field 10 of lines 1 and on 2"),
        (
            "CORD2R,5,,0.,0.,0.,0.,0.,1.,+C1\n,1.,0.,0.\n+C1,1.,0.,0.\n",
            r"d.bdf:3: a second continuation of line 1; the first is line 2",
        ),
        (
            "GRID,1\n" + fields("+X", *[""] * 8, "+Y") + fields("+Y", *[""] * 8, "+X"),
            r"d.bdf:2: the continuation '\+X' continues itself",
        ),
        ("GRID,2,,1.5,45.,1.,,,,\n,7.,8.\n", r"d.bdf:1: GRID 2: field 10 is '7.'; GRID ends with"),
        (
            "CROD,1,2,3,4,5.\n",
            r"d.bdf:1: CROD 1: field 6 is '5.'; CROD ends with field 5",
        ),
        ("MAT1,1,7.+10,,.3,2700.\n,,,,,1.\n", r"MAT1 1: field 14 is '1.'; MAT1 ends with field 13"),
    ],
)
def test_continuations_and_fields_that_belong_to_nothing_are_refused(deck, text, message):
    with pytest.raises(FormatError, match=message):
        deck(text)


REPLICATED = {
    101: [0.0, 1.0, 2.0],
    102: [0.5, 1.0, 2.0],
    103: [1.0, 1.0, 2.0],
    104: [1.5, 1.0, 2.0],
    105: [2.0, 1.0, 2.0],
}


@pytest.mark.parametrize(
    "text",
    [
        "GRID,101,,0.,1.,2.\n=,*1,=,*.5,==\n=(3)\n",
        "GRID,101,,0.,1.,2.\n=,*(1),,*(.5),==\n=3\n",
        fields("GRID", 101, "", "0.0", "1.0", "2.0")
        + fields("=", "*(1)", "=", "*(0.5)", "==")
        + "=3\n",
        "GRID,101,,0.,1.,2.\n=,*1,=,*.5,=,=\n=,*1,,*.5,1.,2.\n=(2)\n",
    ],
)
def test_replicators(deck, text):
    assert positions(deck(text)) == REPLICATED


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("=,*1,==\n", r"d.bdf:1: '=' copies the preceding line; expected a card of one line"),
        ("GRID,1,,1.,2.\n=,*1\n", r"d.bdf:2: field 4 is blank, but '1.' in the preceding line"),
        ("GRID,1\n=,*.5,==\n", r"d.bdf:2: field 2: '1' plus '.5'; expected two integers"),
        ("GRID,1,,1.\n=,*1,,*1,==\n", r"d.bdf:2: field 4: '1.' plus '1'"),
        (
            "GRID,1\n=,%(5),==\n",
            r"d.bdf:2: field 2 is '%\(5\)'; expected =, ==, \*\(x\) or a value",
        ),
        ("GRID,1\n=(4)\n", r"d.bdf:2: '=\(4\)' repeats a copy with increments"),
        ("GRID,1\n=,*1,==\n=100000\n", r"d.bdf:3: more than 100000 copies in a deck"),
        ("GRID,1\n=,*1,==\n=(2),7\n", r"d.bdf:3: '=\(2\),7'; expected ="),
        ("GRID,1\n=,*1,==,5.\n", r"d.bdf:2: == copies all following fields"),
        (
            "CORD2R,5,,0.,0.,0.,0.,0.,1.\n,1.,0.,0.\n=,*1,==\n",
            r"d.bdf:3: '=' copies the preceding line; expected a card of one line",
        ),
        ("GRID*,1,,1.,2.\n=,*1,==\n", r"d.bdf:2: the fields of a copy need the width"),
    ],
)
def test_replicators_that_are_not_read_are_refused(deck, text, message):
    with pytest.raises(FormatError, match=message):
        deck(text)


SPRINGS = """GRID,1
GRID,2
CELAS1,11,1,1,1,2,1
CELAS1,12,2,1,2,2,2
PELAS,1,1000.
=,*1,==
"""


def test_a_changed_card_that_is_copied_leaves_the_copy_as_it_was(deck, tmp_path):
    deck(SPRINGS)
    change = {"PELAS 1": {"stiffness": 3.0}}
    write_deck(change, tmp_path / "d.bdf", tmp_path / "new.bdf")
    found = read_deck(tmp_path / "new.bdf").properties
    assert [found[n].real(1) for n in (1, 2)] == [3000.0, 1000.0]
    with pytest.raises(FormatError, match=r"d.bdf:5: PELAS 1 is copied by a replicator"):
        write_properties(change, tmp_path / "d.bdf", tmp_path / "cards.bdf")


def test_a_field_that_is_too_long_for_large_fields_is_shortened(deck, tmp_path):
    deck(SPRINGS.replace("PELAS,1,1000.", "PELAS,1,1000.,,0.01234567890123456789"))
    write_deck({"PELAS 1": {"stiffness": 3.0}}, tmp_path / "d.bdf", tmp_path / "new.bdf")
    found = read_deck(tmp_path / "new.bdf").properties[1]
    assert found.reals((1, 3)) == pytest.approx([3000.0, 0.0123456789012], rel=1e-9)


def test_include_looks_in_the_folders_of_its_file_and_of_the_main_file(deck, tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "x.inc").write_text("GRID,10\nINCLUDE 'sub/y.inc'")
    (tmp_path / "sub" / "y.inc").write_text("GRID,11\nINCLUDE 'z.inc'\n")
    (tmp_path / "sub" / "z.inc").write_text("GRID,12\n")
    text = "INCLUDE 'sub/x.inc'\n"
    assert sorted(deck(text).grids) == [10, 11, 12]
    assert sorted(deck(text.strip()).grids) == [10, 11, 12]
    (tmp_path / "z.inc").write_text("GRID,13\n")
    with pytest.raises(
        FormatError, match=r"y.inc:2: INCLUDE 'z.inc': found .*sub/z.inc and .*z.inc"
    ):
        deck(text)


def test_include_stays_in_the_folder_to_which_files_are_confined(deck, tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "x.inc").write_text("GRID,10\nINCLUDE '../y.inc'\n")
    (tmp_path / "y.inc").write_text("GRID,11\n")
    monkeypatch.setattr("updyn.foreign.confinement._folders", [tmp_path.resolve()])
    assert sorted(deck("INCLUDE 'sub/x.inc'\n").grids) == [10, 11]
    (tmp_path / "y.inc").unlink()
    with pytest.raises(InputError, match="outside the folder of the project"):
        deck("INCLUDE 'sub/x.inc'\n")


def test_files_that_double_are_refused_soon(deck, tmp_path):
    for n in range(24):
        (tmp_path / f"f{n}.bdf").write_text(f"INCLUDE 'f{n + 1}.bdf'\n" * 2)
    (tmp_path / "f24.bdf").write_text("GRID,1\n")
    start = time.monotonic()
    with pytest.raises(FormatError, match=r"f\d+.bdf:\d: INCLUDE 'f\d+.bdf': nested 20"):
        deck("INCLUDE 'f0.bdf'\n")
    with pytest.raises(FormatError, match=r"more than 100 repeated inclusions"):
        deck("INCLUDE 'f10.bdf'\n")
    assert time.monotonic() - start < 5.0


def test_a_mark_that_all_cards_use_takes_no_longer(deck):
    n = 5_000
    text = "".join(f"CONM2,{k},{k},,1.,,,,,+A\n+A,2.\nGRID,{k}\n" for k in range(1, n + 1))
    start = time.monotonic()
    assert deck(text).elements[-1].real(8) == 2.0
    assert time.monotonic() - start < 10.0


def test_scalar_points_have_a_limit(deck):
    assert len(deck("SPOINT,1,THRU,5\n").points) == 5
    with pytest.raises(FormatError, match=r"d.bdf:1: SPOINT: more than 1000000 scalar points"):
        deck("SPOINT,1,THRU,999999999\n")
