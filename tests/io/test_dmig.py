"""DMIG: against pyyeti in both directions, fields of all widths, and cards with faults."""

import numpy as np
import pytest

from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.nastran.dmig import read_dmig, write_dmig

DOFS = DofSet(["3:X", "3:RZ", "10:Y", "12345678:Z"])
K = np.array(
    [[2.5e9, -1.25, 0.0, 3.0], [-1.25, 4.0 / 3.0, 0.0, 0.0], [0, 0, 7e-12, 0], [3.0, 0.0, 0.0, 1.0]]
)

SMALL = """$ two springs
DMIG    KAAX           0       6       2       0
DMIG    KAAX           3       1               3       1     2.5        +A
+A            10       2    -1.0
DMIG    KAAX          10       2              10       2     1.0
"""
LARGE = """DMIG    KAAX           0       6       2       0
DMIG*   KAAX                           3               1                +B
*B                     3               1 2.500000000D+00
*                     10               2-1.000000000D+00
DMIG*   KAAX                          10               2
*                     10               2 1.000000000+000
"""
FREE = """dmig,kaax,0,6,1,0
dmig,kaax,3,1,,3,1,2.5,
,10,2,-1.
DMIG,KAAX,10,2,,10,2,1.$ the last
"""
TITLED = "TITLE   = PUNCH\n$TITLE\n" + LARGE.replace(
    "       6       2", "       1       2"
).replace(
    "*                     10               2 1.0",
    "*                      3               1-1.000000000D+00\n*                     10            "
    "   2 1.0",
)
SPRINGS = np.array([[2.5, -1.0], [-1.0, 1.0]])


@pytest.mark.parametrize(
    "text", [SMALL, LARGE, FREE, TITLED], ids=["small", "large", "free", "square"]
)
def test_fields_of_all_widths(tmp_path, text):
    (tmp_path / "k.pch").write_text(text)
    (found,) = read_dmig(tmp_path / "k.pch")
    assert found.name == "KAAX"
    assert found.dofs.labels == ["3:X", "10:Y"]
    np.testing.assert_array_equal(found.matrix.toarray(), SPRINGS)


def test_continuations_out_of_order(tmp_path):
    lines = SMALL.splitlines(keepends=True)
    (tmp_path / "k.pch").write_text("".join([*lines[:3], lines[4], lines[3]]))
    (found,) = read_dmig(tmp_path / "k.pch")
    np.testing.assert_array_equal(found.matrix.toarray(), SPRINGS)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("dmig,kaax,0,6,1,0", "dmig,kaax,0,6,1,0,1", r"k.pch:1: DMIG KAAX: POLAR is 1, amplitude"),
        ("dmig,kaax,0,6,1,0", "dmig,kaax,0,6,1,0,,2", r"k.pch:1: .*field 8 of the header is '2'"),
        ("dmig,kaax,0,6,1,0", "dmig,kaax,0,6,1,0,,,2\n,3", r"k.pch:1: .*field 10 of the header"),
        ("3,1,2.5", "3,1,2.5,.1", r"k.pch:2: DMIG KAAX: field 9 is '.1', an imaginary part"),
        ("3,1,,3,1,2.5", "3,1,9,3,1,2.5", r"k.pch:2: DMIG KAAX: field 5 is '9'; expected blank"),
    ],
)
def test_what_makes_another_matrix_is_refused(tmp_path, old, new, message):
    assert old in FREE
    (tmp_path / "k.pch").write_text(FREE.replace(old, new))
    with pytest.raises(FormatError, match=message):
        read_dmig(tmp_path / "k.pch")


def test_round_trip(tmp_path):
    write_dmig({"KSTEEL": K, "m1": np.eye(4)}, DOFS, tmp_path / "k.pch")
    stiffness, mass = read_dmig(tmp_path / "k.pch")
    assert (stiffness.name, mass.name) == ("KSTEEL", "M1")
    assert stiffness.dofs == mass.dofs == DOFS
    np.testing.assert_allclose(stiffness.matrix.toarray(), K, rtol=1e-10)
    np.testing.assert_array_equal(mass.matrix.toarray(), np.eye(4))


def test_order_of_the_dofs_is_free(tmp_path):
    dofs = DofSet(["10:Y", "3:RZ", "3:X", "12345678:Z"])
    write_dmig({"K": K}, dofs, tmp_path / "k.pch")
    (found,) = read_dmig(tmp_path / "k.pch")
    at = found.dofs.match(dofs).index
    np.testing.assert_allclose(found.matrix.toarray()[np.ix_(at, at)], K, rtol=1e-10)


