"""Dataset 58 of universal files, "function at nodal DOF", text and binary.

Layout: SDRC, universal file format, dataset 58, revision of 23 April 1993, and the binary form 58b
of UC-SDRL. The fields of its eleven lines of text are told by column, the numbers of its data by
blanks; both are counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError
from updyn.io.text_numbers import reals
from updyn.io.uff.datasets import (
    Dataset,
    bytes_expected,
    columns_of,
    real_column,
    real_field,
    text_of,
    whole_field,
    whole_fields,
)

__all__ = ["FUNCTIONS", "Function", "Record8", "read_function"]

#: Function types of record 6 that measurements come with.
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
    """What one axis is (records 8 to 10).

    Attributes
    ----------
    kind : int
        Specific data type, for instance 12 for an acceleration.
    unit : str
        Label of its unit; empty where the file says NONE.
    line : int
        Line of the file.
    """

    kind: int
    unit: str
    line: int


@dataclass(frozen=True, slots=True, eq=False)
class Function:
    """One dataset 58.

    Attributes
    ----------
    line : int
        Line of the file on which its number stands.
    kind : int
        Function type, see `FUNCTIONS`.
    title : str
        First line of its identification.
    response, reference : (int, int)
        Node and direction code, -6 to 6, 0 for a scalar.
    x : ndarray of float, shape (n,)
        Abscissa.
    y : ndarray of float or complex, shape (n,)
        Ordinate, in the unit of the file.
    abscissa, numerator, denominator : Record8
        What they are.
    """

    line: int
    kind: int
    title: str
    response: tuple[int, int]
    reference: tuple[int, int]
    x: NDArray[np.float64]
    y: NDArray[np.float64] | NDArray[np.complex128]
    abscissa: Record8
    numerator: Record8
    denominator: Record8

    @property
    def name(self) -> str:
        """What it is, for messages."""
        return FUNCTIONS.get(self.kind, f"function of type {self.kind}")


def read_function(dataset: Dataset, path: str | Path) -> Function:
    """Read a dataset 58.

    Parameters
    ----------
    dataset : Dataset
        The dataset.
    path : path
        The file, for messages.

    Returns
    -------
    Function
        Its content; all numbers are finite, and as many as it says.

    Raises
    ------
    FormatError
        If a field cannot be read, numbers are missing, superfluous, not finite, or the abscissa
        does not increase.
    """
    lines = dataset.body.split(b"\n", 11)
    if len(lines) < 12 and not (dataset.payload is not None and len(lines) == 11):
        raise FormatError(
            f"dataset 58: {len(lines)} line(s); expected 11 of text before the data",
            path,
            dataset.line,
        )
    texts = [text_of(line).rstrip("\r") for line in lines[:11]]
    kind, response, reference = _record_6(lines[5], path, dataset.line + 6)
    at = dataset.line + 7
    bytes_expected(texts[6], path, at)  # checks type, number of points and spacing
    ordinate, points, even = whole_fields(texts[6], 3, "record 7", path, at)
    columns = columns_of(ordinate, even)
    numbers = _numbers(dataset, lines, ordinate, even, points * columns, path)
    table = numbers.reshape(points, columns)
    step = 0.0
    if even:
        start = real_column(texts[6], 30, 13, "record 7, abscissa minimum", path, at)
        step = real_column(texts[6], 43, 13, "record 7, abscissa increment", path, at)
        x = start + step * np.arange(points, dtype=np.float64)
    else:
        x = table[:, 0]
    y = table[:, -1]
    if ordinate in (5, 6):
        y = table[:, -2] + 1j * y
    found = Function(
        dataset.line,
        kind,
        texts[0].strip(),
        response,
        reference,
        x,
        y,
        _axis(texts, 7, dataset, path),
        _axis(texts, 8, dataset, path),
        _axis(texts, 9, dataset, path),
    )
    _check(found, bool(even), step, path)
    return found


def _record_6(
    line: bytes, path: str | Path, at: int
) -> tuple[int, tuple[int, int], tuple[int, int]]:
    """Return function type, response and reference."""
    # A name that is not ASCII may have been padded by bytes or by characters.
    text = text_of(line).rstrip()
    as_bytes = line.decode("latin-1").rstrip()
    if text != as_bytes and len(text) != _WIDTH_6 and len(as_bytes) == _WIDTH_6:
        text = as_bytes
    if len(text) > _WIDTH_6:
        raise FormatError(
            f"record 6: {len(text)} columns, expected {_WIDTH_6}: its fields cannot be told",
            path,
            at,
        )
    return (
        whole_field(text, 0, 5, "record 6, function type", path, at),
        (
            whole_field(text, 41, 10, "record 6, response node", path, at),
            whole_field(text, 51, 4, "record 6, response direction", path, at),
        ),
        (
            whole_field(text, 66, 10, "record 6, reference node", path, at),
            whole_field(text, 76, 4, "record 6, reference direction", path, at),
        ),
    )


def _axis(texts: list[str], index: int, dataset: Dataset, path: str | Path) -> Record8:
    line = dataset.line + 1 + index
    kind = whole_field(texts[index], 0, 10, f"record {index + 1}, specific data type", path, line)
    unit = texts[index][46:].strip()
    if unit.upper() == "NONE":
        unit = ""
    return Record8(kind, unit, line)


def _numbers(
    dataset: Dataset, lines: list[bytes], ordinate: int, even: int, count: int, path: str | Path
) -> NDArray[np.float64]:
    if dataset.payload is not None:
        order = ">" if dataset.big_endian else "<"
        size = 8 if ordinate in (4, 6) else 4
        return np.frombuffer(dataset.payload, f"{order}f{size}").astype(np.float64)
    words = lines[11].split()
    if len(words) < count:  # numbers that touch: "-1.00000E+100-1.00000E+100"
        words = _by_column(lines[11], ordinate, even)
    if len(words) != count:
        raise FormatError(
            f"dataset 58: {count} numbers follow from record 7 (points, type, spacing), found"
            f" {len(words)}",
            path,
            dataset.line,
        )
    found = reals(b" ".join(words))
    if found is not None:
        return found
    first = dataset.line + 12
    out = []
    for number, line in enumerate(lines[11].split(b"\n"), first):
        for word in line.split():
            out.append(real_field(text_of(word), "data", path, number))
    if len(out) != count:
        out = [real_field(text_of(word), "data", path, first) for word in words]
    return np.array(out)


def _by_column(data: bytes, ordinate: int, even: int) -> list[bytes]:
    if ordinate in (2, 5):
        widths = [13] * 6
    elif even:
        widths = [20] * 4
    else:
        widths = [13, 20, 20]
        if ordinate == 4:
            widths = [13, 20, 13, 20]
    edges = [0, *accumulate(widths)]
    fields = []
    for line in data.split(b"\n"):
        for start, end in pairwise(edges):
            field = line[start:end].strip()
            # A field without a point is part of a number that was cut: the columns are not those of
            # the format.
            if field and b"." not in field:
                return data.split()
            if field:
                fields.append(field)
    return fields


def _check(found: Function, even: bool, step: float, path: str | Path) -> None:
    if even and not (np.isfinite(found.x).all() and (step > 0 or len(found.x) == 1)):
        raise FormatError(
            f"record 7: abscissa starts at {found.x[0]:g} with steps of {step:g}; expected finite"
            " numbers, ascending",
            path,
            found.line + 7,
        )
    for what, array in (("abscissa", found.x), ("ordinate", found.y)):
        bad = np.flatnonzero(~np.isfinite(array))
        if bad.size:
            raise FormatError(
                f"dataset 58: the {what} of point {bad[0] + 1} is not finite", path, found.line
            )
    down = np.flatnonzero(np.diff(found.x) <= 0)
    if down.size:
        i = int(down[0])
        raise FormatError(
            f"dataset 58: the abscissa does not increase from point {i + 1} ({found.x[i]:g}) to"
            f" {i + 2} ({found.x[i + 1]:g})",
            path,
            found.line,
        )
