"""One matrix in the Matrix Market format: a header, the size, then one entry per line.

Every line is checked completely, the entries are counted, and the last line has to end, which
detects truncated numbers. Source: Boisvert, Pozo and Remington, The Matrix Market Exchange Formats,
NISTIR 5935 (1996).
"""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IntArray, RealArray
from updyn.errors import FormatError
from updyn.io.items import unreadable_error
from updyn.io.text_numbers import check_last_line, parse_rows
from updyn.model import Matrix

__all__ = ["has_banner", "read_matrix"]

_BANNER = "%%matrixmarket"  # compared in lower case
_MARK = codecs.BOM_UTF8
_HEADER = "'%%MatrixMarket matrix coordinate real symmetric' or the like"
_LAYOUTS = {"coordinate": 3, "array": 2}  # numbers on the line of the size
_FIELDS = ("real", "double", "integer", "unsigned-integer")
_NOT_FIELDS = {
    "complex": "give damping as loss_factor or viscous",
    "pattern": "a pattern has positions of entries, but no values",
}
_SYMMETRIES = ("symmetric", "general")
_SIZE = re.compile(r"[0-9]{1,15}")


@dataclass(frozen=True, slots=True)
class _MatrixMarketHeader:
    """The lines before the entries."""

    layout: str
    field: str
    symmetry: str
    size: tuple[int, ...]  # rows, columns, and for coordinates the number of entries
    body: bytes
    line: int  # first line of the body


def has_banner(start: bytes) -> bool:
    """Return whether the first bytes of a file identify this format."""
    text = start.removeprefix(_MARK).decode("ascii", "replace")
    return text.lower().startswith(_BANNER)


def read_matrix(path: Path, n: int) -> Matrix:
    """Read a real matrix as CSR, shape (n, n)."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise unreadable_error(path, error) from error
    head = _head(raw, path)
    rows, columns = head.size[:2]
    if rows != columns:
        raise FormatError(f"the matrix is {rows} x {columns}; expected a square matrix", path)
    if rows != n:
        raise FormatError(
            f"the matrix is {rows} x {columns}, but there are {n} degrees of freedom", path
        )
    row, column, values = (_coordinate_entries if head.layout == "coordinate" else _array_entries)(
        head, n, path
    )
    if head.symmetry == "symmetric":
        off = row != column
        values = np.concatenate([values, values[off]])
        row, column = np.concatenate([row, column[off]]), np.concatenate([column, row[off]])
    _check_twice(row * n + column, n, head.symmetry, path)
    return sp.csr_array(sp.coo_array((values, (row, column)), shape=(n, n)))


def _head(raw: bytes, path: Path) -> _MatrixMarketHeader:
    """Split the header, the comments and the line of the size from the text."""
    at = len(_MARK) if raw.startswith(_MARK) else 0
    number = 0
    words: list[str] = []
    while at < len(raw):
        end = raw.find(b"\n", at)
        end = len(raw) if end < 0 else end + 1
        line = raw[at:end]
        number += 1
        at = end
        if number == 1:
            words = _banner(line, path)
        elif line.strip() and not line.startswith(b"%"):
            check_last_line(line, path, number)
            size = _size(line, words[0], path, number)
            return _MatrixMarketHeader(words[0], words[1], words[2], size, raw[at:], number + 1)
    raise FormatError("the file ends before the line of the size: it is truncated", path, number)


def _banner(line: bytes, path: Path) -> list[str]:
    """Return layout, field and symmetry, in lower case."""
    words = line.decode("ascii", "backslashreplace").lower().split()
    if len(words) != 5 or words[0] != _BANNER or words[1] != "matrix":
        raise FormatError(f"found {' '.join(words)[:60]!r}; expected {_HEADER}", path, 1)
    layout, field, symmetry = words[2:]
    if layout not in _LAYOUTS:
        raise FormatError(f"layout {layout!r}; expected {' or '.join(_LAYOUTS)}", path, 1)
    if field not in _FIELDS:
        raise FormatError(
            f"field {field!r}: expected real; {_NOT_FIELDS.get(field, 'numbers are needed')}",
            path,
            1,
        )
    if symmetry not in _SYMMETRIES:
        raise FormatError(f"symmetry {symmetry!r}: expected symmetric or general", path, 1)
    return [layout, field, symmetry]


def _size(line: bytes, layout: str, path: Path, number: int) -> tuple[int, ...]:
    words = line.decode("ascii", "backslashreplace").split()
    count = _LAYOUTS[layout]
    if len(words) != count or not all(map(_SIZE.fullmatch, words)):
        expected = "rows, columns" + (", number of entries" if count == 3 else "")
        raise FormatError(f"found {' '.join(words)[:60]!r}; expected {expected}", path, number)
    return tuple(map(int, words))


_Entries = tuple[IntArray, IntArray, RealArray]


def _coordinate_entries(head: _MatrixMarketHeader, n: int, path: Path) -> _Entries:
    """Return rows and columns (from 0) and entries of the coordinate layout."""
    table = parse_rows(
        head.body, f"ii{_letter(head)}", f"row, column, {_noun(head)}", path, head.line
    )
    _check_count(len(table), head.size[2], "the header states", path)
    at = table[:, :2].astype(np.int64) - 1
    outside = np.flatnonzero(((at < 0) | (at >= n)).any(axis=1))
    if outside.size:
        row, column = (at[outside[0]] + 1).tolist()
        raise FormatError(f"entry ({row}, {column}) is outside of {n} x {n}", path)
    return at[:, 0], at[:, 1], table[:, 2]


def _array_entries(head: _MatrixMarketHeader, n: int, path: Path) -> _Entries:
    """Return rows and columns (from 0) and entries of the array layout, column by column."""
    values = parse_rows(head.body, _letter(head), _noun(head), path, head.line)[:, 0]
    is_triangle = head.symmetry == "symmetric"
    count = n * (n + 1) // 2 if is_triangle else n * n
    _check_count(len(values), count, f"{n} x {n}, {head.symmetry}, has", path)
    if is_triangle:
        column, row = np.triu_indices(n)  # the lower triangle by columns is the upper by rows
    else:
        column, row = np.divmod(np.arange(count), n)
    return row.astype(np.int64), column.astype(np.int64), values


def _letter(head: _MatrixMarketHeader) -> str:
    return "i" if "integer" in head.field else "r"


def _noun(head: _MatrixMarketHeader) -> str:
    return "a whole number of at most 15 digits" if "integer" in head.field else "a number"


def _check_count(found: int, expected: int, says: str, path: Path) -> None:
    if found != expected:
        what = "the file is truncated" if found < expected else "there are too many"
        raise FormatError(f"{found} entries; {says} {expected}: {what}", path)


def _check_twice(keys: IntArray, n: int, symmetry: str, path: Path) -> None:
    order = np.sort(keys)
    twice = np.flatnonzero(np.diff(order) == 0)
    if twice.size:
        i, j = divmod(int(order[twice[0]]), n)
        both = ""
        if symmetry == "symmetric":
            both = "; with the header 'symmetric' only one triangle is stored"
        raise FormatError(f"entry ({i + 1}, {j + 1}) occurs twice{both}", path)
