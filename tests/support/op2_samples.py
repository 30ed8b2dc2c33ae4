"""OUTPUT2 files written by hand: data blocks of words of 4 or 8 bytes, in either byte order."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

GRID, SPOINT, END = (4501, 45, 1), (5551, 49, 105), (65535, 65535, 65535)


@dataclass
class Writer:
    """The bytes of a file, block by block."""

    order: str = "<"
    size: int = 4
    parts: list[bytes] = field(default_factory=list)

    def number(self, value: float | int) -> bytes:
        kind = "f" if isinstance(value, float) else "i"
        return np.array(value, f"{self.order}{kind}{self.size}").tobytes()

    def words(self, values: Sequence[Any]) -> bytes:
        return b"".join(self.number(value) for value in values)

    def text(self, text: str) -> bytes:
        words = [text[i : i + 4] for i in range(0, len(text), 4)]
        return b"".join(word.ljust(self.size).encode() for word in words)

    def put(self, raw: bytes) -> None:
        mark = np.array(len(raw), f"{self.order}i4").tobytes()
        self.parts.append(mark + raw + mark)

    def key(self, value: int) -> None:
        self.put(self.number(value))

    def counted(self, raw: bytes, words: int | None = None) -> None:
        self.key(len(raw) // self.size if words is None else words)
        self.put(raw)

    def head(self, label: str = "NX2021.1") -> None:
        self.counted(self.words((11, 23, 26)))
        for text in ("NASTRAN FORT TAPE ID CODE - ", label):
            self.counted(self.text(text))
        self.key(-1)
        self.key(0)

    def block(
        self, name: str, trailer: Sequence[int], records: Sequence[Sequence[bytes]], flag: int = 0
    ) -> None:
        """A data block; each record is a sequence of parts, of a matrix of strings behind their row."""
        self.counted(self.text(name.ljust(8)))
        self.key(-1)
        self.counted(self.words(trailer))
        self.key(-2)
        self.key(1)
        self.key(0)
        self.counted(self.text(name.ljust(8)))
        self.key(-3)
        for number, record in enumerate(records, 4):
            self.key(1)
            self.key(flag)
            for part in record:
                self.counted(part, len(part) // self.size - flag)
            self.key(-number)
        self.key(1)
        self.key(0)
        self.key(0)

    def table(self, name: str, records: Sequence[Sequence[Any]]) -> None:
        """A table of words; a long record is split, as Nastran does."""
        split = []
        for record in records:
            raw = self.words(record)
            step = 64 * self.size
            split.append([raw[i : i + step] for i in range(0, len(raw), step)])
        self.block(name, (101, len(records), 0, 0, 0, 0, 0), split)

    def matrix(self, name: str, given: Any, form: int = 6, double: bool = True) -> None:
        """A real matrix, each column as strings of entries that are not zero."""
        A = np.asarray(given, dtype=float)
        number = f"{self.order}f{8 if double else self.size}"
        columns = []
        for column in A.T:
            rows = np.flatnonzero(column)
            runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if rows.size else []
            columns.append(
                [
                    self.number(int(run[0]) + 1) + column[run].astype(number).tobytes()
                    for run in runs
                ]
            )
        trailer = (101, A.shape[1], A.shape[0], form, 2 if double else 1, 0, 0)
        self.block(name, trailer, columns, flag=1)

    def shapes(
        self,
        modes: Sequence[tuple[int, complex, Mapping[int, Sequence[complex]]]],
        *,
        approach: int = 2,
        subcase: int = 1,
        scalar: Sequence[int] = (),
        table: int = 7,
        form: int | None = None,
        name: str = "OUGV1",
    ) -> None:
        """A table of eigenvectors: number, eigenvalue, and six numbers by node."""
        is_complex = approach == 9
        records: list[list[Any]] = []
        for number, value, shape in modes:
            head: list[Any] = [0] * 50 + [self.text(" " * 128)] * 3
            head[:4] = [10 * approach + 1, table, 0, subcase]
            head[4:7] = [number, float(value.real), float(value.imag)]
            head[8:10] = [form or (2 if is_complex else 1), 14 if is_complex else 8]
            flat = b"".join(h if isinstance(h, bytes) else self.number(h) for h in head)
            body: list[Any] = []
            for node, row in shape.items():
                body += [10 * node + 1, 2 if node in scalar else 1]
                body += [float(np.real(v)) for v in row]
                body += [float(np.imag(v)) for v in row] if is_complex else []
            records += [flat, self.words(body)]
        split = [[raw[i : i + 400] for i in range(0, len(raw), 400)] for raw in records]
        self.block(name, (101, 0, 0, 0, 0, 0, 0), split)

    def eigenvalues(self, rows: Sequence[tuple[int, float, float]]) -> None:
        """The table LAMA: number, eigenvalue and modal mass."""
        body: list[Any] = []
        for number, value, mass in rows:
            omega = abs(value) ** 0.5
            body += [number, number, value, omega, omega / 2 / np.pi, mass, mass * value]
        self.table("LAMA", [[21, 6, *[0] * 144], body])

    def bytes(self, *, closed: bool = True) -> bytes:
        if closed:
            self.key(0)
        return b"".join(self.parts)


#: A quadrangle in mm on a bar in a cylindrical system, a spring to the ground and a scalar point.
POINTS = {1: (0.0, 0.0, 0.0), 2: (100.0, 0.0, 0.0), 3: (100.0, 80.0, 0.0), 4: (0.0, 80.0, 0.0)}


def geometry(out: Writer) -> None:
    """The tables GEOM1 and GEOM2: grid 7 stands at 50 mm and 90 degrees of system 5, and moves along it."""
    grids: list[Any] = list(GRID)
    for node, xyz in POINTS.items():
        grids += [node, 0, *xyz, 0, 0, 0]
    grids += [7, 5, 50.0, 90.0, 30.0, 5, 0, 0]
    cylinder = [2001, 20, 9, 5, 2, 2, 0, *(0.0, 0.0, 0.0), *(0.0, 0.0, 1.0), *(1.0, 0.0, 0.0)]
    out.table("GEOM1S", [cylinder, grids, list(END)])
    bar = [2408, 24, 180, 11, 1, 4, 7, 0.0, 0.0, 1.0, 0, 0, 0, *[0.0] * 6]
    quad = [2958, 51, 177, 12, 1, 1, 2, 3, 4, 0.0, 0.0, 0, 0, -1.0, -1.0, -1.0, -1.0, 0]
    spring = [601, 6, 73, 13, 1, 0, 1, 0, 3]
    out.table("GEOM2S", [bar, quad, spring, [*SPOINT, 20], list(END)])


#: Two modes: grid 1 is held, 4 does not turn; 20 is a scalar point.
MODES = (
    (1, 4.0e4, {1: [0.0] * 6, 2: [1.0, 2.0, 3.0, 0.5, 0.0, -0.5], 20: [0.25, *[0.0] * 5]}),
    (2, 9.0e4, {1: [0.0] * 6, 2: [0.0, -1.0, 4.0, 0.0, 0.0, 2.0], 20: [-1.0, *[0.0] * 5]}),
)


def whole(order: str = "<", size: int = 4, *, masses: bool = True, closed: bool = True) -> bytes:
    """A file with geometry, modes, and the matrices KGG and MGG of a grid and a scalar point."""
    out = Writer(order, size)
    out.head()
    geometry(out)
    out.table("EQEXINS", [[3, 1, 20, 2], [3, 11, 20, 72]])
    if masses:
        out.eigenvalues([(1, 4.0e4, 1.0), (2, 9.0e4, 4.0)])
    out.shapes(MODES, scalar=(20,))
    out.matrix("KGG", stiffness())
    out.matrix("MGG", np.diag([2.0, 2.0, 2.0, 0.0, 0.0, 3.0, 1.0]), double=False)
    return out.bytes(closed=closed)


def stiffness() -> Any:
    """Of the six directions of grid 3 and scalar point 20."""
    K = np.diag([5.0, 6.0, 7.0, 0.0, 0.0, 8.0, 9.0])
    K[2, 6] = K[6, 2] = -3.0
    return K
