"""OUTPUT2 files: data blocks (tables and matrices), as Nastran's DMAP module OUTPUT2 writes them.

The layout is that of the module's description in the MSC Nastran DMAP Programmer's Guide. Every
item is a Fortran record: its length in bytes, the bytes, the length again (4 bytes each). A file
starts with a date and two texts, in most cases, and ends with a key 0. A data block is its name, a
trailer of seven words, a header, then its records, each behind a flag (1 in front of a column of a
matrix, 0 elsewhere): parts behind the number of their words, then a number below 0. Words have 4
bytes or 8, in either byte order; a text has 4 characters a word.

pyNastran 1.4.1 reads such files, but neither installs nor loads beside NumPy 2.
"""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.items import placed
from updyn.io.nastran.op4 import Collector, OP4Matrix, check_header, completed

__all__ = ["MAGIC", "Block", "OP2File", "g_set", "matrix_of", "refuse_element_blocks"]

#: Bytes of the length in front of and behind every Fortran record.
_MARK = 4
_TRAILER = 7  # words
_COLUMNS, _ROWS, _FORM, _TYPE = 1, 2, 3, 4
_DOUBLE = 2
#: Types of points in the table EQEXIN.
_GRID, _SCALAR = 1, 2
#: Matrices of single elements (stiffness, mass, viscous damping), and their dictionaries.
_OF_ELEMENTS = ("KELM", "KDICT", "MELM", "MDICT", "BELM", "BDICT")
#: Number of words of the first record: the date (3), or of a file without it a name (2).
_DATE, _NAME = 3, 2


def _first_record(order: str, size: int, key: int) -> bytes:
    mark = np.array(size, f"{order}i4").tobytes()
    return mark + np.array(key, f"{order}i{size}").tobytes() + mark


#: What the files start with: the number of words of the first record, by byte order and size of a
#: word.
MAGIC: dict[bytes, tuple[str, int]] = {
    _first_record(order, size, key): (order, size)
    for order in "<>"
    for size in (4, 8)
    for key in (_DATE, _NAME)
}


@dataclass(frozen=True, slots=True)
class Block:
    """A data block.

    Parameters
    ----------
    name : str
        Its name, upper case.
    trailer : tuple of int
        Seven words; of a matrix the number of columns, of rows, form and type are 1 to 4.
    is_matrix : bool
        Whether it is a matrix, with a record a column.
    records : tuple of tuple of (int, int)
        Of each record the parts: first byte and number of bytes in the file.
    """

    name: str
    trailer: tuple[int, ...]
    is_matrix: bool
    records: tuple[tuple[tuple[int, int], ...], ...]


