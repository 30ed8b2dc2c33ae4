"""Layout for a width: no line is wider, nothing is lost, tables keep their first column."""

from __future__ import annotations

import re
from collections import Counter

import pytest

from overriding import override
from updyn.cli.layout import fit_text
from updyn.cli.settings import LAYOUT
from updyn.text_table import display_width, fit_columns, text_table

NAMES = ("shaft", "Lagerbock links", "軸受の剛性", "e\u0301crou")
HEADER = ("group", "mass (kg)", "stiffness (N/m)", "loss factor", "change", "MAC", "note")
ROWS = [
    [name, f"{k}.25", f"{k}e6", "0.02", "+1.5 %", "0.999", "a remark of many words on this row"]
    for k, name in enumerate(NAMES)
]


def words(text: str) -> Counter[str]:
    return Counter(text.split())


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_a_table_fits_and_keeps_its_cells(width: int) -> None:
    table = text_table(HEADER, ROWS, left=(0, 6))
    shown = fit_text(table, width)
    assert max(map(display_width, shown.splitlines())) <= width
    # Every part repeats the first column; all other cells are there once.
    parts = shown.split("\n\n")
    assert (len(parts) == 1) == (width == 120)
    again = words(" ".join(["group", *NAMES]))
    extra = Counter({word: n * (len(parts) - 1) for word, n in again.items()})
    assert words(shown) == words(table) + extra
    for part in parts:
        assert [line.split("  ")[0].strip() for line in part.splitlines() if line[0] != " "] == [
            "group",
            *NAMES,
        ]


def test_rows_of_a_part_are_those_of_the_table() -> None:
    table = text_table(HEADER[:6], [row[:6] for row in ROWS], left=(0,))
    first, second = fit_text(table, 60).split("\n\n")
    assert first == text_table(HEADER[:4], [row[:4] for row in ROWS])
    assert second == text_table(("group", *HEADER[4:6]), [[row[0], *row[4:6]] for row in ROWS])


@pytest.mark.parametrize("text", ["", "a\n", "\na", "a\n\n\nb\n\n"])
def test_empty_lines_stay(text: str) -> None:
    assert fit_text(text, 40) == text


def test_a_table_that_fits_is_unchanged() -> None:
    table = text_table(HEADER, ROWS, left=(0, 6))
    assert fit_text(table, max(map(display_width, table.splitlines()))) == table


def test_sentences_are_broken_at_blanks_with_their_indentation() -> None:
    text = "  a sentence of some length in words\nResults/in/one/long/path/stay"
    assert fit_text(text, 20).splitlines() == [
        "  a sentence of some",
        "  length in words",
        "Results/in/one/long/path/stay",
    ]


def test_sentences_in_a_last_column_are_wrapped_in_it() -> None:
    text = (
        "  resembles   yes        6 of 6 peaks have a counterpart\n  converged   not known  short"
    )
    assert fit_text(text, 50).splitlines() == [
        "  resembles  yes        6 of 6 peaks have a",
        "                        counterpart",
        "  converged  not known  short",
    ]


def test_a_long_first_column_is_wrapped_before_a_table_is_split() -> None:
    rows = [["level difference, 95 % of values below (dB)", "12.5", "3.25"], ["FRAC", "0.5", "1"]]
    shown = fit_text(text_table(("agreement", "before", "after"), rows), 50)
    assert shown.splitlines() == [
        "agreement                         before  after",
        "level difference, 95 % of values    12.5   3.25",
        "below (dB)",
        "FRAC                                 0.5      1",
    ]


def test_blank_lines_and_text_around_a_table_stay() -> None:
    text = "A title\n\nname  one  two\na       1    2\n\nThe end"
    assert fit_text(text, 14) == text
    assert (
        fit_text(text, 11) == "A title\n\nname  one\na       1\n\nname  two\na       2\n\nThe end"
    )


@pytest.mark.parametrize(("width", "wrapped"), [(35, True), (34, False)])
def test_the_least_width_of_a_wrapped_column(width: int, wrapped: bool) -> None:
    """24 columns next to a name and an answer of 10; with less, the sentences follow below."""
    assert LAYOUT.least_text_width == 24
    text = "name  yes   a sentence that is long enough for two lines\nmore  no    short"
    first = fit_text(text, width).splitlines()[0]
    assert first.startswith("name  yes  a sentence") is wrapped


@pytest.mark.parametrize(
    ("text", "width"), [("abc", 3), ("軸受", 4), ("e\u0301", 1), ("ä²", 2), ("\u200bx", 1)]
)
def test_columns_of_a_text_on_a_terminal(text: str, width: int) -> None:
    assert display_width(text) == width


def test_columns_are_dropped_in_the_stated_order() -> None:
    header, rows = ("a", "bb", "ccc", "dddd"), [["1", "2", "3", "4"]]
    shown = {}
    for width in range(16, 0, -1):
        found = fit_columns(header, rows, width, ("ccc", "bb"))
        shown[width] = found.splitlines()[0].split()
    assert fit_columns(header, rows, None, ("ccc", "bb")) == text_table(header, rows)
    assert shown[16] == ["a", "bb", "ccc", "dddd"]
    assert shown[15] == shown[11] == ["a", "bb", "dddd"]
    assert shown[10] == shown[7] == shown[1] == ["a", "dddd"]


def test_the_least_width_of_a_wrapped_column_is_a_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "name  yes   a sentence that is long enough for two lines\nmore  no    short"
    override(monkeypatch, LAYOUT, least_text_width=12)
    assert re.match(r"name  yes  a sentence", fit_text(text, 30))
