"""Rigid alignment of two sets of points: a turn and a shift, never a stretch and never a reflection."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from updyn.errors import InputError
from updyn.geometry import Geometry
from updyn.matching.table import Alignment, MatchError, listed

__all__ = ["check_pairs", "fit_to_nearest", "fit_to_pairs", "given_matrix", "rigid"]

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
