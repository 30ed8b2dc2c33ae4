"""Comma-separated tables of a model: its DOFs, and the positions of its nodes.

Headers: ``dof`` or ``node,direction``; ``node,x,y,z`` in m, with nine further columns
``xx,xy,xz,yx,...,zz`` for local directions; ``from,to`` for lines; ``a,b,c,d`` for faces, with the
last node of a triangle repeated. Empty lines and lines that start with ``#`` are ignored.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from updyn.arrays import IntArray
from updyn.dofs import Dof, DofSet
from updyn.errors import DofError, FormatError
from updyn.geometry import Geometry
from updyn.io.csv_text import check_comments
from updyn.io.items import locate_errors, read_utf8
from updyn.io.lengths import length
from updyn.io.text_numbers import check_last_line, parse_integer, parse_real

__all__ = [
    "read_dofs",
    "read_geometry",
    "write_dofs",
    "write_faces",
    "write_geometry",
    "write_lines",
]

_POINT = ("node", "x", "y", "z")
_AXES = ("xx", "xy", "xz", "yx", "yy", "yz", "zx", "zy", "zz")
_LINE = ("from", "to")
_FACE = ("a", "b", "c", "d")
_COMMENT = re.compile(rb"(?:#.*)?")


def read_dofs(path: str | Path) -> DofSet:
    """Read a table of DOFs, in order; the message of a FormatError gives the line."""
    _, rows = _table(path, (("dof",), ("node", "direction")))
    dofs: list[Dof] = []
    seen: dict[tuple[int, str], int] = {}
    for line, cells in rows:
        try:
            dof = Dof.parse(":".join(cells))
        except DofError as error:
            raise FormatError(str(error), path, line) from error
        if (dof.node, dof.direction) in seen:
            raise FormatError(
                f"DOF {dof} occurs twice: also on line {seen[dof.node, dof.direction]}", path, line
            )
        seen[dof.node, dof.direction] = line
        dofs.append(dof)
    return DofSet(dofs)


def write_dofs(dofs: DofSet, path: str | Path) -> None:
    """Write a table of DOFs."""
    Path(path).write_text("\n".join(["dof", *dofs.labels, ""]), encoding="utf-8")


def read_geometry(
    path: str | Path,
    lines_path: str | Path | None = None,
    faces_path: str | Path | None = None,
    *,
    unit: str = "m",
) -> Geometry:
    """Read node positions, and optional tables of lines and faces to draw."""
    scale = length(unit)
    header, rows = _table(path, (_POINT, _POINT + _AXES), has_numbers=True)
    nodes = np.zeros(len(rows), dtype=np.int64)
    numbers = np.zeros((len(rows), len(header) - 1))
    for i, (line, cells) in enumerate(rows):
        nodes[i] = _whole(cells[0], path, line)
        numbers[i] = [_number(cell, path, line) for cell in cells[1:]]
    axes = None
    if len(header) > len(_POINT):
        axes = numbers[:, 3:].reshape(-1, 3, 3)
    lines = _node_rows(lines_path, _LINE)
    faces = _node_rows(faces_path, _FACE)
    with locate_errors(path):
        return Geometry(nodes, numbers[:, :3] * scale, lines, axes, faces)


def write_geometry(geometry: Geometry, path: str | Path) -> None:
    """Write node positions without loss of digits."""
    columns: tuple[str, ...] = _POINT
    numbers = geometry.xyz
    if geometry.axes is not None:
        columns = _POINT + _AXES
        numbers = np.hstack([numbers, geometry.axes.reshape(-1, 9)])
    lines = [",".join(columns)]
    for node, row in zip(geometry.nodes.tolist(), numbers.tolist(), strict=True):
        lines.append(",".join([str(node), *map(repr, row)]))
    Path(path).write_text("\n".join([*lines, ""]), encoding="utf-8")


def write_lines(geometry: Geometry, path: str | Path) -> None:
    """Write the lines to draw."""
    _write_node_rows(geometry.lines, _LINE, path)


def write_faces(geometry: Geometry, path: str | Path) -> None:
    """Write the faces to draw."""
    _write_node_rows(geometry.faces, _FACE, path)


def _node_rows(path: str | Path | None, header: tuple[str, ...]) -> IntArray:
    """Return the node numbers of a table, shape (m, len(header)); no rows without a table."""
    rows: list[list[int]] = []
    if path is not None:
        for line, cells in _table(path, (header,), has_numbers=True)[1]:
            rows.append([_whole(cell, path, line) for cell in cells])
    return np.array(rows, dtype=np.int64).reshape(-1, len(header))


def _write_node_rows(rows: IntArray, header: tuple[str, ...], path: str | Path) -> None:
    lines = [",".join(header)]
    for row in rows.tolist():
        lines.append(",".join(map(str, row)))
    Path(path).write_text("\n".join([*lines, ""]), encoding="utf-8")


def _table(
    path: str | Path, headers: tuple[tuple[str, ...], ...], *, has_numbers: bool = False
) -> tuple[tuple[str, ...], list[tuple[int, list[str]]]]:
    text = read_utf8(path)
    lines = list(enumerate(text.splitlines(), 1))
    comments = [(number, row) for number, row in lines if row.lstrip().startswith("#")]
    check_comments(comments, (), "give the unit of length when reading", path)
    rows = []
    for number, row in lines:
        if row.strip() and not row.lstrip().startswith("#"):
            rows.append((number, [cell.strip() for cell in row.split(",")]))
    expected = " or ".join(repr(",".join(known)) for known in headers)
    if not rows:
        raise FormatError(f"the table is empty; expected the header {expected}", path)
    line, first = rows[0]
    header = tuple(first)
    if header not in headers:
        raise FormatError(f"header {','.join(first)!r}; expected {expected}", path, line)
    if has_numbers:  # a truncated number is still a number, unlike a truncated label
        check_last_line(text, path, harmless=_COMMENT)
    for line, cells in rows[1:]:
        if len(cells) != len(header):
            raise FormatError(
                f"{len(cells)} column(s); expected {len(header)}: {','.join(header)}", path, line
            )
    return header, rows[1:]


def _number(cell: str, path: str | Path, line: int) -> float:
    try:
        return parse_real(cell)
    except ValueError as error:
        raise FormatError(f"{cell!r} is not a number", path, line) from error


def _whole(cell: str, path: str | Path, line: int) -> int:
    try:
        return parse_integer(cell)
    except ValueError as error:
        raise FormatError(f"{cell!r} is not a whole number", path, line) from error
