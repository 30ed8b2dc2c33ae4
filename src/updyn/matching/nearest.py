"""Test nodes to model nodes by their positions: units, alignment, tolerance, and what could not be placed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from updyn.errors import UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.matching.rigid import check_pairs, fit_to_nearest, fit_to_pairs, given_matrix
from updyn.matching.table import SHOWN, Alignment, MatchError, listed, vector_text
from updyn.model import Model

__all__ = ["UNITS", "Placed", "place"]

#: Metres of each unit of length.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
_SHARE = 0.01  # tolerance where none is stated, of the model's size
_TIE = 1e-6  # of the model's size: nodes that are equally near
_CLOSE = 2.0  # a second node up to this many times as far is told

Points = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a node of the test came to lie.

    Attributes
    ----------
    node : int
        Of the model.
    distance : float
        Between the two, in m.
    note : str
        On another node nearly as near.
    """

    node: int
    distance: float
    note: str = ""


class _Candidates:
    """The nodes of a model that have a position and translations, rotations, or both, as asked for."""

    def __init__(self, model: Model, geometry: Geometry, needs: Sequence[frozenset[int]]) -> None:
        own = [
            np.isin(geometry.nodes, model.dofs.nodes[model.dofs.axes < 3]),
            np.isin(geometry.nodes, model.dofs.nodes[model.dofs.axes >= 3]),
        ]
        self.geometry, self.needs = geometry, needs
        self.used = own[0] | own[1]
        if not self.used.any():
            raise MatchError("no node of the geometry of the model has a DOF")
        box = geometry.xyz[self.used]
        self.size = float(np.linalg.norm(np.ptp(box, axis=0)))
        self.centre = box.mean(axis=0)
        self._trees: dict[frozenset[int], tuple[NDArray[np.intp], KDTree]] = {}
        for need in set(needs):
            rows = np.flatnonzero(np.logical_and.reduce([own[part] for part in need]))
            if not len(rows):
                what = " and ".join(("translations", "rotations")[part] for part in sorted(need))
                raise MatchError(
                    f"no node of the model with a position has {what}, which the sensors measure"
                )
            self._trees[need] = rows, KDTree(geometry.xyz[rows])

    def nearest(self, points: Points, n: int) -> tuple[NDArray[np.intp], Points]:
        """Return rows of the geometry and distances in m of the n nearest, shape (len(points), n); far ones inf."""
        rows = np.zeros((len(points), n), dtype=np.intp)
        far = np.full((len(points), n), np.inf)
        for need, (own, tree) in self._trees.items():
            at = [i for i, x in enumerate(self.needs) if x == need]
            distance, index = tree.query(points[at], k=list(range(1, n + 1)))
            far[at] = distance
            rows[at] = own[np.minimum(index, len(own) - 1)]
        return rows, far


@dataclass(frozen=True, slots=True, eq=False)
class _Try:
    """The sensors' nodes, brought to the model with one factor of length."""

    alignment: Alignment
    points: Points
    distance: Points
    distinct: bool


class _Placing:
    """What is asked of one call."""

    def __init__(
        self,
        model: Model,
        geometry: Geometry,
        test: Geometry,
        needs: Mapping[int, frozenset[int]],
        alignment: Any,
    ) -> None:
        self.nodes = list(needs)
        self.test, self.model_geometry, self.alignment = test, geometry, alignment
        self.candidates = _Candidates(model, geometry, list(needs.values()))
        self.raw = test.position(self.nodes)
        span = float(np.ptp(self.raw, axis=0).max())
        self.apart = len(np.unique(np.round(self.raw / span, 9), axis=0)) if span else 1
        self.tolerance = 0.0

    def attempt(self, unit: str | None, factor: float) -> _Try:
        x = factor * self.raw
        if self.alignment is None:
            found = Alignment("not moved", np.eye(3), np.zeros(3), factor, unit)
        elif isinstance(self.alignment, str):
            found = fit_to_nearest(
                x, self._nearest_points, self.candidates.centre, factor, unit, self.tolerance
            )
        elif isinstance(self.alignment, Mapping):
            found, *_ = fit_to_pairs(self.alignment, self.test, self.model_geometry, factor, unit)
        else:
            found = given_matrix(self.alignment, factor, unit)
        points = found.apply(self.raw)
        rows, far = self.candidates.nearest(points, 1)
        return _Try(found, points, far[:, 0], len(np.unique(rows[:, 0])) >= self.apart)

    def _nearest_points(self, points: Points) -> Points:
        return np.asarray(self.model_geometry.xyz[self.candidates.nearest(points, 1)[0][:, 0]])

    def fits(self, tried: _Try) -> bool:
        return bool((tried.distance <= self.tolerance).all())


