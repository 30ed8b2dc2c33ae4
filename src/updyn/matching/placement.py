"""Match test nodes to model nodes by position: units, rigid alignment, tolerance.

An alignment is a rotation and a shift, without scaling or reflection.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads scipy.spatial on use

from updyn.arrays import IndexArray, RealArray
from updyn.errors import InputError, UpdynWarning, suggest
from updyn.geometry import Geometry
from updyn.matching.result import Alignment, MatchError, format_list, vector_text
from updyn.matching.settings import SENSOR_PLACEMENT
from updyn.model import Model
from updyn.positions import UNITS, is_in_line, rigid_motion
from updyn.settings import POSITIONS

__all__ = ["NodeMatch", "fit_rigid", "match_nodes", "read_tolerance"]

_ALIGNMENT = ("alignment",)

Points = RealArray


# -- rigid alignment
def fit_rigid(x: Points, y: Points) -> tuple[Points, Points, float]:
    """Return rotation, shift and rms distance of points (n, 3), by `updyn.positions.rigid_motion`.

    Raises MatchError for fewer than three points, or points in a line, which leave the rotation
    about it undetermined.
    """
    if len(x) < 3:
        raise MatchError(
            f"an alignment needs three points that are not in a line, found {len(x)}", _ALIGNMENT
        )
    _check_not_in_line(x - x.mean(axis=0), "of the test")
    _check_not_in_line(y - y.mean(axis=0), "of the model")
    R, shift = rigid_motion(x, y)
    residual = np.sqrt(np.mean(np.sum((x @ R.T + shift - y) ** 2, axis=1)))
    return R, shift, float(residual)


def _check_not_in_line(centred: Points, what: str) -> None:
    if is_in_line(centred):
        raise MatchError(
            f"the points {what} lie in a line (or all at one place): the rotation about it is"
            " undetermined; add a point off it, give the alignment as a matrix, or leave it out",
            _ALIGNMENT,
        )


def _read_matrix(given: object, factor: float, unit: str | None) -> Alignment:
    """Return the alignment of a 4 x 4 matrix: rotation, and the shift in m in the last column."""
    try:
        matrix = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MatchError(f"alignment: not a matrix of numbers ({error})", _ALIGNMENT) from error
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or (matrix[3] != (0, 0, 0, 1)).any():
        raise MatchError(
            "alignment: expected a 4 x 4 matrix of finite numbers whose last row is 0 0 0 1 and"
            f" whose last column is the shift in m, found shape {matrix.shape}",
            _ALIGNMENT,
        )
    R = matrix[:3, :3]
    size = float(np.cbrt(abs(np.linalg.det(R))))
    if size == 0 or np.abs(R @ R.T / size**2 - np.eye(3)).max() > SENSOR_PLACEMENT.rotation_error:
        raise MatchError(
            "alignment: the upper left 3 x 3 of the matrix is not a rotation: its rows are not at"
            " right angles",
            _ALIGNMENT,
        )
    if abs(size - 1.0) > SENSOR_PLACEMENT.rotation_error:
        raise MatchError(
            f"alignment: the matrix stretches by {size:.6g}; state the unit of the test instead",
            ("unit",),
        )
    if np.linalg.det(R) < 0:
        raise MatchError(
            "alignment: the matrix is a reflection; expected a rotation and a shift", _ALIGNMENT
        )
    return Alignment("aligned by the matrix given", R, matrix[:3, 3].copy(), factor, unit)


def _points_of_pairs(
    pairs: Mapping[int, int], test: Geometry, model: Geometry, factor: float
) -> tuple[Points, Points]:
    try:
        return factor * test.position(list(pairs)), model.position(list(pairs.values()))
    except InputError as error:
        raise MatchError(f"alignment: {error}", _ALIGNMENT) from error


def _fit_to_pairs(
    pairs: Mapping[int, int], test: Geometry, model: Geometry, factor: float, unit: str | None
) -> Alignment:
    x, y = _points_of_pairs(pairs, test, model, factor)
    R, shift, residual = fit_rigid(x, y)
    return Alignment(f"aligned on {len(pairs)} pairs of nodes", R, shift, factor, unit, residual)


def _check_pairs(
    pairs: Mapping[int, int], test: Geometry, model: Geometry, factor: float, tolerance: float
) -> None:
    """Raise an error with a likely cause for pairs farther apart than `tolerance` in m."""
    x, y = _points_of_pairs(pairs, test, model, factor)
    R, shift, residual = fit_rigid(x, y)
    distances = np.linalg.norm(x @ R.T + shift - y, axis=1)
    if distances.max() <= tolerance:
        return
    stretch = _spread(y) / _spread(x)  # Horn (1987), scale of the fit
    cause = ""
    if 10.0 * fit_rigid(x * [1.0, 1.0, -1.0], y)[2] < residual:
        cause = "; they would as a mirror image: one axis of the test points the other way"
    elif abs(stretch - 1.0) > SENSOR_PLACEMENT.noted_scale:
        cause = f"; those of the model are {stretch:.4g} times as far apart as those of the test"
    rows = [f"{a} on {b}: {d:.3g} m" for (a, b), d in zip(pairs.items(), distances, strict=True)]
    raise MatchError(
        f"alignment: the pairs do not lie on each other within {tolerance:.3g}"
        f" m{cause}:{format_list(rows)}",
        _ALIGNMENT,
    )


def _spread(points: Points) -> float:
    return float(np.sqrt(np.sum((points - points.mean(axis=0)) ** 2)))


def _fit_to_nearest(
    x: Points,
    nearest: Callable[[Points], Points],
    centre: Points,
    factor: float,
    unit: str | None,
    tolerance: float,
) -> Alignment:
    """Fit points (n, 3) to the nearest points of the model by iterated closest points."""
    # Besl & McKay 1992; it finds a local minimum. The fit starts from the given positions and, if
    # the points are not within the tolerance (m), once more with the centres of both sets aligned.
    starts: Sequence[tuple[str, Points]] = (
        ("from the positions as given", np.zeros(3)),
        ("with the centres on each other", centre - x.mean(axis=0)),
    )
    fit_rigid(x, x)  # raises for points that do not determine a rotation
    fits = []
    for words, start in starts:
        R, shift = _iterate_nearest(x, nearest, start)
        aligned = x @ R.T + shift
        distances = np.linalg.norm(aligned - nearest(aligned), axis=1)
        residual = float(np.sqrt(np.mean(distances**2)))
        how = f"fitted to the nearest nodes, started {words}"
        fit = Alignment(how, R, shift, factor, unit, residual)
        if distances.max() <= tolerance:
            return fit
        fits.append(fit)
    return min(fits, key=lambda fit: fit.residual or 0.0)


def _iterate_nearest(
    x: Points, nearest: Callable[[Points], Points], start: Points
) -> tuple[Points, Points]:
    """Return rotation and shift when the nearest points no longer change, or fall into a line."""
    R = np.eye(3)
    shift = start
    before: Points | None = None
    for _ in range(SENSOR_PLACEMENT.most_steps):
        y = nearest(x @ R.T + shift)
        if before is not None and np.array_equal(y, before):
            break
        try:
            R, shift, _ = fit_rigid(x, y)
        except MatchError:
            break
        before = y
    return R, shift


# -- nearest nodes
@dataclass(frozen=True, slots=True)
class NodeMatch:
    """Node of the model for a node of the test, distance in m, and note on other near nodes."""

    node: int
    distance: float
    note: str = ""


class _Candidates:
    """Model nodes with a position and translations (0), rotations (1) or both, as needed."""

    def __init__(self, model: Model, geometry: Geometry, needs: Sequence[frozenset[int]]) -> None:
        translating = np.isin(geometry.nodes, model.dofs.nodes[model.dofs.axes < 3])
        rotating = np.isin(geometry.nodes, model.dofs.nodes[model.dofs.axes >= 3])
        self.geometry = geometry
        self.needs = needs
        self.used = translating | rotating
        if not self.used.any():
            raise MatchError("no node of the geometry of the model has a DOF")
        box = geometry.xyz[self.used]
        self.size = float(np.linalg.norm(np.ptp(box, axis=0)))
        self.centre = box.mean(axis=0)
        self._trees: dict[frozenset[int], tuple[IndexArray, scipy.spatial.KDTree]] = {}
        for need in set(needs):
            suitable = self.used.copy()
            if 0 in need:
                suitable &= translating
            if 1 in need:
                suitable &= rotating
            rows = np.flatnonzero(suitable)
            if not len(rows):
                what = " and ".join(("translations", "rotations")[part] for part in sorted(need))
                raise MatchError(
                    f"no node of the model with a position has {what}, which the sensors measure"
                )
            self._trees[need] = rows, scipy.spatial.KDTree(geometry.xyz[rows])

    def nearest(self, points: Points, n: int) -> tuple[IndexArray, Points]:
        """Return geometry rows and distances (m) of the n nearest nodes; missing nodes have inf."""
        rows = np.zeros((len(points), n), dtype=np.intp)
        distances = np.full((len(points), n), np.inf)
        for need, (candidate_rows, tree) in self._trees.items():
            at = [i for i, other in enumerate(self.needs) if other == need]
            distance, index = tree.query(points[at], k=list(range(1, n + 1)))
            distances[at] = distance
            rows[at] = candidate_rows[np.minimum(index, len(candidate_rows) - 1)]
        return rows, distances


@dataclass(frozen=True, slots=True, eq=False)
class _Attempt:
    """Test nodes moved to the model with one unit; `distinct` if no two share a nearest node."""

    alignment: Alignment
    points: Points
    distance: Points
    distinct: bool

    @property
    def span(self) -> float:
        """Diagonal of the box around the points, in m."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def fits(self, tolerance: float) -> bool:
        return bool((self.distance <= tolerance).all())


