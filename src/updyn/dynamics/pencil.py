"""Solutions at all lines of a state by one eigendecomposition instead of a factorisation per line.

With hysteretic damping that does not depend on frequency, Z(s) = K + i D + s^2 M with the same K, D
and M at every line; s = i omega + decay. With P = K + sigma M = L L^T for a real sigma > 0,

    Z(s) = L (I + i D' + (s^2 - sigma) M') L^T,    D' = L^-1 D L^-T,    M' = L^-1 M L^-T.

With one loss factor, the eigenvectors of M' diagonalise this in real arithmetic, as L^-1 K L^-T =
I - sigma M' (Golub & Van Loan, Matrix Computations (2013), section 8.7). Otherwise D' =
U delta U^T and c = (1 + i delta)^-1/2 give the complex symmetric S = c U^T M' U c = X theta X^-1,

    Z(s)^-1 = F X (1 + (s^2 - sigma) theta)^-1 X^-1 F^T,    F = L^-T U c.

M may be singular. If the eigenvectors of S are almost dependent, or the residual of a load that
excites every mode is too large at a line, lines are solved one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg import lapack

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.settings import PENCIL
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.solver import probe_load, unit_scale
from updyn.linalg.threads import use_one_thread

__all__ = ["Pencil", "PencilCache", "StateWeights", "saves_time"]


@dataclass(frozen=True, slots=True, eq=False)
class StateWeights:
    """Weights of the terms in K, D and M of a state, shape (n_terms,), the same at every line.

    `loss` is the common loss factor of all stiffness, or None if there are several.
    """

    stiffness: RealArray
    damping: RealArray
    mass: RealArray
    loss: float | None

    @classmethod
    def find(cls, system: AffineSystem, state: State) -> StateWeights | None:
        """Return the weights at a state, or None if K, D and M depend on the line."""
        quantity = np.array([t.quantity for t in system.terms])
        tabled = np.array([t.table is not None for t in system.terms])
        used = state.factor != 0.0
        if (used & ((state.rate != 0.0) | (tabled & (state.loss != 0.0)))).any():
            return None
        static = quantity == "stiffness"
        losses = np.unique(state.loss[static & used])
        loss = float(losses[0]) if len(losses) == 1 else None
        stiffness = np.where(static, state.factor, 0.0)
        mass = np.where(quantity == "mass", state.factor, 0.0)
        return cls(stiffness, stiffness * state.loss, mass, loss)

    def saves_time(self, n_lines: int, least: int) -> bool:
        """Return whether one eigendecomposition saves time for this number of lines.

        `least` is the smallest sufficient number of lines if damping makes it complex.
        """
        return n_lines >= (least if self.loss is None else PENCIL.least_real_lines)


def saves_time(system: AffineSystem, state: State, n_lines: int, least: int) -> bool:
    """Return whether one eigendecomposition saves time for all `n_lines` lines of a state.

    `least` is the smallest sufficient number of lines if damping makes it complex.
    """
    weights = StateWeights.find(system, state)
    return weights is not None and weights.saves_time(n_lines, least)


@dataclass(frozen=True, slots=True, eq=False)
class Pencil:
    """Z(s)^-1 = V diag(1 / (constant + s^2 slope)) W^T of one state.

    With `refines`, one step of iterative refinement follows: the error is then the rounding error
    of each displacement instead of the largest one of a line (Skeel, Mathematics of Computation 35
    (1980) 817). It takes three to five times as long.
    """

    V: NDArray[np.inexact]
    W: NDArray[np.inexact]
    constant: NDArray[np.inexact]
    slope: NDArray[np.inexact]
    _check: _Check
    refines: bool = False

    @classmethod
    @use_one_thread
    def decompose(
        cls, K: RealArray, D: RealArray, M: RealArray, omega: float, loss: float | None = None
    ) -> Pencil | None:
        """Return the pencil of a state, or None if its eigenvectors are not independent.

        `omega` in rad/s is at least the highest line; `loss` is the common loss factor if D = loss
        K.
        """
        sigma = omega**2
        P = K + sigma * M
        try:
            L = np.asarray(np.linalg.cholesky(P), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        check, mass = _Check.of(K, M, D, unit_scale(P.diagonal())), _transform_symmetric(L, M)
        if loss is not None:
            theta, Q = _modes(mass)
            V = _solve_lower(L, Q, trans="T")
            constant: NDArray[np.inexact] = 1.0 - sigma * theta
            if loss:
                constant = (1.0 + 1j * loss) * constant
            return cls(V, V, constant, theta, check)
        delta, U = _modes(_transform_symmetric(L, D))
        root = 1.0 / np.sqrt(1.0 + 1j * delta)
        S = root[:, None] * (U.T @ mass @ U) * root
        theta, X = scipy.linalg.eig(S, overwrite_a=True, check_finite=False)
        factors, pivots, singular = lapack.zgetrf(X)
        size = np.abs(X).sum(axis=0).max()
        if singular or lapack.zgecon(factors, size)[0] < PENCIL.least_condition:
            return None
        F = _solve_lower(L, U, trans="T") * root
        W = lapack.zgetrs(factors, pivots, F.T)[0].T
        return cls(F @ X, W, 1.0 - sigma * theta, theta, check)

    @use_one_thread
    def solve(self, squares: ComplexArray, B: RealArray) -> tuple[ComplexArray, BoolArray]:
        """Return X of Z X = B, shape (n, n_lines, r), and a mask of lines accurate to rounding.

        `squares` are s^2 in 1/s^2; the loads `B`, (n, r), are the same at every line.
        """
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            amplitude = 1.0 / (self.constant[:, None] + squares * self.slope[:, None])
            X = _times(self.V, amplitude[:, :, None] * (self.W.T @ B)[:, None, :])
            if self.refines:
                R = self._check.residual(squares, X, B)
                X += _times(self.V, amplitude[:, :, None] * _times(self.W.T, R))
            load = self._check.load(B)
            y = _times(self.V, amplitude * (self.W.T @ load)[:, None])
            return X, self._check.accepts(squares, y, load)


@dataclass(frozen=True, slots=True, eq=False)
class _Check:
    """The residual of one load at many lines, in scaled DOFs: displacements times `scale`.

    `scale` is `unit_scale` of K + sigma M; `parts` are the scaled K, M, and D if it is not zero;
    `norms` are their maximum norms.
    """

    scale: RealArray
    parts: tuple[RealArray, ...]
    norms: tuple[float, ...]

    @classmethod
    def of(cls, K: RealArray, M: RealArray, D: RealArray, scale: RealArray) -> _Check:
        """Return the check of K + i D + s^2 M."""
        matrices = (K, M, D) if D.any() else (K, M)
        parts = tuple(A / scale / scale[:, None] for A in matrices)
        norms = tuple(float(np.abs(A).sum(axis=1).max()) for A in parts)
        return cls(scale, parts, norms)

    def load(self, B: RealArray) -> ComplexArray:
        """Return a load that excites every mode plus a combination of all columns of B, (n,)."""
        sizes = (np.abs(B) / self.scale[:, None]).max(axis=0, initial=0.0)
        phase = np.exp(2j * np.pi * np.random.default_rng(1).random(len(sizes)))
        weight = phase / np.maximum(sizes, np.finfo(np.float64).tiny)
        return np.asarray(probe_load(self.scale)[:, 0] + B @ weight, dtype=np.complex128)

    def residual(self, squares: ComplexArray, X: ComplexArray, B: RealArray) -> ComplexArray:
        """Return B - Z X, shape (n, n_lines, r), for displacements X and loads B."""
        scaled = self.scale[:, None, None] * X
        R = np.repeat((B / self.scale[:, None])[:, None, :].astype(np.complex128), len(squares), 1)
        for A, weight in self._terms(squares):
            R -= weight[:, None] * _times(A, scaled)
        return np.asarray(self.scale[:, None, None] * R)

    def _terms(self, squares: ComplexArray) -> Iterator[tuple[RealArray, ComplexArray]]:
        """Yield the matrices with their weights at each line."""
        ones = np.ones(len(squares), dtype=np.complex128)
        yield from zip(self.parts, (ones, squares, 1j * ones), strict=False)

    def accepts(self, squares: ComplexArray, y: ComplexArray, load: ComplexArray) -> BoolArray:
        """Return for each line whether y, shape (n, n_lines), solves the load with small growth."""
        b, y = load / self.scale, self.scale[:, None] * y
        residual, size = np.repeat(b[:, None], len(squares), axis=1), np.zeros(len(squares))
        for norm, (A, weight) in zip(self.norms, self._terms(squares), strict=True):
            residual -= weight * _times(A, y)
            size = size + norm * np.abs(weight)
        largest, moved = np.abs(b).max(), np.abs(y).max(axis=0)
        solved = np.abs(residual).max(axis=0) <= PENCIL.backward_error * (size * moved + largest)
        most = PENCIL.doubtful_growth * SPARSE_SOLVER.largest_probe_growth
        return np.asarray(solved & (moved <= most * largest))


@dataclass(slots=True, eq=False)
class PencilCache:
    """The pencils of the last state; lines of similar highest frequency share one.

    `least` is the smallest number of lines for a pencil if damping makes it complex.
    """

    least: int
    _key: bytes = b""
    _weights: StateWeights | None = None
    _pencils: dict[float, Pencil | None] = field(default_factory=dict)

    def __reduce__(self) -> tuple[type[PencilCache], tuple[int]]:
        return PencilCache, (self.least,)  # a pencil stays in its process

    def find(
        self,
        system: AffineSystem,
        state: State,
        lines: RealArray,
        matrices: Callable[[StateWeights], tuple[RealArray, RealArray, RealArray]],
    ) -> Pencil | None:
        """Return the pencil of a state, or None if separate solutions for each line are faster.

        `lines` are all lines of the state in Hz; `matrices` returns K, D and M for their weights.
        """
        key = np.concatenate((state.factor, state.loss, state.rate)).tobytes()
        if key != self._key:
            self._key, self._weights = key, StateWeights.find(system, state)
            self._pencils.clear()
        if self._weights is None or not self._weights.saves_time(len(lines), self.least):
            return None
        highest = _round_up_frequency(float(lines.max(initial=0.0)))
        if highest not in self._pencils:
            K, D, M = matrices(self._weights)
            omega = 2.0 * np.pi * highest
            self._pencils[highest] = Pencil.decompose(K, D, M, omega, self._weights.loss)
        return self._pencils[highest]


def _round_up_frequency(freq: float) -> float:
    """Return the next of 1, 2^(1/2), 2, ... Hz; its pencil serves all lines up to it."""
    mantissa, exponent = math.frexp(freq)
    step = math.sqrt(0.5) if mantissa <= math.sqrt(0.5) else 1.0
    return math.ldexp(step, exponent) if freq else 0.0


def _modes(A: RealArray) -> tuple[RealArray, RealArray]:
    """Return eigenvalues and orthonormal eigenvectors of a symmetric A."""
    values, vectors = np.linalg.eigh(A)
    return np.asarray(values, dtype=np.float64), np.asarray(vectors, dtype=np.float64)


def _transform_symmetric(L: RealArray, A: RealArray) -> RealArray:
    """Return L^-1 A L^-T of a symmetric A, symmetric to the last bit."""
    half = _solve_lower(L, _solve_lower(L, A).T)
    return np.asarray(0.5 * (half + half.T))


def _solve_lower(L: RealArray, B: RealArray, *, trans: str = "N") -> RealArray:
    """Return L^-1 B, or L^-T B for ``trans="T"``."""
    return np.asarray(
        scipy.linalg.solve_triangular(L, B, lower=True, trans=trans, check_finite=False)
    )


def _times(A: NDArray[np.inexact], X: ComplexArray) -> ComplexArray:
    """Return A X for complex X, shape (n, ...), in real arithmetic if A is real."""
    flat = X.reshape(len(X), -1)
    if np.iscomplexobj(A):
        product = np.asarray(A @ flat, dtype=np.complex128)
    else:
        product = (A @ np.ascontiguousarray(flat).view(np.float64)).view(np.complex128)
    return product.reshape(len(A), *X.shape[1:])
