"""Null space, covariance and rank of a Jacobian whose residuals have unit variance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, RealArray
from updyn.updating.fit.settings import NULL_SPACE

__all__ = [
    "Resolution",
    "complement",
    "covariance_within",
    "null_space",
    "resolve",
]


@dataclass(frozen=True, slots=True, eq=False)
class Resolution:
    """Directions that a Jacobian determines, and those that it does not."""

    #: Those of the Jacobian with columns scaled to unit norm, shape (n,), in descending order.
    singular_values: RealArray
    #: Whether all of them are above the rank tolerance times the largest.
    full_rank: bool
    #: Orthonormal basis of the undetermined directions, shape (n, k): those below the rank
    #: tolerance, and those with a standard deviation above `NULL_SPACE.undetermined_std`.
    null_space: RealArray
    #: Covariance over the directions above the rank tolerance, shape (n, n).
    covariance: RealArray
    #: Whether an unknown is undetermined, shape (n,): it has a share in a direction below the rank
    #: tolerance, or leads an undetermined direction.
    involved: BoolArray


def resolve(R: RealArray, inflation: float = 1.0, even: RealArray | None = None) -> Resolution:
    """Return the determined and undetermined directions of a reduced Jacobian, shape (k, n).

    R is in units of one standard deviation of the noise, and `inflation` is a factor on that.
    `even`, shape (n, n), is a Jacobian of the same null space with rows of equal size, for rank and
    singular values.
    """
    scale, s, Vt = _scaled_svd(R if even is None else even)
    visible = s > NULL_SPACE.rank_tolerance * max(s[0], np.finfo(float).tiny)
    invisible = _orthonormal(Vt[~visible].T / scale[:, None])
    # Columns are directions of one standard deviation each.
    if even is None:
        spread = (Vt[visible].T / s[visible]) / scale[:, None]
        # Of directions determined up to the null space, keep the part orthogonal to it.
        spread -= invisible @ (invisible.T @ spread)
    else:
        within = complement(invisible)
        _, size, turn = np.linalg.svd(R @ within)
        spread = within @ (turn.T / np.maximum(size, NULL_SPACE.blind_inverse_std))
    spread = inflation * spread
    lengths = np.linalg.norm(spread, axis=0)
    short = spread * np.minimum(1.0, NULL_SPACE.largest_std / np.maximum(lengths, 1.0))
    axes, std, _ = np.linalg.svd(short, full_matrices=False)
    # Along a direction without data, a prior of this standard deviation gives it up to rounding.
    known = std <= NULL_SPACE.undetermined_std * (1.0 + NULL_SPACE.std_rounding)
    blind = _orthonormal(np.hstack([invisible, axes[:, ~known]]))
    # Not computed from the axes, where a huge standard deviation reduces small ones to rounding.
    covariance = spread @ spread.T
    involved = (np.linalg.norm(invisible, axis=1) > NULL_SPACE.visible_weight) | _find_undetermined(
        axes[:, ~known], std[~known]
    )
    return Resolution(s, bool(visible.all()), blind, covariance, involved)


def null_space(R: RealArray) -> RealArray:
    """Return an orthonormal basis of the null space of a Jacobian, shape (n, k)."""
    scale, s, Vt = _scaled_svd(R)
    return _orthonormal(
        Vt[s <= NULL_SPACE.rank_tolerance * max(s[0], np.finfo(float).tiny)].T / scale[:, None]
    )


def complement(basis: RealArray) -> RealArray:
    """Return an orthonormal basis, shape (n, n - k), of the complement of an orthonormal basis."""
    return np.asarray(scipy.linalg.null_space(basis.T)) if basis.size else np.eye(len(basis))


def covariance_within(R: RealArray, within: RealArray) -> RealArray:
    """Return the covariance, shape (n, n), in the span of orthonormal columns, shape (n, k)."""
    if within.shape[1] == 0:
        return np.zeros((len(within), len(within)))
    triangle = np.linalg.qr(R @ within, mode="r")
    spread = scipy.linalg.solve_triangular(triangle, within.T, trans="T")
    return np.asarray(spread.T @ spread)


def _scaled_svd(R: RealArray) -> tuple[RealArray, RealArray, RealArray]:
    """Return the column norms, and singular values and V^T of the columns scaled to unit norm."""
    n = R.shape[1]
    norms = np.linalg.norm(R, axis=0)
    # An unknown without effect has a zero column; a scale of 1 keeps it zero.
    scale = np.where(norms > 0, norms, 1.0)
    _, s, Vt = np.linalg.svd(np.vstack([R / scale, np.zeros((max(0, n - len(R)), n))]))
    return scale, s, Vt


def _find_undetermined(axes: RealArray, std: RealArray) -> BoolArray:
    """Return which unknowns are undetermined because of noisy directions."""
    # These are the leading unknowns of a direction, and all with a standard deviation along it
    # above half of `NULL_SPACE.undetermined_std`. Others have a small share in it and remain
    # determined.
    reach = np.abs(axes) * std
    leads = (np.abs(axes) >= 0.5 * np.abs(axes).max(axis=0, initial=0.0)).any(axis=1)
    return np.asarray(leads | (np.linalg.norm(reach, axis=1) > 0.5 * NULL_SPACE.undetermined_std))


def _orthonormal(directions: RealArray) -> RealArray:
    if directions.shape[1] == 0:
        return directions
    return np.asarray(scipy.linalg.orth(directions / np.linalg.norm(directions, axis=0)))
