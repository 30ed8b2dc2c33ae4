"""New properties as an Ansys input file: every number is read back by the few lines below and compared."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import updyn
from updyn.errors import FormatError, OptionError
from updyn.io.ansys.properties import read_deck

DECK = """\
/COM,ANSYS RELEASE 2024 R2           BUILD 24.2
/PREP7
ET,1,SOLID186
ET,2,COMBIN14
ET,3,21
KEYOPT,3,3,0
MP,EX,1,2.1e11 $ MP,PRXY,1,0.3 $ mp,dens,1,7850 ! steel
MP,BETD,1,2e-5
MPTEMP,R5.0, 2, 1,  20.0    , 120.0,
MPDATA,R5.0, 2,EX  ,       2, 1, 7.0E+10, 6.5E+10,
MPTEMP,R5.0, 1, 1,  0.00000000    ,
MPDATA,R5.0, 1,DENS,       2, 1,  2700.00000    ,
MPDATA,R5.0, 1,GXY ,       2, 1,  2.6E10    ,
MP,EX,3,E_RUBBER
MP,DENS,3,1100
MP,EX,4,1e9
TB,ELASTIC,5,1,2
MP,EX,5,1.0e9
R,7,1.5e6,20.0
RLBLOCK,       2,       9,       8,       7
(2i8,6g16.9)
(7g16.9)
       8       6  2.50000000      2.50000000      2.50000000     0.100000000     0.100000000     0.100000000
       9       8  1.00000000E+7   2.00000000E+7   0.00000000      0.00000000      50.0000000      60.0000000
  0.00000000      0.00000000
EBLOCK,19,SOLID,         3,         3
(19i10)
         1         2         7         1         0         0         0         0         2         0         1         5         6
         1         3         8         1         0         0         0         0         1         0         2         5
         1         1         1         1         0         0         0         0        20         0         3         1         2         3         4         5         6         7         8
         9        10        11        12        13        14        15        16        17        18        19        20
        -1
