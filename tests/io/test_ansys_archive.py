"""Archives of Ansys are gone through before a foreign reader sees them: cuts, counts and fields."""

from pathlib import Path

import pytest

from updyn.errors import FormatError
from updyn.io.ansys.archive import check_archive
from updyn.io.ansys.attributes import read_attributes

examples = pytest.importorskip("ansys.mapdl.reader.examples")


@pytest.fixture(scope="module")
def text() -> str:
    return Path(examples.hexarchivefile).read_text()


def test_whole_archives_pass():
    for name in ("hexarchivefile", "sector_archive_file"):
        check_archive(Path(getattr(examples, name)))


def test_every_cut_is_refused(text, tmp_path):
    """All of the last 900 characters, and one in 199 before."""
    path = tmp_path / "cut.cdb"
    end = text.rindex("FINISH")
    for length in (*range(1, end - 900, 199), *range(end - 900, end)):
        path.write_text(text[:length])
        with pytest.raises(FormatError, match=r"cut\.cdb"):
            check_archive(path)


REALS = "RLBLOCK, 1, 4, 8, 7\n(2i8,6g16.9)\n(7g16.9)\n       4       8"
REALS += (
    "".join(f"{value:16.9g}" for value in range(6)) + "\n" + "             7.0             8.0\n"
)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0 1.0000000000000E+000", "0 1.0000000000000E+0x0", "NBLOCK: found .*; expected numbers"),
        ("        2        0", "        2      x 0", "NBLOCK: found .*3 to 3 integers of 9"),
        ("N,R5.3,LOC,       -1,\n", "", "NBLOCK: found 'EBLOCK"),
        ("(19i10)", "(19x10)", r"EBLOCK: found '\(19x10\)'; expected a format such as \(19i10\)"),
        ("(19i10)", "(6e21.13)", r"EBLOCK: found '\(6e21.13\)'; expected a format such as \(19i10\)"),
        ("EBLOCK,19", REALS.replace("(7g16.9)", "(8i10)") + "EBLOCK,19", r"expected a format such as \(7g16.9\)"),
        ("SOLID,        40,        40", "SOLID,        40,        41", "40 elements; .* declares 41"),
        ("SOLID,       321,       321", "SOLID,       321,       320", "321 nodes; .* declares 320"),
        ("         0        20         0", "         0        21         0", r"EBLOCK: found|nodes on"),
        ("         0        20         0", "         0        -1         0", "19 numbers on its first"),
        ("ECOMP1  ,ELEM,       4", "ECOMP1  ,ELEM,       5", "CMBLOCK: found 'CMBLOCK,ECOMP2|says 5"),
        ("ECOMP1  ,ELEM,       4", "ECOMP1  ,ELEM,        ", "CMBLOCK: no number of entities"),
        ("ECOMP1  ,ELEM,       4", "ECOMP1  ,ELEM,       3", "CMBLOCK: 4 entities; its first line declares 3"),
        ("EBLOCK,19", REALS.replace("8.0", "8,0") + "EBLOCK,19", "RLBLOCK: found '7.0 .*8,0'"),
        ("EBLOCK,19", REALS.replace(" 8.0", "") + "EBLOCK,19", "RLBLOCK: found|RLBLOCK: an empty"),
    ],
)  # fmt: skip
def test_faults_are_told(text, tmp_path, old, new, message):
    assert old in text
    path = tmp_path / "bad.cdb"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError, match=rf"bad\.cdb:\d+: .*({message})"):
        read_attributes(path)


def test_an_archive_without_nodes_never_reaches_the_reader(text, tmp_path):
    """Without them ansys-mapdl-reader raises a SystemError."""
    path = tmp_path / "bare.cdb"
    start, end = text.index("NBLOCK"), text.index("EBLOCK")
    path.write_text(text[:start] + text[end:])
    with pytest.raises(FormatError, match=r"bare\.cdb: holds no nodes \(NBLOCK\)"):
        read_attributes(path)


def test_sets_of_real_constants_pass(text, tmp_path):
    path = tmp_path / "reals.cdb"
    path.write_text(text.replace("EBLOCK,19", REALS + "EBLOCK,19"))
    check_archive(path)


def test_a_number_wider_than_its_field_never_reaches_the_reader(text, tmp_path):
    """This one makes ansys-mapdl-reader write beyond its arrays."""
    path = tmp_path / "wide.cdb"
    path.write_text(text.replace("       317       ", "       317" + "1" * 5000 + "       ", 1))
    with pytest.raises(FormatError, match=r"wide\.cdb:\d+: (N|E)BLOCK: "):
        read_attributes(path)
