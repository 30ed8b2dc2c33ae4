"""OUTPUT2 files: data blocks (tables and matrices), as Nastran's DMAP module OUTPUT2 writes them.

Layout: MSC Nastran DMAP Programmer's Guide. Every item is a Fortran record. A file starts in most
cases with a date and two texts, and ends with a key 0. A data block is its name, a trailer of seven
words, a header, then its records. Words have 4 or 8 bytes in either byte order; a text has 4
characters per word. pyNastran 1.4.1 does not support NumPy 2.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import NumberArray
from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.items import locate_errors
from updyn.io.nastran.op4 import EntryCollector, OP4Matrix, check_header, complete_triangles

__all__ = ["MAGIC", "OP2Block", "OP2File", "g_set", "read_matrix", "refuse_element_blocks"]

#: Bytes of the length before and after every Fortran record.
_MARK = 4
_TRAILER = 7  # words
_COLUMNS, _ROWS, _FORM, _TYPE = 1, 2, 3, 4
_DOUBLE = 2
#: Types of points in the table EQEXIN.
_GRID, _SCALAR = 1, 2
#: Matrices of single elements (stiffness, mass, viscous damping), and their dictionaries.
_OF_ELEMENTS = ("KELM", "KDICT", "MELM", "MDICT", "BELM", "BDICT")
#: Number of words of the first record: the date (3), or a name (2) in files without a date.
_DATE, _NAME = 3, 2


def _first_record(order: str, size: int, key: int) -> bytes:
    mark = np.array(size, f"{order}i4").tobytes()
    return mark + np.array(key, f"{order}i{size}").tobytes() + mark


#: First bytes of the files (the number of words of the first record), with the byte order and the
#: size of a word.
MAGIC: dict[bytes, tuple[str, int]] = {
    _first_record(order, size, key): (order, size)
    for order in "<>"
    for size in (4, 8)
    for key in (_DATE, _NAME)
}


@dataclass(frozen=True, slots=True)
class OP2Block:
    """A data block; of a matrix, one record per column.

    Words 1 to 4 of the `trailer` of a matrix are the numbers of columns and rows, form and type.
    Each of `records` has parts: first byte and number of bytes in the file.
    """

    name: str
    trailer: tuple[int, ...]
    is_matrix: bool
    records: tuple[tuple[tuple[int, int], ...], ...]


class OP2File:
    """An OUTPUT2 file whose layout is read and checked completely."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._bytes: Any = np.empty(0, np.uint8)
        if self.path.stat().st_size:
            self._bytes = np.memmap(self.path, np.uint8, mode="r")
        start = self._bytes[:16].tobytes()
        found = [kind for magic, kind in MAGIC.items() if start.startswith(magic)]
        if not found:
            raise FormatError(
                "not an OUTPUT2 file: it does not start with the number of words of a date or a"
                " name",
                path,
            )
        self.order, self.size = found[0]
        self._length = struct.Struct(f"{self.order}i")
        #: A Fortran record of one word.
        self._one = struct.Struct(f"{self.order}i{'i' if self.size == 4 else 'q'}i")
        self.program = ""
        at = 0
        if self._key(at)[0] == _DATE:
            at = self._head()
        self.blocks = tuple(self._blocks(at))

    # -- content ----------------------------------------------------------------------------------
    def data(self, record: tuple[tuple[int, int], ...]) -> bytes:
        """Return the bytes of a record."""
        return b"".join(self._bytes[at : at + n].tobytes() for at, n in record)

    def words(self, raw: bytes, kind: str = "i") -> NumberArray:
        """Return bytes as words of a NumPy kind, ``"i"`` or ``"f"``."""
        if len(raw) % self.size:
            raise FormatError(
                f"a record of {len(raw)} bytes, expected words of {self.size} bytes: damaged",
                self.path,
            )
        return np.frombuffer(raw, f"{self.order}{kind}{self.size}")

    def tables_named(self, *names: str) -> list[OP2Block]:
        """Return the tables with these names, in order."""
        return [block for block in self.blocks if block.name in names and not block.is_matrix]

    @property
    def matrices(self) -> list[OP2Block]:
        """The assembled matrices, in order."""
        return [b for b in self.blocks if b.is_matrix and b.name not in _OF_ELEMENTS]

    @property
    def element_blocks(self) -> tuple[str, ...]:
        """Names of the data blocks of element matrices, in order."""
        return tuple(block.name for block in self.blocks if block.name in _OF_ELEMENTS)

    # -- layout -----------------------------------------------------------------------------------
    def _head(self) -> int:
        """Read the texts of the file header, and return the first byte of the first data block."""
        key, at = self._key(0)
        _, at = self._part(at, key)
        for _ in range(2):
            key, at = self._key(at)
            part, at = self._part(at, key)
            self.program = self._text(part)
        for expected in (-1, 0):
            key, after = self._key(at)
            self._expect(key == expected, at, f"found the key {key}, expected {expected}")
            at = after
        return at

    def _blocks(self, at: int) -> Iterator[OP2Block]:
        while True:
            start = at
            if at == len(self._bytes):
                warnings.warn(
                    f"{self.path}: the OUTPUT2 file has no end mark; if it was truncated between"
                    " two data blocks, the later blocks are missing",
                    UpdynWarning,
                    stacklevel=3,
                )
                return
            key, at = self._key(at)
            if key == 0:
                self._expect(
                    at == len(self._bytes), at, f"{len(self._bytes) - at} bytes after the end"
                )
                return
            part, at = self._part(at, key)
            name = self._text(part)
            self._expect(key == _NAME and name.isalnum(), start, f"found {name!r}, expected a name")
            _, at = self._key(at)
            key, at = self._key(at)
            part, at = self._part(at, key)
            self._expect(key == _TRAILER, at, f"{name}: a trailer of {key} words")
            trailer = tuple(self.words(self._raw(part)).tolist())
            _, at = self._key(at)
            records, flags, at = self._records(name, at)
            # The first is the header, which repeats the name.
            yield OP2Block(name, trailer, 1 in flags[1:], tuple(records[1:]))

    def _records(
        self, name: str, at: int
    ) -> tuple[list[tuple[tuple[int, int], ...]], list[int], int]:
        """Return the records of a data block, their flags, and the first byte of the next block."""
        records: list[tuple[tuple[int, int], ...]] = []
        flags: list[int] = []
        while True:
            key, after = self._key(at)
            self._expect(key == 1, at, f"{name}: found the key {key}, expected 1")
            flag, after = self._key(after)
            self._expect(flag in (0, 1), at, f"{name}: found the flag {flag}, expected 0 or 1")
            key, at = self._key(after)
            if key == 0:
                return records, flags, at
            parts = []
            while key > 0:
                # The row before the entries of a column is not counted.
                part, at = self._part(at, key + flag)
                parts.append(part)
                key, at = self._key(at)
            self._expect(
                key == -len(records) - 3,
                at,
                f"{name}: record {len(records)} ends with the key {key}, expected"
                f" {-len(records) - 3}",
            )
            records.append(tuple(parts))
            flags.append(flag)

    def _key(self, at: int) -> tuple[int, int]:
        """Return the integer in the one-word record at a byte, and the byte after it."""
        after = at + self._one.size
        self._expect(after <= len(self._bytes), at, "truncated")
        first, key, last = self._one.unpack_from(self._bytes, at)
        self._expect(first == last == self.size, at, f"no record of {self.size} bytes")
        return key, after

    def _part(self, at: int, words: int) -> tuple[tuple[int, int], int]:
        """Return first byte and length of a record of `words` words, and the byte after it."""
        return self._check_record(at, words * self.size)

    def _check_record(self, at: int, n: int) -> tuple[tuple[int, int], int]:
        end = at + n + 2 * _MARK
        self._expect(n > 0 and end <= len(self._bytes), at, f"fewer than {n} bytes: truncated")
        for mark in (at, end - _MARK):
            (found,) = self._length.unpack_from(self._bytes, mark)
            self._expect(found == n, mark, f"found a length of {found} bytes, expected {n}")
        return (at + _MARK, n), end

    def _raw(self, part: tuple[int, int]) -> bytes:
        return self.data((part,))

    def _text(self, part: tuple[int, int]) -> str:
        """Return a text, stored with four characters per word."""
        raw = self._raw(part)
        words = [raw[i : i + 4] for i in range(0, len(raw), self.size)]
        return b"".join(words).decode("latin-1").strip("\0 ")

    def _expect(self, is_so: bool, at: int, message: str) -> None:
        if not is_so:
            raise FormatError(
                f"byte {at:,} of {len(self._bytes):,}: {message}; the OUTPUT2 file is damaged or"
                " truncated",
                self.path,
            )


