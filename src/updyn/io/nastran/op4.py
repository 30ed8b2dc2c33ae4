"""OUTPUT4 files: matrices as Nastran's DMAP module OUTPUT4 writes them, in text or binary.

The layout is that of the module's description in the MSC Nastran DMAP Programmer's Guide: a header
(columns, rows, form, type, name), then a record a column, then a record of the column after the
last. A column is dense, from its first to its last entry, or a run of strings (row, length,
values), whose head is one word (rows up to 65535) or two (big matrix, told by a negative number of
rows). Binary files come in either byte order, with words of 4 or of 8 bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import scipy.sparse as sp

from updyn.errors import FormatError, suggest
from updyn.io.atomic import atomic_path

__all__ = ["Layout", "OP4Matrix", "read_op4", "select", "write_op4"]

#: How a column is stored: from first to last entry, or as strings with heads of one or of two
#: words.
Layout: TypeAlias = Literal["dense", "strings", "bigmat"]

RECTANGULAR, SYMMETRIC = 2, 6
#: From this number of rows the head of a string takes two words, whatever the sign of the number of
#: rows.
ROWS_OF_BIGMAT = 65536
_SQUARE = 1
_LARGEST = 10**8  # beyond any model; a damaged header would ask for all memory
_NAME = re.compile(r"[A-Z][A-Z0-9]{0,7}")


@dataclass(frozen=True, slots=True, eq=False)
class OP4Matrix:
    """One matrix of an OUTPUT4 file.

    Parameters
    ----------
    name : str
        Its name, upper case.
    matrix : scipy.sparse.csc_array, shape (rows, columns), float64
        The entries, in the units of the program that wrote it.
    form : int
        1 square, 2 rectangular, 3 diagonal, 6 symmetric, 8 identity, ... as the file says.
    """

    name: str
    matrix: Any
    form: int


def read_op4(path: str | Path) -> list[OP4Matrix]:
    """Read all matrices of an OUTPUT4 file.

    Parameters
    ----------
    path : path
        The file: text or binary (either byte order, 4 or 8 bytes a word), single or double
        precision, real.

    Returns
    -------
    list of OP4Matrix
        In the order of the file. Of a symmetric matrix (form 6) that is stored as one triangle both
        are returned.

    Raises
    ------
    FormatError
        If the file is cut short or damaged, holds complex numbers, or a matrix of form 6 is not
        symmetric; the message says in which matrix, and on which line or in which record.
    """
    from updyn.io.nastran import op4_binary, op4_text

    path = Path(path)
    with path.open("rb") as file:
        start = file.read(8)
    if not start:
        raise FormatError("the file is empty", path)
    order = op4_binary.byte_order(start)
    found = op4_text.read(path) if order is None else op4_binary.read(path, *order)
    return [
        OP4Matrix(name, _completed(path, name, matrix, form), form) for name, matrix, form in found
    ]


def select(matrices: Iterable[OP4Matrix], name: str | None, path: str | Path) -> OP4Matrix:
    """Return the matrix of that name, or the only one.

    Raises
    ------
    FormatError
        If the name is not there or stands twice, or there are several and no name is given.
    """
    matrices = list(matrices)
    names = [m.name for m in matrices]
    if name is None:
        if len(matrices) != 1:
            raise FormatError(
                f"holds {len(matrices)} matrices ({', '.join(names)}); say which: FILE:NAME", path
            )
        return matrices[0]
    if names.count(name.upper()) > 1:
        raise FormatError(f"matrix {name!r} stands {names.count(name.upper())} times", path)
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
    """Write matrices to an OUTPUT4 file, the file replaced as a whole once it is complete.

    Parameters
    ----------
    matrices : mapping of str to array_like or sparse, shape (rows, columns)
        Real matrices by name: a letter, then up to 7 letters and digits.
    path : path
        The file to write.
    text : bool
        Text instead of binary, with enough digits for every number to come back exactly.
    layout : {"bigmat", "strings", "dense"}
        How columns are stored. "strings" is for up to 65535 rows.
    single : bool
        Numbers of 32 bits instead of 64.
    big_endian : bool
        Byte order of a binary file.

    Raises
    ------
    FormatError
        If a name or a matrix cannot be written so.
    """
    from updyn.io.nastran import op4_binary, op4_text

    path = Path(path)
    if layout not in ("dense", "strings", "bigmat"):
        raise FormatError(
            f"layout {layout!r}; {suggest(str(layout), ('dense', 'strings', 'bigmat'))}", path
        )
    if not matrices:
        raise FormatError("no matrix to write", path)
    ready = [_checked(name, given, path, layout) for name, given in matrices.items()]
    with atomic_path(path) as temporary:
        if text:
            op4_text.write(ready, temporary, layout, single)
        else:
            op4_binary.write(ready, temporary, layout, single, ">" if big_endian else "<")


def runs(rows: Any) -> list[tuple[int, int]]:
    """Return start and end (past the last) of the runs of consecutive numbers in ascending `rows`."""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    edges = [0, *breaks.tolist(), len(rows)]
    return list(pairwise(edges))


def check_header(
    path: Path, where: int | None, name: str, columns: int, rows: int, kind: int
) -> None:
    """Refuse sizes and types that no real matrix has."""
    if not (1 <= columns <= _LARGEST and 1 <= abs(rows) <= _LARGEST):
        raise FormatError(
            f"matrix {name!r}: {columns} columns and {abs(rows)} rows; expected 1 to {_LARGEST}",
            path,
            where,
        )
    if kind in (3, 4):
        raise FormatError(
            f"matrix {name!r} is complex (type {kind}); expected real: damping goes into loss"
            " factors and viscous matrices",
            path,
            where,
        )
    if kind not in (1, 2):
        raise FormatError(
            f"matrix {name!r}: type {kind}; expected 1 (single) or 2 (double precision)",
            path,
            where,
        )


class Collector:
    """The entries of one matrix as they are read, each checked to lie inside."""

    def __init__(self, path: Path, name: str, rows: int, columns: int) -> None:
        self._path, self._name, self.shape = path, name, (rows, columns)
        self._rows: list[Any] = []
        self._columns: list[Any] = []
        self._values: list[Any] = []

    def add(self, row: int, column: int, values: Any, line: int | None = None) -> None:
        """Take consecutive values of a column, rows and columns counted from 1."""
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

    def matrix(self) -> Any:
        """Return what was taken."""
        if not self._values:
            return sp.csc_array(self.shape, dtype=np.float64)
        rows, columns, values = (
            np.concatenate(p) for p in (self._rows, self._columns, self._values)
        )
        keep = values != 0.0
        if not np.isfinite(values).all():
            raise FormatError(
                f"matrix {self._name!r} holds a number that is not finite", self._path
            )
        key = np.sort(columns[keep] * self.shape[0] + rows[keep])
        if (twice := np.flatnonzero(np.diff(key) == 0)).size:
            column, row = divmod(int(key[twice[0]]), self.shape[0])
            raise FormatError(
                f"matrix {self._name!r}: entry ({row + 1}, {column + 1}) stands twice", self._path
            )
        return sp.csc_array(
            sp.coo_array((values[keep], (rows[keep], columns[keep])), shape=self.shape)
        )


def _completed(path: Path, name: str, matrix: Any, form: int) -> Any:
    if form != SYMMETRIC:
        return matrix
    if matrix.shape[0] != matrix.shape[1]:
        raise FormatError(
            f"matrix {name!r} is {matrix.shape[0]} x {matrix.shape[1]} and said to be symmetric",
            path,
        )
    lower, upper = sp.tril(matrix, -1), sp.triu(matrix, 1)
    if bool(lower.nnz) != bool(upper.nnz):
        return sp.csc_array(matrix + (lower + upper).T)
    difference = sp.coo_array(abs(matrix - matrix.T))
    if difference.nnz and difference.max() > 1e-6 * abs(matrix).max():
        worst = int(np.argmax(difference.data))
        i, j = int(difference.row[worst]) + 1, int(difference.col[worst]) + 1
        raise FormatError(
            f"matrix {name!r} is said to be symmetric (form 6), but entries ({i}, {j}) and ({j},"
            f" {i}) differ by {difference.data[worst]:.3g}",
            path,
        )
    return matrix


def _checked(name: str, given: Any, path: Path, layout: Layout) -> OP4Matrix:
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
            f"matrix {name!r} has {matrix.shape[0]} rows; from {ROWS_OF_BIGMAT} on use 'bigmat'",
            path,
        )
    if matrix.shape[0] != matrix.shape[1]:
        form = RECTANGULAR
    else:
        form = SYMMETRIC if (matrix != matrix.T).nnz == 0 else _SQUARE
    return OP4Matrix(name.upper(), matrix, form)