class _Placement:
    """Nodes of a test to place in a model, and their alignment."""

    def __init__(
        self,
        model: Model,
        geometry: Geometry,
        test: Geometry,
        needs: Mapping[int, frozenset[int]],
        alignment: object,
    ) -> None:
        self.nodes = list(needs)
        self.test = test
        self.model_geometry = geometry
        self.alignment = alignment
        self.candidates = _Candidates(model, geometry, list(needs.values()))
        self.raw = test.position(self.nodes)
        self.n_places = 1
        span = float(np.ptp(self.raw, axis=0).max())
        if span:
            self.n_places = len(np.unique(np.round(self.raw / span, 9), axis=0))
        self.tolerance = 0.0

    def attempt(self, unit: str | None, factor: float) -> _Attempt:
        """Align the nodes with one length factor and find the nearest nodes of the model."""
        found = self._align(unit, factor)
        points = found.apply(self.raw)
        rows, distances = self.candidates.nearest(points, 1)
        distinct = len(np.unique(rows[:, 0])) >= self.n_places
        return _Attempt(found, points, distances[:, 0], distinct)

    def _align(self, unit: str | None, factor: float) -> Alignment:
        if self.alignment is None:
            return Alignment("not moved", np.eye(3), np.zeros(3), factor, unit)
        if isinstance(self.alignment, str):
            return _fit_to_nearest(
                factor * self.raw,
                self._nearest_points,
                self.candidates.centre,
                factor,
                unit,
                self.tolerance,
            )
        if isinstance(self.alignment, Mapping):
            return _fit_to_pairs(self.alignment, self.test, self.model_geometry, factor, unit)
        return _read_matrix(self.alignment, factor, unit)

    def _nearest_points(self, points: Points) -> Points:
        rows, _ = self.candidates.nearest(points, 1)
        return np.asarray(self.model_geometry.xyz[rows[:, 0]])


