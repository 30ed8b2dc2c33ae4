"""`match`: sensors and forces of a test to DOFs of a model, by label or by position.

The user's input is the table of labels, the directions of sensors, and the geometries that know
the nodes of the test.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import DofError, OptionError, UpdynWarning, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching.directions import Aim, Seat, seat
from updyn.matching.placement import Placed, place
from updyn.matching.result import EXACT, Alignment, MatchError, Matching, SensorMatch
from updyn.model import Model

__all__ = [
    "Told",
    "match",
    "positive",
    "read_directions",
    "read_table",
    "sensors_of",
]

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


_WAYS = ("label", "coordinates")
_FITTED = 1.0  # degrees: a turn that was fitted to positions is no better known


def match(
    model: Model,
    frf: FRF,
    geometry: Geometry | None = None,
    *,
    by: str = "label",
    tolerance: float | str | None = None,
    unit: str | None = None,
    alignment: str | Mapping[int, int] | ArrayLike | None = None,
    angle: float | None = None,
    table: Mapping[str, str] | None = None,
    directions: Mapping[str, ArrayLike] | None = None,
) -> Matching:
    """Match sensors and forces to the model, and name the measurement as the model names its DOFs.

    A sensor that points along no DOF of its node is made one: the DOFs of that node are turned,
    exactly, in a copy of the model. Nothing is interpolated between nodes, and no unit, alignment
    or direction is assumed without a word.

    Parameters
    ----------
    model : Model
        The structure.
    frf : FRF
        The measurement, with the labels of the test.
    geometry : Geometry, optional
        Where the nodes of the test stand, and which way their directions point; None: as
        `frf.geometry` says. Where both know the directions of a node, those of `frf.geometry` hold:
        its labels are meant in them.
    by : {"label", "coordinates"}
        By label, test and model call the same DOF the same. By coordinates, each sensor belongs to
        the nearest node of the model that has translations, or rotations, as it measures them.
    tolerance : float or str, optional
        Largest distance in m, or a share of the diagonal of the box around the model, such as "0.5
        %". By default 1 %.
    unit : {"m", "cm", "mm", "in", "ft"}, optional
        Of the positions of the test. By default they are taken to be in m, and it is an error if
        they fit only in another unit; a stated unit is not doubted.
    alignment : "fit", mapping of int to int, or array_like of float, shape (4, 4), optional
        How to bring the positions of the test onto the model. "fit": turned and shifted until the
        distances to the nearest nodes are smallest, starting where they stand; for small
        corrections. A mapping: nodes of the test, and nodes of the model on which they lie; three
        or more, not in a line. A matrix: the turn, and in the last column the shift in m. By
        default the two systems are one.
    angle : float, optional
        Degrees within which a direction is taken to be along a DOF; above 0.1 with a warning that
        says which. By default 0.1, and 1 where the alignment was fitted.
    table : mapping of str to str, optional
        Label in the test = label in the model, whatever `by` says; signs multiply: ``{"3:Z":
        "17:-Z"}``. A node alone, ``{"3": "17"}``, stands for all sensors at it.
    directions : mapping of str to array_like of float, shape (3,), optional
        By label in the test, where a sensor or force points, in the axes of the test; any length.
        For rotations the axis of rotation. It replaces what the label and the geometry say.

    Returns
    -------
    Matching
        The model, the renamed measurement, and the table of who sits where.

    Raises
    ------
    MatchError
        If a sensor is not matched (the nearest candidates are listed), two are one DOF, positions
        fit in another unit only, or directions at a node cannot all be DOFs.
    OptionError
        If an option is not known or does not belong to this way of matching.

    Warns
    -----
    UpdynWarning
        If sensors are taken along DOFs that they are up to `angle` off, or a fit to nearest nodes
        went far.
    """
    _check_options(by, tolerance, unit, alignment, angle)
    sensors = sensors_of(frf)
    told = Told(
        sensors,
        read_table(table or {}, sensors),
        read_directions(directions or {}, sensors),
        frf.geometry,
        geometry,
    )
    aligned: Alignment | None = None
    notes: list[str] = []
    if by == "label":
        placed = told.by_label(model)
    else:
        placed, aligned, notes = told.by_coordinates(model, tolerance, unit, alignment)
    notes += told.doubts(model, by)
    rotation = np.eye(3) if aligned is None else aligned.rotation
    aims = [told.aim(s, roles, placed, rotation, by, model) for s, roles in sensors.items()]
    near = (
        angle
        if angle is not None
        else EXACT
        if aligned is None or aligned.residual is None
        else _FITTED
    )
    changed, seats, more = seat(model, aims, near)
    _warn_of_angles(aims, seats)
    named = _named(frf, aims, seats, bool(table))
    at = [told.placed(a, placed, model, aligned) for a in aims]
    rows = tuple(_sensor_match(a, s, p) for a, s, p in zip(aims, seats, at, strict=True))
    drawn = _drawn(told, aims, changed, aligned, moved=by != "label" or changed is not model)
    named = replace(named, geometry=drawn, source=_record(frf.source, by, rows))
    return Matching(changed, named, rows, by, aligned, (*notes, *more))


def _check_options(by: str, tolerance: Any, unit: Any, alignment: Any, angle: Any) -> None:
    if by not in _WAYS:
        raise OptionError(f"by = {by!r}: {suggest(str(by), _WAYS)}")
    if by == "label":
        for name, value in (("tolerance", tolerance), ("unit", unit), ("alignment", alignment)):
            if value is not None:
                raise MatchError(
                    f"{name} belongs to by = 'coordinates'; by label no positions are compared",
                    (name,),
                )
    if isinstance(alignment, str) and alignment != "fit":
        raise MatchError(
            f"alignment {alignment!r}: expected 'fit', pairs of nodes, or a 4 x 4 matrix",
            ("alignment",),
        )
    number = isinstance(angle, int | float | np.number) and not isinstance(angle, bool)
    if angle is not None and not (number and 0 <= angle <= 45):
        raise MatchError(f"angle {angle!r}: expected degrees between 0 and 45", ("angle",))


# -- what comes out ----------------------------------------------------------------------------------------
def _warn_of_angles(aims: Sequence[Aim], seats: Sequence[Seat]) -> None:
    off = [
        (s.angle, a, s)
        for a, s in zip(aims, seats, strict=True)
        if not s.turned and s.angle > EXACT
    ]
    if off:
        worst, aim, found = max(off, key=lambda t: t[0])
        warnings.warn(
            f"{len(off)} sensors and forces are taken along DOFs that they are not quite along; the"
            f" largest angle is {worst:.3g} degrees, of {aim.sensor} with {found.dof}",
            UpdynWarning,
            stacklevel=3,
        )


def _named(frf: FRF, aims: Sequence[Aim], seats: Sequence[Seat], by_table: bool) -> FRF:
    new = {a.sensor: s.dof for a, s in zip(aims, seats, strict=True)}
    sets: dict[str, Any] = {}
    for what, dofs in (("responses", frf.responses), ("references", frf.references)):
        taken: dict[Dof, Dof] = {}
        for old in dofs:
            dof = new[positive(old)]
            if (other := taken.setdefault(positive(dof), old)) is not old:
                raise MatchError(
                    f"DOF {positive(dof)} stands twice: {what} {other} and {old} would be the same;"
                    " leave one out, or give it another place or direction",
                    ("table",) if by_table else (),
                )
        sets[what] = DofSet([new[positive(d)] if d.sign > 0 else -new[positive(d)] for d in dofs])
    return replace(frf, **sets)


def _sensor_match(aim: Aim, found: Seat, at: Placed) -> SensorMatch:
    v = (
        None
        if aim.vector is None
        else (float(aim.vector[0]), float(aim.vector[1]), float(aim.vector[2]))
    )
    return SensorMatch(
        str(aim.sensor),
        aim.role,
        str(found.dof),
        at.distance,
        found.angle,
        found.turned,
        v,
        at.note,
    )


def _record(source: str, by: str, rows: Sequence[SensorMatch]) -> str:
    """Return where the data came from, with what became of the labels of the test: results and reports keep it."""
    changed = [
        f"{r.sensor} = {r.dof}" + (" (turned)" if r.turned else "")
        for r in rows
        if r.turned or r.sensor != r.dof
    ]
    if not changed:
        return source
    return "; ".join(
        [*([source] if source else []), f"matched by {by}, test = model: {', '.join(changed)}"]
    )


def _drawn(
    told: Told, aims: Sequence[Aim], model: Model, aligned: Alignment | None, moved: bool
) -> Geometry | None:
    """Return where the measured nodes stand in the model, numbered as there, with the lines between them."""
    test = told.geometry
    nodes = {a.sensor.node: a.dof.node for a in reversed(aims)}
    if not moved and all(a == b for a, b in nodes.items()):
        return told.measured
    own = model.geometry
    new = list(dict.fromkeys(nodes[a.sensor.node] for a in aims))
    if own is not None and np.isin(new, own.nodes).all():
        rows = np.array([np.flatnonzero(own.nodes == n)[0] for n in new])
        xyz, axes = own.xyz[rows], None if own.axes is None else own.axes[rows]
    elif test is not None and np.isin(list(nodes), test.nodes).all():
        first = {b: a for a, b in reversed(nodes.items())}
        xyz, axes = test.position([first[n] for n in new]), None
        xyz = xyz if aligned is None else aligned.apply(xyz)
    else:
        return None
    pairs = [] if test is None else [(nodes.get(a), nodes.get(b)) for a, b in test.lines.tolist()]
    lines = list(
        dict.fromkeys((a, b) for a, b in pairs if a is not None and b is not None and a != b)
    )
    return Geometry(new, xyz, lines, axes)
