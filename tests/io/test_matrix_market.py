"""Matrix Market through a small TOML file: exact round trip, headers, and messages with file and line."""

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from io_samples import assert_same_model, model
from updyn.errors import FormatError
from updyn.io.matrix_market import read_model, write_model
from updyn.io.matrix_market_file import read_matrix
from updyn.model import Group, Model

K = np.array([[2.0, -1.0], [-1.0, 1.0]])
SYMMETRIC = "%%MatrixMarket matrix coordinate real symmetric\n2 2 3\n1 1 2.0\n2 1 -1.0\n2 2 1.0\n"
GENERAL = (
    "%%MatrixMarket matrix coordinate real general\n% all\n2 2 4\n1 1 2\n2 1 -1\n1 2 -1\n2 2 1\n"
)
ARRAY = "%%MatrixMarket matrix array real general\n2 2\n2\n-1\n-1\n1\n"
INTEGER = "%%MatrixMarket matrix array integer symmetric\n2 2\n2\n-1\n1\n"
TOML = 'dofs = "dofs.csv"\n\n[[group]]\nname = "a"\nstiffness = "K.mtx"\nloss_factor = 0.25\n'


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "dofs.csv").write_text("dof\n1:X\n2:X\n")
    (tmp_path / "K.mtx").write_text(SYMMETRIC)
    (tmp_path / "m.toml").write_text(TOML)
    return tmp_path


@pytest.mark.parametrize("with_geometry", [True, False])
def test_round_trip_is_exact(tmp_path, with_geometry):
    write_model(model(with_geometry), tmp_path / "case.toml")
    assert_same_model(read_model(tmp_path / "case.toml"), model(with_geometry))


def test_written_matrices_are_plain_matrix_market(tmp_path):
    write_model(model(), tmp_path / "case.toml")
    assert scipy.io.mminfo(tmp_path / "case_01_K.mtx")[3:] == ("coordinate", "real", "symmetric")
    stored = sp.csr_array(scipy.io.mmread(tmp_path / "case_01_K.mtx", spmatrix=False)).toarray()
    np.testing.assert_array_equal(stored, model().groups["shaft"].stiffness.toarray())


@pytest.mark.parametrize("matrix", [SYMMETRIC, GENERAL, ARRAY, INTEGER])
def test_headers_of_the_same_matrix(folder, matrix):
    (folder / "K.mtx").write_text(matrix)
    expected = Model.from_groups({"a": Group(K, loss_factor=0.25)}, ["1:X", "2:X"])
    assert_same_model(read_model(folder / "m.toml"), expected)


def test_exponents_of_fortran_are_read(folder):
    text = SYMMETRIC.replace("2.0", "2.0D+05").replace("-1.0", "-1.5d-1").replace("1.0", ".5E+1")
    (folder / "K.mtx").write_text(text.replace("\n", "\r\n"), newline="")
    K = read_model(folder / "m.toml").groups["a"].stiffness.toarray()
    np.testing.assert_array_equal(K, [[2e5, -0.15], [-0.15, 5.0]])


@pytest.mark.parametrize("layout", [sp.coo_array, np.array])
@pytest.mark.parametrize("symmetry", ["symmetric", "general"])
def test_matrices_are_those_that_scipy_reads(tmp_path, layout, symmetry):
    rng = np.random.default_rng(8)
    A = rng.standard_normal((30, 30)) * 10.0 ** rng.integers(-9, 9, (30, 30))
    A[rng.random((30, 30)) < 0.5] = 0.0
    with (tmp_path / "K.mtx").open("wb") as file:
        scipy.io.mmwrite(file, layout(A + A.T), symmetry=symmetry, comment=" two\n% lines")
    expected = sp.coo_array(scipy.io.mmread(tmp_path / "K.mtx", spmatrix=False)).toarray()
    found = read_matrix(tmp_path / "K.mtx", 30).toarray()
    np.testing.assert_array_equal(found, expected)


def test_every_cut_of_a_matrix_is_refused(tmp_path):
    for text in (SYMMETRIC, GENERAL, ARRAY, INTEGER):
        for length in range(len(text)):
            (tmp_path / "K.mtx").write_text(text[:length])
            with pytest.raises(FormatError, match=r"K\.mtx"):
                read_matrix(tmp_path / "K.mtx", 2)