def match_nodes(
    model: Model,
    test: Geometry,
    needs: Mapping[int, frozenset[int]],
    tolerance: float | str | None,
    unit: str | None,
    alignment: object,
) -> tuple[dict[int, NodeMatch], Alignment, list[str]]:
    """Return the nearest model node of each test node, the alignment and notes.

    `needs` maps nodes of the test to the required DOFs of the model node: translations (0),
    rotations (1) or both.
    """
    if model.geometry is None:
        raise MatchError(
            "the model has no geometry, so that its nodes have no positions; match by label",
            ("by",),
        )
    if unit is not None and unit not in UNITS:
        raise MatchError(f"unit {unit!r}: {suggest(str(unit), UNITS)}", ("unit",))
    _check_positions(test, needs)
    placement = _Placement(model, model.geometry, test, needs, alignment)
    placement.tolerance = read_tolerance(tolerance, placement.candidates.size)
    factor = UNITS[unit or "m"]
    attempt = placement.attempt(unit, factor)
    _check_unit(placement, attempt, unit)
    if isinstance(alignment, Mapping):
        _check_pairs(alignment, test, model.geometry, factor, placement.tolerance)
    if not attempt.fits(placement.tolerance):
        raise MatchError(_too_far(placement, attempt), ("tolerance",))
    note = f"Tolerance {placement.tolerance:.3g} m"
    if tolerance is None:
        note += " (1 % of the model's size)"
    _warn_of_far_fit(placement, attempt)
    return _node_matches(placement, attempt), attempt.alignment, [note]


