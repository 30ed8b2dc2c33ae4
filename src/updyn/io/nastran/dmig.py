"""DMIG: matrices by grid and component, as Nastran punches them (``.pch``) and reads them.

The header card (``DMIG, NAME, 0, IFO, TIN, TOUT, ...``) says the form, 1 square, 6 symmetric (one triangle is enough)
or 9 rectangular, and the type, 1 real single or 2 real double precision; the column cards hold entries by grid and
component (MSC Nastran Quick Reference Guide, DMIG).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DIRECTIONS, DofSet
from updyn.errors import FormatError
from updyn.io.atomic import atomic_path
from updyn.io.nastran.cards import Card, Line, lines_of, parse
from updyn.io.nastran.fields import text_of

__all__ = ["DMIGMatrix", "read_dmig", "write_dmig"]

_SQUARE, _SYMMETRIC = 1, 6
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]{0,7}")
#: Lines of a deck or of a punch file that are no bulk data.
_TITLES = re.compile(r"(?:TITLE|SUBTITLE|LABEL)\s*=|BEGIN\s+BULK|ENDDATA", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class DMIGMatrix:
    """One square matrix with its degrees of freedom.

    Parameters
    ----------
    name : str
        Upper case.
    matrix : scipy.sparse.csr_array, shape (n, n), float64
        The entries, in the units of the program that wrote it; both triangles.
    dofs : DofSet
        The n degrees of freedom that have entries, by node, then direction.
    """

    name: str
    matrix: Any
    dofs: DofSet


def read_dmig(path: str | Path) -> list[DMIGMatrix]:
    """Read all DMIG matrices of a punch file or a deck.

    Parameters
    ----------
    path : path
        The file; cards other than DMIG are refused, as are complex and rectangular matrices.

    Returns
    -------
    list of DMIGMatrix
        In the order of their headers.

    Raises
    ------
    FormatError
        If a card is not valid; the message says file and line.
    """
    path = Path(path)
    cards = list(parse(_bulk(lines_of(path))))
    headers: dict[str, Card] = {}
    columns: dict[str, list[Card]] = {}
    for card in cards:
        if card.name != "DMIG":
            raise card.error(f"{card.name}: expected DMIG cards only")
        name = card.text(0)
        if _NAME.fullmatch(name) is None:
            raise card.error(f"DMIG: field 2 is {name!r}; expected a name")
        if card.text(1) == "0":
            if name in headers:
                raise card.error(f"DMIG {name}: a second header; the first is on line {headers[name].lines[0].number}")
            headers[name] = card
            _check_header(card)
        else:
            columns.setdefault(name, []).append(card)
    if not headers:
        raise FormatError("no DMIG header card: DMIG, NAME, 0, form, type", path)
    for name, found in columns.items():
        if name not in headers:
            raise found[0].error(f"DMIG {name}: a column, but no header card of that name")
    return [_matrix(header, columns.get(name, [])) for name, header in headers.items()]


def _bulk(lines: Iterable[Line]) -> Iterator[Line]:
    return (line for line in lines if _TITLES.match(line.text.lstrip()) is None)


def _check_header(card: Card) -> None:
    form, kind = card.integer(2), card.integer(3)
    if form not in (_SQUARE, _SYMMETRIC):
        raise card.error(f"DMIG {card.text(0)}: form {form}; expected 1 (square) or 6 (symmetric)")
    if kind not in (1, 2):
        why = " (complex: damping goes into loss factors and viscous matrices)" if kind in (3, 4) else ""
        raise card.error(f"DMIG {card.text(0)}: type {kind}{why}; expected 1 or 2, real")


def _matrix(header: Card, columns: Sequence[Card]) -> DMIGMatrix:
    name, symmetric = header.text(0), header.integer(2) == _SYMMETRIC
    rows: list[int] = []
    at: list[int] = []
    values: list[float] = []
    where: list[Card] = []
    for card in columns:
        column = _key(card, 1)
        start = 4
        while start < len(card.fields) or start == 4:
            rows.append(_key(card, start))
            at.append(column)
            values.append(card.real(start + 2))
            where.append(card)
            start += 4
    keys = np.unique(np.array(rows + at, dtype=np.int64))
    i, j = np.searchsorted(keys, rows), np.searchsorted(keys, at)
    if symmetric:  # either triangle, or both of them
        below = i >= j
        if below.any() and (i < j).any():
            _check_both(name, i, j, np.array(values), where)
            keep = below
            i, j, values = i[keep], j[keep], np.array(values)[keep].tolist()
            where = [c for c, kept in zip(where, keep, strict=True) if kept]
    order = np.argsort(i * len(keys) + j, kind="stable")
    twice = np.flatnonzero(np.diff((i * len(keys) + j)[order]) == 0)
    if twice.size:
        again = int(order[twice[0] + 1])
        raise where[again].error(
            f"DMIG {name}: entry ({_label(keys[i[again]])}, {_label(keys[j[again]])}) stands twice"
        )
    matrix = sp.csr_array(sp.coo_array((values, (i, j)), shape=(len(keys),) * 2), dtype=np.float64)
    if symmetric:
        matrix = matrix + (sp.tril(matrix, -1) + sp.triu(matrix, 1)).T
    return DMIGMatrix(name, sp.csr_array(matrix), DofSet.from_arrays(keys // 6, keys % 6))


def _key(card: Card, at: int) -> int:
    """Return node * 6 + direction of the grid and component in two fields."""
    node, component = card.integer(at), card.integer(at + 1, 0)
    if not 0 <= component <= 6:
        raise card.error(f"DMIG: component {component} of grid {node}; expected 1 to 6, or 0 for a scalar point")
    return node * 6 + max(component, 1) - 1


def _label(key: Any) -> str:
    return f"{int(key) // 6}:{DIRECTIONS[int(key) % 6]}"


def _check_both(name: str, i: Any, j: Any, values: Any, where: list[Card]) -> None:
    """Both triangles of a symmetric matrix are there: they have to be the same."""
    n = int(max(i.max(), j.max())) + 1
    full = sp.csr_array(sp.coo_array((values, (i, j)), shape=(n, n)))
    difference = sp.coo_array(abs(full - full.T))
    if difference.nnz and difference.max() > 1e-6 * abs(values).max():
        worst = int(np.argmax(difference.data))
        at = int(np.flatnonzero((i == difference.row[worst]) & (j == difference.col[worst]))[0:1].sum())
        raise where[at].error(
            f"DMIG {name}: said to be symmetric (form 6), with entries of both triangles that differ by "
            f"{difference.data[worst]:.3g}"
        )


def write_dmig(matrices: Mapping[str, Any], dofs: DofSet, path: str | Path) -> None:
    """Write symmetric matrices as DMIG cards in large fields, the file replaced as a whole once it is complete.

    Parameters
    ----------
    matrices : mapping of str to array_like or sparse, shape (N, N)
        Real symmetric matrices by name: a letter, then up to 7 letters and digits. One triangle is written.
    dofs : DofSet
        The N degrees of freedom; nodes are 1 to 99999999.
    path : path
        The file to write.

    Raises
    ------
    FormatError
        If a name, a node, a size or a matrix cannot be written so.

    Notes
    -----
    A field has 16 characters: numbers come back to 10 digits or more.
    """
    path = Path(path)
    nodes, components = dofs.nodes, dofs.axes.astype(np.int64) + 1
    if len(dofs) and (nodes.min() < 1 or nodes.max() > 99999999):
        wrong = int(nodes.min()) if nodes.min() < 1 else int(nodes.max())
        raise FormatError(f"node {wrong}; grids are numbered from 1 to 99999999", path)
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as file:
        for name, given in matrices.items():
            if _NAME.fullmatch(name) is None:
                raise FormatError(f"matrix name {name!r}; expected a letter, then up to 7 letters and digits", path)
            matrix = sp.csc_array(given)
            if matrix.shape != (len(dofs),) * 2:
                raise FormatError(f"matrix {name!r} is {matrix.shape}; expected {len(dofs)} rows and columns", path)
            difference = abs(matrix - matrix.T)
            if difference.nnz and difference.max() > 1e-10 * abs(matrix).max():
                raise FormatError(f"matrix {name!r} is not symmetric", path)
            file.write(f"{'DMIG':<8}{name.upper():<8}{0:>8}{_SYMMETRIC:>8}{2:>8}{0:>8}\n")
            for j in range(len(dofs)):
                some = slice(matrix.indptr[j], matrix.indptr[j + 1])
                entries = [
                    (i, x) for i, x in zip(matrix.indices[some], matrix.data[some], strict=True) if i >= j and x != 0.0
                ]
                if not entries:
                    continue
                file.write(f"{'DMIG*':<8}{name.upper():<16}{nodes[j]:>16}{components[j]:>16}\n")
                file.writelines(
                    f"{'*':<8}{nodes[i]:>16}{components[i]:>16}{text_of(float(x)):>16}\n" for i, x in entries
                )