@pytest.mark.parametrize("mark", ["", "\ufeff"])
@pytest.mark.parametrize("header", [str.upper, str.lower, str.title])
def test_the_header_in_any_case_and_behind_a_byte_order_mark(folder, mark, header):
    first, rest = SYMMETRIC.split("\n", 1)
    expected = read_model(folder / "m.toml").stiffness.toarray()
    (folder / "K.mtx").write_text(f"{mark}{header(first)}\n{rest}", encoding="utf-8")
    np.testing.assert_array_equal(read_model(folder / "m.toml").stiffness.toarray(), expected)
    with pytest.raises(FormatError, match="one matrix is not a model"):
        read_model(folder / "K.mtx")


@pytest.mark.parametrize("dofs", ["node,direction\n# two\n1,X\n\n2,X\n", "dof\n1:X\n2:X"])
def test_tables_of_dofs(folder, dofs):
    (folder / "dofs.csv").write_text(dofs)
    assert read_model(folder / "m.toml").dofs.labels == ["1:X", "2:X"]


def test_labels_inline(folder):
    (folder / "m.toml").write_text(TOML.replace('"dofs.csv"', '["4:RX", "5:Z"]'))
    assert read_model(folder / "m.toml").dofs.labels == ["4:RX", "5:Z"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "stiffness",
            "stifness",
            r"m.toml:5: unknown key 'stifness' in \[group\]; did you mean 'stiffness'",
        ),
        ("dofs =", "dof =", r"m.toml:1: unknown key 'dof'; did you mean 'dofs'"),
        (
            '"K.mtx"',
            '"k1.mtx"',
            r"m.toml:5: stiffness: no such file 'k1.mtx'; did you mean 'K.mtx'",
        ),
        (
            '"dofs.csv"',
            '"dof.csv"',
            r"m.toml:1: dofs: no such file 'dof.csv'; did you mean 'dofs.csv'",
        ),
        ('"K.mtx"', "3", r"m.toml:5: stiffness is 3; expected a text"),
        ("0.25", "-1.0", r"m.toml:6: group 'a': loss factor -1.0"),
        ("0.25", '"x"', r"m.toml:6: group 'a': loss factor 'x'"),
        ('name = "a"\n', "", r"m.toml:3: \[\[group\]\] number 1 has no name"),
        ('name = "a"', 'name = "a.b"', r"m.toml: group name 'a.b' holds '.'"),
        ("[[group]]", "[group]", r"m.toml:3: 'group' is not a list of tables; write \[\[group\]\]"),
        ("name = ", "name ", r"m.toml:4: not a TOML file"),
        ('dofs = "dofs.csv"\n', "", r"m.toml: no 'dofs'"),
        (
            "0.25",
            '0.25\n[[group]]\nname = "a"\nmass = "K.mtx"',
            r"m.toml:8: group name 'a' occurs twice",
        ),
        (
            "0.25",
            '0.25\n[[group]]\nname = "b"\nmas = "K.mtx"',
            r"m.toml:9: unknown key 'mas' in \[group\]",
        ),
        ("0.25", "0.25\n[geometry]\nlines = 'l.csv'", r"m.toml:7: \[geometry\] needs nodes"),
    ],
)
def test_entries_of_the_toml_file(folder, old, new, message):
    (folder / "m.toml").write_text(TOML.replace(old, new))
    with pytest.raises(FormatError, match=message):
        read_model(folder / "m.toml")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("dofs.csv", "dof\n1:X\n2:W\n", r"dofs.csv:3: DOF '2:W'"),
        ("dofs.csv", "dof\n1:X\n2:X\n1:X\n", r"dofs.csv:4: DOF 1:X occurs twice: also on line 2"),
        (
            "dofs.csv",
            "label\n1:X\n",
            r"dofs.csv:1: header 'label'; expected 'dof' or 'node,direction'",
        ),
        ("dofs.csv", "node,direction\n1,X\n2\n", r"dofs.csv:3: 1 column\(s\); expected 2"),
        ("dofs.csv", "", r"dofs.csv: the table is empty"),
        (
            "K.mtx",
            SYMMETRIC.replace("2 2 3\n", "2 2 4\n") + "1 2 -1\n",
            r"K.mtx: entry \(1, 2\) occurs twice; with",
        ),
        (
            "K.mtx",
            SYMMETRIC.replace("real", "complex").replace("\n2 2 1.0", " 0\n2 2 1.0 0"),
            "field 'complex'",
        ),
        ("K.mtx", SYMMETRIC.replace("symmetric", "skew-symmetric"), "symmetry 'skew-symmetric'"),
        ("K.mtx", SYMMETRIC.replace("2 2 3", "3 2 3"), "the matrix is 3 x 2"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "x"), "K.mtx:4: found '2 1 x'; expected row, column"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "-1,5"), "K.mtx:4: found '2 1 -1,5'; expected"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "7.12x45"), "K.mtx:4: found '2 1 7.12x45'; expected"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "7e-"), "K.mtx:4: found '2 1 7e-'; expected"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "1.0+5"), "K.mtx:4: found '2 1 1.0.5'; expected"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "nan"), "K.mtx:4: found '2 1 nan'; expected"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "1_0"), "K.mtx:4: found '2 1 1_0'; expected"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "1e999"), "K.mtx:4: .*of a size that a double holds"),
        ("K.mtx", SYMMETRIC.replace("-1.0", "-1.0 2"), "K.mtx:4: found '2 1 -1.0 2'; expected"),
        ("K.mtx", SYMMETRIC.replace("2 1 -", "2.0 1 -"), "K.mtx:4: found '2.0 1 -1.0'; expected"),
        ("K.mtx", SYMMETRIC.replace("2 1 -", "3 1 -"), r"K.mtx: entry \(3, 1\) is outside of 2"),
        ("K.mtx", SYMMETRIC.replace("2 1 -", "0 1 -"), r"K.mtx: entry \(0, 1\) is outside of 2"),
        ("K.mtx", SYMMETRIC.replace("2 1 -", "9" * 5000 + " 1 -"), "K.mtx:4: found '9999"),
        ("K.mtx", SYMMETRIC.replace("2 2 3", "2 2 " + "9" * 5000), "K.mtx:2: found '2 2 9999"),
        (
            "K.mtx",
            SYMMETRIC.replace("2 2 3", "2 2 4"),
            "3 entries; the header states 4: .*truncated",
        ),
        (
            "K.mtx",
            SYMMETRIC.replace("2 2 3", "2 2 2"),
            "3 entries; the header states 2: .*too many",
        ),
        ("K.mtx", SYMMETRIC.replace("2 2 3", "9999999 9999999 3"), "9999999, but there are 2 deg"),
        ("K.mtx", SYMMETRIC[:-1], "K.mtx:5: the last line, '2 2 1.0', does not end: .*truncated"),
        ("K.mtx", SYMMETRIC[:-2], "K.mtx:5: the last line, '2 2 1.', does not end"),
        ("K.mtx", SYMMETRIC[:53], "K.mtx:2: the last line, '2 2 3', does not end"),
        ("K.mtx", SYMMETRIC[:20], "K.mtx:1: found '%%matrixmarket matri'; expected '%%Matrix"),
        ("K.mtx", SYMMETRIC.split("2 2")[0], "ends before the line of the size: it is truncated"),
        ("K.mtx", ARRAY[:-2], "3 entries; 2 x 2, general, has 4: the file is truncated"),
        ("K.mtx", ARRAY.replace("1\n", "1 5\n"), "K.mtx:4: found '-1 5'; expected a number"),
        ("K.mtx", INTEGER.replace("-1", "-1.0"), "K.mtx:4: found '-1.0'; expected a whole number"),
        ("K.mtx", SYMMETRIC.replace("coordinate", "elemental"), "layout 'elemental'; expected"),
    ],
)
def test_files_beside_the_toml_file(folder, name, text, message):
    (folder / name).write_text(text)
    with pytest.raises(FormatError, match=message):
        read_model(folder / "m.toml")