MP,EX,6,2.0e9,,-1e3
TB,ELASTIC,10,1,2
FINISH
"""


@pytest.fixture
def deck(tmp_path) -> Path:
    out = tmp_path / "arm.cdb"
    out.write_text(DECK)
    return out


def written(changes, deck: Path, **options) -> str:
    out = deck.parent / "new.inp"
    updyn.write_properties(changes, deck, out, **options)
    return out.read_text()


def commands(text: str) -> list[tuple[str, ...]]:
    """Return the commands of a file, comments left out."""
    lines = [line.split("!")[0].strip() for line in text.splitlines()]
    return [tuple(f.strip() for f in line.split(",")) for line in lines if line]


def numbers(fields) -> list[float]:
    return [float(f) for f in fields]


def test_modulus_and_density(deck):
    text = written({"material 1": {"stiffness": 1.1, "mass": 0.9}}, deck)
    has = {c[1]: float(c[3]) for c in commands(text) if c[0] == "MP" and c[2] == "1"}
    # BETD M K: the stiffness is 1.1 times as large, and C is to stay.
    assert has == pytest.approx({"EX": 2.31e11, "DENS": 7065.0, "BETD": 2e-5 / 1.1}, rel=1e-15)
    assert "! old EX (line 7): 210000000000.0" in text
    assert "PRXY" not in text
    assert "/INPUT,new,inp" in text


def test_a_table_over_temperature(deck):
    out = commands(written({"material 2": {"stiffness": 0.5}}, deck))
    at = out.index(("MPTEMP",))
    assert out[at + 1][:2] == ("MPTEMP", "1")
    assert numbers(out[at + 1][2:]) == [20.0, 120.0]
    assert out[at + 2][:4] == ("MPDATA", "EX", "2", "1")
    assert numbers(out[at + 2][4:]) == [3.5e10, 3.25e10]
    assert ("MP", "GXY", "2", "13000000000.0") in out  # the shear modulus goes along
    assert not any("DENS" in c for c in out)


def test_viscous_damping_of_a_material(deck):
    out = commands(written({"material 1": {"viscous": 1.5, "stiffness": 2.0}}, deck))
    assert {c[1]: float(c[3]) for c in out} == pytest.approx(
        {"EX": 4.2e11, "BETD": 2e-5 * 1.5 / 2.0}
    )


@pytest.mark.parametrize(
    ("release", "label", "value"),
    [
        ("2024 R2", "DMPS", 0.03),
        ("2019 R2", "DMPR", 0.015),
        ("18.2", "DMPR", 0.015),
        ("15.0", "DMPR", 0.015),
    ],
)
def test_loss_factor(deck, release, label, value):
    """2 g K by DMPR in the older releases, g K by DMPS in the newer."""
    deck.write_text(DECK.replace("2024 R2", release))
    out = commands(written({"material 4": {"loss_factor": 0.03}}, deck))
    assert out == [("MP", label, "4", repr(value))]


def test_a_damping_ratio_that_stands_in_the_way(deck):
    deck.write_text(DECK.replace("MP,EX,4,1e9", "MP,EX,4,1e9\nMP,DMPR,4,0.02"))
    text = written({"material 4": {"loss_factor": 0.03}}, deck)
    assert commands(text) == [("MP", "DMPR", "4", "0.0"), ("MP", "DMPS", "4", "0.03")]
    assert "! old DMPR (line 17): 0.02" in text


def test_springs_and_masses(deck):
    out = commands(
        written({"real 7": {"stiffness": 1.2, "viscous": 0.5}, "real 8": {"mass": 1.1}}, deck)
    )
    assert out[0][:2] == ("R", "7")
    assert numbers(out[0][2:]) == pytest.approx([1.8e6, 10.0], rel=1e-15)
    assert out[1][:2] == ("R", "8")
    assert numbers(out[1][2:]) == pytest.approx([2.75, 2.75, 2.75, 0.11, 0.11, 0.11], rel=1e-15)


def test_a_routine_of_too_many_digits_is_none_that_is_known(deck):
    deck.write_text(DECK.replace("ET,1,SOLID186", f"ET,1,SOLID186\nET,9,{'1' * 5000}"))
    assert read_deck(deck).types[9] == 0


def test_more_than_six_constants(deck):
    """A bearing: K11 K22 K12 K21, then C11 C22 C12 C21, the last two of them on a line of their own."""
    deck.write_text(
        DECK.replace("ET,1,SOLID186", "ET,1,SOLID186\nET,4,214").replace(
            "         1         1         1", "         1         4         9", 1
        )
    )
    assert read_deck(deck).reals[9].values[:2] == ("1.00000000E+7", "2.00000000E+7")
    out = commands(written({"real 9": {"stiffness": 2.0, "viscous": 3.0}}, deck))
    assert out[0][:2] == ("R", "9")
    assert numbers(out[0][2:]) == [2e7, 4e7, 0.0, 0.0, 150.0, 180.0]
    assert out[1][0] == "RMORE"
    assert numbers(out[1][1:]) == [0.0, 0.0]


def test_later_definitions_count(deck):
    deck.write_text(DECK + "/PREP7\nMP,EX,1,1.0e11\nR,7,5.0\n")
    out = commands(written({"material 1": {"stiffness": 3.0}, "real 7": {"stiffness": 3.0}}, deck))
    assert ("MP", "EX", "1", "300000000000.0") in out
    assert ("R", "7", "15.0") in out


def test_constants_that_are_modified_count(deck):
    """RMODIF from a place on; a blank leaves what stands there."""
    deck.write_text(DECK + "/PREP7\nRMODIF,7,1,2.0e6\nRMODIF,8,2,3.0,,0.2\nRMODIF,7,4,0.5\n")
    out = commands(
        written({"real 7": {"stiffness": 1.5, "viscous": 2.0}, "real 8": {"mass": 10.0}}, deck)
    )
    assert out[0] == ("R", "7", "3000000.0", "40.0", "", "0.5")
    assert numbers(out[1][2:]) == pytest.approx([25.0, 30.0, 25.0, 2.0, 1.0, 1.0], rel=1e-15)


@pytest.mark.parametrize("command", ["RMODIF,7,1000000000000,1.0", "MPDATA,EX,2,-3,1.0"])
def test_places_that_are_none_are_refused(deck, command):
    deck.write_text(DECK + command + "\n")
    with pytest.raises(
        FormatError, match=r"arm\.cdb:36: numbers from position -?\d+ on; expected 1"
    ):
        read_deck(deck)


def test_a_table_that_is_modified_counts(deck):
    """MPDATA from the second place on; a place that is skipped has no number."""
    deck.write_text(DECK + "MPTEMP\nMPTEMP,1,20.0,120.0,220.0\nMPDATA,EX,2,2,6.0e10,5.0e10\n")
    out = commands(written({"material 2": {"stiffness": 0.5}}, deck))
    at = out.index(("MPTEMP",))
    assert numbers(out[at + 1][2:]) == [20.0, 120.0, 220.0]
    assert numbers(out[at + 2][4:]) == [3.5e10, 3.0e10, 2.5e10]


def test_of_an_update(deck):
    """The values of a result, as they are."""
    import numpy as np

    K, M = np.diag([4.0e6, 1.0e6]), np.diag([10.0, 5.0])
    start = updyn.Model.from_groups(
        {"material 1": updyn.Group(K, M, 0.02), "real 7": updyn.Group([[0, 0], [0, 3e6]])},
        ["1:X", "2:X"],
    )
    frf = updyn.response(
        start.scaled({"real 7": {"stiffness": 1.3}}),
        np.linspace(20, 250, 40),
        ["1:X", "2:X"],
        ["2:X"],
    )
    result = updyn.update(
        start, frf, updyn.parameters(start, stiffness=["real 7"]), noise={"relative": 1e-5}
    )
    out = deck.parent / "new.inp"
    updyn.write_properties(result, deck, out)
    value = result.values["real 7.stiffness"]
    assert value == pytest.approx(1.3, rel=1e-5)
    assert float(commands(out.read_text())[0][2]) == 1.5e6 * value


def test_the_deck_that_the_program_wrote(tmp_path):
    examples = pytest.importorskip("ansys.mapdl.reader.examples", reason="needs updyn[ansys]")
    out = tmp_path / "new.inp"
    updyn.write_properties(
        {"material 1": {"stiffness": 1.25, "mass": 0.5}}, Path(examples.hexarchivefile), out
    )
    assert commands(out.read_text()) == [
        ("MP", "EX", "1", "87500000000.0"),
        ("MP", "DENS", "1", "1350.0"),
    ]
    found = read_deck(examples.hexarchivefile)
    assert found.release == 2019.2
    assert found.types == {1: 186}
    assert found.users == {1: {1}}
    assert found.materials[1]["NUXY"].values == ("0.350000000",)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"material 9": {"stiffness": 1.1}},
            "no properties of 'material 9' .MP, MPDATA; R, RLBLOCK.; did you mean",
        ),
        ({"steel": {"stiffness": 1.1}}, r"has no properties of 'steel' \(a component"),
        ({"real 3": {"stiffness": 1.1}}, "has no properties of 'real 3'"),
        (
            {"material 3": {"stiffness": 1.1}},
            r"arm.cdb:14: EX of material 3 is 'E_RUBBER'; expected a number",
        ),
        ({"material 4": {"mass": 1.1}}, r"arm.cdb:16: material 4 has no DENS to change; it has EX"),
        (
            {"material 6": {"stiffness": 1.1}},
            "arm.cdb:33: EX of material 6 is ''; expected a number",
        ),
        (
            {"material 10": {"stiffness": 1.1}},
            r"arm.cdb:34: material 10 has a table \(TB\)",
        ),
        (
            {"material 10": {"mass": 1.1}},
            r"arm.cdb:34: material 10 has no DENS to change; it has a table \(TB\) only",
        ),
        ({"material 2": {"viscous": 1.1}}, "material 2 has no ALPD or BETD"),
        ({"material 5": {"stiffness": 1.1}}, r"arm.cdb:17: material 5 has a table \(TB\)"),
        ({"real 7": {"mass": 1.1}}, r"arm.cdb:19: real 7: COMBIN14 has no mass"),
        ({"real 7": {"loss_factor": 0.1}}, "COMBIN14 has no loss factor"),
        ({"real 8": {"stiffness": 2.0}}, "MASS21 has no stiffness"),
        ({"real 9": {"stiffness": 2.0}}, "its constants belong to elements COMBIN14, MASS21"),
        ({"material 1": {"stifness": 1.1}}, "no quantity 'stifness'; did you mean 'stiffness'"),
        ({"material 1": {"stiffness": 0.0}}, "stiffness 0.0; expected a finite number above 0"),
        (
            {"material 1": {"loss_factor": -0.1}},
            "loss_factor -0.1; expected a finite number of at least 0",
        ),
    ],
)
def test_what_cannot_be_written(deck, changes, said):
    with pytest.raises(FormatError, match=said):
        written(changes, deck)
    assert not (deck.parent / "new.inp").exists()


def test_the_deck_beside_the_model(deck, tmp_path):
    """A job names the .emat; what is written goes by the .cdb beside it."""
    header = b"d\0\0\0\0\0\0\x80\x02\0\0\0"
    (tmp_path / "arm.emat").write_bytes(header)
    text = written({"material 1": {"stiffness": 2.0}}, tmp_path / "arm.emat")
    assert ("MP", "EX", "1", "420000000000.0") in commands(text)
    (tmp_path / "leg.emat").write_bytes(header)
    with pytest.raises(FormatError, match=r"leg.cdb .* is not in the same folder"):
        written({"material 1": {"stiffness": 2.0}}, tmp_path / "leg.emat")


def test_other_suffixes_are_told(deck):
    other = deck.rename(deck.with_suffix(".dat"))
    assert "EX" in written({"material 1": {"stiffness": 1.1}}, other, format="ansys")
    with pytest.raises(OptionError, match="is the deck itself"):
        updyn.write_properties({"material 1": {"stiffness": 1.1}}, other, other, format="ansys")


def test_a_binary_file_is_refused(tmp_path):
    (tmp_path / "job.cdb").write_bytes(bytes(500))
    with pytest.raises(FormatError, match="is a binary file"):
        updyn.write_properties(
            {"material 1": {"stiffness": 1.1}}, tmp_path / "job.cdb", tmp_path / "new.inp"
        )


def test_a_block_that_is_cut_short(deck):
    deck.write_text(re.split(r"       9       8", DECK)[0])
    with pytest.raises(FormatError, match="RLBLOCK: ends before its last set"):
        written({"material 1": {"stiffness": 1.1}}, deck)


def test_elements_out_of_their_columns(deck):
    deck.write_text(
        DECK.replace("         1         2         7", "         1         2        7a")
    )
    with pytest.raises(
        FormatError, match=r"arm.cdb:28: EBLOCK: found .* integers of 10 characters"
    ):
        written({"material 1": {"stiffness": 1.1}}, deck)


@pytest.mark.parametrize(
    "line",
    [
        "MP",
        "MPDATA",
        "MPTEMP",
        "R",
        "RMORE",
        "ET",
        "TB",
        "KEYOPT",
        "MP,EX",
        "/COM,ANSYS RELEASE 19.2.1",
    ],
)
def test_commands_without_their_arguments(deck, line):
    """Of no use, and no harm to the others."""
    deck.write_text(line + "\n" + DECK)
    assert ("MP", "EX", "4", "2000000000.0") in commands(
        written({"material 4": {"stiffness": 2.0}}, deck)
    )


PLAIN = "/PREP7\nET,1,185\nET,2,14\nMP,EX,1,1.E11\nMP,DENS,1,7850\nMP,EX,2,2.E11\nR,4,1000.\n"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("MPCOPY,,2,1", "MPCOPY copies a material"),
        ("mpco,,2,1", "MPCO copies a material"),
        ("MPCHG,2,1", "MPCHG changes the material of elements"),
        ("*DO,I,1,2\nMP,EX,I,2.E11\n*ENDDO", "arm.cdb:9: MP is within"),
        ("*IF,A,EQ,1,THEN\nMP,EX,1,1.E11\n*ELSE\nMP,EX,1,2.E11\n*ENDIF", "MP is within"),
        (
            "*IF,A,EQ,1,THEN\n*IF,B,EQ,1,THEN\n*ENDIF\nMPDATA,EX,1,1,2.E11\n*ENDIF",
            "MPDATA is within",
        ),
        ("*IF,A,EQ,1,:over\nMP,EX,1,3.E11\n:over", r"\*IF without THEN skips commands"),
        ("*GO,:over\nMP,EX,1,3.E11\n:over", r"\*GO skips commands"),
        ("*CREATE,steel,mac\nMP,EX,1,3.E11\n*END", "MP is within"),
        ("*USE,steel.mac", r"\*USE runs a macro"),
        ("steel", "STEEL is not a known command"),
        ("steel,1,2", "arm.cdb:8: STEEL is not a known command"),
        ("%name%,1", "%NAME% is not a known command"),
        ("/INPUT,more,inp", "/INPUT reads commands from another file"),
        ("/inp,more", "/INP reads commands from another file"),
        ("RESUME,old,db", "RESUME reads a database"),
        ("CDREAD,DB,old,cdb", "CDREAD reads a model"),
        ("/CLEAR", "/CLEAR clears the database"),
        ("/EOF\nMP,EX,1,2.E11", "arm.cdb:8: /EOF ends the deck, but commands follow"),
        ("/EXIT,NOSAVE\nMP,EX,1,2.E11", "/EXIT ends the deck"),
        ("MPREAD,steel,mp", "MPREAD reads a material"),
        ("UIMP,1,EX,DENS,NUXY,2.E11,7850,.3", "UIMP sets a material"),
        ("MP,EX,1,", "MP,EX has no value"),
        ("MP,EX,MATID,2.E11", "EX refers to material 'MATID'"),
        ("MPDATA,EX,MATID,1,2.E11", "EX refers to material 'MATID'"),
        ("MPDELE,EX,MATID", "MPDELE refers to material 'MATID'"),
        ("MPTGEN,1,3,20.,10.", "MPTGEN changes the table of temperatures"),
        ("MPTEMP,T1,20.", "MPTEMP starts at 'T1'"),
        ("MP,EX,3,2.E11\n*REPEAT,3,0,-1", r"\*REPEAT repeats MP"),
        ("NUMMRG,ALL", "NUMMRG renumbers properties"),
        ("NUMCMP,MAT", "NUMCMP renumbers properties"),
        ("EMODIF,ALL,MAT,2", "EMODIF changes the attributes"),
        ("TB,ELAS,MATID", "TB refers to material 'MATID'"),
    ],
)
def test_commands_that_may_change_a_material_are_refused(deck, more, message):
    deck.write_text(PLAIN + more + "\nFINISH\n")
    with pytest.raises(FormatError, match=message + ".*: properties of materials are not known"):
        written({"material 1": {"stiffness": 2.0}}, deck)
    assert not (deck.parent / "new.inp").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ("R,TID,5.", "R,TID has no known number"),
        ("RMODIF,TID,1,5.", "RMODIF,TID has no known number"),
        ("RDELE,4", "RDELE deletes real constants"),
        ("ETCHG,ETI", "ETCHG changes element types"),
        ("*DO,I,1,4\nR,I,5.\n*ENDDO", "R is within"),
        ("/INPUT,more", "/INPUT reads commands"),
    ],
)
def test_commands_that_may_change_real_constants_are_refused(deck, more, message):
    deck.write_text(PLAIN + more + "\nFINISH\n")
    with pytest.raises(FormatError, match=message + ".*: real constants are not known"):
        written({"real 4": {"stiffness": 2.0}}, deck)
    if "INPUT" not in more:
        assert ("MP", "EX", "1", "200000000000.0") in commands(
            written({"material 1": {"stiffness": 2.0}}, deck)
        )


@pytest.mark.parametrize(
    "more",
    [
        "*IF,_CDRDOFF,EQ,1,THEN\n_CDRDOFF=\n*ELSE\nNUMOFF,NODE,40\n*ENDIF",
        "*SET,T_PAR,-1\nE1 = 2.E11\n:CDWRITE",
        "*VWRITE,A(1)\n(F10.3)\n*MSG,INFO,A\nMP of %G &\nMP,EX,1,9.E11",
        "NUMMRG,NODE\nNUMCMP,ELEM\nN,1,0.,0.\n*REPEAT,3,1,1.",
        "SECTYPE,1,BEAM,RECT\nSECBLOCK,2\n0.5,1.\n.5,2.\nACEL,0,0,9.81\nMPLIST\nALLSEL,ALL",
        "*DO,I,1,3\nN,I,I\n*ENDDO\n/SOLU\nANTYPE,MODAL\nMODOPT,LANB,10\nSOLVE\nFINISH\n/POST1\nSET,1,1",
        "MP,EX,7,",
        "C*** MP,EX,1,9.E11\n/COM, MP,EX,1,8.E11\n! MP,EX,1,7E11\n/EOF\n! the end\n",
    ],
)
def test_commands_that_leave_properties_as_they_are(deck, more):
    deck.write_text("/COM,ANSYS RELEASE 2019 R2\n" + PLAIN + more + "\n")
    assert commands(written({"material 1": {"stiffness": 2.0, "mass": 3.0}}, deck)) == [
        ("MP", "EX", "1", "200000000000.0"),
        ("MP", "DENS", "1", "23550.0"),
    ]


def test_deleted_properties_have_nothing_to_change(deck):
    deck.write_text(PLAIN + "MPDELE,EX,1\n")
    with pytest.raises(FormatError, match="material 1 has no EX to change; it has DENS"):
        written({"material 1": {"stiffness": 2.0}}, deck)
    deck.write_text(PLAIN + "MPDELE,ALL,1,2\nMP,EX,2,5.E10\n")
    assert list(read_deck(deck).materials) == [2]
    assert commands(written({"material 2": {"stiffness": 2.0}}, deck)) == [
        ("MP", "EX", "2", "100000000000.0")
    ]
    deck.write_text(PLAIN + "MPDELE,EX,ALL\n")
    assert read_deck(deck).materials == {1: read_deck(deck).materials[1], 2: {}}


def test_forms_of_newer_releases(deck):
    deck.write_text(
        "/PREP7\nETBLOCK,        2,        2\n(2i9,19a9)\n        1      185        0\n"
        "        2       14        0\n       -1\nR,4,1000.\n"
        "MPTEMP,UNBL,1, 1,  0.00000000    ,\nMPDATA,UNBL,1,EX,   1, 1,  2.05E5,\n"
    )
    out = commands(written({"material 1": {"stiffness": 2.0}, "real 4": {"stiffness": 3.0}}, deck))
    assert out == [("MP", "EX", "1", "410000.0"), ("R", "4", "3000.0")]
    assert read_deck(deck).types == {1: 185, 2: 14}


def test_a_component_that_is_cut_short_hides_no_commands(deck):
    deck.write_text(
        PLAIN + "CMBLOCK,TIP,ELEM,20\n(8i10)\n         1         2\nMP,EX,1,9.E11\nFINISH\n"
    )
    with pytest.raises(
        FormatError, match=r"arm.cdb:11: CMBLOCK: found 'MP,EX,1,9.E11'; expected 20"
    ):
        written({"material 1": {"stiffness": 2.0}}, deck)
