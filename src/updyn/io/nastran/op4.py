"""OUTPUT4 files: matrices as Nastran's DMAP module OUTPUT4 writes them, in text or binary.

Layout: MSC Nastran DMAP Programmer's Guide. A file has a header, then one record per column, then a
record of the column after the last. A column is dense, from its first to its last entry, or a
sequence of strings (row, length, values) whose header is one word (rows up to 65535) or two (big
matrix, marked by a negative number of rows). Words have 4 or 8 bytes in either byte order.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Literal, Protocol, TypeAlias, TypeVar

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IndexArray, NumberArray, RealArray
from updyn.errors import FormatError, suggest
from updyn.io.atomic import atomic_path
from updyn.io.nastran.fields import parse_nastran_real
from updyn.io.settings import MATRIX_FILE
from updyn.io.text_numbers import parse_integer

__all__ = [
    "EntryCollector",
    "Layout",
    "OP4Matrix",
    "check_header",
    "complete_triangles",
    "read_op4",
    "select",
    "write_op4",
]

#: Storage of a column: from first to last entry, or as strings with headers of one or two words.
Layout: TypeAlias = Literal["dense", "strings", "bigmat"]

RECTANGULAR, SYMMETRIC = 2, 6
#: From this number of rows on, the header of a string has two words, independent of the sign of the
#: number of rows.
ROWS_OF_BIGMAT = 65536
_SQUARE = 1
_NAME = re.compile(r"[A-Z][A-Z0-9]{0,7}")


@dataclass(frozen=True, slots=True, eq=False)
class OP4Matrix:
    """One matrix of an OUTPUT4 file, csc_array, in the units of the program that wrote it.

    `form` is 1 square, 2 rectangular, 3 diagonal, 6 symmetric, 8 identity, ... as stated in the
    file.
    """

    name: str
    matrix: sp.csc_array
    form: int


def read_op4(path: str | Path) -> list[OP4Matrix]:
    """Read all matrices of an OUTPUT4 file, with both triangles of a symmetric one (form 6)."""
    path = Path(path)
    with path.open("rb") as file:
        start = file.read(8)
    if not start:
        raise FormatError("the file is empty", path)
    order = _byte_order(start)
    found = _read_text(path) if order is None else _read_binary(path, *order)
    return [
        OP4Matrix(name, complete_triangles(path, name, matrix, form), form)
        for name, matrix, form in found
    ]


class NamedMatrix(Protocol):
    """A matrix with a name."""

    @property
    def name(self) -> str:
        """The name, upper case."""


NamedMatrixT = TypeVar("NamedMatrixT", bound=NamedMatrix)


def select(matrices: Iterable[NamedMatrixT], name: str | None, path: str | Path) -> NamedMatrixT:
    """Return the matrix with this name, or the only matrix if `name` is None."""
    matrices = list(matrices)
    names = [m.name for m in matrices]
    if name is None:
        if len(matrices) != 1:
            raise FormatError(
                f"holds {len(matrices)} matrices ({', '.join(names)}); select one: FILE:NAME", path
            )
        return matrices[0]
    if names.count(name.upper()) > 1:
        raise FormatError(f"matrix {name!r} occurs {names.count(name.upper())} times", path)
    if name.upper() not in names:
        raise FormatError(f"no matrix {name!r}; {suggest(name.upper(), names)}", path)
    return matrices[names.index(name.upper())]


def write_op4(
    matrices: Mapping[str, Any],
    path: str | Path,
    *,
    text: bool = False,
    layout: Layout = "bigmat",
    single: bool = False,
    big_endian: bool = False,
) -> None:
    """Write matrices to an OUTPUT4 file, binary or text, with exact numbers unless `single`.

    A name is a letter, then up to 7 letters and digits. Layout "strings" is for up to 65535 rows.
    """
    path = Path(path)
    if layout not in ("dense", "strings", "bigmat"):
        raise FormatError(
            f"layout {layout!r}; {suggest(str(layout), ('dense', 'strings', 'bigmat'))}", path
        )
    if not matrices:
        raise FormatError("no matrix to write", path)
    ready = [_check_matrix(name, given, path, layout) for name, given in matrices.items()]
    with atomic_path(path) as temporary:
        if text:
            _write_text(ready, temporary, layout, single)
        else:
            _write_binary(ready, temporary, layout, single, ">" if big_endian else "<")


def runs(rows: IndexArray) -> list[tuple[int, int]]:
    """Return start and end (past the last) of runs of consecutive numbers in ascending `rows`."""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    edges = [0, *breaks.tolist(), len(rows)]
    return list(pairwise(edges))


def check_header(
    path: Path, where: int | None, name: str, columns: int, rows: int, kind: int
) -> None:
    """Refuse sizes and types that no real matrix has."""
    most = MATRIX_FILE.most_rows
    if not (1 <= columns <= most and 1 <= abs(rows) <= most):
        raise FormatError(
            f"matrix {name!r}: {columns} columns and {abs(rows)} rows; expected 1 to {most}",
            path,
            where,
        )
    if kind in (3, 4):
        raise FormatError(
            f"matrix {name!r} is complex (type {kind}); expected real: give damping as loss"
            " factors or viscous matrices",
            path,
            where,
        )
    if kind not in (1, 2):
        raise FormatError(
            f"matrix {name!r}: type {kind}; expected 1 (single) or 2 (double precision)",
            path,
            where,
        )


class EntryCollector:
    """Collects the entries of a matrix as they are read, and checks their positions."""

    def __init__(self, path: Path, name: str, rows: int, columns: int) -> None:
        self._path, self._name, self.shape = path, name, (rows, columns)
        self._rows: list[IndexArray] = []
        self._columns: list[IndexArray] = []
        self._values: list[RealArray] = []

    def add(self, row: int, column: int, values: Any, line: int | None = None) -> None:
        """Add consecutive values of a column; rows and columns are counted from 1."""
        if not (
            1 <= column <= self.shape[1] and row >= 1 and row + len(values) - 1 <= self.shape[0]
        ):
            raise FormatError(
                f"matrix {self._name!r}: an entry in rows {row} to {row + len(values) - 1} of"
                f" column {column}; expected {self.shape[0]} rows and {self.shape[1]} columns",
                self._path,
                line,
            )
        self._rows.append(np.arange(row - 1, row - 1 + len(values)))
        self._columns.append(np.full(len(values), column - 1))
        self._values.append(np.asarray(values, dtype=np.float64))

    def matrix(self) -> sp.csc_array:
        """Return the sparse matrix of the entries."""
        if not self._values:
            return sp.csc_array(self.shape, dtype=np.float64)
        rows = np.concatenate(self._rows)
        columns = np.concatenate(self._columns)
        values = np.concatenate(self._values)
        keep = values != 0.0
        if not np.isfinite(values).all():
            raise FormatError(
                f"matrix {self._name!r} holds a number that is not finite", self._path
            )
        key = np.sort(columns[keep] * self.shape[0] + rows[keep])
        twice = np.flatnonzero(np.diff(key) == 0)
        if twice.size:
            column, row = divmod(int(key[twice[0]]), self.shape[0])
            raise FormatError(
                f"matrix {self._name!r}: entry ({row + 1}, {column + 1}) occurs twice", self._path
            )
        return sp.csc_array(
            sp.coo_array((values[keep], (rows[keep], columns[keep])), shape=self.shape)
        )


def complete_triangles(path: Path, name: str, matrix: sp.csc_array, form: int) -> sp.csc_array:
    """Return both triangles of a matrix of form 6; refuse one that is not symmetric."""
    if form != SYMMETRIC:
        return matrix
    if matrix.shape[0] != matrix.shape[1]:
        raise FormatError(
            f"matrix {name!r} is {matrix.shape[0]} x {matrix.shape[1]} but declared symmetric",
            path,
        )
    lower = sp.tril(matrix, -1)
    upper = sp.triu(matrix, 1)
    if bool(lower.nnz) != bool(upper.nnz):
        return sp.csc_array(matrix + (lower + upper).T)
    difference = sp.coo_array(abs(matrix - matrix.T))
    if difference.nnz and difference.max() > 1e-6 * abs(matrix).max():
        worst = int(np.argmax(difference.data))
        i = int(difference.row[worst]) + 1
        j = int(difference.col[worst]) + 1
        raise FormatError(
            f"matrix {name!r} is declared symmetric (form 6), but entries ({i}, {j}) and ({j},"
            f" {i}) differ by {difference.data[worst]:.3g}",
            path,
        )
    return matrix


def _check_matrix(name: str, given: Any, path: Path, layout: Layout) -> OP4Matrix:
    if _NAME.fullmatch(name.upper()) is None:
        raise FormatError(
            f"matrix name {name!r}; expected a letter, then up to 7 letters and digits", path
        )
    dense_or_sparse = given if sp.issparse(given) else np.atleast_2d(np.asarray(given))
    if dense_or_sparse.dtype.kind not in "fiu":
        raise FormatError(
            f"matrix {name!r} is of type {dense_or_sparse.dtype}; expected real numbers", path
        )
    matrix = sp.csc_array(dense_or_sparse, dtype=np.float64, copy=True)
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    if layout == "strings" and matrix.shape[0] >= ROWS_OF_BIGMAT:
        raise FormatError(
            f"matrix {name!r} has {matrix.shape[0]} rows; use 'bigmat' from {ROWS_OF_BIGMAT} rows"
            " on",
            path,
        )
    if matrix.shape[0] != matrix.shape[1]:
        form = RECTANGULAR
    elif (matrix != matrix.T).nnz:
        form = _SQUARE
    else:
        form = SYMMETRIC
    return OP4Matrix(name.upper(), matrix, form)


def _columns(matrix: sp.csc_array) -> Iterator[tuple[int, IndexArray, RealArray]]:
    """Yield number (from 1), rows and values of the non-empty columns of a CSC matrix."""
    for j in range(matrix.shape[1]):
        some = slice(matrix.indptr[j], matrix.indptr[j + 1])
        if some.start != some.stop:
            yield j + 1, matrix.indices[some], matrix.data[some]


def _dense_column(rows: Any, values: Any, number: Any = np.float64) -> NumberArray:
    """Return the dense column from its first to its last entry."""
    full = np.zeros(rows[-1] - rows[0] + 1, number)
    full[rows - rows[0]] = values
    return full


# -- headers of strings: two words (length and row), or one with the length in its upper half ---
def _head_words(rows: int) -> int:
    """Return the number of words in the header of a string, by the number of rows in the file."""
    return 2 if rows < 0 or rows >= ROWS_OF_BIGMAT else 1


def _row_and_length(head: Sequence[int]) -> tuple[int, int]:
    """Return row and number of words of a string; the length in the header includes the header."""
    if len(head) == 2:
        length, row = head
    else:
        length, row = head[0] >> 16, head[0] & 0xFFFF
    return row, length - 1


def _head(row: int, words: int, layout: Layout) -> tuple[int, ...]:
    if layout == "bigmat":
        return words + 1, row
    return (row + ((words + 1) << 16),)


# -- text ---------------------------------------------------------------------------------------

_TEXT_FORMAT = re.compile(r"(\d{1,4})\s*[EDed]\s*(\d{1,4})\s*\.\s*(\d+)")
#: Values per line, width and digits after the point, by single precision or not.
_TEXT_FIELDS = {False: (3, 26, 16), True: (5, 16, 8)}


def _read_text(path: Path) -> Iterator[tuple[str, sp.csc_array, int]]:
    """Yield name, entries (sparse) and form of each matrix."""
    with path.open(encoding="latin-1") as file:
        lines = _OP4Lines(path, file)
        while (header := lines.next()) is not None:
            if header.strip():
                yield _text_matrix(lines, header)


class _OP4Lines:
    """The lines of a file, with a counter."""

    def __init__(self, path: Path, file: Iterable[str]) -> None:
        self.path = path
        self.number = 0
        self._file = iter(file)

    def next(self) -> str | None:
        line = next(self._file, None)
        if line is None:
            return None
        self.number += 1
        return line.rstrip("\r\n")

    def require(self, what: str) -> str:
        line = self.next()
        if line is None:
            raise FormatError(
                f"the file ends, expected {what}: it is truncated", self.path, self.number
            )
        return line

    def error(self, what: str) -> FormatError:
        return FormatError(what, self.path, self.number)

    def integers(self, line: str, n: int, width: int, what: str) -> list[int]:
        try:
            return [parse_integer(line[i * width : (i + 1) * width]) for i in range(n)]
        except ValueError as error:
            raise self.error(f"{line.strip()[:60]!r}; expected {what}") from error


def _text_matrix(lines: _OP4Lines, header: str) -> tuple[str, sp.csc_array, int]:
    letter = re.search(r"[A-Za-z]", header)
    if letter is None or letter.start() not in (32, 40, 64):
        raise lines.error(
            f"{header.strip()[:60]!r}; expected the header of an OUTPUT4 matrix: columns, rows,"
            " form, type, name"
        )
    width = letter.start() // 4
    columns, rows, form, kind = lines.integers(header, 4, width, "columns, rows, form and type")
    name = header[4 * width : 4 * width + 8].strip().upper()
    check_header(lines.path, lines.number, name, columns, rows, kind)
    layout = _TEXT_FORMAT.search(header, 4 * width + 8)
    if layout is None:
        raise lines.error(f"matrix {name!r}: no format such as '1P,5E16.9' after the name")
    a_line, field = int(layout[1]), int(layout[2])
    if not (a_line and field):
        raise lines.error(f"matrix {name!r}: no numbers fit into the format {layout[0]!r}")
    head = _head_words(rows)
    out = EntryCollector(lines.path, name, abs(rows), columns)
    while True:
        line = lines.require(f"a column of matrix {name!r}")
        column, row, n_words = lines.integers(
            line, 3, width, f"column, row and number of words in matrix {name!r}"
        )
        if n_words < 0:
            raise lines.error(f"column {column} of matrix {name!r}: {n_words} words")
        if column > columns:
            _text_values(lines, n_words, a_line, field)
            return name, out.matrix(), form
        if row:  # dense: n_words counts numbers here, not words
            out.add(row, column, _text_values(lines, n_words, a_line, field), lines.number)
            continue
        while n_words > 0:
            row, length = _text_string_head(lines, head, column)
            if length < 1 or length + head > n_words:
                raise lines.error(
                    f"column {column}: a string of {length} words; the column has {n_words} more"
                )
            out.add(row, column, _text_values(lines, length // kind, a_line, field), lines.number)
            n_words -= length + head


def _text_string_head(lines: _OP4Lines, head: int, column: int) -> tuple[int, int]:
    """Return row and number of words of a string."""
    line = lines.require(f"a string of column {column}")
    try:
        found = list(map(parse_integer, line.split()))
    except ValueError:
        found = []
    if len(found) != head:
        raise lines.error(
            f"{line.strip()[:60]!r}; expected the header of a string of column {column}: {head}"
            " integer(s)"
        )
    return _row_and_length(found)


def _text_values(lines: _OP4Lines, n: int, a_line: int, width: int) -> Any:
    out = np.empty(n)
    for first in range(0, n, a_line):
        line = lines.require("values")
        n_values = min(a_line, n - first)
        if line[n_values * width :].strip():
            raise lines.error(f"more than {n_values} value(s) of {width} characters on the line")
        for k in range(n_values):
            cell = line[k * width : (k + 1) * width].strip()
            try:
                out[first + k] = parse_nastran_real(cell)
            except ValueError as error:
                raise lines.error(
                    f"{cell!r} is not a number; expected {n} values of {width} characters"
                ) from error
    return out


def _write_text(matrices: Iterable[OP4Matrix], path: Path, layout: Layout, single: bool) -> None:
    a_line, width, digits = _TEXT_FIELDS[single]
    kind = 1 if single else 2
    with path.open("w", encoding="ascii", newline="\n") as file:
        for m in matrices:
            rows, columns = m.matrix.shape
            if layout == "bigmat":
                rows = -rows
            form = f"1P,{a_line}E{width}.{digits}"
            file.write(f"{columns:8}{rows:8}{m.form:8}{kind:8}{m.name:<8}{form}\n")
            for column, at, values in _columns(m.matrix):
                file.writelines(_text_column(column, at, values, layout, single))
            file.write(f"{columns + 1:8}{1:8}{1:8}\n" + _cells([1.0], single))


def _text_column(
    column: int, rows: Any, values: Any, layout: Layout, single: bool
) -> Iterator[str]:
    if layout == "dense":
        full = _dense_column(rows, values)
        yield f"{column:8}{rows[0] + 1:8}{len(full):8}\n"
        yield _cells(full, single)
        return
    a_number = 1 if single else 2  # words of a number
    strings = runs(rows)
    heads = 2 if layout == "bigmat" else 1
    yield f"{column:8}{0:8}{heads * len(strings) + a_number * len(rows):8}\n"
    for start, end in strings:
        head = _head(int(rows[start]) + 1, a_number * (end - start), layout)
        width = 8 if layout == "bigmat" else 12
        yield "".join(f"{word:{width}}" for word in head) + "\n"
        yield _cells(values[start:end], single)


def _cells(values: Any, single: bool) -> str:
    a_line, width, digits = _TEXT_FIELDS[single]
    out = ""
    for start in range(0, len(values), a_line):
        for x in values[start : start + a_line]:
            out += f"{x:{width}.{digits}E}"
        out += "\n"
    return out


# -- binary: Fortran records of words of 4 or 8 bytes, in either byte order ---------------------
#: Bytes of a word, by the bytes of a header record.
_HEADER_WORDS = {24: 4, 48: 8}
#: Codes of `struct` for an integer of one word, by its bytes.
_INTEGERS = {4: "i", 8: "q"}


def _byte_order(start: bytes) -> tuple[str, int] | None:
    """Return byte order and bytes per word by the first bytes of a file; None for text."""
    if len(start) < 4:
        return None
    for order in "<>":
        (length,) = struct.unpack(order + "i", start[:4])
        if length in _HEADER_WORDS:
            return order, _HEADER_WORDS[length]
    return None


def _read_binary(path: Path, order: str, word: int) -> Iterator[tuple[str, sp.csc_array, int]]:
    """Yield name, entries (sparse) and form of each matrix."""
    with path.open("rb") as file:
        records = _OP4Records(file, path, order)
        while (header := records.next()) is not None:
            yield _binary_matrix(records, header, word)


class _OP4Records:
    """The records of a Fortran unformatted file: each between two copies of its length."""

    def __init__(self, file: BinaryIO, path: Path, order: str) -> None:
        self.path = path
        self.order = order
        self.number = 0
        self._file = file
        self._left = path.stat().st_size

    def next(self) -> bytes | None:
        """Return the next record, None at the end of the file."""
        marker = self._file.read(4)
        if not marker:
            return None
        self.number += 1
        length = -1
        if len(marker) == 4:
            (length,) = struct.unpack(self.order + "i", marker)
        self._left -= 8 + length
        if length < 0 or self._left < 0:
            raise self.error("the file is truncated or damaged")
        body = self._file.read(length)
        if self._file.read(4) != marker:
            raise self.error("the lengths before and after it differ: the file is damaged")
        return body

    def error(self, what: str) -> FormatError:
        return FormatError(f"record {self.number}: {what}", self.path)


def _binary_matrix(records: _OP4Records, header: bytes, word: int) -> tuple[str, sp.csc_array, int]:
    order = records.order
    integer = _INTEGERS[word]
    if _HEADER_WORDS.get(len(header)) != word:
        raise records.error(
            f"{len(header)} bytes; expected the header of a matrix, {6 * word} bytes"
        )
    columns, rows, form, kind = struct.unpack(f"{order}4{integer}", header[: 4 * word])
    name = header[4 * word :].decode("ascii", "replace").replace("\x00", " ").strip().upper()
    check_header(records.path, None, name, columns, rows, kind)
    # Words of 8 bytes hold a number of either precision.
    is_short = kind == 1 and word == 4
    number = np.dtype(f"{order}f4" if is_short else f"{order}f8")
    head = _head_words(rows)
    out = EntryCollector(records.path, name, abs(rows), columns)
    while True:
        body = records.next()
        if body is None:
            raise records.error(f"the file ends within matrix {name!r}: it is truncated")
        if len(body) < 3 * word:
            raise records.error(f"{len(body)} bytes; expected a column of matrix {name!r}")
        column, row, n_words = struct.unpack(f"{order}3{integer}", body[: 3 * word])
        if column > columns:
            return name, out.matrix(), form
        data = body[3 * word : (3 + n_words) * word]
        if n_words < 0 or len(data) != n_words * word:
            raise records.error(
                f"column {column} of matrix {name!r} declares {n_words} words but has"
                f" {len(body) // word - 3}"
            )
        if row:
            out.add(row, column, _binary_numbers(records, data, number))
            continue
        at = 0
        while at < len(data):
            at = _binary_string(records, data, at, column, out, head, word, number)


def _binary_string(
    records: _OP4Records,
    data: bytes,
    at: int,
    column: int,
    out: EntryCollector,
    head: int,
    word: int,
    number: Any,
) -> int:
    """Read the string that starts at byte `at`; return the byte after it."""
    start = at + head * word
    if start > len(data):
        raise records.error(f"column {column}: a string without a header")
    found = struct.unpack(f"{records.order}{head}{_INTEGERS[word]}", data[at:start])
    row, length = _row_and_length(found)
    end = int(start + length * word)
    if length < 1 or end > len(data):
        raise records.error(
            f"column {column}: a string of {length} words at row {row}; the column has fewer"
        )
    out.add(row, column, _binary_numbers(records, data[start:end], number))
    return end


def _binary_numbers(records: _OP4Records, data: bytes, number: Any) -> Any:
    if len(data) % number.itemsize:
        raise records.error(
            f"{len(data)} bytes are not a whole number of values of {number.itemsize}"
        )
    return np.frombuffer(data, number)


def _write_binary(
    matrices: Iterable[OP4Matrix], path: Path, layout: Layout, single: bool, order: str
) -> None:
    """Write checked matrices with words of 4 bytes."""
    number = np.dtype(f"{order}f4" if single else f"{order}f8")
    kind = 1 if single else 2
    with path.open("wb") as file:
        for m in matrices:
            rows, columns = m.matrix.shape
            if layout == "bigmat":
                rows = -rows
            name = m.name.encode().ljust(8)
            header = struct.pack(f"{order}4i8s", columns, rows, m.form, kind, name)
            _write_record(file, order, header)
            for column, at, values in _columns(m.matrix):
                body = _binary_column(column, at, values, layout, order, number)
                _write_record(file, order, body)
            one = np.ones(1, number).tobytes()
            end = struct.pack(f"{order}3i", columns + 1, 1, len(one) // 4) + one
            _write_record(file, order, end)


def _binary_column(
    column: int, rows: Any, values: Any, layout: Layout, order: str, number: Any
) -> bytes:
    if layout == "dense":
        data = _dense_column(rows, values, number).tobytes()
        return struct.pack(f"{order}3i", column, rows[0] + 1, len(data) // 4) + data
    parts = []
    for start, end in runs(rows):
        data = values[start:end].astype(number).tobytes()
        head = _head(int(rows[start]) + 1, len(data) // 4, layout)
        parts += [struct.pack(f"{order}{len(head)}i", *head), data]
    body = b"".join(parts)
    return struct.pack(f"{order}3i", column, 0, len(body) // 4) + body


def _write_record(file: BinaryIO, order: str, body: bytes) -> None:
    marker = struct.pack(f"{order}i", len(body))
    file.write(marker + body + marker)
