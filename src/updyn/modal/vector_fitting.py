"""Vector fitting: rational fits with common poles of all functions, added one by one.

B. Gustavsen & A. Semlyen, IEEE Trans. Power Delivery 14 (1999) 1052-1061 (vector fitting: poles are
moved to the zeros of a common denominator, in partial fractions); B. Gustavsen, ibid. 21 (2006)
1587-1592 (free level of the denominator); D. Deschrijver et al., IEEE Microw. Wirel. Compon. Lett.
18 (2008) 383-385 (functions one after the other); S. Grivet-Talocia & M. Bandinu, IEEE Trans.
Electromagn. Compat. 48 (2006) 104-120 (poles added at the largest error).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from updyn.arrays import ComplexArray, NumberArray
from updyn.modal.settings import VECTOR_FITTING

__all__ = [
    "RationalBasis",
    "RationalFit",
    "compute_sigma_zeros",
    "fit",
    "fit_by_cross_validation",
    "fit_increasing_orders",
    "stack_equations",
]


@dataclass(frozen=True, slots=True)
class RationalBasis:
    """Basis of a rational fit: partial fractions and powers of x up to `degree`.

    If `mirrored`, functions are conjugate at conjugate x (x = i omega), poles come in conjugate
    pairs, represented by one of them, and all weights are real; else x is real.
    """

    degree: int
    mirrored: bool

    def fractions(self, x: ComplexArray, poles: ComplexArray) -> ComplexArray:
        """Return the fractions at x, shape (n_f, m)."""
        # A mirrored pole has two, the sum and i times the difference with its image, unless it is
        # real.
        direct = 1.0 / (x[:, None] - poles)
        if not self.mirrored:
            return direct
        pair = poles.imag != 0
        other = np.where(pair, 1.0 / (x[:, None] - poles.conj()), 0.0)
        return np.hstack([direct + other, 1j * (direct - other)[:, pair]])

    def powers(self, x: ComplexArray) -> ComplexArray:
        """Return the powers at x, shape (n_f, degree + 1)."""
        return np.asarray(x[:, None] ** np.arange(self.degree + 1))

    def parts(self, A: ComplexArray) -> NumberArray:
        """Return real equations of the weights, real above imaginary parts, if they are real."""
        if not self.mirrored:
            return A
        return np.vstack([A.real, A.imag])

    def residues(self, weights: NumberArray, poles: ComplexArray) -> ComplexArray:
        """Return the residues at the poles, shape (k, ...), from the weights of the fractions."""
        out = weights[: len(poles)].astype(np.complex128)
        if self.mirrored:
            pair = poles.imag != 0
            out[pair] += 1j * weights[len(poles) : len(poles) + int(pair.sum())]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class RationalFit:
    """A rational fit: sum of residue_k / (x - pole_k), and mirror images, plus a polynomial.

    `poles`, shape (k,), are in the unit of x; `weights`, shape (m, p), are those of the basis in
    each of p functions; `cost` is the sum of squared errors.
    """

    basis: RationalBasis
    poles: ComplexArray
    weights: NumberArray
    cost: float

    @property
    def residues(self) -> ComplexArray:
        """Residues of each function, shape (k, p)."""
        return self.basis.residues(self.weights, self.poles)

    def at(self, x: ComplexArray) -> ComplexArray:
        """Return the fitted functions at x, shape (n_f, p)."""
        return np.asarray(_columns(self.basis, x, self.poles) @ self.weights)


def fit_increasing_orders(
    basis: RationalBasis, x: ComplexArray, Y: ComplexArray, first: ComplexArray, largest: int
) -> Iterator[RationalFit]:
    """Yield fits with an increasing number of poles, up to `largest`, from initial poles `first`.

    Each fit has one more pole, at the largest error of the last. The variable x, shape (n_f,), must
    be scaled to at most 1 in size; Y has the shape (n_f, p).
    """
    poles = first
    for _ in range(len(first), largest + 1):
        poles = _relocate_poles(basis, x, Y, poles)
        fitted = fit(basis, x, Y, poles)
        yield fitted
        if fitted.cost <= VECTOR_FITTING.residual_rounding**2 * float(np.sum(np.abs(Y) ** 2)):
            return
        poles = np.append(poles, _place_pole(basis, x, Y - fitted.at(x), poles))


def fit_by_cross_validation(
    basis: RationalBasis, x: ComplexArray, Y: ComplexArray, first: ComplexArray, largest: int
) -> tuple[RationalFit, tuple[RationalFit, RationalFit]]:
    """Return the fit with the number of poles that best predicts omitted lines.

    Arguments are those of `fit_increasing_orders`. The fit of all lines is followed by two fits of
    every second line with as many poles.
    """
    halves = slice(0, None, 2), slice(1, None, 2)
    total = float(np.sum(np.abs(Y) ** 2))
    errors: list[float] = []
    fits: list[tuple[RationalFit, RationalFit]] = []
    for pair in zip(
        *(fit_increasing_orders(basis, x[h], Y[h], first, largest) for h in halves), strict=False
    ):
        squares = 0.0
        for one, other in zip(pair, halves[::-1], strict=True):
            squares += float(np.sum(np.abs(one.at(x[other]) - Y[other]) ** 2))
        errors.append(float(np.sqrt(squares / total)))
        fits.append((pair[0], pair[1]))
        if errors[-1] < VECTOR_FITTING.exact_prediction:
            break
        recent = VECTOR_FITTING.patience
        if len(errors) > recent:
            before, latest = min(errors[:-recent]), min(errors[-recent:])
            if latest > (1.0 - VECTOR_FITTING.least_improvement) * before:
                break
    worst = VECTOR_FITTING.prediction_margin * min(errors) + VECTOR_FITTING.exact_prediction
    best = int(np.flatnonzero(np.array(errors) <= worst)[0])
    pair = fits[best]
    *_, last = fit_increasing_orders(basis, x, Y, pair[0].poles, len(pair[0].poles))
    return last, pair


def fit(basis: RationalBasis, x: ComplexArray, Y: ComplexArray, poles: ComplexArray) -> RationalFit:
    """Fit the residues to the functions for given poles, by linear least squares."""
    A = basis.parts(_columns(basis, x, poles))
    norms = np.linalg.norm(A, axis=0)
    scale = np.where(norms > 0, norms, 1.0)  # the fraction of a distant pole may vanish
    scaled = np.linalg.lstsq(A / scale, basis.parts(Y), rcond=VECTOR_FITTING.rounding)[0]
    weights = scaled / scale[:, None]
    return RationalFit(
        basis, poles, weights, float(np.sum(np.abs(basis.parts(Y) - A @ weights) ** 2))
    )


def _columns(basis: RationalBasis, x: ComplexArray, poles: ComplexArray) -> ComplexArray:
    return np.hstack([basis.fractions(x, poles), basis.powers(x)])


def _place_pole(
    basis: RationalBasis, x: ComplexArray, error: ComplexArray, poles: ComplexArray
) -> complex:
    """Return a new pole next to the line with the largest error."""
    at = complex(x[int(np.argmax(np.sum(np.abs(error) ** 2, axis=1)))])
    away = 1j * VECTOR_FITTING.new_loss_factor * abs(at)
    if basis.mirrored:
        away = -0.5 * VECTOR_FITTING.new_loss_factor * abs(at)
    while (np.abs(poles - at - away) < 1e-9 * abs(at)).any():  # distinct from all others
        away *= 0.5
    return at + away


def _relocate_poles(
    basis: RationalBasis, x: ComplexArray, Y: ComplexArray, poles: ComplexArray
) -> ComplexArray:
    """Relocate the poles until they converge."""
    for _ in range(VECTOR_FITTING.sweeps):
        before = poles
        try:
            poles = _compute_zeros(basis, x, Y, poles)
        except np.linalg.LinAlgError:  # two poles coincide: too many poles
            break
        # The order of the poles may change.
        change = max((np.abs(before - p).min() / abs(p) for p in poles), default=0.0)
        if change < VECTOR_FITTING.settled_change:
            break
    return poles


def _compute_zeros(
    basis: RationalBasis, x: ComplexArray, Y: ComplexArray, poles: ComplexArray
) -> ComplexArray:
    """Return the zeros of the sigma that minimises |sigma Y - numerators| at mean |sigma|^2 = 1."""
    inner = basis.fractions(x, poles)
    Q = np.linalg.qr(basis.parts(np.hstack([inner, basis.powers(x)])))[0]
    sigma = np.hstack([inner, np.ones((len(x), 1))])
    triangle: NumberArray = np.zeros((0, sigma.shape[1]))
    for y in Y.T:
        triangle = stack_equations(triangle, basis.parts(y[:, None] * sigma), Q)
    return compute_sigma_zeros(basis, x, poles, triangle)


def stack_equations(triangle: NumberArray, block: NumberArray, Q: NumberArray) -> NumberArray:
    """Return the triangle of the equations of sigma, (k, m + 1), extended by one function.

    `block`, shape (n, m + 1), is the function times the fractions and 1, as from
    `RationalBasis.parts`. `Q`, shape (n, j), is an orthonormal basis of its numerator, which is
    eliminated.
    """
    block = block - Q @ (Q.conj().T @ block)
    triangle_of_function = np.linalg.qr(block, mode="r")
    return np.asarray(np.linalg.qr(np.vstack([triangle, triangle_of_function]), mode="r"))


def compute_sigma_zeros(
    basis: RationalBasis, x: ComplexArray, poles: ComplexArray, triangle: NumberArray
) -> ComplexArray:
    """Return the poles moved to the zeros of sigma at mean |sigma|^2 = 1, unstable ones reflected.

    `triangle` are the equations of sigma, from `stack_equations`.
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
    # The zeros are eigenvalues of diag(a) - 1 c^T / c_0, as a pencil that allows c_0 = 0.
    n = len(poles)
    A, B = np.zeros((2, n + 1, n + 1), dtype=np.complex128)
    A[:n, :n], A[:n, n], A[n, :n], A[n, n] = np.diag(poles), 1.0, residues, c[-1]
    B[:n, :n] = np.eye(n)
    above, below = scipy.linalg.eig(A, B, right=False, homogeneous_eigvals=True)
    finite = np.abs(below) > VECTOR_FITTING.rounding * np.abs(above)
    return _stable(basis, above[finite] / below[finite])


def _stable(basis: RationalBasis, poles: ComplexArray) -> ComplexArray:
    """Return stable poles: unstable ones reflected, and the upper one of each mirrored pair."""
    if not basis.mirrored:
        return np.asarray(poles.real + 1j * np.maximum(np.abs(poles.imag), VECTOR_FITTING.rounding))
    paired = np.abs(poles.imag) > VECTOR_FITTING.real_pole_share * np.abs(poles)
    imag = np.where(paired, poles.imag, 0.0)
    real = -np.maximum(np.abs(poles.real), VECTOR_FITTING.rounding)
    return np.asarray(real + 1j * imag)[imag >= 0]