def place(
    model: Model,
    test: Geometry,
    needs: Mapping[int, frozenset[int]],
    tolerance: float | str | None,
    unit: str | None,
    alignment: Any,
) -> tuple[dict[int, Placed], Alignment, list[str]]:
    """Find the node of the model that is nearest to each node of the test.

    Parameters
    ----------
    model : Model
        With a geometry.
    test : Geometry
        Of the test.
    needs : mapping of int to frozenset of int
        Nodes of the test to place; each needs a node of the model with translations (0), rotations
        (1) or both.
    tolerance : float, str or None
        Largest distance in m, or a share of the model's size such as "1 %".
    unit : str or None
        Of the positions of the test.
    alignment : None, "fit", mapping of int to int, or array_like (4, 4)
        As for `match`.

    Returns
    -------
    placed : dict of int to Placed
        By node of the test.
    alignment : Alignment
        What was done to the positions.
    notes : list of str

    Raises
    ------
    MatchError
        If a node is not within the tolerance of one, or of two alike; or the unit has to be stated.
    """
    if model.geometry is None:
        raise MatchError(
            "the model has no geometry, so that its nodes have no positions; match by label",
            ("by",),
        )
    _check_unit(unit)
    lost = [n for n in needs if n not in set(test.nodes.tolist())]
    if lost:
        known = ", ".join(str(n) for n in test.nodes[:SHOWN].tolist()) + (
            ", ..." if len(test.nodes) > SHOWN else ""
        )
        raise MatchError(
            f"{len(lost)} nodes of the measurement have no position in the geometry of the test (it"
            f" has {known}); give each its node in table: {', '.join(str(n) for n in lost[:SHOWN])}"
            + (", ..." if len(lost) > SHOWN else ""),
            ("geometry",),
        )
    task = _Placing(model, model.geometry, test, needs, alignment)
    task.tolerance = read_tolerance(tolerance, task.candidates.size)
    factor = UNITS[unit or "m"]
    tried = task.attempt(unit, factor)
    _check_size(task, tried, unit, factor)
    if isinstance(alignment, Mapping):
        check_pairs(alignment, test, model.geometry, factor, task.tolerance)
    if not task.fits(tried):
        raise MatchError(_far(task, tried), ("tolerance",))
    notes = [
        f"Tolerance {task.tolerance:.3g} m"
        + ("" if tolerance is not None else " (1 % of the model's size)")
    ]
    _check_slide(task, tried)
    return _placed(task, tried), tried.alignment, notes


def read_tolerance(given: float | str | None, size: float) -> float:
    """Return a tolerance in m; a share such as "1 %" is of `size` in m."""
    if given is None:
        return _SHARE * size
    number: Any = given
    share = isinstance(given, str) and given.strip().endswith("%")
    try:
        number = (
            float(given.strip().removesuffix("%")) if share and isinstance(given, str) else given
        )
    except ValueError:
        number = None
    if (
        isinstance(number, bool)
        or not isinstance(number, int | float | np.number)
        or not 0 < number < np.inf
    ):
        raise MatchError(
            f"tolerance {given!r}: expected a distance in m, or a share of the model's size such as"
            " '1 %'",
            ("tolerance",),
        )
    return float(number) * size / 100.0 if share else float(number)


def _check_unit(unit: str | None) -> None:
    if unit is not None and unit not in UNITS:
        raise MatchError(f"unit {unit!r}: {suggest(str(unit), UNITS)}", ("unit",))


