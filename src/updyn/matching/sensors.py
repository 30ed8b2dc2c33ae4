"""`match`: sensors and forces of a test to DOFs of a model."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.dofs import Dof, DofSet
from updyn.errors import OptionError, UpdynWarning, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.matching.nearest import Placed
from updyn.matching.table import EXACT, Alignment, MatchError, Matching, SensorMatch
from updyn.matching.told import Told, positive, read_directions, read_table, sensors_of
from updyn.matching.turning import Aim, Seat, seat
from updyn.model import Model

__all__ = ["match"]

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
    rows = tuple(_row(a, s, p) for a, s, p in zip(aims, seats, at, strict=True))
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


def _row(aim: Aim, found: Seat, at: Placed) -> SensorMatch:
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