def _check_positions(test: Geometry, nodes: Iterable[int]) -> None:
    missing = [node for node in nodes if node not in test.nodes]
    if missing:
        known = _format_numbers(test.nodes.tolist())
        raise MatchError(
            f"{len(missing)} nodes of the measurement have no position in the geometry of the test"
            f" (it has {known}); give each its node in table: {_format_numbers(missing)}",
            ("geometry",),
        )


def _format_numbers(numbers: Sequence[int]) -> str:
    most = SENSOR_PLACEMENT.listed_items
    text = ", ".join(map(str, numbers[:most]))
    return text + ", ..." if len(numbers) > most else text


def read_tolerance(given: float | str | None, size: float, *others: str) -> float:
    """Return a tolerance in m; a share such as "1 %" is relative to `size` in m.

    Messages also list the valid values in `others`.
    """
    if given is None:
        return POSITIONS.matched_share * size
    number: Any = given
    is_share = isinstance(given, str) and given.strip().endswith("%")
    if isinstance(given, str) and is_share:
        try:
            number = float(given.strip().removesuffix("%"))
        except ValueError:
            number = None
    is_number = isinstance(number, int | float | np.number) and not isinstance(number, bool)
    if not (is_number and 0 < number < np.inf):
        raise MatchError(
            f"tolerance {given!r}: expected a distance in m, or a share of the model's size such as"
            f" '1 %'{''.join(f', or {other!r}' for other in others)}",
            ("tolerance",),
        )
    return float(number) * size / 100.0 if is_share else float(number)


def _check_unit(placement: _Placement, attempt: _Attempt, unit: str | None) -> None:
    """Raise an error if the positions fit only in another unit; nothing is converted silently."""
    size = placement.candidates.size
    shrunk = unit is None and not attempt.distinct and 10.0 * attempt.span < size
    if attempt.fits(placement.tolerance) and not shrunk:
        return
    fits = _fits_in_other_units(placement, unit or "m")
    if not fits:
        return
    what, name, other = min(fits, key=lambda fit: float(np.sqrt(np.mean(fit[2].distance ** 2))))
    n = len(placement.nodes)
    lie = "its node lies" if n == 1 else f"all {n} nodes lie"
    stated = "as given" if unit is None else f"in {unit}"
    outside = int((attempt.distance > placement.tolerance).sum())
    if outside:
        bad = f"{outside} do not"
    else:
        bad = f"they span {attempt.span:.3g} m of a model of {size:.3g} m"
    if name is not None:
        advice = f"if so, state it: unit = {name!r}"
    else:
        advice = "models are in SI: read or scale it in m, or confirm the positions with unit = 'm'"
    raise MatchError(
        f"the positions of the test {what}: then {lie} within {placement.tolerance:.3g} m of the"
        f" model (largest distance {other.distance.max():.3g} m), {stated} {bad}. Nothing is"
        f" converted unless it is stated; {advice}",
        ("unit",),
        proposal={} if name is None else {"unit": name},
    )