def test_pyyeti_reads_ours(tmp_path):
    bulk = pytest.importorskip("pyyeti.nastran.bulk")
    write_dmig({"KSTEEL": K}, DOFS, tmp_path / "k.pch")
    found = bulk.rddmig(str(tmp_path / "k.pch"))["ksteel"]
    assert list(found.index) == [(3, 1), (3, 6), (10, 2), (12345678, 3)]
    np.testing.assert_allclose(found.to_numpy(), K, rtol=1e-10)


def test_files_of_pyyeti_are_read(tmp_path):
    bulk = pytest.importorskip("pyyeti.nastran.bulk")
    pd = pytest.importorskip("pandas")
    index = pd.MultiIndex.from_tuples([(3, 1), (3, 6), (10, 2), (12345678, 3)], names=["id", "dof"])
    bulk.wtdmig(str(tmp_path / "k.pch"), {"ksteel": pd.DataFrame(K, index=index, columns=index)})
    (found,) = read_dmig(tmp_path / "k.pch")
    assert found.dofs == DOFS
    np.testing.assert_allclose(found.matrix.toarray(), K, rtol=1e-9)  # it writes ten digits


def test_rectangular_matrices_of_a_punch_file_are_passed_over(tmp_path):
    load = "DMIG    VAX            0       9       2       0                       1\n"
    load += "DMIG*   VAX                            1               0\n"
    load += "*                      3               1 1.000000000D+00\n"
    begin = (
        "BEGIN SUPER     111\nEXTRN   10      123456\nGRID    10              1.      0.      0.\n"
    )
    (tmp_path / "k.pch").write_text(begin + SMALL + load)
    passed_over = "k.pch: passed over: rectangular matrix VAX, EXTRN cards, GRID cards"
    with pytest.warns(UpdynWarning, match=passed_over):
        (found,) = read_dmig(tmp_path / "k.pch")
    assert found.name == "KAAX"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "       6       2       0",
            "       6       4       0",
            r"k.pch:2: DMIG KAAX: type 4 \(complex",
        ),
        (
            "       6       2       0",
            "       9       2       0",
            r"k.pch: only rectangular matrices \(form 9\): KAAX; expected form 1",
        ),
        (
            "DMIG    KAAX           0",
            "DMIG    KAAY           0",
            r"k.pch:3: DMIG KAAX: a column without a header",
        ),
        ("+A            10       2", "+B            10       2", "k.pch:4: contin"),
        (
            "      10       2     1.0",
            "      10       7     1.0",
            r"k.pch:5: DMIG: component 7 of grid 10",
        ),
        (
            "      10       2     1.0",
            "      10       2     1.x",
            r"k.pch:5: DMIG: field 8 is '1.X'; expected a number",
        ),
        (
            "              10       2     1.0",
            "               3       1    -2.0",
            r"declared symmetric .*entry \(3:X, 10:Y\) is -2 and its mirror entry -1",
        ),
        (
            "10       2              10       2     1.0",
            " 3       1               3       1     1.0",
            r"entry \(3:X, 3:X\) occurs twice",
        ),
        ("$ two springs", "CBAR,1", "k.pch:1: CBAR: expected only DMIG cards"),
        (
            "$ two springs",
            "DMIG,KAAX,0,6,2",
            "k.pch:2: DMIG KAAX: a second header; the first is on line 1",
        ),
        ("$ two springs", "DMIG,1K,0,6,2", "k.pch:1: DMIG: field 2 is '1K'; expected a name"),
        ("$ two springs", "+,1", "k.pch:1: a continuation without a card before it"),
    ],
)
def test_faults(tmp_path, old, new, message):
    assert old in SMALL
    (tmp_path / "k.pch").write_text(SMALL.replace(old, new, 1))
    with pytest.raises(FormatError, match=message):
        read_dmig(tmp_path / "k.pch")


@pytest.mark.parametrize(
    ("matrices", "dofs", "message"),
    [
        ({"K 1": np.eye(4)}, DOFS, "matrix name 'K 1'; expected a letter"),
        ({"K": np.eye(3)}, DOFS, r"matrix 'K' is \(3, 3\); expected 4 rows"),
        ({"K": np.triu(np.ones((4, 4)))}, DOFS, "matrix 'K' is not symmetric"),
        ({"K": np.eye(1)}, DofSet(["0:X"]), "node 0; expected grid numbers from 1"),
    ],
)
def test_what_cannot_be_written_leaves_the_old_file(tmp_path, matrices, dofs, message):
    (tmp_path / "k.pch").write_text("old")
    with pytest.raises(FormatError, match=message):
        write_dmig(matrices, dofs, tmp_path / "k.pch")
    assert (tmp_path / "k.pch").read_text() == "old"


def test_a_file_without_dmig(tmp_path):
    (tmp_path / "k.pch").write_text("$ nothing\n")
    with pytest.raises(FormatError, match="no DMIG header card"):
        read_dmig(tmp_path / "k.pch")
