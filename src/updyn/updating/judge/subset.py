"""Columns of a Jacobian that can be told apart, and columns that are alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.updating.judge.identifiability import RANK_TOLERANCE, WIDEST

__all__ = ["alike", "index", "subset", "unit"]

_Vector = NDArray[np.float64]
_Matrix = NDArray[np.float64]

#: Of the unknowns that explain another, those are named whose share is at least so much of the
#: largest.
_SHARE = 0.2
_NAMED = 3


def subset(
    R: _Matrix, names: Sequence[str], n: int | None = None, max_collinearity: float = 15.0
) -> tuple[list[int], dict[int, str]]:
    """Choose columns of a Jacobian by QR factors with column pivoting.

    Parameters
    ----------
    R : ndarray of float, shape (k, m)
        Jacobian or its triangle, in units of one standard deviation of the noise.
    names : sequence of str
        Of its columns.
    n : int, optional
        How many; by default as many as the noise and `max_collinearity` allow.
    max_collinearity : float
        Largest 1 / smallest singular value of the chosen columns at unit length, where `n` is not
        given.

    Returns
    -------
    order : list of int
        The chosen columns, the most telling first.
    left_out : dict of int to str
        Why not the others.
    """
    size = np.linalg.norm(R, axis=0)
    state = _Pivoting(R, names, size)
    for _ in range(R.shape[1]):
        if not state.waiting or len(state.order) == n:
            break
        i = max(state.waiting, key=lambda j: state.length[j])
        asked = n is not None and state.length[i] > RANK_TOLERANCE * size[i]
        reason = "" if asked else state.refused(i, max_collinearity)
        if reason:
            state.left_out[i] = reason
        else:
            state.take(i)
        state.waiting.remove(i)
    for i in state.waiting:
        state.left_out[i] = f"{n} unknowns were asked for, and these tell more"
    return state.order, state.left_out


class _Pivoting:
    """The QR factors so far: an orthonormal basis of the chosen columns, and what of the others is not in it."""

    def __init__(self, R: _Matrix, names: Sequence[str], size: _Vector) -> None:
        self.R, self.names, self.size = R, names, size
        self.rest = R.copy()
        self.basis = np.zeros((len(R), 0))
        self.order: list[int] = []
        self.left_out: dict[int, str] = {}
        self.waiting = list(range(R.shape[1]))

    @property
    def length(self) -> _Vector:
        return np.asarray(np.linalg.norm(self.rest, axis=0))

    def take(self, i: int) -> None:
        # Once more against the basis: rounding of the earlier projections counts where columns are
        # nearly dependent.
        fresh = self.rest[:, i] - self.basis @ (self.basis.T @ self.rest[:, i])
        fresh = fresh / np.linalg.norm(fresh)
        self.basis = np.column_stack([self.basis, fresh])
        self.rest = self.rest - np.outer(fresh, fresh @ self.rest)
        self.order.append(i)

    def refused(self, i: int, limit: float) -> str:
        """Say why a column is not taken; empty where it may be."""
        if self.size[i] * WIDEST <= 1.0:
            known = "not at all" if self.size[i] == 0.0 else f"only to ±{1.0 / self.size[i]:.2g}"
            return f"the data hardly react to it: even alone it would be known {known}"
        length = float(np.linalg.norm(self.rest[:, i]))
        gamma = index(np.linalg.svd(unit(self.R[:, [*self.order, i]]), compute_uv=False))
        if gamma > limit:
            return (
                f"its effect is explained by {self.explained_by(i)} (collinearity index"
                f" {gamma:.3g})"
            )
        if length * WIDEST <= 1.0:
            return f"beside {self.explained_by(i)} it would be known only to ±{1.0 / length:.2g}"
        return ""

    def explained_by(self, i: int) -> str:
        weight = np.linalg.lstsq(unit(self.R[:, self.order]), self.R[:, i], rcond=None)[0]
        most = [
            j
            for j in np.argsort(-np.abs(weight))
            if abs(weight[j]) >= _SHARE * np.abs(weight).max()
        ][:_NAMED]
        return ", ".join(self.names[self.order[j]] for j in most)


def alike(cosine: _Matrix, kinds: Sequence[str | None], threshold: float) -> list[list[int]]:
    """Cluster columns of one kind whose cosines are at least a threshold, each with each.

    Parameters
    ----------
    cosine : ndarray of float, shape (n, n)
        Between the columns; nan for a column that is zero.
    kinds : sequence of str or None
        Columns of different kinds are not joined, those of kind None not at all.
    threshold : float
        Between 0 and 1.

    Returns
    -------
    list of list of int
        Clusters of two or more, ascending.
    """
    from scipy.cluster.hierarchy import fcluster, linkage
    from scipy.spatial.distance import squareform

    out = []
    for kind in dict.fromkeys(k for k in kinds if k is not None):
        at = [i for i, k in enumerate(kinds) if k == kind and np.isfinite(cosine[i, i])]
        if len(at) < 2:
            continue
        distance = np.clip(1.0 - cosine[np.ix_(at, at)], 0.0, 2.0)
        distance = 0.5 * (distance + distance.T)
        np.fill_diagonal(distance, 0.0)
        label = fcluster(linkage(squareform(distance), "complete"), 1.0 - threshold, "distance")
        out += [
            [at[j] for j in np.flatnonzero(label == c)]
            for c in np.unique(label)
            if (label == c).sum() > 1
        ]
    return sorted(out)


def unit(R: _Matrix) -> _Matrix:
    """Return a matrix with its columns at unit length; those that are zero stay so."""
    size = np.linalg.norm(R, axis=0)
    return np.asarray(R / np.where(size > 0.0, size, 1.0))


def index(s: NDArray[np.floating[Any]]) -> float:
    """Return the collinearity index of unit columns from their singular values, falling; inf for dependent ones."""
    return float(1.0 / s[-1]) if s[-1] > RANK_TOLERANCE * s[0] else float("inf")