def _check_size(task: _Placing, tried: _Try, unit: str | None, factor: float) -> None:
    """Complain where the positions fit in another unit only. Nothing is converted that was not stated."""
    span = float(np.linalg.norm(np.ptp(tried.points, axis=0)))
    shrunk = unit is None and not tried.distinct and 10.0 * span < task.candidates.size
    if task.fits(tried) and not shrunk:
        return
    others: list[tuple[str, str | None, float]] = [
        (f"look like {name}", name, f) for name, f in UNITS.items() if name != (unit or "m")
    ]
    others += [
        (f"are in m where those of the model look like {n}", None, 1.0 / f)
        for n, f in UNITS.items()
        if n != "m"
    ]
    found = []
    for words, name, other in others:
        try:
            again = task.attempt(name, other)
        except MatchError:
            continue
        if task.fits(again) and again.distinct:
            found.append((float(np.sqrt(np.mean(again.distance**2))), words, name, again))
    if not found:
        return
    _, words, name, again = min(found, key=lambda f: f[0])
    many = "node lies" if len(task.nodes) == 1 else f"{len(task.nodes)} nodes lie"
    stated = "as they stand" if unit is None else f"in {unit}"
    outside = int((tried.distance > task.tolerance).sum())
    bad = (
        f"{outside} do not"
        if outside
        else f"they span {span:.3g} m of a model of {task.candidates.size:.3g} m"
    )
    advice = (
        f"if so, state it: unit = {name!r}"
        if name is not None
        else "models are in SI: read or scale it in m, or confirm the positions with unit = 'm'"
    )
    raise MatchError(
        f"the positions of the test {words}: then {'its' if len(task.nodes) == 1 else 'all'} {many}"
        f" within {task.tolerance:.3g} m of the model (largest distance {again.distance.max():.3g}"
        f" m), {stated} {bad}. Nothing is converted unless it is stated; {advice}",
        ("unit",),
    )


def _far(task: _Placing, tried: _Try) -> str:
    rows, far = task.candidates.nearest(tried.points, 3)
    lost = np.flatnonzero(tried.distance > task.tolerance)
    texts = []
    for i in lost:
        near = [
            f"{task.model_geometry.nodes[r]} at {d:.3g} m"
            for r, d in zip(rows[i], far[i], strict=True)
            if np.isfinite(d)
        ]
        texts.append(
            f"node {task.nodes[i]} at {vector_text(tried.points[i])} m: nearest {', '.join(near)}"
        )
    return (
        f"{len(lost)} of {len(task.nodes)} nodes of the test are not within {task.tolerance:.3g} m"
        " of a node of the "
        f"model ({tried.alignment}):{listed(texts)}\nGive a tolerance, an alignment, or their nodes"
        " in table "
        f'("{task.nodes[lost[0]]}" = "...")'
    )


def _check_slide(task: _Placing, tried: _Try) -> None:
    """Warn of a fit to nearest nodes that went so far that others may be the right ones."""
    if not isinstance(task.alignment, str):
        return
    moved = np.linalg.norm(tried.points - tried.alignment.factor * task.raw, axis=1)
    used = task.model_geometry.xyz[task.candidates.used]
    spacing = (
        float(np.median(KDTree(used).query(tried.points, k=[2])[0])) if len(used) > 1 else np.inf
    )
    if moved.max() > spacing / 2.0:
        warnings.warn(
            f"the fit to the nearest nodes moved the sensors by up to {moved.max():.3g} m, where"
            f" nodes of the model are about {spacing:.3g} m apart: it may have found the wrong"
            " ones; confirm it with three pairs of nodes",
            UpdynWarning,
            stacklevel=4,
        )


def _placed(task: _Placing, tried: _Try) -> dict[int, Placed]:
    rows, far = task.candidates.nearest(tried.points, 2)
    names = task.model_geometry.nodes
    tied = np.flatnonzero(far[:, 1] - far[:, 0] <= _TIE * task.candidates.size)
    if len(tied):
        texts = [
            f"node {task.nodes[i]} at {vector_text(tried.points[i])} m: {min(names[rows[i]])} and "
            f"{max(names[rows[i]])}, both at {far[i, 0]:.3g} m"
            for i in tied
        ]
        raise MatchError(
            f"{len(tied)} nodes of the test are equally near to two nodes of the model; say which"
            " in table "
            f'("{task.nodes[tied[0]]}" = "..."):{listed(texts)}',
            ("by",),
        )
    out = {}
    for i, node in enumerate(task.nodes):
        near = far[i, 1] < _CLOSE * far[i, 0]
        note = f"node {names[rows[i, 1]]} is at {far[i, 1]:.3g} m" if near else ""
        out[node] = Placed(int(names[rows[i, 0]]), float(far[i, 0]), note)
    return out
