"""Dataset 58 of universal files, "function at nodal DOF", text and binary.

Layout: SDRC, universal file format, dataset 58, revision of 23 April 1993, and the binary form 58b
of UC-SDRL.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import FormatError
from updyn.io.settings import MEASURED_FILE
from updyn.io.text_numbers import parse_reals
from updyn.io.uff.datasets import (
    Dataset,
    Payload,
    check_record_7,
    count_columns,
    decode_line,
    parse_real_field,
    read_integer_field,
    read_real_column,
)

__all__ = ["FUNCTIONS", "Function", "Record8", "read_function"]

#: Function types of record 6 that occur in measurements.
FUNCTIONS = {
    0: "general or unknown function",
    1: "time response",
    2: "auto spectrum",
    3: "cross spectrum",
    4: "frequency response function",
    5: "transmissibility",
    6: "coherence",
    7: "auto correlation",
    8: "cross correlation",
    9: "power spectral density",
    12: "spectrum",
    25: "finite impulse response filter",
    26: "multiple coherence",
}
_WIDTH_6 = 80


@dataclass(frozen=True, slots=True)
class Record8:
    """The definition of an axis (records 8 to 10); names and units are empty if NONE in the file.

    `kind` is the specific data type, for instance 12 for an acceleration.
    """

    kind: int
    name: str
    unit: str
    line: int


@dataclass(frozen=True, slots=True, eq=False)
class Function:
    """One dataset 58. Abscissa and ordinate of a binary one are read from the file at each access.

    `line` is that of its number, `kind` the function type (`FUNCTIONS`), `title` the first line of
    its identification. `response` and `reference` are node and direction code, -6 to 6, 0 for a
    scalar. `even` is minimum and increment of an even abscissa of `points` values, else None;
    `unit_of_x` converts it to Hz or s. `data` are the numbers, shape (points, columns), or their
    place in the file.
    """

    line: int
    kind: int
    title: str
    response: tuple[int, int]
    reference: tuple[int, int]
    points: int
    even: tuple[float, float] | None
    is_complex: bool
    abscissa: Record8
    numerator: Record8
    denominator: Record8
    data: RealArray | Payload
    unit_of_x: float = 1.0

    @property
    def name(self) -> str:
        """Name of the function type, for messages."""
        return FUNCTIONS.get(self.kind, f"function of type {self.kind}")

    @property
    def x(self) -> RealArray:
        """Abscissa, shape (points,)."""
        if self.even is None:
            return self._table()[:, 0] * self.unit_of_x
        start, step = self.even
        return (start + step * np.arange(self.points, dtype=np.float64)) * self.unit_of_x

    @property
    def y(self) -> RealArray | ComplexArray:
        """Ordinate in the unit of the file, shape (points,)."""
        return _ordinate(self._table(), self.is_complex)

    def _table(self) -> RealArray:
        return self.data.read() if isinstance(self.data, Payload) else self.data


def _ordinate(table: RealArray, is_complex: bool) -> RealArray | ComplexArray:
    if is_complex:
        return np.ascontiguousarray(table[:, -2:]).view(np.complex128)[:, 0]
    return table[:, -1]


def read_function(dataset: Dataset, path: str | Path) -> Function:
    """Read a dataset 58 and check its numbers."""
    lines = dataset.body.split(b"\n", 11)
    if len(lines) < 12 and not (dataset.payload is not None and len(lines) == 11):
        raise FormatError(
            f"dataset 58: {len(lines)} line(s); expected 11 of text before the data",
            path,
            dataset.line,
        )
    texts = [decode_line(line).rstrip("\r") for line in lines[:11]]
    kind, response, reference = _record_6(lines[5], path, dataset.line + 6)
    at = dataset.line + 7
    ordinate, points, is_even = check_record_7(texts[6], path, at)
    if dataset.payload is None:
        numbers = _numbers(dataset, lines[11], ordinate, is_even, points, path)
        table = numbers.reshape(points, -1)
    else:
        table = dataset.payload.read()
        _check_byte_order(dataset.payload, table, path, dataset.line)
    even = None
    if is_even:
        even = (
            read_real_column(texts[6], 30, 13, "record 7, abscissa minimum", path, at),
            read_real_column(texts[6], 43, 13, "record 7, abscissa increment", path, at),
        )
    found = Function(
        dataset.line,
        kind,
        texts[0].strip(),
        response,
        reference,
        points,
        even,
        ordinate in (5, 6),
        _axis(texts, 7, dataset, path),
        _axis(texts, 8, dataset, path),
        _axis(texts, 9, dataset, path),
        table if dataset.payload is None else dataset.payload,
    )
    _check(found, table, path)
    return found


def _check_byte_order(payload: Payload, table: RealArray, path: str | Path, line: int) -> None:
    """Refuse numbers of unusual magnitude that have usual magnitudes in the other byte order."""
    if _fraction_unusual(table) < MEASURED_FILE.unusual_share:
        return
    other = payload.read(swapped=True)
    if _fraction_unusual(other) == 0.0:
        small, large = np.abs(table[table != 0]).min(), np.abs(table).max()
        raise FormatError(
            f"58b: magnitudes from {small:.3g} to {large:.3g} in the byte order stated in the first"
            f" line, and from {np.abs(other).min():.3g} to {np.abs(other).max():.3g} in the other:"
            " the byte order (1 little-endian, 2 big-endian) in columns 8 to 13 is wrong",
            path,
            line,
        )


def _fraction_unusual(table: RealArray) -> float:
    """Return the fraction of nonzero numbers with unusual magnitudes."""
    size = np.abs(table[table != 0])
    usual = (size >= MEASURED_FILE.least_magnitude) & (size <= MEASURED_FILE.most_magnitude)
    return 1.0 - float(usual.mean()) if size.size else 0.0


def _record_6(
    line: bytes, path: str | Path, at: int
) -> tuple[int, tuple[int, int], tuple[int, int]]:
    """Return function type, response and reference."""
    # A name with other than ASCII characters may be padded to bytes or to characters.
    text = decode_line(line).rstrip()
    as_bytes = line.decode("latin-1").rstrip()
    if text != as_bytes and len(text) != _WIDTH_6 and len(as_bytes) == _WIDTH_6:
        text = as_bytes
    if len(text) > _WIDTH_6:
        raise FormatError(
            f"record 6: {len(text)} columns, expected {_WIDTH_6}: its fields are not identifiable",
            path,
            at,
        )
    return (
        read_integer_field(text, 0, 5, "record 6, function type", path, at),
        (
            read_integer_field(text, 41, 10, "record 6, response node", path, at),
            read_integer_field(text, 51, 4, "record 6, response direction", path, at),
        ),
        (
            read_integer_field(text, 66, 10, "record 6, reference node", path, at),
            read_integer_field(text, 76, 4, "record 6, reference direction", path, at),
        ),
    )


def _axis(texts: list[str], index: int, dataset: Dataset, path: str | Path) -> Record8:
    line = dataset.line + 1 + index
    kind = read_integer_field(
        texts[index], 0, 10, f"record {index + 1}, specific data type", path, line
    )
    name, unit = texts[index][26:46].strip(), texts[index][46:].strip()
    return Record8(kind, _float_or_none(name), _float_or_none(unit), line)


def _float_or_none(label: str) -> str:
    return "" if label.upper() == "NONE" else label


def _numbers(
    dataset: Dataset, body: bytes, ordinate: int, even: int, points: int, path: str | Path
) -> RealArray:
    count = points * count_columns(ordinate, even)
    found = parse_reals(body)
    if found is not None and len(found) == count:
        return found
    lines = list(enumerate(body.split(b"\n"), dataset.line + 12))
    words = [(at, word) for at, line in lines for word in line.split()]
    if len(words) < count:  # numbers without blanks between them: "-1.00000E+100-1.00000E+100"
        words = _by_column(lines, _widths(ordinate, even)) or words
    if len(words) != count:
        raise FormatError(
            f"dataset 58: record 7 (points, type, spacing) requires {count} numbers, found"
            f" {len(words)}",
            path,
            dataset.line,
        )
    return np.array([parse_real_field(decode_line(word), "data", path, at) for at, word in words])


def _widths(ordinate: int, even: int) -> list[int]:
    """Return the widths of the fields of a line of data."""
    if ordinate in (2, 5):
        return [13] * 6
    if even:
        return [20] * 4
    return [13, 20, 13, 20] if ordinate == 4 else [13, 20, 20]


def _by_column(
    lines: Sequence[tuple[int, bytes]], widths: Sequence[int]
) -> list[tuple[int, bytes]]:
    """Return the fields of lines in fixed columns; empty if the columns do not fit the format."""
    edges = [0, *accumulate(widths)]
    fields = []
    for at, line in lines:
        for start, end in pairwise(edges):
            field = line[start:end].strip()
            if field and b"." not in field:  # a part of a number
                return []
            if field:
                fields.append((at, field))
    return fields


def _check(found: Function, table: RealArray, path: str | Path) -> None:
    """Refuse numbers that are not finite, and an abscissa that does not increase."""
    if found.even is None:
        x = table[:, 0]
    else:
        x = found.x
        start, step = found.even
        if not (np.isfinite(x).all() and (step > 0 or found.points == 1)):
            raise FormatError(
                f"record 7: abscissa starts at {start:g} with steps of {step:g}; expected finite,"
                " ascending numbers",
                path,
                found.line + 7,
            )
    for what, array in (("abscissa", x), ("ordinate", _ordinate(table, found.is_complex))):
        bad = np.flatnonzero(~np.isfinite(array))
        if bad.size:
            raise FormatError(
                f"dataset 58: the {what} of point {bad[0] + 1} is not finite", path, found.line
            )
    down = np.flatnonzero(np.diff(x) <= 0)
    if down.size:
        i = int(down[0])
        raise FormatError(
            f"dataset 58: the abscissa does not increase from point {i + 1} ({x[i]:g}) to"
            f" {i + 2} ({x[i + 1]:g})",
            path,
            found.line,
        )
