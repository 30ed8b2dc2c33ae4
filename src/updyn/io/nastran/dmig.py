"""DMIG: matrices by grid and component, as Nastran punches them (``.pch``) and reads them.

The header card (``DMIG, NAME, 0, IFO, TIN, TOUT, ...``) defines the form (1 square, 6 symmetric
with one triangle, 9 rectangular) and the type (1 real single, 2 real double precision); the column
cards hold entries (MSC Nastran Quick Reference Guide, DMIG).
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DIRECTIONS, DofSet
from updyn.errors import FormatError, UpdynWarning
from updyn.io.atomic import atomic_path
from updyn.io.nastran.cards import NastranCard, parse, read_lines
from updyn.io.nastran.fields import NastranLine, format_field
from updyn.io.settings import MATRIX_FILE

__all__ = ["DMIGMatrix", "read_dmig", "write_dmig"]

_SQUARE, _SYMMETRIC, _RECTANGULAR = 1, 6, 9
_LAST_GRID = 99999999
_HEADER = 8  # fields of a header card
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")
#: Lines of a deck or of a punch file that are not bulk data.
_TITLES = re.compile(r"(?:TITLE|SUBTITLE|LABEL)\s*=|BEGIN\s+(?:BULK|SUPER)|ENDDATA", re.IGNORECASE)
#: Cards in punch files of superelements, which define the grids and sets of the matrices.
_ACCOMPANYING = (
    *("ASET", "ASET1", "CORD2C", "CORD2R", "CORD2S", "DTI", "EXTRN", "GRID", "QSET", "QSET1"),
    *("SEBNDRY", "SECONCT", "SPOINT"),
)


@dataclass(frozen=True, slots=True, eq=False)
class DMIGMatrix:
    """A square matrix with its degrees of freedom, by node, then direction.

    `matrix` is csr_array, shape (n, n), with both triangles, in the units of the program that wrote
    it.
    """

    name: str
    matrix: sp.csr_array
    dofs: DofSet


def read_dmig(path: str | Path) -> list[DMIGMatrix]:
    """Read all square DMIG matrices of a punch file or a deck; refuse other cards."""
    # PARAM,EXTOUT,DMIGPCH and EXTSEOUT also punch rectangular matrices (loads, transformations of
    # recovery), tables, and the boundary grids; these are passed over with a warning.
    path = Path(path)
    headers: dict[str, NastranCard] = {}
    rectangular: dict[str, None] = {}
    columns: dict[str, list[NastranCard]] = {}
    passed_over: dict[str, None] = {}
    for card in parse(_bulk(read_lines(path))):
        if card.name in _ACCOMPANYING:
            passed_over[card.name] = None
            continue
        if card.name != "DMIG":
            raise card.error(f"{card.name}: expected only DMIG cards")
        name = card.text(0)
        if _NAME.fullmatch(name) is None:
            raise card.error(f"DMIG: field 2 is {name!r}; expected a name")
        if card.text(1) == "0":
            if name in headers:
                raise card.error(
                    f"DMIG {name}: a second header; the first is on line"
                    f" {headers[name].lines[0].number}"
                )
            headers[name] = card
            if card.integer(2) == _RECTANGULAR:
                rectangular[name] = None
            else:
                _check_header(card)
        else:
            columns.setdefault(name, []).append(card)
    if not headers:
        raise FormatError("no DMIG header card: DMIG, NAME, 0, form, type", path)
    for name, found in columns.items():
        if name not in headers:
            raise found[0].error(f"DMIG {name}: a column without a header card of this name")
    square = {name: header for name, header in headers.items() if name not in rectangular}
    if not square:
        raise FormatError(
            f"only rectangular matrices (form 9): {', '.join(rectangular)}; expected form 1"
            " (square) or 6 (symmetric)",
            path,
        )
    if rectangular or passed_over:
        parts = [f"rectangular matrix {name}" for name in rectangular]
        parts += [f"{name} cards" for name in passed_over]
        warnings.warn(f"{path}: passed over: {', '.join(parts)}", UpdynWarning, stacklevel=3)
    return [_matrix(header, columns.get(name, [])) for name, header in square.items()]


def _bulk(lines: Iterable[NastranLine]) -> Iterator[NastranLine]:
    for line in lines:
        if _TITLES.match(line.text.lstrip()) is None:
            yield line


def _check_header(card: NastranCard) -> None:
    form = card.integer(2)
    kind = card.integer(3)
    for at in card.nonempty((6, *range(_HEADER, len(card.fields)))):
        raise card.error(
            f"DMIG {card.text(0)}: field {at + 2} of the header is {card.fields[at]!r}; expected"
            " blank (NAME, 0, IFO, TIN, TOUT, POLAR, blank, NCOL)"
        )
    if card.integer(5, 0):
        raise card.error(
            f"DMIG {card.text(0)}: POLAR is {card.text(5)}, amplitude and phase; expected 0 or"
            " blank, real numbers"
        )
    if form not in (_SQUARE, _SYMMETRIC):
        raise card.error(f"DMIG {card.text(0)}: form {form}; expected 1 (square) or 6 (symmetric)")
    if kind not in (1, 2):
        why = ""
        if kind in (3, 4):
            why = " (complex: give damping as loss factors or viscous matrices)"
        raise card.error(f"DMIG {card.text(0)}: type {kind}{why}; expected 1 or 2, real")


def _matrix(header: NastranCard, columns: Sequence[NastranCard]) -> DMIGMatrix:
    name = header.text(0)
    symmetric = header.integer(2) == _SYMMETRIC
    rows: list[int] = []
    at: list[int] = []
    values: list[float] = []
    where: list[NastranCard] = []
    for card in columns:
        column = _key(card, 1)
        if card.nonempty((3,)):
            raise card.error(f"DMIG {name}: field 5 is {card.text(3)!r}; expected blank")
        for start in range(4, max(len(card.fields), 5), 4):
            if card.real(start + 3, 0.0):
                raise card.error(
                    f"DMIG {name}: field {start + 5} is {card.text(start + 3)!r}, an imaginary"
                    " part; expected real entries, as stated in the header"
                )
            rows.append(_key(card, start))
            at.append(column)
            values.append(card.real(start + 2))
            where.append(card)
    keys = np.unique(np.array(rows + at, dtype=np.int64))
    i = np.searchsorted(keys, rows)
    j = np.searchsorted(keys, at)
    # An entry of a symmetric matrix may be in either triangle; if it is in both, the values have
    # to agree.
    key = i * len(keys) + j
    if symmetric:
        key = np.maximum(i, j) * len(keys) + np.minimum(i, j)
    order = np.argsort(key, kind="stable")
    for one, two in pairwise(order.tolist()):
        if key[one] != key[two]:
            continue
        pair = f"({_label(keys[i[two]])}, {_label(keys[j[two]])})"
        if i[one] == i[two]:
            raise where[two].error(f"DMIG {name}: entry {pair} occurs twice")
        a, b = values[one], values[two]
        level = max(abs(a), abs(b), 1e-9 * max(map(abs, values)))
        if abs(a - b) > MATRIX_FILE.mirror_tolerance * level:
            raise where[two].error(
                f"DMIG {name}: declared symmetric (form 6), but entry {pair} is {b:g} and its"
                f" mirror entry {a:g}"
            )
    is_first = np.diff(key[order], prepend=-1) != 0
    kept = np.sort(order[is_first])
    entries = (np.array(values)[kept], (i[kept], j[kept]))
    matrix = sp.csr_array(sp.coo_array(entries, shape=(len(keys),) * 2), dtype=np.float64)
    if symmetric:
        matrix = matrix + (sp.tril(matrix, -1) + sp.triu(matrix, 1)).T
    return DMIGMatrix(name, sp.csr_array(matrix), DofSet.from_arrays(keys // 6, keys % 6))


def _key(card: NastranCard, at: int) -> int:
    """Return node * 6 + direction of the grid and component in fields `at` and `at + 1`."""
    node = card.integer(at)
    component = card.integer(at + 1, 0)
    if not 0 <= component <= 6:
        raise card.error(
            f"DMIG: component {component} of grid {node}; expected 1 to 6, or 0 for a scalar point"
        )
    return node * 6 + max(component, 1) - 1


def _label(key: Any) -> str:
    return f"{int(key) // 6}:{DIRECTIONS[int(key) % 6]}"


def write_dmig(matrices: Mapping[str, object], dofs: DofSet, path: str | Path) -> None:
    """Write symmetric matrices, each shape (N, N), as DMIG cards in large fields."""
    # A name is a letter, then up to 7 letters and digits. A field has 16 characters, which keep at
    # least 10 digits of a number.
    path = Path(path)
    wrong = dofs.nodes[(dofs.nodes < 1) | (dofs.nodes > _LAST_GRID)]
    if len(wrong):
        raise FormatError(f"node {wrong[0]}; expected grid numbers from 1 to {_LAST_GRID}", path)
    text = ""
    for name, given in matrices.items():
        matrix = _check_matrix(name, given, len(dofs), path)
        text += "".join(_cards(name.upper(), matrix, dofs))
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="ascii", newline="\n")


def _check_matrix(name: str, given: Any, n: int, path: Path) -> sp.csc_array:
    """Return a matrix as CSC; refuse one that DMIG cannot hold."""
    if _NAME.fullmatch(name) is None:
        raise FormatError(
            f"matrix name {name!r}; expected a letter, then up to 7 letters and digits", path
        )
    matrix = sp.csc_array(given)
    if matrix.shape != (n, n):
        raise FormatError(f"matrix {name!r} is {matrix.shape}; expected {n} rows and columns", path)
    difference = abs(matrix - matrix.T)
    if difference.nnz and difference.max() > 1e-10 * abs(matrix).max():
        raise FormatError(f"matrix {name!r} is not symmetric", path)
    return matrix


def _cards(name: str, matrix: sp.csc_array, dofs: DofSet) -> Iterator[str]:
    yield f"{'DMIG':<8}{name:<8}{0:>8}{_SYMMETRIC:>8}{2:>8}{0:>8}\n"
    places = []
    for node, axis in zip(dofs.nodes.tolist(), dofs.axes.tolist(), strict=True):
        places.append(f"{node:>16}{axis + 1:>16}")
    lower = sp.csc_array(sp.tril(matrix))
    lower.eliminate_zeros()
    for j, place in enumerate(places):
        some = slice(lower.indptr[j], lower.indptr[j + 1])
        if some.start == some.stop:
            continue
        yield f"{'DMIG*':<8}{name:<16}{place}\n"
        for i, x in zip(lower.indices[some].tolist(), lower.data[some].tolist(), strict=True):
            yield f"{'*':<8}{places[i]}{format_field(float(x)):>16}\n"