def refuse_element_blocks(file: OP2File, names: Sequence[str]) -> None:
    """Raise a FormatError if any of the named data blocks holds matrices of single elements."""
    # A dictionary gives an element's matrix as an address of Nastran's internal storage (MSC
    # Nastran DMAP Programmer's Guide, data blocks KDICT and KELM); no file was available to verify
    # a reader.
    found = [name for name in names if name.upper() in _OF_ELEMENTS]
    if found:
        raise FormatError(
            f"{', '.join(found)}: matrices of single elements are not supported. Let updyn read the"
            " deck (.bdf), whose element properties become groups; or let Nastran assemble the"
            " matrices of each part from a deck with only its elements, and write them as"
            " OUTPUT4 files or DMIG cards (PARAM,EXTOUT,DMIGPCH)",
            file.path,
        )


def g_set(file: OP2File) -> DofSet | None:
    """Return the degrees of freedom of the g-set in the order of KGG, or None."""
    # They are six per grid and X per scalar point, by the table EQEXIN. None if this table is
    # missing or there are several (superelements).
    tables = file.tables_named("EQEXIN", "EQEXINS")
    if len(tables) != 1:
        return None
    pairs = np.empty(0, np.int64)
    if len(tables[0].records) == 2:
        pairs = file.words(file.data(tables[0].records[1])).astype(np.int64)
    if not pairs.size or pairs.size % 2:
        raise FormatError("EQEXIN: not pairs of point and position: damaged", file.path)
    nodes = pairs[::2]
    starts, kinds = np.divmod(pairs[1::2], 10)
    order = np.argsort(starts, kind="stable")
    nodes, starts, kinds = nodes[order], starts[order], kinds[order]
    count = np.where(kinds == _GRID, 6, 1)
    expected = 1 + np.cumsum(count) - count
    if not (np.isin(kinds, (_GRID, _SCALAR)).all() and np.array_equal(starts, expected)):
        raise FormatError(
            "EQEXIN: points with positions that are not consecutive, or that are neither grids nor"
            " scalar points",
            file.path,
        )
    axes = np.arange(count.sum()) - np.repeat(expected - 1, count)
    with locate_errors(file.path, "EQEXIN"):
        return DofSet.from_arrays(np.repeat(nodes, count), axes)


