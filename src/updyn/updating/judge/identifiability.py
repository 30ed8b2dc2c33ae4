"""What the data can determine: rank, open combinations in group names, standard deviations, and what would cure it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.updating.result import Identifiability

__all__ = ["RANK_TOLERANCE", "Analysis", "analyse", "covariance_within", "open_directions"]

_Matrix = NDArray[np.float64]

#: Singular values of the column-scaled Jacobian below this share of the largest count as zero: no
#: measurement is as exact as the 8 digits that it would take to see them.
RANK_TOLERANCE = 1e-8

#: A direction that the data leave uncertain by more than this (of a logarithm, or of a loss factor)
#: is open.
WIDEST = 1.0

_VISIBLE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """Identifiability together with the numbers behind it.

    Attributes
    ----------
    report : Identifiability
        For the user.
    open : ndarray of float, shape (n, k)
        Orthonormal basis of the open directions, in the optimiser's coordinates.
    covariance : ndarray of float, shape (n, n)
        Of the optimiser's coordinates, over the directions that are not open by arithmetic.
    involved : ndarray of bool, shape (n,)
        Unknowns that are left open: they take part in a direction that is open by arithmetic, or
        lead one that is open by noise.
    """

    report: Identifiability
    open: _Matrix
    covariance: _Matrix
    involved: NDArray[np.bool_]


def analyse(R: _Matrix, names: list[str], *, inflation: float = 1.0, advice: str = "") -> Analysis:
    """Analyse a reduced Jacobian whose residuals have unit variance.

    Parameters
    ----------
    R : ndarray of float, shape (k, n)
        Reduced Jacobian by the optimiser's coordinates (logarithm of a factor, loss factor).
    names : list of str
        The unknowns.
    inflation : float
        Factor on the standard deviations.
    advice : str
        What to say if all is well.

    Returns
    -------
    Analysis

    Notes
    -----
    Two things make a direction open: arithmetic (a singular value of the Jacobian with unit columns
    below `RANK_TOLERANCE`), and noise (a standard deviation along it above `WIDEST`). The
    collinearity index is that of Brun, Reichert & Kuensch, Water Resour. Res. 37 (2001) 1015, for
    all unknowns together.
    """
    n = R.shape[1]
    norms = np.linalg.norm(R, axis=0)
    # An unknown without any effect has a zero column; scaling it by 1 keeps it zero.
    scale = np.where(norms > 0, norms, 1.0)
    _, s, Vt = np.linalg.svd(np.vstack([R / scale, np.zeros((max(0, n - len(R)), n))]))
    seen = s > RANK_TOLERANCE * max(s[0], np.finfo(float).tiny)
    spread = (
        inflation * (Vt[seen].T / s[seen]) / scale[:, None]
    )  # columns: one standard deviation each
    axes, std, _ = np.linalg.svd(spread, full_matrices=False)
    known = std <= WIDEST
    unseen = _orthonormal(Vt[~seen].T / scale[:, None])
    blind = _orthonormal(np.hstack([unseen, axes[:, ~known]]))
    covariance = (axes * std**2) @ axes.T
    involved = (np.linalg.norm(unseen, axis=1) > _VISIBLE) | _led(axes[:, ~known], std[~known])
    smallest = float(s[-1] / s[0]) if s[0] > 0 else 0.0
    report = Identifiability(
        rank=n - blind.shape[1],
        n_parameters=n,
        condition=1.0 / smallest if seen.all() else np.inf,
        singular_values=tuple(float(v) for v in s),
        null_directions=[_words(d, names) for d in _readable(blind)],
        determined_directions=_determined(blind, involved, names),
        collinearity=float(1.0 / s[-1]) if seen.all() else np.inf,
        advice=advice,
    )
    return Analysis(report, blind, covariance, involved)


def _led(axes: _Matrix, std: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Say which unknowns a noisy direction leaves open: its leaders, and whoever it spreads by half of `WIDEST`.

    The others take part in it, too, but by a share that leaves them known: their standard deviation
    says how well.
    """
    reach = np.abs(axes) * std
    leads = (np.abs(axes) >= 0.5 * np.abs(axes).max(axis=0, initial=0.0)).any(axis=1)
    return np.asarray(leads | (np.linalg.norm(reach, axis=1) > 0.5 * WIDEST))


def covariance_within(R: _Matrix, within: _Matrix) -> _Matrix:
    """Return the covariance, shape (n, n), of unknowns that move along orthonormal directions only, shape (n, k)."""
    if within.shape[1] == 0:
        return np.zeros((len(within), len(within)))
    triangle = np.linalg.qr(R @ within, mode="r")
    spread = scipy.linalg.solve_triangular(triangle, within.T, trans="T")
    return np.asarray(spread.T @ spread)


def open_directions(R: _Matrix) -> _Matrix:
    """Return the directions that a Jacobian does not see by arithmetic, orthonormal columns, shape (n, k)."""
    norms = np.linalg.norm(R, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    _, s, Vt = np.linalg.svd(
        np.vstack([R / scale, np.zeros((max(0, R.shape[1] - len(R)), R.shape[1]))])
    )
    return _orthonormal(
        Vt[s <= RANK_TOLERANCE * max(s[0], np.finfo(float).tiny)].T / scale[:, None]
    )


def _orthonormal(directions: _Matrix) -> _Matrix:
    if directions.shape[1] == 0:
        return directions
    return np.asarray(scipy.linalg.orth(directions / np.linalg.norm(directions, axis=0)))


def _readable(basis: _Matrix) -> list[NDArray[np.float64]]:
    """Turn a basis into one with as many zeros as its dimension allows: each direction led by another unknown."""
    k = basis.shape[1]
    if k == 0:
        return []
    pivots = scipy.linalg.qr(basis.T, mode="r", pivoting=True)[1][:k]
    reduced = np.linalg.solve(basis[pivots].T, basis.T)
    return [d / d[np.argmax(np.abs(d))] for d in reduced]


def _words(direction: NDArray[np.float64], names: list[str]) -> dict[str, float]:
    return {name: float(w) for name, w in zip(names, direction, strict=True) if abs(w) > _VISIBLE}


def _determined(
    blind: _Matrix, involved: NDArray[np.bool_], names: list[str]
) -> list[dict[str, float]]:
    """Return what stays fixed along all open directions: each further unknown, less its share of the leading ones."""
    k = blind.shape[1]
    if k == 0:
        return []
    pivots = scipy.linalg.qr(blind.T, mode="r", pivoting=True)[1][:k]
    share = np.linalg.solve(blind[pivots].T, blind.T).T
    out = []
    for i in np.flatnonzero(involved):
        if i in pivots:
            continue
        combination = {names[i]: 1.0}
        combination |= {
            names[p]: float(-w) for p, w in zip(pivots, share[i], strict=True) if abs(w) > _VISIBLE
        }
        out.append(combination)
    return out
