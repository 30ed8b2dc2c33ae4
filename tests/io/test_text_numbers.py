"""Numbers in texts are read whole or refused, and no text whose last line is cut is taken for a whole one."""

import re

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError
from updyn.io.text_numbers import check_last_line, parse_integer, parse_real, parse_rows


@pytest.mark.parametrize(
    ("text", "value"),
    [("1", 1.0), (" -1.5 ", -1.5), (".5", 0.5), ("+2.", 2.0), ("1e3", 1000.0), ("2.5D-01", 0.25), ("3d+2", 300.0)],
)  # fmt: skip
def test_numbers_as_programs_write_them(text, value):
    assert parse_real(text) == value


@pytest.mark.parametrize(
    "text", ["", "1_0", "1,5", "1.5x", "1e", "7e-", "nan", "inf", "0x10", "1e999", "1 2", "\u0661", "1.0+5"]
)  # fmt: skip
def test_other_texts_are_no_numbers(text):
    with pytest.raises(ValueError, match="number"):
        parse_real(text)
    with pytest.raises(ValueError, match="number"):
        parse_integer(text)


def test_whole_numbers_fit_64_bits():
    assert parse_integer("-999999999999999999") == 1 - 10**18
    for text in ("1" * 19, "9" * 5000, "1.0", "1e3"):
        with pytest.raises(ValueError, match="is not a whole number"):
            parse_integer(text)


def test_rows_with_comments_commas_and_empty_lines():
    raw = b"* all\n1, 2,3.5D1\n\n 4 5 -6\r\n 7,8, 9,\n"
    rows = parse_rows(raw, "iir", "a row", "f", commas=True, comment=b"*")
    np.testing.assert_array_equal(rows, [[1, 2, 35.0], [4, 5, -6.0], [7, 8, 9.0]])


@pytest.mark.parametrize("raw", [b"", b"\n", b" \n\t\n", b"* all\n\n"])
def test_blank_lines_are_no_rows(raw):
    assert parse_rows(raw, "iir", "a row", "f", comment=b"*").shape == (0, 3)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"1 2 3\n1 2\n", "f:11: found '1 2'; expected a row"),
        (b"1 2 3\n\n1 2 3 4\n", "f:12: found '1 2 3 4'; expected a row"),
        (b"1 2 3\n1,2,3\n", "f:11: found '1,2,3'; expected a row"),
        (b"1 2 3\n* 5\n", "f:11: found '* 5'; expected a row"),
        (b"1 2 3\n1 2 1e400\n", "f:11: found '1 2 1e400'; expected a row, of a size that a double"),
        (b"1 2 3\n1 2 3", "f:11: the last line, '1 2 3', does not end"),
        (b"1 2 3\n\xff\x00 2 3\n", r"f:11: found '\xff\x00 2 3'; expected a row"),
    ],
)
def test_the_first_line_that_is_no_row_is_told(raw, message):
    with pytest.raises(FormatError, match=re.escape(message).replace("xff", ".{0,2}xff")):
        parse_rows(raw, "iir", "a row", "f", 10)


def test_last_lines():
    check_last_line("a\n", "f")
    check_last_line("a\r\n", "f")
    check_last_line("", "f")
    check_last_line("a\n# b", "f", harmless=re.compile(rb"#.*"))
    with pytest.raises(FormatError, match=r"f:2: the last line, 'b', does not end: .*truncated"):
        check_last_line("a\nb", "f", harmless=re.compile(rb"#.*"))


@pytest.mark.parametrize(
    ("name", "text", "read"),
    [
        ("n.csv", "node,x,y,z\n1,0,0,0\n2,0,0,1.25\n", updyn.read_geometry),
        ("f.csv", "# quantity: mobility\nfreq_Hz,H(1:X/1:X) re,H(1:X/1:X) im\n1,2,3.25\n", updyn.read_frf),
        ("d.bdf", "BEGIN BULK\nGRID,1,,0.,0.,0.\nGRID,2,,0.,0.,1.25\n", updyn.read_geometry),
    ],
)  # fmt: skip
def test_a_table_cut_within_its_last_number_is_refused(tmp_path, name, text, read):
    (tmp_path / name).write_text(text)
    whole = read(tmp_path / name)
    assert whole is not None
    for length in (1, 2, 3):
        (tmp_path / name).write_text(text[:-length])
        with pytest.raises(FormatError, match=r"the last line, .*, does not end"):
            read(tmp_path / name)