def _fits_in_other_units(
    placement: _Placement, stated: str
) -> list[tuple[str, str | None, _Attempt]]:
    """Return other units in which all nodes fit: description, unit to give, attempt."""
    others: list[tuple[str, str | None, float]] = []
    for name, factor in UNITS.items():
        if name != stated:
            others.append((f"look like {name}", name, factor))
    for name, factor in UNITS.items():
        if name != "m":
            what = f"are in m where those of the model look like {name}"
            others.append((what, None, 1.0 / factor))
    found = []
    for what, unit, factor in others:
        try:
            attempt = placement.attempt(unit, factor)
        except MatchError:
            continue
        if attempt.fits(placement.tolerance) and attempt.distinct:
            found.append((what, unit, attempt))
    return found


def _too_far(placement: _Placement, attempt: _Attempt) -> str:
    """Return the message about test nodes without a model node within the tolerance."""
    rows, distances = placement.candidates.nearest(attempt.points, 3)
    lost = np.flatnonzero(attempt.distance > placement.tolerance)
    texts = []
    for i in lost:
        known = np.isfinite(distances[i])
        names = placement.model_geometry.nodes[rows[i, known]]
        near = [f"{n} at {d:.3g} m" for n, d in zip(names, distances[i, known], strict=True)]
        at = vector_text(attempt.points[i])
        texts.append(f"node {placement.nodes[i]} at {at} m: nearest {', '.join(near)}")
    return (
        f"{len(lost)} of {len(placement.nodes)} nodes of the test are not within"
        f" {placement.tolerance:.3g} m of a node of the model ({attempt.alignment}):"
        f"{format_list(texts)}\nGive a tolerance, an alignment, or their nodes in table"
        f' ("{placement.nodes[lost[0]]}" = "...")'
    )


def _warn_of_far_fit(placement: _Placement, attempt: _Attempt) -> None:
    """Warn if a fit to nearest nodes moved the sensors so far that nodes may be wrong."""
    if not isinstance(placement.alignment, str):
        return
    start = attempt.alignment.factor * placement.raw
    distances = np.linalg.norm(attempt.points - start, axis=1)
    used = placement.model_geometry.xyz[placement.candidates.used]
    if len(used) < 2:
        return
    spacing = float(np.median(scipy.spatial.KDTree(used).query(attempt.points, k=[2])[0]))
    if distances.max() > spacing / 2.0:
        warnings.warn(
            f"the fit to the nearest nodes moved the sensors by up to {distances.max():.3g} m,"
            f" where nodes of the model are about {spacing:.3g} m apart: it may have found the"
            " wrong ones; confirm it with three pairs of nodes",
            UpdynWarning,
            stacklevel=4,
        )


def _node_matches(placement: _Placement, attempt: _Attempt) -> dict[int, NodeMatch]:
    rows, distances = placement.candidates.nearest(attempt.points, 2)
    names = placement.model_geometry.nodes[rows]
    first = distances[:, 0]
    second = distances[:, 1]
    equal = SENSOR_PLACEMENT.equal_distance * placement.candidates.size
    tied = np.flatnonzero(second - first <= equal)
    if len(tied):
        texts = []
        for i in tied:
            at = vector_text(attempt.points[i])
            low, high = sorted(names[i].tolist())
            texts.append(
                f"node {placement.nodes[i]} at {at} m: {low} and {high}, both at {first[i]:.3g} m"
            )
        raise MatchError(
            f"{len(tied)} nodes of the test are equally near to two nodes of the model; say which"
            f' in table ("{placement.nodes[tied[0]]}" = "..."):{format_list(texts)}',
            ("by",),
        )
    out = {}
    for row, node in enumerate(placement.nodes):
        note = ""
        if second[row] < SENSOR_PLACEMENT.noted_distance_ratio * first[row]:
            note = f"node {names[row, 1]} is at {second[row]:.3g} m"
        out[node] = NodeMatch(int(names[row, 0]), float(first[row]), note)
    return out
