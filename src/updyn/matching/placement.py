"""Test nodes to model nodes by position: units, rigid alignment, tolerance, nodes that are not matched.

An alignment is a rotation and a shift, never a scaling or a reflection.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from updyn.errors import InputError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.matching.result import SHOWN, Alignment, MatchError, listed, vector_text
from updyn.model import Model

__all__ = [
    "UNITS",
    "Placed",
    "check_pairs",
    "fit_to_nearest",
    "fit_to_pairs",
    "given_matrix",
    "place",
    "rigid",
]

_MOST_ROUNDS = 200
_IN_LINE = 1e-6  # width of a set of points over its length
_PLACE = ("alignment",)

Points = NDArray[np.float64]


def rigid(x: Points, y: Points) -> tuple[Points, Points, float]:
    """Return the turn and the shift that bring points onto others with the least sum of squared distances.

    Parameters
    ----------
    x, y : ndarray of float, shape (n, 3)
        Points, and where they should come to lie.

    Returns
    -------
    rotation : ndarray of float, shape (3, 3)
    shift : ndarray of float, shape (3,)
        y is about ``x @ rotation.T + shift``.
    residual : float
        Root mean square distance left.

    Raises
    ------
    MatchError
        If there are fewer than three, or they lie in a line: the turn about it is open.

    Notes
    -----
    Kabsch (1976), Horn (1987), by `scipy.spatial.transform.Rotation.align_vectors`.
    """
    if len(x) < 3:
        raise MatchError(
            f"an alignment needs three points that are not in a line, found {len(x)}", _PLACE
        )
    x0, y0 = x.mean(axis=0), y.mean(axis=0)
    for points, what in ((x - x0, "of the test"), (y - y0, "of the model")):
        size = np.linalg.svd(points, compute_uv=False)
        if size[1] <= _IN_LINE * size[0]:
            raise MatchError(
                f"the points {what} lie in a line (or all at one place): the turn about it is open;"
                " add a point off it, give the alignment as a matrix, or leave it out",
                _PLACE,
            )
    R = Rotation.align_vectors(y - y0, x - x0)[0].as_matrix()
    shift = y0 - R @ x0
    return R, shift, float(np.sqrt(np.mean(np.sum((x @ R.T + shift - y) ** 2, axis=1))))


def given_matrix(given: Any, factor: float, unit: str | None) -> Alignment:
    """Return the alignment that a 4 x 4 matrix states: the turn, and in its last column the shift in m.

    Raises
    ------
    MatchError
        If it is none, stretches or reflects.
    """
    try:
        matrix = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MatchError(f"alignment: not a matrix of numbers ({error})", _PLACE) from error
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or (matrix[3] != (0, 0, 0, 1)).any():
        raise MatchError(
            "alignment: expected a 4 x 4 matrix of finite numbers whose last row is 0 0 0 1 and"
            f" whose last column is the shift in m, found shape {matrix.shape}",
            _PLACE,
        )
    R = matrix[:3, :3]
    size = float(np.cbrt(abs(np.linalg.det(R))))
    if size == 0 or np.abs(R @ R.T / size**2 - np.eye(3)).max() > 1e-6:
        raise MatchError(
            "alignment: the upper left 3 x 3 of the matrix is not a turn: its rows are not at right"
            " angles",
            _PLACE,
        )
    if abs(size - 1.0) > 1e-6:
        raise MatchError(
            f"alignment: the matrix stretches by {size:.6g}; state the unit of the test instead",
            ("unit",),
        )
    if np.linalg.det(R) < 0:
        raise MatchError(
            "alignment: the matrix is a reflection; a rigid body cannot be moved like that", _PLACE
        )
    return Alignment("aligned by the matrix given", R, matrix[:3, 3].copy(), factor, unit)


def fit_to_pairs(
    pairs: Mapping[int, int], test: Geometry, model: Geometry, factor: float, unit: str | None
) -> tuple[Alignment, Points, float]:
    """Fit nodes of the test on nodes of the model.

    Returns
    -------
    alignment : Alignment
    distances : ndarray of float, shape (len(pairs),)
        That are left, in m.
    stretch : float
        Size of the model's points over that of the test's, 1 where the unit is right (Horn 1987,
        eq. for the scale).

    Raises
    ------
    MatchError
        If a node has no position, or the points do not determine a turn.
    """
    try:
        x, y = factor * test.position(list(pairs)), model.position(list(pairs.values()))
    except InputError as error:
        raise MatchError(f"alignment: {error}", _PLACE) from error
    R, shift, residual = rigid(x, y)
    spread = [float(np.sqrt(np.sum((p - p.mean(axis=0)) ** 2))) for p in (x, y)]
    out = Alignment(f"aligned on {len(pairs)} pairs of nodes", R, shift, factor, unit, residual)
    return out, np.linalg.norm(x @ R.T + shift - y, axis=1), spread[1] / spread[0]


def check_pairs(
    pairs: Mapping[int, int], test: Geometry, model: Geometry, factor: float, tolerance: float
) -> None:
    """Complain about pairs that do not lie on each other.

    Raises
    ------
    MatchError
        If one is farther off than `tolerance` in m; the message says each distance, and what may be
        the matter.
    """
    _, distances, stretch = fit_to_pairs(pairs, test, model, factor, None)
    if distances.max() <= tolerance:
        return
    x, y = factor * test.position(list(pairs)), model.position(list(pairs.values()))
    hint = ""
    if 10.0 * rigid(x * [1.0, 1.0, -1.0], y)[2] < rigid(x, y)[2]:
        hint = "; they would as a mirror image: one axis of the test points the other way"
    elif abs(stretch - 1.0) > 0.02:
        hint = f"; those of the model are {stretch:.4g} times as far apart as those of the test"
    rows = [f"{a} on {b}: {d:.3g} m" for (a, b), d in zip(pairs.items(), distances, strict=True)]
    raise MatchError(
        f"alignment: the pairs do not lie on each other within {tolerance:.3g}"
        f" m{hint}:{listed(rows)}",
        _PLACE,
    )


def fit_to_nearest(
    x: Points,
    nearest: Callable[[Points], Points],
    centre: Points,
    factor: float,
    unit: str | None,
    tolerance: float,
) -> Alignment:
    """Fit points on the nearest of the model, again and again until the nearest stay the same (Besl & McKay 1992).

    It starts where the points stand; if they do not come within the tolerance, once more with the
    centres of both on each other. It finds the nearest fit, not the best of all.

    Parameters
    ----------
    x : ndarray of float, shape (n, 3)
        Points in m.
    nearest : callable
        From points (n, 3) to the nearest points of the model (n, 3).
    centre : ndarray of float, shape (3,)
        Of the model's points.
    factor, unit
        For the record.
    tolerance : float
        In m.

    Returns
    -------
    Alignment

    Raises
    ------
    MatchError
        If the points do not determine a turn.
    """
    starts: Sequence[tuple[str, Points]] = (
        ("as the positions stand", np.zeros(3)),
        ("with the centres on each other", centre - x.mean(axis=0)),
    )
    rigid(x, x)  # whether the points determine a turn at all
    tries = []
    for words, start in starts:
        R, shift = _settled(x, nearest, start)
        distances = np.linalg.norm(x @ R.T + shift - nearest(x @ R.T + shift), axis=1)
        rms = float(np.sqrt(np.mean(distances**2)))
        out = Alignment(
            f"fitted to the nearest nodes, started {words}", R, shift, factor, unit, rms
        )
        if distances.max() <= tolerance:
            return out
        tries.append(out)
    return min(tries, key=lambda a: a.residual or 0.0)


def _settled(
    x: Points, nearest: Callable[[Points], Points], start: Points
) -> tuple[Points, Points]:
    """Return turn and shift where the nearest points stay the same; where they fall into a line it goes no further."""
    R, shift, before = np.eye(3), start, None
    for _ in range(_MOST_ROUNDS):
        y = nearest(x @ R.T + shift)
        if before is not None and np.array_equal(y, before):
            break
        try:
            R, shift, _ = rigid(x, y)
        except MatchError:
            break
        before = y
    return R, shift


#: Metres of each unit of length.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
_SHARE = 0.01  # tolerance where none is stated, of the model's size
_TIE = 1e-6  # of the model's size: nodes that are equally near
_CLOSE = 2.0  # a second node up to this many times as far is told


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