def read_matrix(file: OP2File, block: OP2Block) -> OP4Matrix:
    """Return a matrix of an OUTPUT2 file; both triangles of a symmetric one."""
    columns, rows, form, kind = (block.trailer[at] for at in (_COLUMNS, _ROWS, _FORM, _TYPE))
    check_header(file.path, None, block.name, columns, rows, kind)
    if len(block.records) != columns:
        raise FormatError(
            f"matrix {block.name!r}: {len(block.records)} columns, expected {columns}", file.path
        )
    number = np.dtype(f"{file.order}f{8 if kind == _DOUBLE else file.size}")
    collector = EntryCollector(file.path, block.name, rows, columns)
    for column, record in enumerate(block.records, 1):
        for part in record:  # the row, then entries of consecutive rows
            raw = file.data((part,))
            entries = raw[file.size :]
            if len(entries) % number.itemsize:
                raise FormatError(
                    f"matrix {block.name!r}, column {column}: {len(entries)} bytes of entries,"
                    f" expected {number.itemsize} each",
                    file.path,
                )
            row = int(file.words(raw[: file.size])[0])
            collector.add(row, column, np.frombuffer(entries, number))
    matrix = complete_triangles(file.path, block.name, collector.matrix(), form)
    return OP4Matrix(block.name, matrix, form)
