"""Tests of a residual against noise: exact tails of serial correlation, bands of lines, many tests at once."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvals_banded
from scipy.special import ndtr

__all__ = ["adjusted", "bands", "clipped", "serial_p"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Weights of the correlations at lags 1, 2, 3 (Bartlett's triangle): what stays alike over a few
#: lines counts.
_LAGS = np.array([0.75, 0.5, 0.25])
#: Fewer values than this say nothing about correlation.
_FEWEST = 5
#: Values beyond this many standard deviations are cut back before correlations are formed; 1 % of
#: Gaussian ones are.
_CUT = 3.0
#: From so many lines on, the eigenvalues are taken from the symbol of the matrix, at so many
#: points.
_LONG = 512
#: Smallest band, in lines; and most bands.
_LEAST, _MOST = 8, 24


def clipped(values: _Complex) -> _Complex:
    """Return values cut back to three times their typical size, so that one outlier does not stand for correlation.

    Parameters
    ----------
    values : ndarray of complex, shape (m, ...)
        Along the first axis: values of equal variance; NaN for what is missing.

    Returns
    -------
    ndarray of complex, same shape
        The typical size is the median magnitude, which is 1.18 standard deviations of each part of
        a Gaussian value.
    """
    size = np.abs(values)
    missing = np.isnan(size)
    order = np.sort(np.where(missing, np.inf, size), axis=0)
    count = (~missing).sum(axis=0)
    middle = np.take_along_axis(order, np.maximum((count[None] - 1) // 2, 0), axis=0)
    limit = _CUT * np.where(np.isfinite(middle), middle, 0.0) / np.sqrt(2.0 * np.log(2.0))
    with np.errstate(invalid="ignore"):
        return np.asarray(
            values * np.where(size > limit, limit / np.where(size > 0, size, 1.0), 1.0)
        )


def serial_p(values: _Complex) -> _Real:
    """Return how likely independent noise is as alike from line to line as these values, or more.

    Parameters
    ----------
    values : ndarray of complex, shape (m, n)
        Columns of circular values at neighbouring lines, of equal variance in a column; NaN for
        what is missing.

    Returns
    -------
    ndarray of float, shape (n,)
        One-sided p-values; 1 where a column holds too few values to tell.

    Notes
    -----
    The statistic is r = e^H T e / e^H e with T Toeplitz, 0 on the diagonal and 3/4, 1/2, 1/4 beside
    it: a weighted sum of autocorrelations. The scale of the noise drops out. For Gaussian noise P(r
    > r0) is that of a sum of exponential variables with weights (eigenvalue of T - r0) being
    positive; its tail is taken by the saddlepoint approximation of Lugannani and Rice in the form
    of Barndorff-Nielsen, good to a per cent even far out (Butler, Saddlepoint Approximations, 2007,
    sections 1.2 and 3.1). One-sided: what windows do to neighbouring lines is not taken for
    structure where it makes them unlike.
    """
    out = np.ones(values.shape[1])
    there = np.isfinite(values)
    for mask, columns in _alike(there):
        if mask.sum() < _FEWEST:
            continue
        e = values[np.ix_(mask, columns)]
        power = np.sum(np.abs(e) ** 2, axis=0)
        full = power > 0
        if not full.any():
            continue
        diagonals = _diagonals(np.flatnonzero(mask))
        r = _form(diagonals, e[:, full]) / power[full]
        out[columns[full]] = _tail(*_eigenvalues(diagonals, gaps=not _consecutive(mask)), r)
    return out


def _alike(there: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.bool_], NDArray[np.intp]]]:
    """Yield each pattern of what is there, shape (m,), with the columns that have it."""
    patterns, of = np.unique(there, axis=1, return_inverse=True)
    for i in range(patterns.shape[1]):
        yield patterns[:, i], np.flatnonzero(of.ravel() == i)


def _consecutive(mask: NDArray[np.bool_]) -> bool:
    at = np.flatnonzero(mask)
    return bool(at[-1] - at[0] + 1 == len(at))


def _diagonals(at: NDArray[np.intp]) -> _Real:
    """Return T by its diagonals below, shape (4, m): row d has T[i + d, i] at i; 0 where there is none."""
    weights = np.concatenate([[0.0], _LAGS, [0.0]])
    out = np.zeros((len(_LAGS) + 1, len(at)))
    for d in range(1, min(len(_LAGS) + 1, len(at))):
        out[d, :-d] = weights[np.minimum(at[d:] - at[:-d], len(_LAGS) + 1)]
    return out


def _form(diagonals: _Real, e: _Complex) -> _Real:
    """Return e^H T e for each column of e, shape (m, n)."""
    out = np.zeros(e.shape[1])
    for d in range(1, min(len(diagonals), len(e))):
        out += 2.0 * np.sum(diagonals[d, :-d, None] * (e[d:].conj() * e[:-d]).real, axis=0)
    return out


def _eigenvalues(diagonals: _Real, *, gaps: bool) -> tuple[_Real, _Real]:
    """Return eigenvalues of T, rising, and how often each counts.

    Those of a long Toeplitz matrix are spread like the values of its symbol, 2 sum of t_d cos(d
    theta), at equal steps of theta (Szegő's theorem; Gray, Toeplitz and Circulant Matrices, 2006,
    theorem 4.1).
    """
    m = diagonals.shape[1]
    if m <= _LONG or gaps:
        values = np.asarray(eigvals_banded(diagonals[: min(len(diagonals), m)], lower=True))
        return values, np.ones(m)
    theta = np.pi * (np.arange(_LONG) + 0.5) / _LONG
    symbol = sum(2.0 * t * np.cos((d + 1) * theta) for d, t in enumerate(_LAGS))
    return np.sort(symbol), np.full(_LONG, m / _LONG)


def _tail(eigenvalues: _Real, often: _Real, r: _Real) -> _Real:
    """Return P(sum_j (eigenvalue_j - r) E_j > 0) for independent unit exponentials E_j, for each r.

    Each eigenvalue counts as often as it says.
    """
    edge = 1e-9 * (eigenvalues[-1] - eigenvalues[0])
    inside = np.clip(r, eigenvalues[0] + edge, eigenvalues[-1] - edge)
    a = eigenvalues[None, :] - inside[:, None]
    low, high = 1.0 / a[:, 0], 1.0 / a[:, -1]
    for _ in range(80):  # K' rises from -inf to inf between the poles
        s = 0.5 * (low + high)
        rising = (a / (1.0 - s[:, None] * a)) @ often > 0
        high, low = np.where(rising, s, high), np.where(rising, low, s)
    s = 0.5 * (low + high)
    share = 1.0 - s[:, None] * a
    K, K2 = -np.log(share) @ often, (a / share) ** 2 @ often
    w = np.sign(s) * np.sqrt(np.maximum(-2.0 * K, 0.0))
    v = s * np.sqrt(K2)
    near = np.abs(w) < 1e-3
    safe = np.where(near, 1.0, w)
    star = safe + np.log(np.where(near, 1.0, v) / safe) / safe
    skew = 2.0 * (a**3 @ often) / (a**2 @ often) ** 1.5
    middle = -w - np.where(near, skew, 0.0) / 6.0
    return np.asarray(np.clip(ndtr(np.where(near, middle, -star)), 1e-300, 1.0))


def adjusted(p: _Real) -> _Real:
    """Return p-values adjusted for their number, so that those below q hold at most a share q of false alarms.

    Where there is nothing to find, any alarm is false, and one is raised in at most a share q of
    cases (Benjamini & Hochberg, J. R. Stat. Soc. B 57 (1995) 289).

    Parameters
    ----------
    p : ndarray of float
        p-values, any shape.

    Returns
    -------
    ndarray of float, same shape
    """
    flat = p.ravel()
    order = np.argsort(flat)
    scaled = flat[order] * flat.size / np.arange(1, flat.size + 1)
    out = np.empty_like(flat)
    out[order] = np.minimum(np.minimum.accumulate(scaled[::-1])[::-1], 1.0)
    return out.reshape(p.shape)


def bands(level: _Real) -> list[slice]:
    """Cut the lines into bands, one about each resonance of the model.

    Parameters
    ----------
    level : ndarray of float, shape (n_f,)
        Mean logarithm of the model's |H| at the lines. The data have no say in it, so that the
        tests stay what they are.

    Returns
    -------
    list of slice
        In order, without gaps. Cuts lie in the valleys between peaks; bands of fewer than eight
        lines are joined to the neighbour behind the shallower cut, those of more than a quarter of
        all lines are cut where the level is lowest.
    """
    n = len(level)
    inner = level[1:-1]
    peaks = (
        1 + np.flatnonzero((inner > level[:-2]) & (inner >= level[2:]))
        if n > 2
        else np.zeros(0, dtype=np.intp)
    )
    cuts = [a + int(np.argmin(level[a : b + 1])) for a, b in pairwise(peaks.tolist())]
    edges = [0, *cuts, n]
    while len(edges) > 2:
        sizes = np.diff(edges)
        small = int(np.argmin(sizes))
        if sizes[small] >= _LEAST and len(sizes) <= _MOST:
            break
        sides = [i for i in (small, small + 1) if 0 < i < len(edges) - 1]
        del edges[max(sides, key=lambda i: level[edges[i]])]
    longest = max(3 * _LEAST, -(-n // 4))
    while len(edges) <= _MOST and max(np.diff(edges)) > longest:
        at = int(np.argmax(np.diff(edges)))
        first, last = edges[at] + _LEAST, edges[at + 1] - _LEAST
        edges.insert(at + 1, first + int(np.argmin(level[first : last + 1])))
    return [slice(a, b) for a, b in pairwise(edges)]
