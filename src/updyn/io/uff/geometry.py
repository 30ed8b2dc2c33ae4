"""Nodes, coordinate systems, trace lines, elements and units of universal files.

Datasets 15 (nodes), 2411 (nodes, double precision), 18 and 2420 (coordinate systems), 82 (trace
lines), 2412 (elements), 164 (units); layouts by SDRC. Ambiguities are resolved as in I-DEAS:

- Systems 0 and 1 are the global Cartesian system unless the file defines them.
- Rows 1 to 3 of a 2420 matrix are the axes of the system in the global one, row 4 is its origin.
- Angles are in degrees; cylindrical is (r, azimuth, z), spherical (r, angle from z, azimuth).
- Positions of dataset 15 are in the definition system. Those of 2411 are in the system of the part,
  which is the global one here; its field 2 is an export system that does not change them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError
from updyn.geometry import Geometry
from updyn.io.items import locate_errors
from updyn.io.uff.datasets import (
    Dataset,
    decode_line,
    parse_real_field,
    read_integer_field,
    read_integer_fields,
)
from updyn.io.uff.elements import Elements, read_elements

__all__ = ["NUMBERS", "GeometryCollector", "Units"]

#: Datasets that a `GeometryCollector` reads.
NUMBERS = (15, 18, 82, 164, 2411, 2412, 2420)
_GLOBAL = (0, 1)
#: Length and force of one SI unit in the units of each code of dataset 164.
_UNITS = {
    1: (1.0, 1.0),
    2: (3.28083989501, 0.224808943),
    3: (1.0, 0.101971621),
    4: (3.28083989501, 7.23301385),
    5: (1000.0, 1000.0),
    6: (100.0, 100.0),
    7: (39.3700787402, 0.224808943),
    8: (1000.0, 0.101971621),
    10: (1000.0, 1.0),
}
_USER_DEFINED = 9


@dataclass(frozen=True, slots=True)
class Units:
    """Factors of dataset 164: a number in the file divided by its factor is in SI.

    `line` is 0 for SI units without a dataset 164.
    """

    length: float = 1.0
    force: float = 1.0
    line: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class _UFFSystem:
    """A coordinate system, in the unit of the file: its axes are rows, in the global system."""

    kind: int
    axes: RealArray
    origin: RealArray

    def position(self, local: RealArray) -> RealArray:
        a, b, c = local.tolist()
        if self.kind == 1:
            local = np.array([a * _cos(b), a * _sin(b), c])
        elif self.kind == 2:
            local = a * np.array([_sin(b) * _cos(c), _sin(b) * _sin(c), _cos(b)])
        return self.origin + local @ self.axes

    def directions(self, point: RealArray) -> RealArray:
        """Return the directions (rows) at a point of the global system; azimuth 0 on the axis."""
        if self.kind == 0:
            return self.axes
        x, y, z = self.axes @ (point - self.origin)
        r = np.hypot(x, y)
        cos_a, sin_a = 1.0, 0.0
        if r > 1e-12 * np.abs([x, y, z]).max():
            cos_a, sin_a = x / r, y / r
        radial = np.array([cos_a, sin_a, 0.0])
        around = np.array([-sin_a, cos_a, 0.0])
        if self.kind == 1:
            return np.array([radial, around, [0.0, 0.0, 1.0]]) @ self.axes
        length = np.hypot(r, z)
        cos_p, sin_p = 1.0, 0.0
        if length:
            cos_p, sin_p = z / length, r / length
        outward = sin_p * radial + np.array([0.0, 0.0, cos_p])
        down = cos_p * radial - np.array([0.0, 0.0, sin_p])
        return np.array([outward, down, around]) @ self.axes


def _cos(degrees: float) -> float:
    return _sin(degrees + 90.0)


def _sin(degrees: float) -> float:
    """Return the sine, exact at multiples of 90 degrees."""
    # Exact, because a system rotated by 90 degrees has to coincide with the global axes.
    quarter = degrees / 90.0
    if quarter == int(quarter):
        return (0.0, 1.0, 0.0, -1.0)[int(quarter) % 4]
    return float(np.sin(np.deg2rad(degrees)))


@dataclass(slots=True)
class _Node:
    line: int
    definition: int
    displacement: int
    xyz: RealArray


@dataclass(slots=True)
class GeometryCollector:
    """Collects the datasets of positions, systems, lines and units, then builds the geometry.

    Systems may follow the nodes that use them, so `geometry` transforms all positions at the end.
    Nodes and systems are in the unit of the file.
    """

    path: str | Path
    units: Units = field(default_factory=Units)
    nodes: dict[int, _Node] = field(default_factory=dict)
    systems: dict[int, _UFFSystem] = field(default_factory=dict)
    traces: list[tuple[int, list[tuple[int, int]]]] = field(default_factory=list)
    elements: list[Elements] = field(default_factory=list)

    def take(self, dataset: Dataset) -> None:
        """Read a dataset whose number is in `NUMBERS`."""
        body = dataset.body.rstrip()
        if not body:
            raise FormatError(f"dataset {dataset.number} is empty", self.path, dataset.line)
        texts = [decode_line(line).rstrip() for line in body.split(b"\n")]
        lines = list(enumerate(texts, dataset.line + 1))
        readers = {
            15: self._15,
            18: self._18,
            82: self._82,
            164: self._164,
            2411: self._2411,
            2412: self._2412,
            2420: self._2420,
        }
        readers[dataset.number](lines)

    def _fields(self, line: int, text: str, count: int, what: str) -> list[int]:
        return read_integer_fields(text, count, what, self.path, line)

    def _reals(self, line: int, text: str, count: int, what: str) -> RealArray:
        words = text.split()
        if len(words) != count:
            raise FormatError(
                f"{what}: expected {count} numbers, found {len(words)}: {text!r}", self.path, line
            )
        return np.array([parse_real_field(word, what, self.path, line) for word in words])

    def _groups(
        self, lines: Sequence[tuple[int, str]], size: int, what: str
    ) -> Iterator[Sequence[tuple[int, str]]]:
        if len(lines) % size:
            raise FormatError(
                f"{what}: expected {size} lines for each, the last has {len(lines) % size}",
                self.path,
                lines[-1][0],
            )
        return (lines[i : i + size] for i in range(0, len(lines), size))

    # -- nodes -----------------------------------------------------------------------------------
    def _15(self, lines: Sequence[tuple[int, str]]) -> None:
        for line, text in lines:
            numbers = self._fields(line, text, 4, "dataset 15, node")
            self._add_node(line, numbers, self._reals(line, text[40:], 3, "dataset 15, position"))

    def _2411(self, lines: Sequence[tuple[int, str]]) -> None:
        for (line, text), (below, position) in self._groups(lines, 2, "dataset 2411"):
            number, _, displacement, _ = self._fields(line, text, 4, "dataset 2411, node")
            xyz = self._reals(below, position, 3, "dataset 2411, position")
            self._add_node(line, [number, 0, displacement], xyz)

    def _add_node(self, line: int, numbers: Sequence[int], xyz: RealArray) -> None:
        number, definition, displacement = numbers[:3]
        before = self.nodes.get(number)
        if before is not None:
            same = (before.definition, before.displacement) == (definition, displacement)
            if not (same and (before.xyz == xyz).all()):
                raise FormatError(
                    f"node {number} is defined twice: also on line {before.line}", self.path, line
                )
            return
        self.nodes[number] = _Node(line, definition, displacement, xyz)

    # -- coordinate systems ----------------------------------------------------------------------
    def _18(self, lines: Sequence[tuple[int, str]]) -> None:
        for (line, text), _, (third, a), (fourth, b) in self._groups(lines, 4, "dataset 18"):
            number, kind, reference, _, method = self._fields(line, text, 5, "dataset 18, system")
            if method != 1:
                raise FormatError(
                    f"dataset 18: definition method {method}; expected 1", self.path, line
                )
            parent = self._system(reference, line, f"system {number}, reference")
            six = self._reals(third, a, 6, "dataset 18, points")
            origin = parent.position(six[:3])
            on_x = parent.position(six[3:])
            on_xz = parent.position(self._reals(fourth, b, 3, "dataset 18, points"))
            x = on_x - origin
            y = np.cross(on_xz - origin, x)  # z x X = Y: the third point is on the side of +z
            length = np.linalg.norm(x)
            is_plane = np.linalg.norm(y) > 1e-9 * length * np.linalg.norm(on_xz - origin)
            if not (length > 0 and is_plane):
                raise FormatError(
                    f"dataset 18: the three points of system {number} are collinear",
                    self.path,
                    line,
                )
            x = x / length
            y = y / np.linalg.norm(y)
            self._add_system(line, number, kind, np.array([x, y, np.cross(x, y)]), origin)

    def _2420(self, lines: Sequence[tuple[int, str]]) -> None:
        for (line, text), _, *rows in self._groups(lines[2:], 6, "dataset 2420, system"):
            number, kind = self._fields(line, text, 2, "dataset 2420, system")
            matrix = np.array([self._reals(at, row, 3, "dataset 2420, matrix") for at, row in rows])
            self._add_system(line, number, kind, matrix[:3], matrix[3])

    def _add_system(
        self,
        line: int,
        number: int,
        kind: int,
        axes: RealArray,
        origin: RealArray,
    ) -> None:
        if kind not in (0, 1, 2):
            raise FormatError(
                f"system {number}: type {kind}; expected 0 (Cartesian), 1 (cylindrical) or 2"
                " (spherical)",
                self.path,
                line,
            )
        if not np.allclose(axes @ axes.T, np.eye(3), rtol=0, atol=1e-4):
            raise FormatError(
                f"system {number}: its axes are not three orthogonal unit vectors",
                self.path,
                line,
            )
        if number in self.systems:
            raise FormatError(f"system {number} is defined twice", self.path, line)
        self.systems[number] = _UFFSystem(kind, axes, origin)

    def _system(self, number: int, line: int, what: str) -> _UFFSystem:
        if number in self.systems:
            return self.systems[number]
        if number in _GLOBAL:
            return _UFFSystem(0, np.eye(3), np.zeros(3))
        known = ", ".join(map(str, sorted(self.systems))) or "none"
        raise FormatError(
            f"{what}: coordinate system {number} is not defined in this file (defined: {known}; 0"
            " and 1 are global)",
            self.path,
            line,
        )

    # -- lines and units -------------------------------------------------------------------------
    def _82(self, lines: Sequence[tuple[int, str]]) -> None:
        line, text = lines[0]
        _, count = self._fields(line, text, 2, "dataset 82, trace line")
        path: list[int] = []
        for at, row in lines[2:]:
            path += self._fields(at, row, -(-len(row) // 10), "dataset 82, node")
        if len(path) < count or any(path[count:]):
            raise FormatError(
                f"dataset 82: expected {count} nodes, found {len(path)}", self.path, line
            )
        pairs = [(a, b) for a, b in pairwise(path[:count]) if a and b]
        self.traces.append((line, pairs))

    def _2412(self, lines: Sequence[tuple[int, str]]) -> None:
        self.elements += read_elements(lines, self.path)

    def _164(self, lines: Sequence[tuple[int, str]]) -> None:
        line, text = lines[0]
        code = read_integer_field(text, 0, 10, "dataset 164, units code", self.path, line)
        words = " ".join(row for _, row in lines[1:]).split()
        if len(words) < 2:
            raise FormatError("dataset 164: no factors of length and force", self.path, line)
        length = parse_real_field(words[0], "dataset 164, factor", self.path, line)
        force = parse_real_field(words[1], "dataset 164, factor", self.path, line)
        if not (0 < length < np.inf and 0 < force < np.inf):
            raise FormatError(
                f"dataset 164: factors {length:g} and {force:g}; expected positive numbers",
                self.path,
                line,
            )
        expected = _UNITS.get(code)
        if expected is None and code != _USER_DEFINED:
            raise FormatError(f"dataset 164: units code {code}; expected 1 to 10", self.path, line)
        if expected is not None and not np.allclose((length, force), expected, rtol=1e-3, atol=0):
            raise FormatError(
                f"dataset 164: units code {code} requires factors {expected[0]:g} (length) and"
                f" {expected[1]:g} (force), found {length:g} and {force:g}",
                self.path,
                line,
            )
        if self.units.line and (self.units.length, self.units.force) != (length, force):
            raise FormatError(
                f"dataset 164 contradicts the one on line {self.units.line}", self.path, line
            )
        self.units = Units(length, force, line)

    # -- result ----------------------------------------------------------------------------------
    def geometry(self) -> Geometry | None:
        """Return the geometry in m, or None if the file has no nodes."""
        if not self.nodes:
            return None
        xyz = []
        axes = []
        for number, node in self.nodes.items():
            definition = self._system(node.definition, node.line, f"node {number}, definition")
            displacement = self._system(
                node.displacement, node.line, f"node {number}, displacement"
            )
            point = definition.position(node.xyz)
            xyz.append(point)
            axes.append(displacement.directions(point))
        drawn: list[tuple[int, int]] = []
        for line, pairs in self.traces:
            drawn += pairs
            for number in chain.from_iterable(pairs):
                if number not in self.nodes:
                    raise FormatError(
                        f"dataset 82: node {number} of the trace line has no position",
                        self.path,
                        line,
                    )
        self._check_elements()
        # All numbers so far are in the unit of the file; dataset 164 may follow any dataset.
        turned = np.abs(np.array(axes) - np.eye(3)).max() > 0
        with locate_errors(self.path):
            return Geometry(
                list(self.nodes),
                np.array(xyz) / self.units.length,
                drawn or Elements.edges(self.elements),
                axes if turned else None,
                Elements.faces(self.elements),
            )

    def _check_elements(self) -> None:
        """Refuse elements at nodes without a position."""
        known = list(self.nodes)
        for elements in self.elements:
            missing = ~np.isin(elements.corners, known)
            if missing.any():
                row = int(np.flatnonzero(missing.any(axis=1))[0])
                raise FormatError(
                    f"dataset 2412: node {elements.corners[missing][0]} of the element has no"
                    " position",
                    self.path,
                    elements.lines[row],
                )
