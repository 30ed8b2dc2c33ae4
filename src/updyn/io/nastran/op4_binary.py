"""Binary OUTPUT4 files: Fortran records of words of 4 or 8 bytes, in either byte order. See `updyn.io.nastran.op4`."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from updyn.errors import FormatError
from updyn.io.nastran.op4 import ROWS_OF_BIGMAT, Collector, Layout, OP4Matrix, check_header, runs

__all__ = ["byte_order", "read", "write"]

_HEADER = {24: 4, 48: 8}  # bytes of a header record: bytes of its words


def byte_order(start: bytes) -> tuple[str, int] | None:
    """Return byte order and bytes a word of a binary file by its first bytes; None: not a binary file."""
    if len(start) < 4:
        return None
    for order in "<>":
        if (length := struct.unpack(order + "i", start[:4])[0]) in _HEADER:
            return order, _HEADER[length]
    return None


def read(path: Path, order: str, word: int) -> Iterator[tuple[str, Any, int]]:
    """Yield name, entries (sparse) and form of each matrix."""
    with path.open("rb") as file:
        records = _Records(file, path, order)
        while (header := records.next()) is not None:
            yield _matrix(records, header, word)


class _Records:
    """The records of a Fortran unformatted file: each between two copies of its length."""

    def __init__(self, file: BinaryIO, path: Path, order: str) -> None:
        self._file, self.path, self.order = file, path, order
        self.number = 0
        self._left = path.stat().st_size

    def next(self) -> bytes | None:
        """Return the next record, None at the end of the file."""
        marker = self._file.read(4)
        if not marker:
            return None
        self.number += 1
        length = struct.unpack(self.order + "i", marker)[0] if len(marker) == 4 else -1
        self._left -= 8 + length
        if length < 0 or self._left < 0:
            raise self.error("the file is cut short or damaged")
        body = self._file.read(length)
        if self._file.read(4) != marker:
            raise self.error("its length before and after it differ: the file is damaged")
        return body

    def error(self, what: str) -> FormatError:
        return FormatError(f"record {self.number}: {what}", self.path)


def _matrix(records: _Records, header: bytes, word: int) -> tuple[str, Any, int]:
    order, integer = records.order, "i" if word == 4 else "q"
    if _HEADER.get(len(header)) != word:
        raise records.error(
            f"{len(header)} bytes; expected the header of a matrix, {6 * word} bytes"
        )
    columns, rows, form, kind = struct.unpack(f"{order}4{integer}", header[: 4 * word])
    name = header[4 * word :].decode("ascii", "replace").replace("\x00", " ").strip().upper()
    check_header(records.path, None, name, columns, rows, kind)
    # Words of 8 bytes hold a number of either precision.
    number = np.dtype(f"{order}f{4 if kind == 1 and word == 4 else 8}")
    head = 2 if rows < 0 or rows >= ROWS_OF_BIGMAT else 1
    out = Collector(records.path, name, abs(rows), columns)
    while True:
        body = records.next()
        if body is None:
            raise records.error(f"the file ends within matrix {name!r}: it is cut short")
        if len(body) < 3 * word:
            raise records.error(f"{len(body)} bytes; expected a column of matrix {name!r}")
        column, row, n_words = struct.unpack(f"{order}3{integer}", body[: 3 * word])
        if column > columns:
            return name, out.matrix(), form
        data = body[3 * word : (3 + n_words) * word]
        if n_words < 0 or len(data) != n_words * word:
            raise records.error(
                f"column {column} of matrix {name!r} says {n_words} words, {len(body) // word - 3}"
                " there"
            )
        if row:
            out.add(row, column, _numbers(records, data, number))
            continue
        at = 0
        while at < len(data):
            at = _string(records, data, at, column, out, head, word, number)


def _string(
    records: _Records,
    data: bytes,
    at: int,
    column: int,
    out: Collector,
    head: int,
    word: int,
    number: Any,
) -> int:
    """Read one string that starts at byte `at`; return where it ends."""
    start = at + head * word
    if start > len(data):
        raise records.error(f"column {column}: a string without its head")
    found = struct.unpack(f"{records.order}{head}{'i' if word == 4 else 'q'}", data[at:start])
    length, row = (
        (found[0] - 1, found[1]) if head == 2 else ((found[0] >> 16) - 1, found[0] & 0xFFFF)
    )
    end = int(start + length * word)
    if length < 1 or end > len(data):
        raise records.error(
            f"column {column}: a string of {length} words at row {row}; the column has not so many"
        )
    out.add(row, column, _numbers(records, data[start:end], number))
    return end


def _numbers(records: _Records, data: bytes, number: Any) -> Any:
    if len(data) % number.itemsize:
        raise records.error(
            f"{len(data)} bytes are not a whole number of values of {number.itemsize}"
        )
    return np.frombuffer(data, number)


def write(
    matrices: Iterable[OP4Matrix], path: Path, layout: Layout, single: bool, order: str
) -> None:
    """Write checked matrices with words of 4 bytes."""
    number = np.dtype(f"{order}f{4 if single else 8}")
    with path.open("wb") as file:
        for m in matrices:
            rows, columns = m.matrix.shape
            sign = -1 if layout == "bigmat" else 1
            header = struct.pack(
                f"{order}4i8s",
                columns,
                sign * rows,
                m.form,
                1 if single else 2,
                m.name.encode().ljust(8),
            )
            _record(file, order, header)
            pointer, indices, data = m.matrix.indptr, m.matrix.indices, m.matrix.data
            for j in range(columns):
                some = slice(pointer[j], pointer[j + 1])
                if len(indices[some]):
                    _record(
                        file,
                        order,
                        _column(j + 1, indices[some], data[some], layout, order, number),
                    )
            one = np.ones(1, number).tobytes()
            _record(file, order, struct.pack(f"{order}3i", columns + 1, 1, len(one) // 4) + one)


def _column(column: int, rows: Any, values: Any, layout: Layout, order: str, number: Any) -> bytes:
    if layout == "dense":
        full = np.zeros(rows[-1] - rows[0] + 1, number)
        full[rows - rows[0]] = values
        return struct.pack(f"{order}3i", column, rows[0] + 1, full.nbytes // 4) + full.tobytes()
    parts = []
    for start, end in runs(rows):
        words = (end - start) * number.itemsize // 4
        row = int(rows[start]) + 1
        head = (words + 1, row) if layout == "bigmat" else (row + ((words + 1) << 16),)
        parts.append(
            struct.pack(f"{order}{len(head)}i", *head) + values[start:end].astype(number).tobytes()
        )
    body = b"".join(parts)
    return struct.pack(f"{order}3i", column, 0, len(body) // 4) + body


def _record(file: BinaryIO, order: str, body: bytes) -> None:
    marker = struct.pack(f"{order}i", len(body))
    file.write(marker + body + marker)
