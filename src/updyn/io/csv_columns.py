"""FRFs from selected columns of a text table of any layout, the option ``columns``.

The mapping is that of `updyn.io.channels`: a column is the name in the header or a number from 1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError, OptionError
from updyn.frf import FRF
from updyn.io.channels import check_keys, read_channels, read_frequency
from updyn.io.csv_table import SEPARATORS, Line, TextTable, find_table
from updyn.io.csv_text import (
    EXCITATION,
    Comments,
    check_comments,
    comment,
    read_averages,
    read_decay,
    read_excitation,
    single_comment,
)
from updyn.io.items import read_windows_text, require_file
from updyn.io.named import build_frf
from updyn.io.text_numbers import check_last_line

__all__ = ["find_stated_table", "read_columns"]

_KEYS = ("frequency", "frequency_unit", "unit", "separator", "first_row", "channels")
_COMMENTS = ("quantity", "averages", "decay", "source", *EXCITATION)


def read_columns(
    path: str | Path, columns: Mapping[str, object], *, quantity: str | None, real_valued: bool
) -> FRF:
    """Read FRFs from the columns that a mapping selects."""
    key = ("columns",)
    check_keys(columns, _KEYS, ("frequency", "channels"), key)
    text = read_windows_text(require_file(path))
    check_last_line(text, path)
    table = find_stated_table(text, path, columns)
    freq = read_frequency(
        table,
        columns["frequency"],
        columns.get("frequency_unit"),
        (*key, "frequency"),
        (*key, "frequency_unit"),
    )
    _check_order(freq, table)
    items = read_channels(table, columns, key)
    comments = _read_comments(table.preamble, columns, path)
    items |= {"freq": freq, "source": "\n".join(v for _, v in comments.get("source", []))}
    stated = single_comment(comments, "quantity", path)
    by_unit = items.get("quantity")
    if stated is not None and by_unit not in (None, stated):
        raise FormatError(
            f"quantity {stated!r} contradicts the unit of the values, of {by_unit}", path
        )
    if stated is not None:
        items["quantity"] = stated
    if quantity is None and "quantity" not in items:
        raise FormatError(
            "states no quantity; state quantity ('accelerance', 'mobility', 'receptance' or"
            " 'transmissibility'), or unit in columns, such as 'g/N'",
            path,
            key=("quantity",),
        )
    averages, decay = read_averages(comments, path), read_decay(comments, path)
    items |= {"decay": decay} if averages is None else {"decay": decay, "averages": averages}
    items |= read_excitation(comments, path)
    return build_frf(items, path, quantity=quantity, real_valued=real_valued)


def find_stated_table(text: str, path: str | Path, columns: Mapping[str, object]) -> TextTable:
    """Return the table of a text, with the separator and the first row of a mapping if stated."""
    separator, first_row = columns.get("separator"), columns.get("first_row")
    if separator not in (None, *SEPARATORS):
        raise OptionError(
            f"columns.separator = {separator!r}: expected ';', a tab, ',' or a blank",
            key=("columns", "separator"),
        )
    if first_row is not None and (type(first_row) is not int or first_row < 1):
        raise OptionError(
            f"columns.first_row = {first_row!r}: expected the number of a line, from 1",
            key=("columns", "first_row"),
        )
    table = find_table(text, path, separator, first_row)
    if table is None:
        stated = next((key for key in ("separator", "first_row") if key in columns), "")
        where = f" by columns.{stated}" if stated else ""
        raise FormatError(
            f"no table{where}: expected at least two lines with the same columns",
            path,
            key=("columns", stated) if stated else (),
        )
    return table


def _check_order(freq: RealArray, table: TextTable) -> None:
    """Refuse frequencies that do not increase."""
    wrong = np.flatnonzero(np.diff(freq) <= 0.0)
    if wrong.size:
        at = int(wrong[0])
        raise FormatError(
            f"{freq[at + 1]:g} Hz does not exceed {freq[at]:g} Hz; lines must increase",
            table.path,
            table.line(at + 1),
            key=("columns", "frequency"),
        )


def _read_comments(
    preamble: Sequence[Line], columns: Mapping[str, Any], path: str | Path
) -> Comments:
    """Return the known values in the comments above the table, by name.

    Units and scales there are refused, because they may apply to any column, unless the mapping
    states the units.
    """
    found: Comments = {}
    for number, line in preamble:
        stated = comment(line)
        if stated is not None and stated[0] in _COMMENTS:
            found.setdefault(stated[0], []).append((number, stated[1].strip()))
    has_unit = all("unit" in channel for channel in columns["channels"]) or "unit" in columns
    if not (has_unit and "frequency_unit" in columns):
        lines = [(number, _as_comment(line)) for number, line in preamble]
        check_comments(lines, (), "state frequency_unit and unit in columns", path)
    return found


def _as_comment(line: str) -> str:
    """Return a line above the table as a comment ``# NAME: VALUE``."""
    text = line.strip().lstrip("#%").strip()
    cells = [cell.strip() for cell in text.replace("\t", ";").split(";") if cell.strip()]
    if len(cells) == 2 and ":" not in cells[0]:
        return f"# {cells[0]}: {cells[1]}"
    return f"# {text}"
