"""`match`: match sensors and forces of a test to DOFs of a model, by label or by position.

The user's input is the table of labels, the directions of sensors, and the geometries of the test.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.errors import DofError, OptionError, UpdynWarning, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching.directions import AssignedDof, SensorDirection, assign_dofs
from updyn.matching.placement import NodeMatch, match_nodes, read_tolerance
from updyn.matching.result import Alignment, MatchError, Matching, SensorMatch
from updyn.matching.settings import SENSOR_DIRECTION
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.positions import CoordinateSystem, check_labels, model_size

__all__ = ["match"]

_WAYS = ("label", "coordinates")
_ANY = "any"  # tolerance without a comparison of positions
_NODE = re.compile(r"-?[0-9]{1,18}")  # longer numbers are not node numbers


def match(
    model: Model,
    data: FRF | ModeSet,
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
    """Match sensors and forces to the model, and label the measurement with its DOFs.

    If a sensor is not along a DOF of its node, the DOFs of that node are rotated, exactly, in a
    copy of the model. Nothing is interpolated between nodes, and every assumed unit, alignment or
    direction is reported.

    Parameters
    ----------
    model : Model
        The structure.
    data : FRF or ModeSet
        The measurement, with the labels of the test.
    geometry : Geometry, optional
        Positions of the nodes of the test, and their directions; by default from the geometry of
        the FRFs. If both give directions of a node, those of the FRFs are used, as their labels
        refer to them.
    by : {"label", "coordinates"}
        By label, test and model have the same labels; if both have positions, these are compared.
        By coordinates, each sensor is matched to the nearest node of the model with translations
        or rotations, whichever it measures.
    tolerance : float or str, optional
        Largest distance between a sensor and its node in m, or a share of the diagonal of the box
        around the model, such as "0.5 %". Default by coordinates 1 %; by label 5 %, or 25 % if the
        node is the nearest of the model, after a change of unit or a rigid motion of the positions
        if needed. "any" matches by label without a comparison of positions.
    unit : {"m", "cm", "mm", "in", "ft"}, optional
        Unit of the positions of the test. By default m is assumed, and it is an error if they fit
        only in another unit; a given unit is always used.
    alignment : "fit", mapping of int to int, or array_like of float, shape (4, 4), optional
        Motion of the positions of the test onto the model. "fit": rotation and shift with the
        smallest distances to the nearest nodes, starting from the given positions; for small
        corrections. A mapping: from nodes of the test to the nodes of the model at the same place;
        three or more, not in a line. A matrix: the rotation, and the shift in m in the last
        column. By default, both systems are the same.
    angle : float, optional
        Angle in degrees within which a direction is taken to be along a DOF; above 0.1, a warning
        gives the sensors. By default 0.1, or 1 for a fitted alignment.
    table : mapping of str to str, optional
        Labels in the model by label in the test, for any `by`; signs multiply: ``{"3:Z":
        "17:-Z"}``. A node alone, ``{"3": "17"}``, applies to all its sensors. Their positions are
        not compared.
    directions : mapping of str to array_like of float, shape (3,), optional
        Directions of sensors or forces by label in the test, in the axes of the test; any length.
        For rotations, the axis of rotation. They replace the directions from label and geometry.

    Returns
    -------
    Matching
        The model, the renamed measurement, and the table of sensors and their DOFs.

    Raises
    ------
    MatchError
        If a sensor is not matched (the message lists the nearest candidates), two sensors have the
        same DOF, positions fit only in another unit, labels and positions contradict each other,
        or the directions at a node cannot all be DOFs.
    OptionError
        If an option is unknown or does not apply to this way of matching.

    Warns
    -----
    UpdynWarning
        If sensors deviate from their DOFs by an angle up to `angle`, a fit to nearest nodes moved
        the sensors far, or positions of equal labels agree only in other axes.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> matching = updyn.match(chain.build(), chain.measure())
    >>> matching.frf.responses.labels[0]
    '2:X'
    """
    _check_options(by, tolerance, unit, alignment, angle)
    sensors = _roles(data)
    data_geometry = data.geometry if isinstance(data, FRF) else None
    test = _UserInput(
        sensors,
        _read_table(table or {}, sensors),
        _read_directions(directions or {}, sensors),
        data_geometry,
        geometry,
    )
    aligned: Alignment | None = None
    notes: list[str] = []
    if by == "label":
        nodes = test.nodes_by_label(model, None)
    else:
        nodes, aligned, notes = test.nodes_by_coordinates(model, tolerance, unit, alignment)
    notes += test.warn_of_unused(model, by)
    rotation = np.eye(3) if aligned is None else aligned.rotation
    targets = []
    for sensor, role in sensors.items():
        targets.append(test.target(sensor, role, nodes, rotation, by, model))
    if angle is None:
        is_fitted = aligned is not None and aligned.residual is not None
        angle = SENSOR_DIRECTION.fitted_angle if is_fitted else SENSOR_DIRECTION.exact_angle
    try:
        changed, assigned, more = assign_dofs(model, targets, angle)
    except MatchError as error:
        wrong = test.table.places(map(Dof.parse, error.lost))
        error.key = error.key or (wrong[0] if wrong else ())
        raise
    is_moved = by != "label" or changed is not model
    if by == "label":
        aligned, remarks = test.compare_labels(model, tolerance)
        notes += remarks
        is_moved = is_moved or aligned is not None or tolerance is not None
        nodes = test.nodes_by_label(model, aligned)
    _warn_of_angles(targets, assigned)
    rows = []
    for target, dof in zip(targets, assigned, strict=True):
        rows.append(_sensor_match(target, dof, test.node_of(target, nodes, model, aligned)))
    new = {t.sensor: found.dof for t, found in zip(targets, assigned, strict=True)}
    named: FRF | ModeSet
    if isinstance(data, FRF):
        named = replace(
            _rename_dofs(data, new, test.table),
            geometry=_geometry_in_model(test, targets, changed, aligned, is_moved),
            source=_record(data.source, by, rows),
        )
    else:
        dofs = _model_dofs("DOFs", data.dofs, new, test.table)
        named = data.renamed(dofs, source=_record(data.source, by, rows))
    return Matching(changed, named, tuple(rows), by, aligned, (*notes, *more))


def _check_options(by: str, tolerance: object, unit: object, alignment: object, angle: Any) -> None:
    if by not in _WAYS:
        raise OptionError(f"by = {by!r}: {suggest(str(by), _WAYS)}")
    if by == "label":
        for name, value in (("unit", unit), ("alignment", alignment)):
            if value is not None:
                raise MatchError(
                    f"{name} belongs to by = 'coordinates'; by label positions are only compared",
                    (name,),
                )
    elif tolerance == _ANY:
        raise MatchError(
            "tolerance 'any' belongs to by = 'label'; expected a distance in m, or a share such as"
            " '1 %'",
            ("tolerance",),
        )
    if isinstance(alignment, str) and alignment != "fit":
        raise MatchError(
            f"alignment {alignment!r}: expected 'fit', pairs of nodes, or a 4 x 4 matrix",
            ("alignment",),
        )
    if angle is None:
        return
    is_number = isinstance(angle, int | float | np.number) and not isinstance(angle, bool)
    if not (is_number and 0 <= angle <= 45):
        raise MatchError(f"angle {angle!r}: expected degrees between 0 and 45", ("angle",))


# -- user input
def _roles(data: FRF | ModeSet) -> dict[Dof, str]:
    """Return the role of each sensor and force, by unsigned label, in order."""
    if isinstance(data, ModeSet):
        return dict.fromkeys(map(abs, data.dofs), "DOF of the modes")
    frf = data
    responses = [*map(abs, frf.responses)]
    references = [*map(abs, frf.references)]
    out = dict.fromkeys(responses, "response")
    for dof in references:
        out[dof] = "response and reference" if dof in responses else "reference"
    return out


@dataclass(frozen=True, slots=True)
class _Table:
    """Model labels and nodes by those of the test, and the original entries for messages."""

    dofs: Mapping[Dof, Dof] = field(default_factory=dict)
    nodes: Mapping[int, int] = field(default_factory=dict)
    written: Mapping[Dof | int, str] = field(default_factory=dict)

    def places(self, sensors: Iterable[Dof]) -> list[tuple[str, ...]]:
        """Return the key paths of the entries for given sensors, in the order of the table."""
        used = {sensor if sensor in self.dofs else sensor.node for sensor in map(abs, sensors)}
        return [("table", text) for entry, text in self.written.items() if entry in used]


def _read_table(given: Mapping[str, str], sensors: Mapping[Dof, str]) -> _Table:
    """Read model labels and nodes by those of the test; errors have the key of the entry."""
    if not isinstance(given, Mapping):
        raise MatchError(
            f"table: expected labels by label, found {type(given).__name__}", ("table",)
        )
    dofs: dict[Dof, Dof] = {}
    nodes: dict[int, int] = {}
    written: dict[Dof | int, str] = {}
    for old, new in given.items():
        at = ("table", str(old))
        if _NODE.fullmatch(str(old)):
            nodes[int(old)] = _read_node(old, new, sensors, at)
            written[int(old)] = str(old)
            continue
        before = _label(old, at)
        after = _label(new, at)
        _check_is_sensor(old, before, sensors, at)
        if abs(before) in dofs:
            raise MatchError(
                f"{old!r} names a sensor that already has an entry, with another sign", at
            )
        dofs[abs(before)] = after if before.sign > 0 else -after
        written[abs(before)] = str(old)
    return _Table(dofs, nodes, written)


def _read_node(old: Any, new: Any, sensors: Mapping[Dof, str], at: tuple[str, ...]) -> int:
    if not _NODE.fullmatch(str(new)):
        raise MatchError(f"{old} is a node: expected a node of the model, found {new!r}", at)
    known = [sensor.node for sensor in sensors]
    if int(old) not in known:
        near = suggest(str(old), [str(node) for node in known])
        raise MatchError(
            f"node {old} holds no response or reference of the measurement; {near}", at
        )
    return int(new)


def _read_directions(
    given: Mapping[str, ArrayLike], sensors: Mapping[Dof, str]
) -> dict[Dof, RealArray]:
    """Return unit directions by sensor, in the axes of the test."""
    if not isinstance(given, Mapping):
        raise MatchError(
            f"directions: expected vectors by label, found {type(given).__name__}", ("directions",)
        )
    out: dict[Dof, RealArray] = {}
    for label, vector in given.items():
        at = ("directions", str(label))
        dof = _label(label, at)
        _check_is_sensor(label, dof, sensors, at)
        if abs(dof) in out:
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
        a = a / np.abs(a).max()  # the square of a length of 1e-200 would be 0
        out[abs(dof)] = dof.sign * a / np.linalg.norm(a)
    return out


def _label(given: Any, place: tuple[str, ...]) -> Dof:
    try:
        return Dof.parse(given)
    except DofError as error:
        raise MatchError(str(error), place) from error


def _check_is_sensor(
    label: str, dof: Dof, sensors: Mapping[Dof, str], place: tuple[str, ...]
) -> None:
    if abs(dof) not in sensors:
        near = suggest(str(label), [str(s) for s in sensors])
        raise MatchError(
            f"{str(label)!r} is no response or reference of the measurement; {near}", place
        )


@dataclass(frozen=True, slots=True, eq=False)
class _UserInput:
    """Sensors of a test with their roles, and the user's table, directions and geometries.

    `measured` is the geometry of the measurement, `given` the argument of `match`.
    """

    sensors: Mapping[Dof, str]
    table: _Table
    vectors: Mapping[Dof, RealArray]
    measured: Geometry | None
    given: Geometry | None

    @property
    def geometry(self) -> Geometry | None:
        return self.measured if self.given is None else self.given

    def _geometry_of_node(self, node: int) -> Geometry | None:
        for source in (self.measured, self.given):
            if source is not None and node in source.nodes:
                return source
        return None

    def axes(self, node: int) -> RealArray | None:
        """Return the directions of a node of the test as rows; None if no geometry has the node."""
        source = self._geometry_of_node(node)
        if source is None:
            return None
        if source.axes is None:
            return np.eye(3)
        return np.asarray(source.axes[int(np.argmax(source.nodes == node))])

    def nodes_by_label(self, model: Model, aligned: Alignment | None) -> dict[int, NodeMatch]:
        """Return the model node for each node of the test: the same number, or from the table."""
        out = {}
        for node in {sensor.node for sensor in self.sensors}:
            new = self.table.nodes.get(node, node)
            distance = _distance(self.geometry, node, model.geometry, new, aligned)
            out[node] = NodeMatch(new, distance)
        return out

    def compare_labels(
        self, model: Model, tolerance: float | str | None
    ) -> tuple[Alignment | None, list[str]]:
        """Compare the positions of nodes that are not in the table, and warn of other axes.

        Returns notes and the alignment in which labels and positions agree, None if they agree
        directly.
        """
        if tolerance == _ANY:
            return None, ["By label whatever the positions are (tolerance = any)"]
        if self.geometry is None or model.geometry is None:
            if tolerance is None:
                return None, []
            whose = "the measurement" if self.geometry is None else "the model"
            raise MatchError(
                f"tolerance: {whose} has no positions that could be compared; leave it out",
                ("tolerance",),
            )
        limit = None
        if tolerance is not None:
            limit = read_tolerance(tolerance, model_size(model), _ANY)
        table = self.table
        nodes = [s.node for s in self.sensors if s not in table.dofs and s.node not in table.nodes]
        found = check_labels(model, self.geometry, nodes, limit)
        if found is None:
            return None, []
        if found.contradiction:
            insist = 'tolerance = "any" matches by label nevertheless'
            raise MatchError(f"{found.contradiction}\n{insist}", ("by",), proposal=found.proposal)
        if found.warning:
            warnings.warn(found.warning, UpdynWarning, stacklevel=3)
        return _as_alignment(found.system), [*filter(None, [found.note, found.warning])]

    def nodes_by_coordinates(
        self, model: Model, tolerance: float | str | None, unit: str | None, alignment: object
    ) -> tuple[dict[int, NodeMatch], Alignment, list[str]]:
        """Return the nearest node of the model for each node of the test not in the table."""
        if self.geometry is None:
            raise MatchError(
                "the measurement has no geometry: give that of the test, or match by label",
                ("geometry",),
            )
        needs: dict[int, frozenset[int]] = {}  # translations (0), rotations (1) or both
        for sensor in self.sensors:
            if sensor in self.table.dofs or sensor.node in self.table.nodes:
                continue
            part = DIRECTIONS.index(sensor.direction) // 3
            needs[sensor.node] = needs.get(sensor.node, frozenset()) | {part}
        if not needs:
            raise MatchError("table contains every sensor; match by label", ("by",))
        found, aligned, notes = match_nodes(model, self.geometry, needs, tolerance, unit, alignment)
        for node, new in self.table.nodes.items():
            distance = _distance(self.geometry, node, model.geometry, new, aligned)
            found[node] = NodeMatch(new, distance)
        return found, aligned, notes

    def node_of(
        self,
        target: SensorDirection,
        nodes: Mapping[int, NodeMatch],
        model: Model,
        aligned: Alignment | None,
    ) -> NodeMatch:
        """Return the model node of a sensor, and the distance between the two."""
        found = nodes.get(target.sensor.node)
        if found is not None and found.node == target.dof.node:
            return found
        distance = _distance(
            self.geometry, target.sensor.node, model.geometry, target.dof.node, aligned
        )
        return NodeMatch(target.dof.node, distance)

    def target(
        self,
        sensor: Dof,
        role: str,
        nodes: Mapping[int, NodeMatch],
        R: RealArray,
        by: str,
        model: Model,
    ) -> SensorDirection:
        """Return node and direction of a sensor in the model; `R` rotates the test to the model."""
        entry = self.table.dofs.get(sensor)
        vector = self.vectors.get(sensor)
        if entry is not None and vector is None:
            return SensorDirection(sensor, role, entry)
        if entry is not None and entry.sign < 0:
            raise MatchError(
                f"{sensor} has a direction, and the sign of {entry} in table besides; leave it out",
                ("directions", str(sensor)),
            )
        node = nodes[sensor.node].node if entry is None else entry.node
        dof = Dof(node, sensor.direction)
        if vector is None:
            source = self._geometry_of_node(sensor.node)
            has_axes = source is not None and source.axes is not None
            if by == "label" and (model.geometry is None or not has_axes):
                return SensorDirection(sensor, role, dof)
            axes = self.axes(sensor.node)
            if axes is None:
                axes = np.eye(3)
            vector = axes[DIRECTIONS.index(sensor.direction) % 3]
            vector = vector / np.linalg.norm(vector)
        return SensorDirection(sensor, role, dof, R @ vector)

    def warn_of_unused(self, model: Model, by: str) -> list[str]:
        """Warn of given directions that are not used; return the texts."""
        out = []
        nodes = list(dict.fromkeys(sensor.node for sensor in self.sensors))
        if by == "label" and model.geometry is None:
            rotated = [node for node in nodes if self._has_other_axes(node, np.eye(3))]
            if rotated:
                out.append(
                    f"According to the test, nodes {', '.join(map(str, rotated))} have their own"
                    " directions. The model has no geometry to compare them with: their labels are"
                    " used unchanged"
                )
        if self.measured is not None and self.given is not None and self.given.axes is not None:
            other = dict(zip(self.given.nodes.tolist(), self.given.axes, strict=True))
            both = [node for node in nodes if node in self.measured.nodes and node in other]
            differing = [node for node in both if self._has_other_axes(node, other[node])]
            if differing:
                out.append(
                    f"Directions of nodes {', '.join(map(str, differing))} are those of the"
                    " measurement; the given geometry has others"
                )
        for text in out:
            warnings.warn(text, UpdynWarning, stacklevel=3)
        return out

    def _has_other_axes(self, node: int, axes: RealArray) -> bool:
        test_axes = self.axes(node)
        if test_axes is None:
            return False
        return bool(np.abs(test_axes - axes).max() > SENSOR_DIRECTION.axes_difference)


def _distance(
    test: Geometry | None,
    node: int,
    model: Geometry | None,
    new: int,
    aligned: Alignment | None = None,
) -> float:
    """Return the distance of a test node from a model node in m; nan if unknown."""
    if test is None or model is None or node not in test.nodes or new not in model.nodes:
        return float("nan")
    at = test.position([node])
    if aligned is not None:
        at = aligned.apply(at)
    return float(np.linalg.norm(at - model.position([new])))


def _as_alignment(system: CoordinateSystem) -> Alignment | None:
    """Return the system in which labels and positions agree; None if it is that of the model."""
    if system.factor == 1.0 and system.residual is None:
        return None
    how = "not moved" if system.residual is None else "moved onto the nodes of the same labels"
    return Alignment(
        how, system.rotation, system.shift, system.factor, system.unit, system.residual
    )


# -- results
def _warn_of_angles(targets: Sequence[SensorDirection], assigned: Sequence[AssignedDof]) -> None:
    off = []
    for target, found in zip(targets, assigned, strict=True):
        if not found.turned and found.angle > SENSOR_DIRECTION.exact_angle:
            off.append((target, found))
    if off:
        target, found = max(off, key=lambda pair: pair[1].angle)
        warnings.warn(
            f"{len(off)} sensors and forces are taken along DOFs that they are not quite along; the"
            f" largest angle is {found.angle:.3g} degrees, of {target.sensor} with {found.dof}",
            UpdynWarning,
            stacklevel=3,
        )


def _rename_dofs(frf: FRF, new: Mapping[Dof, Dof], table: _Table) -> FRF:
    """Return the measurement with the labels of the model."""
    return replace(
        frf,
        responses=_model_dofs("responses", frf.responses, new, table),
        references=_model_dofs("references", frf.references, new, table),
    )


def _model_dofs(what: str, dofs: DofSet, new: Mapping[Dof, Dof], table: _Table) -> DofSet:
    renamed = []
    taken: dict[Dof, Dof] = {}
    for old in dofs:
        dof = new[abs(old)]
        other = taken.setdefault(abs(dof), old)
        if other is not old:
            places = table.places((other, old))
            raise MatchError(
                f"DOF {abs(dof)} occurs twice: {what} {other} and {old} would be the"
                " same; leave one out, or give it another place or direction",
                places[-1] if places else (),
            )
        renamed.append(dof if old.sign > 0 else -dof)
    return DofSet(renamed)


def _sensor_match(target: SensorDirection, found: AssignedDof, node: NodeMatch) -> SensorMatch:
    direction = None
    if target.vector is not None:
        x, y, z = target.vector.tolist()
        direction = (x, y, z)
    return SensorMatch(
        str(target.sensor),
        target.role,
        str(found.dof),
        node.distance,
        found.angle,
        found.turned,
        direction,
        node.note,
    )


def _record(source: str, by: str, rows: Sequence[SensorMatch]) -> str:
    """Return the source of the data with the changed labels, for results and reports."""
    changed = []
    for row in rows:
        if row.turned:
            changed.append(f"{row.sensor} = {row.dof} (turned)")
        elif row.sensor != row.dof:
            changed.append(f"{row.sensor} = {row.dof}")
    if not changed:
        return source
    text = f"matched by {by}, test = model: {', '.join(changed)}"
    return f"{source}; {text}" if source else text


def _geometry_in_model(
    test: _UserInput,
    targets: Sequence[SensorDirection],
    model: Model,
    aligned: Alignment | None,
    is_moved: bool,
) -> Geometry | None:
    """Return the measured nodes with numbers and positions of the model, and their lines."""
    nodes = {t.sensor.node: t.dof.node for t in reversed(targets)}
    if not is_moved and all(a == b for a, b in nodes.items()):
        return test.measured
    new = list(dict.fromkeys(nodes[t.sensor.node] for t in targets))
    model_geometry = model.geometry
    axes = None
    if model_geometry is not None and np.isin(new, model_geometry.nodes).all():
        rows = np.array([np.flatnonzero(model_geometry.nodes == n)[0] for n in new])
        xyz = model_geometry.xyz[rows]
        if model_geometry.axes is not None:
            axes = model_geometry.axes[rows]
    elif test.geometry is not None and np.isin(list(nodes), test.geometry.nodes).all():
        first = {b: a for a, b in reversed(nodes.items())}
        xyz = test.geometry.position([first[n] for n in new])
        if aligned is not None:
            xyz = aligned.apply(xyz)
    else:
        return None
    lines: dict[tuple[int, int], None] = {}
    if test.geometry is not None:
        for a, b in test.geometry.lines.tolist():
            if a in nodes and b in nodes and nodes[a] != nodes[b]:
                lines[nodes[a], nodes[b]] = None
    return Geometry(new, xyz, list(lines), axes)
