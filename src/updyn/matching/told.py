"""What is said about a test: its sensors, the user's table and directions, and the geometries that know its nodes."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import DIRECTIONS, Dof
from updyn.errors import DofError, UpdynWarning, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching.nearest import Placed, place
from updyn.matching.table import Alignment, MatchError
from updyn.matching.turning import Aim
from updyn.model import Model

__all__ = ["Told", "positive", "read_directions", "read_table", "sensors_of"]

_NODE = re.compile(r"-?[0-9]+")


# -- what was said -----------------------------------------------------------------------------------------
def positive(dof: Dof) -> Dof:
    """Return a DOF without its sign."""
    return dof if dof.sign > 0 else -dof


def sensors_of(frf: FRF) -> dict[Dof, str]:
    """Return what was measured, without signs, in order, and what it is there."""
    responses, references = ([positive(d) for d in s] for s in (frf.responses, frf.references))
    both = set(responses) & set(references)
    out = {d: "response and reference" if d in both else "response" for d in responses}
    return out | {d: "reference" for d in references if d not in both}


@dataclass(frozen=True, slots=True)
class Table:
    """Labels and nodes of the test, and what they are in the model."""

    dofs: Mapping[Dof, Dof] = field(default_factory=dict)
    nodes: Mapping[int, int] = field(default_factory=dict)


def read_table(given: Mapping[str, str], sensors: Mapping[Dof, str]) -> Table:
    """Read labels and nodes by those of the test; errors say which entry."""
    if not isinstance(given, Mapping):
        raise MatchError(
            f"table: expected labels by label, found {type(given).__name__}", ("table",)
        )
    dofs: dict[Dof, Dof] = {}
    nodes: dict[int, int] = {}
    for old, new in given.items():
        at = ("table", str(old))
        if _NODE.fullmatch(str(old)):
            if not _NODE.fullmatch(str(new)):
                raise MatchError(
                    f"{old} is a node: expected a node of the model, found {new!r}", at
                )
            if int(old) not in {s.node for s in sensors}:
                near = suggest(str(old), [str(s.node) for s in sensors])
                raise MatchError(
                    f"node {old} holds no response or reference of the measurement; {near}", at
                )
            nodes[int(old)] = int(new)
            continue
        before, after = _label(old, at), _label(new, at)
        _check_is_sensor(old, before, sensors, at)
        if positive(before) in dofs:
            raise MatchError(
                f"{old!r} names a sensor that already has an entry, with another sign", at
            )
        dofs[positive(before)] = after if before.sign > 0 else -after
    return Table(dofs, nodes)


def read_directions(
    given: Mapping[str, ArrayLike], sensors: Mapping[Dof, str]
) -> dict[Dof, NDArray[np.float64]]:
    """Return directions of length 1 by sensor, in the axes of the test."""
    if not isinstance(given, Mapping):
        raise MatchError(
            f"directions: expected vectors by label, found {type(given).__name__}", ("directions",)
        )
    out: dict[Dof, NDArray[np.float64]] = {}
    for label, vector in given.items():
        at = ("directions", str(label))
        dof = _label(label, at)
        _check_is_sensor(label, dof, sensors, at)
        if positive(dof) in out:
            raise MatchError(
                f"{label!r} names a sensor that already has a direction, with another sign", at
            )
        try:
            a = np.asarray(vector, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise MatchError(
                f"direction of {label}: expected three numbers ({error})", at
            ) from error
        if a.shape != (3,) or not np.isfinite(a).all() or not a.any():
            raise MatchError(
                f"direction of {label}: expected three finite numbers, not all 0, found {vector!r}",
                at,
            )
        a = a / np.abs(a).max()  # a length of 1e-200 has a square of 0
        out[positive(dof)] = dof.sign * a / np.linalg.norm(a)
    return out


def _label(given: Any, place: tuple[str, ...]) -> Dof:
    try:
        return Dof.parse(given)
    except DofError as error:
        raise MatchError(str(error), place) from error


def _check_is_sensor(
    label: str, dof: Dof, sensors: Mapping[Dof, str], place: tuple[str, ...]
) -> None:
    if positive(dof) not in sensors:
        near = suggest(str(label), [str(s) for s in sensors])
        raise MatchError(
            f"{str(label)!r} is no response or reference of the measurement; {near}", place
        )


# -- where sensors are, and which way they point -----------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """All that is said about the test."""

    sensors: Mapping[Dof, str]
    table: Table
    vectors: Mapping[Dof, NDArray[np.float64]]
    measured: Geometry | None
    given: Geometry | None

    @property
    def geometry(self) -> Geometry | None:
        """Where positions are taken from."""
        return self.measured if self.given is None else self.given

    def axes(self, node: int) -> NDArray[np.float64] | None:
        """Return the directions of a node of the test, as rows; None where nothing is said of them."""
        for source in (self.measured, self.given):
            if source is not None and node in source.nodes:
                return (
                    np.eye(3)
                    if source.axes is None
                    else source.axes[int(np.argmax(source.nodes == node))]
                )
        return None

    def by_label(self, model: Model) -> dict[int, Placed]:
        """Return the node of the model for each node of the test: of the same number, unless the table says else."""
        out = {}
        for node in {s.node for s in self.sensors}:
            new = self.table.nodes.get(node, node)
            out[node] = Placed(new, _distance(self.geometry, node, model.geometry, new))
        return out

    def by_coordinates(
        self, model: Model, tolerance: float | str | None, unit: str | None, alignment: Any
    ) -> tuple[dict[int, Placed], Alignment, list[str]]:
        """Return the nearest node of the model for each node of the test that is not in the table."""
        if self.geometry is None:
            raise MatchError(
                "the measurement has no geometry: give that of the test, or match by label",
                ("geometry",),
            )
        needs: dict[int, set[int]] = {}
        for s in self.sensors:
            if s not in self.table.dofs and s.node not in self.table.nodes:
                needs.setdefault(s.node, set()).add(DIRECTIONS.index(s.direction) // 3)
        if not needs:
            raise MatchError("every sensor stands in table; match by label", ("by",))
        wanted = {n: frozenset(parts) for n, parts in needs.items()}
        placed, aligned, notes = place(model, self.geometry, wanted, tolerance, unit, alignment)
        for node, new in self.table.nodes.items():
            placed[node] = Placed(new, _distance(self.geometry, node, model.geometry, new, aligned))
        return placed, aligned, notes

    def placed(
        self, aim: Aim, placed: Mapping[int, Placed], model: Model, aligned: Alignment | None
    ) -> Placed:
        """Return where a sensor sits in the model and how far from it it stands."""
        found = placed.get(aim.sensor.node)
        if found is not None and found.node == aim.dof.node:
            return found
        return Placed(
            aim.dof.node,
            _distance(self.geometry, aim.sensor.node, model.geometry, aim.dof.node, aligned),
        )

    def aim(
        self,
        sensor: Dof,
        role: str,
        placed: Mapping[int, Placed],
        R: NDArray[np.float64],
        by: str,
        model: Model,
    ) -> Aim:
        """Return where a sensor is to sit in the model and which way it points; `R` turns the test to the model."""
        entry, vector = self.table.dofs.get(sensor), self.vectors.get(sensor)
        if entry is not None and vector is None:
            return Aim(sensor, role, entry)
        if entry is not None and vector is not None and entry.sign < 0:
            at = ("directions", str(sensor))
            raise MatchError(
                f"{sensor} has a direction, and the sign of {entry} in table besides; leave it out",
                at,
            )
        node = placed[sensor.node].node if entry is None else entry.node
        if vector is None:
            axes = self.axes(sensor.node)
            if by == "label" and (
                axes is None or model.geometry is None or not self._has_axes(sensor.node)
            ):
                return Aim(sensor, role, Dof(node, sensor.direction))
            vector = (np.eye(3) if axes is None else axes)[DIRECTIONS.index(sensor.direction) % 3]
            vector = vector / np.linalg.norm(vector)
        return Aim(sensor, role, Dof(node, sensor.direction), R @ vector)

    def _has_axes(self, node: int) -> bool:
        """Return whether the geometry that knows a node says directions at all."""
        for source in (self.measured, self.given):
            if source is not None and node in source.nodes:
                return source.axes is not None
        return False

    def doubts(self, model: Model, by: str) -> list[str]:
        """Return what was said and not used."""
        out = []
        nodes = list(dict.fromkeys(s.node for s in self.sensors))
        if by == "label" and model.geometry is None:
            off = [
                n
                for n in nodes
                if (a := self.axes(n)) is not None and np.abs(a - np.eye(3)).max() > 1e-9
            ]
            if off:
                out.append(
                    f"The test says that nodes {', '.join(map(str, off))} have directions of their"
                    " own. The model has no geometry that could say how they compare with its own:"
                    " their labels are taken as they are"
                )
        if self.measured is not None and self.given is not None and self.given.axes is not None:
            both = [n for n in nodes if n in self.measured.nodes and n in self.given.nodes]
            rows = {int(n): a for n, a in zip(self.given.nodes, self.given.axes, strict=True)}
            off = [
                n
                for n in both
                if (a := self.axes(n)) is not None and np.abs(rows[n] - a).max() > 1e-9
            ]
            if off:
                out.append(
                    f"Directions of nodes {', '.join(map(str, off))} as the measurement itself"
                    " says; the geometry given says others"
                )
        for text in out:
            warnings.warn(text, UpdynWarning, stacklevel=3)
        return out


def _distance(
    test: Geometry | None,
    node: int,
    model: Geometry | None,
    new: int,
    aligned: Alignment | None = None,
) -> float:
    if test is None or model is None or node not in test.nodes or new not in model.nodes:
        return float("nan")
    at = test.position([node])
    return float(
        np.linalg.norm((at if aligned is None else aligned.apply(at)) - model.position([new]))
    )
