"""Vector fitting: rational fits with poles that all functions share, added one by one.

B. Gustavsen & A. Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052-1061 (vector fitting: poles are
moved to the zeros of a common denominator, in partial fractions); B. Gustavsen, ibid. 21 (2006)
1587-1592 (its level left free); D. Deschrijver et al., IEEE Microw. Wirel. Compon. Lett. 18 (2008)
383-385 (functions one after the other); S. Grivet-Talocia & M. Bandinu, IEEE Trans. Electromagn.
Compat. 48 (2006) 104-120 (poles added where the fit is worst).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

__all__ = ["Basis", "Fitted", "fit", "growing", "predicting", "relocated", "stacked"]

_Complex = NDArray[np.complex128]

_SWEEPS, _SETTLED = 6, 1e-11
#: A residual below this share of the data is rounding.
_ROUNDING = 1e-12
#: Poles are added until this number more of them has not improved the prediction.
_PATIENCE = 4
#: Least relative improvement of the prediction.
_BETTER = 0.02
#: The fewest poles are taken whose prediction is worse than the best by at most this factor.
_AS_GOOD = 1.05
#: Relative error of the prediction that is rounding.
_EXACT = 1e-10
#: Loss factor of a new pole.
_NEW = 0.01
_TINY = 1e-14
#: Imaginary part below which a mirrored pole is real.
_OWN_IMAGE = 1e-9


@dataclass(frozen=True, slots=True)
class Basis:
    """The functions of which a fit is a sum: partial fractions and powers of x.

    Parameters
    ----------
    degree : int
        Largest power of x.
    mirrored : bool
        Whether the functions are conjugate at conjugate x (x = i omega; poles come in conjugate
        pairs, one of which stands for both, and all weights are real), or any function of a real x.
    """

    degree: int
    mirrored: bool

    def fractions(self, x: _Complex, poles: _Complex) -> _Complex:
        """Return the fractions at x, shape (n_f, m).

        Of a mirrored pole they are two, sum and i times difference with its image, unless the pole
        is its own image.
        """
        own = 1.0 / (x[:, None] - poles)
        if not self.mirrored:
            return own
        pair = poles.imag != 0
        other = np.where(pair, 1.0 / (x[:, None] - poles.conj()), 0.0)
        return np.hstack([own + other, 1j * (own - other)[:, pair]])

    def powers(self, x: _Complex) -> _Complex:
        """Return the powers at x, shape (n_f, degree + 1)."""
        return np.asarray(x[:, None] ** np.arange(self.degree + 1))

    def parts(self, A: _Complex) -> NDArray[Any]:
        """Return equations of the weights: real over imaginary parts where weights are real."""
        if not self.mirrored:
            return A
        return np.vstack([A.real, A.imag])

    def residues(self, weights: NDArray[Any], poles: _Complex) -> _Complex:
        """Return the residues at the poles, shape (k, ...), from the weights of the fractions."""
        out = weights[: len(poles)].astype(np.complex128)
        if self.mirrored:
            pair = poles.imag != 0
            out[pair] += 1j * weights[len(poles) : len(poles) + int(pair.sum())]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """A rational fit: sum of residue_k / (x - pole_k), and mirror images, plus a polynomial.

    Attributes
    ----------
    basis : Basis
        Of what it is a sum.
    poles : ndarray of complex, shape (k,)
        In the unit of x.
    weights : ndarray, shape (m, p)
        Of the functions of the basis, in each of the p functions.
    cost : float
        Sum of squared errors.
    """

    basis: Basis
    poles: _Complex
    weights: NDArray[Any]
    cost: float

    @property
    def residues(self) -> _Complex:
        """Residues of each function, shape (k, p)."""
        return self.basis.residues(self.weights, self.poles)

    def at(self, x: _Complex) -> _Complex:
        """Return the functions, shape (n_f, p)."""
        return np.asarray(_columns(self.basis, x, self.poles) @ self.weights)


def growing(
    basis: Basis, x: _Complex, Y: _Complex, first: _Complex, largest: int
) -> Iterator[Fitted]:
    """Yield fits with an increasing number of poles.

    Parameters
    ----------
    basis : Basis
        What is fitted.
    x : ndarray of complex, shape (n_f,)
        The variable at the lines, scaled to at most 1 in size.
    Y : ndarray of complex, shape (n_f, p)
        The functions.
    first : ndarray of complex, shape (k,)
        Poles to begin with.
    largest : int
        Number of poles at which to end.

    Yields
    ------
    Fitted
        The next one, with a pole more where the last fitted worst.
    """
    poles = first
    for _ in range(len(first), largest + 1):
        poles = _moved(basis, x, Y, poles)
        fitted = fit(basis, x, Y, poles)
        yield fitted
        if fitted.cost <= _ROUNDING**2 * float(np.sum(np.abs(Y) ** 2)):
            return
        poles = np.append(poles, _worst(basis, x, Y - fitted.at(x), poles))


def predicting(
    basis: Basis, x: _Complex, Y: _Complex, first: _Complex, largest: int
) -> tuple[Fitted, tuple[Fitted, Fitted]]:
    """Return the fit with as many poles as best predict lines left out, which does not fit noise.

    Parameters
    ----------
    basis, x, Y, first, largest
        As for `growing`.

    Returns
    -------
    whole : Fitted
        Of all lines.
    halves : tuple of Fitted
        Of every second line, with as many poles.
    """
    halves = slice(0, None, 2), slice(1, None, 2)
    total = float(np.sum(np.abs(Y) ** 2))
    errors: list[float] = []
    fits: list[tuple[Fitted, Fitted]] = []
    for pair in zip(*(growing(basis, x[h], Y[h], first, largest) for h in halves), strict=False):
        squares = 0.0
        for one, other in zip(pair, halves[::-1], strict=True):
            squares += float(np.sum(np.abs(one.at(x[other]) - Y[other]) ** 2))
        errors.append(float(np.sqrt(squares / total)))
        fits.append((pair[0], pair[1]))
        if errors[-1] < _EXACT:
            break
        if len(errors) > _PATIENCE:
            before, latest = min(errors[:-_PATIENCE]), min(errors[-_PATIENCE:])
            if latest > (1.0 - _BETTER) * before:
                break
    best = int(np.flatnonzero(np.array(errors) <= _AS_GOOD * min(errors) + _EXACT)[0])
    pair = fits[best]
    *_, last = growing(basis, x, Y, pair[0].poles, len(pair[0].poles))
    return last, pair


def fit(basis: Basis, x: _Complex, Y: _Complex, poles: _Complex) -> Fitted:
    """Fit the residues to the functions for given poles, by linear least squares."""
    A = basis.parts(_columns(basis, x, poles))
    norms = np.linalg.norm(A, axis=0)
    scale = np.where(norms > 0, norms, 1.0)  # of a pole far away nothing may be left
    weights = np.linalg.lstsq(A / scale, basis.parts(Y), rcond=_TINY)[0] / scale[:, None]
    return Fitted(basis, poles, weights, float(np.sum(np.abs(basis.parts(Y) - A @ weights) ** 2)))


def _columns(basis: Basis, x: _Complex, poles: _Complex) -> _Complex:
    return np.hstack([basis.fractions(x, poles), basis.powers(x)])


def _worst(basis: Basis, x: _Complex, error: _Complex, poles: _Complex) -> complex:
    """Return a new pole beside the line with the largest error."""
    at = complex(x[int(np.argmax(np.sum(np.abs(error) ** 2, axis=1)))])
    away = 1j * _NEW * abs(at)
    if basis.mirrored:
        away = -0.5 * _NEW * abs(at)
    while (np.abs(poles - at - away) < 1e-9 * abs(at)).any():  # not on top of another one
        away *= 0.5
    return at + away


def _moved(basis: Basis, x: _Complex, Y: _Complex, poles: _Complex) -> _Complex:
    """Relocate the poles until they converge."""
    for _ in range(_SWEEPS):
        before = poles
        try:
            poles = _zeros(basis, x, Y, poles)
        except np.linalg.LinAlgError:  # two poles coincide: the functions have fewer
            break
        # The poles may change their order.
        if max((np.abs(before - p).min() / abs(p) for p in poles), default=0.0) < _SETTLED:
            break
    return poles


def _zeros(basis: Basis, x: _Complex, Y: _Complex, poles: _Complex) -> _Complex:
    """Return the zeros of sigma that minimises |sigma Y - numerators| at mean |sigma|^2 = 1."""
    inner = basis.fractions(x, poles)
    Q = np.linalg.qr(basis.parts(np.hstack([inner, basis.powers(x)])))[0]
    sigma = np.hstack([inner, np.ones((len(x), 1))])
    triangle: NDArray[Any] = np.zeros((0, sigma.shape[1]))
    for y in Y.T:
        triangle = stacked(triangle, basis.parts(y[:, None] * sigma), Q)
    return relocated(basis, x, poles, triangle)


def stacked(triangle: NDArray[Any], block: NDArray[Any], Q: NDArray[Any]) -> NDArray[Any]:
    """Return the triangle of the equations of sigma, with those of one more function.

    Parameters
    ----------
    triangle : ndarray, shape (k, m + 1)
        Of the functions before; at first without rows.
    block : ndarray, shape (n, m + 1)
        The function times the fractions and 1, as `Basis.parts`.
    Q : ndarray, shape (n, j)
        Orthonormal columns of which its numerator is a sum: they are eliminated.
    """
    block = block - Q @ (Q.conj().T @ block)
    own = np.linalg.qr(block, mode="r")
    return np.asarray(np.linalg.qr(np.vstack([triangle, own]), mode="r"))


def relocated(basis: Basis, x: _Complex, poles: _Complex, triangle: NDArray[Any]) -> _Complex:
    """Return the poles moved to the zeros of sigma at mean |sigma|^2 = 1, unstable ones reflected.

    Parameters
    ----------
    basis : Basis
        Of the fractions.
    x : ndarray of complex, shape (n_f,)
        The variable at the lines.
    poles : ndarray of complex, shape (m,)
        Of sigma.
    triangle : ndarray
        Equations of sigma, from `stacked`.
    """
    sigma = np.hstack([basis.fractions(x, poles), np.ones((len(x), 1))])
    level = np.linalg.qr(basis.parts(sigma), mode="r")
    scaled = scipy.linalg.solve_triangular(level, triangle.conj().T, trans="C").conj().T
    c = scipy.linalg.solve_triangular(level, np.linalg.svd(scaled)[2][-1].conj())
    residues = basis.residues(c[:-1], poles)
    if basis.mirrored:
        pair = poles.imag != 0
        poles = np.append(poles, poles[pair].conj())
        residues = np.append(residues, residues[pair].conj())
    # The zeros are eigenvalues of diag(a) - 1 c^T / c_0, as a pencil that a vanishing c_0 does not
    # harm.
    n = len(poles)
    A, B = np.zeros((2, n + 1, n + 1), dtype=np.complex128)
    A[:n, :n], A[:n, n], A[n, :n], A[n, n] = np.diag(poles), 1.0, residues, c[-1]
    B[:n, :n] = np.eye(n)
    above, below = scipy.linalg.eig(A, B, right=False, homogeneous_eigvals=True)
    finite = np.abs(below) > _TINY * np.abs(above)
    return _stable(basis, above[finite] / below[finite])


def _stable(basis: Basis, poles: _Complex) -> _Complex:
    """Return stable poles: unstable ones reflected, of mirror images the upper one."""
    if not basis.mirrored:
        return np.asarray(poles.real + 1j * np.maximum(np.abs(poles.imag), _TINY))
    imag = np.where(np.abs(poles.imag) > _OWN_IMAGE * np.abs(poles), poles.imag, 0.0)
    return np.asarray(-np.maximum(np.abs(poles.real), _TINY) + 1j * imag)[imag >= 0]