class OP2File:
    """An OUTPUT2 file, of which the layout is read and checked as a whole.

    Parameters
    ----------
    path : path
        The file.

    Raises
    ------
    FormatError
        If it is no such file, is cut short, or is not laid out so; the message says at which byte.
    """

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

    def words(self, raw: bytes, kind: str = "i") -> NDArray[Any]:
        """Return bytes as words of a NumPy kind, ``"i"`` or ``"f"``.

        Raises
        ------
        FormatError
            If their number is not a whole number of words.
        """
        if len(raw) % self.size:
            raise FormatError(
                f"a record of {len(raw)} bytes, expected words of {self.size} bytes: damaged",
                self.path,
            )
        return np.frombuffer(raw, f"{self.order}{kind}{self.size}")

    def named(self, *names: str) -> list[Block]:
        """Return the tables of these names, in order."""
        return [block for block in self.blocks if block.name in names and not block.is_matrix]

    @property
    def matrices(self) -> list[Block]:
        """The assembled matrices, in order."""
        return [b for b in self.blocks if b.is_matrix and b.name not in _OF_ELEMENTS]

    @property
    def element_blocks(self) -> tuple[str, ...]:
        """Names of the data blocks of element matrices, in order."""
        return tuple(block.name for block in self.blocks if block.name in _OF_ELEMENTS)

    # -- layout -----------------------------------------------------------------------------------
    def _head(self) -> int:
        """Read the texts of the head, and return where the first data block starts."""
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

    def _blocks(self, at: int) -> Iterator[Block]:
        while True:
            start = at
            if at == len(self._bytes):
                warnings.warn(
                    f"{self.path}: the OUTPUT2 file has no mark of its end; if it was cut short"
                    " between two data blocks, those that followed are missing",
                    UpdynWarning,
                    stacklevel=3,
                )
                return
            key, at = self._key(at)
            if key == 0:
                self._expect(
                    at == len(self._bytes), at, f"{len(self._bytes) - at} bytes behind the end"
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
            yield Block(name, trailer, 1 in flags[1:], tuple(records[1:]))

    def _records(
        self, name: str, at: int
    ) -> tuple[list[tuple[tuple[int, int], ...]], list[int], int]:
        """Return the records of a data block, their flags, and where the next one starts."""
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
                # The row in front of the entries of a column is not counted.
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
        """Return the record of one word that starts at a byte, and where the next one starts."""
        after = at + self._one.size
        self._expect(after <= len(self._bytes), at, "cut short")
        first, key, last = self._one.unpack_from(self._bytes, at)
        self._expect(first == last == self.size, at, f"no record of {self.size} bytes")
        return key, after

    def _part(self, at: int, words: int) -> tuple[tuple[int, int], int]:
        """Return first byte and length of the record of so many words, and where the next is."""
        return self._checked(at, words * self.size)

    def _checked(self, at: int, n: int) -> tuple[tuple[int, int], int]:
        end = at + n + 2 * _MARK
        self._expect(n > 0 and end <= len(self._bytes), at, f"no {n} bytes: cut short")
        for mark in (at, end - _MARK):
            (found,) = self._length.unpack_from(self._bytes, mark)
            self._expect(found == n, mark, f"found a length of {found} bytes, expected {n}")
        return (at + _MARK, n), end

    def _raw(self, part: tuple[int, int]) -> bytes:
        return self.data((part,))

    def _text(self, part: tuple[int, int]) -> str:
        """Return a text, of which each word holds four characters."""
        raw = self._raw(part)
        words = [raw[i : i + 4] for i in range(0, len(raw), self.size)]
        return b"".join(words).decode("latin-1").strip("\0 ")

    def _expect(self, is_so: bool, at: int, message: str) -> None:
        if not is_so:
            raise FormatError(
                f"byte {at:,} of {len(self._bytes):,}: {message}; the OUTPUT2 file is damaged or"
                " cut short",
                self.path,
            )


def refuse_element_blocks(file: OP2File, names: Sequence[str]) -> None:
    """Refuse matrices of single elements, if any of some data blocks holds them.

    A dictionary gives an element's matrix as an address of Nastran's own storage (MSC Nastran DMAP
    Programmer's Guide, data blocks KDICT and KELM), and no file is at hand to check its reading by.

    Parameters
    ----------
    file : OP2File
        The file.
    names : sequence of str
        Names of data blocks, in either case.

    Raises
    ------
    FormatError
        If one is of elements; the message says what to do instead.
    """
    found = [name for name in names if name.upper() in _OF_ELEMENTS]
    if found:
        raise FormatError(
            f"{', '.join(found)}: matrices of single elements are not read. Let updyn read the deck"
            " (.bdf), whose element properties become groups; or let Nastran assemble the matrices"
            " of each part, from decks with the elements of that part alone, and write them as"
            " OUTPUT4 files or DMIG cards (PARAM,EXTOUT,DMIGPCH)",
            file.path,
        )


def g_set(file: OP2File) -> DofSet | None:
    """Return the degrees of freedom of the g-set, in the order of KGG.

    Parameters
    ----------
    file : OP2File
        The file.

    Returns
    -------
    DofSet or None
        Six of each grid, X of each scalar point, by the table EQEXIN; None if it is not there, or
        there are several, of superelements.

    Raises
    ------
    FormatError
        If the table is damaged.
    """
    tables = file.named("EQEXIN", "EQEXINS")
    if len(tables) != 1:
        return None
    pairs = np.empty(0, np.int64)
    if len(tables[0].records) == 2:
        pairs = file.words(file.data(tables[0].records[1])).astype(np.int64)
    if not pairs.size or pairs.size % 2:
        raise FormatError("EQEXIN: no pairs of point and place: damaged", file.path)
    nodes = pairs[::2]
    starts, kinds = np.divmod(pairs[1::2], 10)
    order = np.argsort(starts, kind="stable")
    nodes, starts, kinds = nodes[order], starts[order], kinds[order]
    count = np.where(kinds == _GRID, 6, 1)
    expected = 1 + np.cumsum(count) - count
    if not (np.isin(kinds, (_GRID, _SCALAR)).all() and np.array_equal(starts, expected)):
        raise FormatError(
            "EQEXIN: points whose places do not follow each other, or that are neither grids nor"
            " scalar points",
            file.path,
        )
    axes = np.arange(count.sum()) - np.repeat(expected - 1, count)
    with placed(file.path, "EQEXIN"):
        return DofSet.from_arrays(np.repeat(nodes, count), axes)


def matrix_of(file: OP2File, block: Block) -> OP4Matrix:
    """Return a matrix of an OUTPUT2 file.

    Parameters
    ----------
    file : OP2File
        The file.
    block : Block
        One of its data blocks, a matrix.

    Returns
    -------
    OP4Matrix
        Of a symmetric matrix both triangles.

    Raises
    ------
    FormatError
        If the matrix is complex, or is not as its trailer says.
    """
    columns, rows, form, kind = (block.trailer[at] for at in (_COLUMNS, _ROWS, _FORM, _TYPE))
    check_header(file.path, None, block.name, columns, rows, kind)
    if len(block.records) != columns:
        raise FormatError(
            f"matrix {block.name!r}: {len(block.records)} columns, expected {columns}", file.path
        )
    number = np.dtype(f"{file.order}f{8 if kind == _DOUBLE else file.size}")
    collector = Collector(file.path, block.name, rows, columns)
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
    matrix = completed(file.path, block.name, collector.matrix(), form)
    return OP4Matrix(block.name, matrix, form)