def test_geometry_tables_with_faults(folder):
    (folder / "m.toml").write_text(TOML + '[geometry]\nnodes = "n.csv"\n')
    (folder / "n.csv").write_text("node,x,y,z\n1,0,0,0\n2,0,zero,0\n")
    with pytest.raises(FormatError, match=r"n.csv:3: 'zero' is not a number"):
        read_model(folder / "m.toml")
    (folder / "n.csv").write_text("node,x,y,z\n1,0,0,0\n2.5,0,0,0\n")
    with pytest.raises(FormatError, match=r"n.csv:3: '2.5' is not a whole number"):
        read_model(folder / "m.toml")


def test_a_matrix_alone_is_not_a_model(folder):
    with pytest.raises(
        FormatError, match=r'write a small TOML file.*\[\[group\]\].*stiffness = "K.mtx"'
    ):
        read_model(folder / "K.mtx")
    with pytest.raises(FormatError, match=r"write to 'x.toml' instead"):
        write_model(model(), folder / "x.mtx")


@pytest.mark.parametrize("table", ["[model]", "[test]", "[[parameter]]"])
def test_a_job_is_not_taken_for_a_model(folder, table):
    (folder / "job.toml").write_text(f'title = "Run 3"\n{table}\nfile = "m.toml"\n')
    with pytest.raises(
        FormatError, match=r"job\.toml: looks like a job file .*: updyn check job\.toml$"
    ):
        read_model(folder / "job.toml")
