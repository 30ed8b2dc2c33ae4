"""OUTPUT4 files: against pyyeti in both directions, against records packed by hand, and files with faults."""

import itertools
import struct

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.errors import FormatError
from updyn.io.nastran.fields import format_field, parse_nastran_real
from updyn.io.nastran.op4 import read_op4, select, write_op4

RNG = np.random.default_rng(4)
LAYOUTS = ("dense", "strings", "bigmat")


def matrices():
    """A symmetric one with gaps, empty columns and numbers of all sizes; a full one; a tall one."""
    A = RNG.standard_normal((9, 9)) * 10.0 ** RNG.integers(-12, 12, (9, 9))
    A[np.abs(A) < 1e-6] = 0.0
    A[:, 4] = A[4] = 0.0
    return {
        "KGG": A + A.T,
        "FULL": RNG.standard_normal((4, 4)),
        "TALL": np.array([[0.0, 1.5], [0, 0], [-2e-300, 0]]),
    }


def assert_same(found, expected, rtol=0.0):
    assert [m.name for m in found] == list(expected)
    for m in found:
        assert m.matrix.shape == expected[m.name].shape
        np.testing.assert_allclose(m.matrix.toarray(), expected[m.name], rtol=rtol, atol=0.0)


@pytest.mark.parametrize(
    ("text", "layout", "big_endian"),
    [
        (t, layout, e)
        for t, layout, e in itertools.product((True, False), LAYOUTS, (True, False))
        if not (t and e)
    ],
)
def test_round_trip_is_exact(tmp_path, text, layout, big_endian):
    given = matrices()
    write_op4(given, tmp_path / "a.op4", text=text, layout=layout, big_endian=big_endian)
    found = read_op4(tmp_path / "a.op4")
    assert_same(found, given)
    assert [m.form for m in found] == [6, 1, 2]


@pytest.mark.parametrize(("text", "layout"), [*itertools.product((True, False), LAYOUTS)])
def test_single_precision_keeps_what_32_bits_hold(tmp_path, text, layout):
    given = {"A": matrices()["FULL"].astype(np.float32).astype(np.float64)}
    write_op4(given, tmp_path / "a.op4", text=text, layout=layout, single=True)
    if text:
        found = read_op4(tmp_path / "a.op4")[0].matrix.toarray().astype(np.float32)
        np.testing.assert_array_equal(found, given["A"].astype(np.float32))
    else:
        assert_same(read_op4(tmp_path / "a.op4"), given)


@pytest.mark.parametrize(
    ("binary", "layout", "endian"),
    [(b, y, e) for b, y, e in itertools.product((True, False), LAYOUTS, "<>") if b or e == "<"],
)
def test_files_of_pyyeti_are_read(tmp_path, binary, layout, endian):
    op4 = pytest.importorskip("pyyeti.nastran.op4")
    given = matrices()
    given["TALL"][2, 0] = -2e-99  # its fields in text have no room for three digits of exponent
    sparse = {"strings": "nonbigmat"}.get(layout, layout)
    op4.write(tmp_path / "p.op4", given, binary=binary, sparse=sparse, endian=endian)
    assert_same(read_op4(tmp_path / "p.op4"), given, 0.0 if binary else 1e-15)


@pytest.mark.parametrize(
    ("single", "text", "layout"), [*itertools.product((True, False), (True, False), LAYOUTS)]
)
def test_pyyeti_reads_ours(tmp_path, single, text, layout):
    op4 = pytest.importorskip("pyyeti.nastran.op4")
    given = {
        k: v.astype(np.float32).astype(float) if single else v
        for k, v in matrices().items()
        if k != "TALL"
    }
    write_op4(
        given, tmp_path / "a.op4", text=text, layout=layout, single=single, big_endian=not text
    )
    found = op4.read(tmp_path / "a.op4", into="dct", justmatrix=True)
    for name, matrix in given.items():
        np.testing.assert_allclose(
            found[name.lower()], matrix, rtol=1e-8 if single and text else 0.0
        )


def test_more_rows_than_one_word_counts(tmp_path):
    A = sp.coo_array(([1.0, 2.0, 3.0], ([0, 65535, 69999], [0, 0, 1])), shape=(70000, 2))
    with pytest.raises(FormatError, match="70000 rows; use 'bigmat' from 65536 rows on"):
        write_op4({"A": A}, tmp_path / "a.op4", layout="strings")
    for text in (True, False):
        write_op4({"A": A}, tmp_path / "a.op4", text=text)
        assert (read_op4(tmp_path / "a.op4")[0].matrix != A.tocsc()).nnz == 0


def words8(order, *records):
    return b"".join(
        struct.pack(order + "i", len(r)) + r + struct.pack(order + "i", len(r)) for r in records
    )


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", [1, 2])
def test_words_of_eight_bytes(tmp_path, order, kind):
    header = struct.pack(order + "4q16s", 2, -3, 2, kind, b"M".ljust(16))
    column = struct.pack(order + "3q2q2d", 1, 0, 4, 3, 2, 5.0, 6.0)
    last = struct.pack(order + "3qd", 3, 1, 1, 1.0)
    (tmp_path / "w.op4").write_bytes(words8(order, header, column, last))
    assert_same(read_op4(tmp_path / "w.op4"), {"M": np.array([[0, 0], [5.0, 0], [6.0, 0]])})


TEXT = """       2       2       6       2KLL     1P,5E16.9
       1       1       2
 2.000000000D+00-1.000000000D+00
       2       2       1
 1.000000000-100
       3       1       1
 1.414213562E+00
"""


def test_text_with_one_triangle_and_fortran_exponents(tmp_path):
    (tmp_path / "t.op4").write_text(TEXT)
    assert_same(read_op4(tmp_path / "t.op4"), {"KLL": np.array([[2.0, -1.0], [-1.0, 1e-100]])})


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "       6       2KLL",
            "       6       4KLL",
            r"t.op4:1: matrix 'KLL' is complex \(type 4\)",
        ),
        (
            "       6       2KLL",
            "       6       7KLL",
            r"t.op4:1: matrix 'KLL': type 7; expected 1",
        ),
        (
            "       2       2       6",
            "       x       2       6",
            r"t.op4:1: .*expected the header of an OUTPUT4 matrix",
        ),
        (
            "-1.000000000D+00",
            "-1.00000x000D+00",
            r"t.op4:3: '-1.00000x000D\+00' is not a number; expected 2 values",
        ),
        (
            "       2       2       1\n",
            "       2       3       1\n",
            r"t.op4:5: .*rows 3 to 3 of column 2; expected 2",
        ),
        (
            "-1.000000000D+00",
            "-1.000000000D+000",
            r"t.op4:3: more than 2 value\(s\) of 16 characters",
        ),
        ("       2       2       6", "999999999       2      6", r"t.op4:1: .*expected"),
        ("1P,5E16.9", "", r"t.op4:1: matrix 'KLL': no format"),
        ("1P,5E16.9", "1P,0E16.9", r"t.op4:1: matrix 'KLL': no numbers fit into the format"),
        ("1P,5E16.9", "1P,5E0.9", r"t.op4:1: matrix 'KLL': no numbers fit into the format"),
        (
            "       1       1       2",
            "       1       1      -2",
            r"t.op4:2: column 1 of matrix 'KLL': -2 words",
        ),
        (
            "       1       1       2",
            "       1       a       2",
            r"t.op4:2: .*expected column, row and number of words",
        ),
        (
            "       3       1       1\n 1.414213562E+00\n",
            "",
            r"t.op4:5: the file ends, expected a column of matrix 'KLL'",
        ),
        (
            "2       1\n 1.000000000-100",
            "1       2\n -4.00000000E+00 1.000000000-100",
            r"\(1, 2\).*differ by 3",
        ),
    ],
)
def test_faults_in_text(tmp_path, old, new, message):
    assert old in TEXT
    (tmp_path / "t.op4").write_text(TEXT.replace(old, new))
    with pytest.raises(FormatError, match=message):
        read_op4(tmp_path / "t.op4")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_cut_of_a_binary_file_is_named(tmp_path, layout):
    write_op4({"A": matrices()["KGG"]}, tmp_path / "a.op4", layout=layout)
    raw = (tmp_path / "a.op4").read_bytes()
    for end in range(5, len(raw), 7):
        (tmp_path / "b.op4").write_bytes(raw[:end])
        with pytest.raises(FormatError, match=r"b.op4: record \d+: "):
            read_op4(tmp_path / "b.op4")


@pytest.mark.parametrize("layout", ["strings", "bigmat"])
def test_every_cut_of_a_text_file_is_named(tmp_path, layout):
    write_op4({"A": matrices()["FULL"]}, tmp_path / "a.op4", text=True, layout=layout)
    lines = (tmp_path / "a.op4").read_text().splitlines(keepends=True)
    for end in range(1, len(lines)):
        (tmp_path / "b.op4").write_text("".join(lines[:end]))
        with pytest.raises(FormatError, match=rf"b.op4:{end}: the file ends"):
            read_op4(tmp_path / "b.op4")


def test_selection_and_names(tmp_path):
    write_op4(matrices(), tmp_path / "a.op4")
    found = read_op4(tmp_path / "a.op4")
    assert select(found, "full", "a.op4").name == "FULL"
    with pytest.raises(FormatError, match=r"a.op4: no matrix 'KGH'; did you mean 'KGG'"):
        select(found, "KGH", "a.op4")
    with pytest.raises(
        FormatError, match=r"holds 3 matrices \(KGG, FULL, TALL\); select one: FILE:NAME"
    ):
        select(found, None, "a.op4")
    with pytest.raises(FormatError, match="matrix name 'K-1'; expected a letter"):
        write_op4({"K-1": np.eye(2)}, tmp_path / "a.op4")
    with pytest.raises(FormatError, match="layout 'bigmatrix'; did you mean 'bigmat'"):
        write_op4(matrices(), tmp_path / "a.op4", layout="bigmatrix")
    with pytest.raises(FormatError, match="of type complex128; expected real"):
        write_op4({"A": np.eye(2) * 1j}, tmp_path / "a.op4")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.5-3", 1.5e-3),
        ("1.5+3", 1500.0),
        ("2.D5", 2e5),
        (".5", 0.5),
        ("7.", 7.0),
        ("-1.E-2", -0.01),
        ("1e3", 1e3),
    ],
)
def test_numbers_of_a_deck(text, value):
    assert parse_nastran_real(text) == value


def test_numbers_that_are_written_come_back():
    for value in RNG.standard_normal(300) * 10.0 ** RNG.integers(-30, 30, 300):
        assert len(format_field(value, 16)) <= 16
        assert parse_nastran_real(format_field(value, 16)) == pytest.approx(value, rel=1e-10)
        assert parse_nastran_real(format_field(value, 8)) == pytest.approx(value, rel=0.05)
    assert [format_field(x, 8) for x in (2.1e11, 0.0, 1.0, -7850.0, 1e-3)] == [
        "2.1+11",
        "0.0",
        "1.0",
        "-7850.0",
        "0.001",
    ]
    for text in ("abc", "1.5e", "", "1.5.2"):
        with pytest.raises(ValueError, match="is not a number"):
            parse_nastran_real(text)
