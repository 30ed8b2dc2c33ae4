"""Solutions at all lines of a state by one eigendecomposition instead of a factorisation per line.

At every line, Z = k K + m M with the real, symmetric K and M of the state, if all stiffness has one
coefficient k and all mass has one, m. With P = K + sigma M = L L^T for a real sigma > 0, the
eigenvectors of M' = L^-1 M L^-T diagonalise Z in real arithmetic, as L^-1 K L^-T = I - sigma M'
(Golub & Van Loan, Matrix Computations (2013), section 8.7).

Otherwise Z(s) = K + i D + s^2 M + U diag(w) U^T, s = i omega + decay, where the last part has what
depends on the line in other ways (viscous dampers, loss factors over frequency), of small rank. The
first part is

    Z0(s) = L (I + i D' + (s^2 - sigma) M') L^T,    D' = L^-1 D L^-T.

D' = Q delta Q^T and c = (1 + i delta)^-1/2 give the complex symmetric S = c Q^T M' Q c = X theta
X^-1,

    Z0(s)^-1 = F X (1 + (s^2 - sigma) theta)^-1 X^-1 F^T,    F = L^-T Q c,

and Z^-1 = Z0^-1 - Z0^-1 U (I + diag(w) U^T Z0^-1 U)^-1 diag(w) U^T Z0^-1 (Woodbury; Golub & Van
Loan, section 2.1.4). D contains the damping that depends on the line at half the highest frequency,
so that Z0 is damped where Z is.

M may be singular. If the eigenvectors of S are almost dependent, or the residual of a load that
excites every mode is too large at a line, lines are solved one by one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.linalg import lapack

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.settings import PENCIL
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.solver import probe_load, unit_scale
from updyn.linalg.threads import use_one_thread

__all__ = ["Pencil", "PencilCache", "StateWeights", "decompose", "saves_time"]


@dataclass(frozen=True, slots=True, eq=False)
class StateWeights:
    """Weights of the terms in K, D, C and M of a state, shape (n_terms,), the same at every line.

    `is_common`: at each line, all stiffness has one coefficient, and all mass has one. `corrected`
    are the other terms whose coefficients depend on the line in other ways.
    """

    stiffness: RealArray
    damping: RealArray
    viscous: RealArray
    mass: RealArray
    is_common: bool
    corrected: IndexArray

    @classmethod
    def find(cls, system: AffineSystem, state: State) -> StateWeights | None:
        """Return the weights at a state, or None if too much depends on the line."""
        tabled = np.zeros(len(system.terms), dtype=np.bool_)
        tabled[system.tabled_terms] = True
        used = state.factor != 0.0
        stiffness = state.factor * system.stiffness_terms
        mass = state.factor * system.mass_terms
        viscous = state.factor * state.rate
        about = stiffness, stiffness * state.loss, viscous, mass
        if _is_common(system, state, used):
            return cls(*about, is_common=True, corrected=np.zeros(0, dtype=np.intp))
        corrected = np.flatnonzero(used & ((state.rate != 0.0) | (tabled & (state.loss != 0.0))))
        rank = sum(len(system.factor_term(t)[1]) for t in corrected.tolist())
        if rank > PENCIL.most_rank_share * system.n:
            return None
        return cls(*about, is_common=False, corrected=corrected)

    def saves_time(self, n_lines: int, least: int) -> bool:
        """Return whether one eigendecomposition saves time for this number of lines.

        `least` is the smallest sufficient number of lines if damping makes it complex.
        """
        return n_lines >= (PENCIL.least_real_lines if self.is_common else least)

    def at(self, omega: float) -> StateWeights:
        """Return the weights with viscous damping at a frequency as structural damping."""
        return replace(self, damping=self.damping + omega * self.viscous)

    def line_factors(
        self, coefficients: ComplexArray, squares: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the coefficients of K and M at lines, shape (n_lines,), apart from corrections."""
        if not self.is_common:
            return np.ones_like(squares), squares
        found = []
        for weights in (self.stiffness, self.mass):
            used = np.flatnonzero(weights)
            found.append(coefficients[used[0]] / weights[used[0]] if len(used) else 0.0 * squares)
        return found[0], found[1]

    def remainder(self, coefficients: ComplexArray, squares: ComplexArray) -> ComplexArray:
        """Return the coefficients of corrected terms less those in Z0, (n_corrected, n_lines)."""
        t = self.corrected
        constant = self.stiffness[t] + 1j * self.damping[t]
        return np.asarray(coefficients[t] - constant[:, None] - np.outer(self.mass[t], squares))


def _is_common(system: AffineSystem, state: State, used: BoolArray) -> bool:
    """Return whether all stiffness has one coefficient at each line, and all mass has one."""
    kinds: dict[str, set[tuple[float, float, int]]] = {"stiffness": set(), "mass": set()}
    for i in np.flatnonzero(used).tolist():
        term, loss, rate = system.terms[i], float(state.loss[i]), float(state.rate[i])
        if term.quantity not in kinds:
            return False
        kinds[term.quantity].add((loss, rate, id(term.table) if loss else 0))
    return all(len(found) <= 1 for found in kinds.values())


def saves_time(system: AffineSystem, state: State, n_lines: int, least: int) -> bool:
    """Return whether one eigendecomposition saves time for all `n_lines` lines of a state.

    `least` is the smallest sufficient number of lines if damping makes it complex.
    """
    if not _may_save_time(n_lines, least):
        return False
    weights = StateWeights.find(system, state)
    return weights is not None and weights.saves_time(n_lines, least)


def _may_save_time(n_lines: int, least: int) -> bool:
    """Return whether this number of lines is sufficient for a real or a complex decomposition."""
    return n_lines >= min(PENCIL.least_real_lines, least)


def decompose(
    S: ComplexArray,
) -> tuple[ComplexArray, ComplexArray, tuple[ComplexArray, IndexArray]] | None:
    """Return eigenvalues, eigenvectors and the LU factors and pivots of these; overwrites S.

    None if the eigenvectors are not independent.
    """
    theta, X = scipy.linalg.eig(S, overwrite_a=True, check_finite=False)
    factors, pivots, singular = lapack.zgetrf(X)
    size = np.abs(X).sum(axis=0).max()
    if singular or lapack.zgecon(factors, size)[0] < PENCIL.least_condition:
        return None
    return theta, X, (factors, pivots)


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """Coefficients of K and M, and of the columns of U, at some lines."""

    stiffness: ComplexArray
    mass: ComplexArray
    correction: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class _Correction:
    """Part of Z with a small rank, U diag(w) U^T, and U in the coordinates of a pencil.

    `of_term` is the position of the term of each column among the corrected ones.
    """

    U: RealArray
    values: RealArray
    of_term: IndexArray
    left: ComplexArray
    right: ComplexArray

    def apply(self, w: ComplexArray, amplitude: ComplexArray, q: ComplexArray) -> ComplexArray:
        """Return the coordinates of Z^-1 from those of Z0^-1, both (n, n_lines, r)."""
        a = np.ascontiguousarray(amplitude.T)
        inner = (self.left * a[:, None, :]) @ self.right
        system = w.T[:, :, None] * inner
        system[:, np.arange(len(w)), np.arange(len(w))] += 1.0
        loads = w.T[:, :, None] * _times(self.left, q).transpose(1, 0, 2)
        try:
            y = np.linalg.solve(system, loads)
        except np.linalg.LinAlgError:  # the check rejects these lines
            y = np.full_like(loads, np.nan)
        change = _times(self.right, y.transpose(1, 0, 2))
        return np.asarray(q - amplitude[:, :, None] * change)


@dataclass(frozen=True, slots=True, eq=False)
class Pencil:
    """Z0^-1 = V diag(1 / (k constant + m slope)) W^T of one state, with its correction.

    With `refines`, one step of iterative refinement follows: the error is then the rounding error
    of each displacement instead of the largest one of a line (Skeel, Mathematics of Computation 35
    (1980) 817). It takes three to five times as long.
    """

    V: NDArray[np.inexact]
    W: NDArray[np.inexact]
    constant: NDArray[np.inexact]
    slope: NDArray[np.inexact]
    _weights: StateWeights
    _check: _Check
    _correction: _Correction | None = None
    refines: bool = False

    @classmethod
    @use_one_thread
    def decompose(
        cls,
        weights: StateWeights,
        matrices: Callable[[StateWeights], tuple[RealArray, RealArray, RealArray]],
        system: AffineSystem,
        omega: float,
    ) -> Pencil | None:
        """Return the pencil of a state, or None if its eigenvectors are not independent.

        `omega` in rad/s is at least the highest line; `matrices` returns K, D and M.
        """
        if not weights.is_common:
            weights = weights.at(PENCIL.reference_share * omega)
        K, D, M = matrices(weights)
        sigma = omega**2
        P = K + sigma * M
        try:
            L = np.asarray(np.linalg.cholesky(P), dtype=np.float64)
        except np.linalg.LinAlgError:
            return None
        scale, mass = unit_scale(P.diagonal()), _transform_symmetric(L, M)
        if weights.is_common:
            theta, Q = _modes(mass)
            modes = _solve_lower(L, Q, trans="T")
            check = _Check.of((K, M), scale, None)
            return cls(modes, modes, 1.0 - sigma * theta, theta, weights, check)
        delta, Q = _modes(_transform_symmetric(L, D))
        root = 1.0 / np.sqrt(1.0 + 1j * delta)
        S = root[:, None] * (Q.T @ mass @ Q) * root
        decomposed = decompose(np.asarray(S, dtype=np.complex128))
        if decomposed is None:
            return None
        roots, X, lu = decomposed
        F = _solve_lower(L, Q, trans="T") * root
        V, W = F @ X, lapack.zgetrs(*lu, F.T)[0].T
        correction = _correct(system, weights, V, W)
        check = _Check.of((K, M, D) if D.any() else (K, M), scale, correction)
        return cls(V, W, 1.0 - sigma * roots, roots, weights, check, correction)

    @use_one_thread
    def solve(
        self, coefficients: ComplexArray, squares: ComplexArray, B: RealArray
    ) -> tuple[ComplexArray, BoolArray]:
        """Return X of Z X = B, shape (n, n_lines, r), and a mask of lines accurate to rounding.

        `coefficients`, (n_terms, n_lines), are those of the terms, `squares` s^2 in 1/s^2; the
        loads `B`, (n, r), are the same at every line.
        """
        lines = self._find_lines(coefficients, squares)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            amplitude = 1.0 / (
                self.constant[:, None] * lines.stiffness + self.slope[:, None] * lines.mass
            )
            X = self._invert(lines, amplitude, (self.W.T @ B)[:, None, :])
            if self.refines:
                R = self._check.residual(lines, X, B)
                X += self._invert(lines, amplitude, _times(self.W.T, R))
            load = self._check.load(B)
            y = self._invert(lines, amplitude, (self.W.T @ load)[:, None, None])[:, :, 0]
            return X, self._check.accepts(lines, y, load)

    def _find_lines(self, coefficients: ComplexArray, squares: ComplexArray) -> _Lines:
        k, m = self._weights.line_factors(coefficients, squares)
        w = np.zeros((0, len(squares)), dtype=np.complex128)
        if self._correction is not None:
            of_terms = self._weights.remainder(coefficients, squares)
            w = self._correction.values[:, None] * of_terms[self._correction.of_term]
        return _Lines(k, m, w)

    def _invert(
        self, lines: _Lines, amplitude: ComplexArray, loads: NDArray[np.inexact]
    ) -> ComplexArray:
        """Return Z^-1 times loads, which are given as W^T loads, (n, 1 or n_lines, r)."""
        q = amplitude[:, :, None] * loads
        if self._correction is not None:
            q = self._correction.apply(lines.correction, amplitude, q)
        return _times(self.V, q)


def _correct(
    system: AffineSystem, weights: StateWeights, V: ComplexArray, W: ComplexArray
) -> _Correction | None:
    """Return the correction for the terms that depend on the line; None without such terms."""
    columns, values, of_term = [], [], []
    for number, t in enumerate(weights.corrected.tolist()):
        vectors, scale = system.factor_term(t)
        U = np.zeros((system.n, len(scale)))
        U[system.terms[t].rows] = vectors
        columns.append(U)
        values.append(scale)
        of_term.append(np.full(len(scale), number))
    if not columns:
        return None
    U = np.hstack(columns)
    return _Correction(U, np.concatenate(values), np.concatenate(of_term), U.T @ V, W.T @ U)


@dataclass(frozen=True, slots=True, eq=False)
class _Check:
    """The residual of one load at many lines, in scaled DOFs: displacements times `scale`.

    `scale` is `unit_scale` of K + sigma M; `parts` are the scaled K, M, and D if it is not zero;
    `norms` are their maximum norms; `U` is that of the correction, scaled.
    """

    scale: RealArray
    parts: tuple[RealArray, ...]
    norms: tuple[float, ...]
    U: RealArray

    @classmethod
    def of(
        cls, matrices: Sequence[RealArray], scale: RealArray, correction: _Correction | None
    ) -> _Check:
        """Return the check of k K + m M + i D with a correction."""
        parts = tuple(A / scale / scale[:, None] for A in matrices)
        norms = tuple(float(np.abs(A).sum(axis=1).max()) for A in parts)
        U = np.zeros((len(scale), 0)) if correction is None else correction.U / scale[:, None]
        return cls(scale, parts, norms, U)

    def load(self, B: RealArray) -> ComplexArray:
        """Return a load that excites every mode plus a combination of all columns of B, (n,)."""
        sizes = (np.abs(B) / self.scale[:, None]).max(axis=0, initial=0.0)
        phase = np.exp(2j * np.pi * np.random.default_rng(1).random(len(sizes)))
        weight = phase / np.maximum(sizes, np.finfo(np.float64).tiny)
        return np.asarray(probe_load(self.scale)[:, 0] + B @ weight, dtype=np.complex128)

    def residual(self, lines: _Lines, X: ComplexArray, B: RealArray) -> ComplexArray:
        """Return B - Z X, shape (n, n_lines, r), for displacements X and loads B."""
        n_lines, scaled = len(lines.mass), self.scale[:, None, None] * X
        R = np.repeat((B / self.scale[:, None])[:, None, :].astype(np.complex128), n_lines, 1)
        R -= self._multiply(lines, scaled)
        return np.asarray(self.scale[:, None, None] * R)

    def accepts(self, lines: _Lines, y: ComplexArray, load: ComplexArray) -> BoolArray:
        """Return for each line whether y, shape (n, n_lines), solves the load with small growth."""
        b, y = load / self.scale, self.scale[:, None] * y
        residual = b[:, None] - self._multiply(lines, y[:, :, None])[:, :, 0]
        largest, moved = np.abs(b).max(), np.abs(y).max(axis=0)
        size = self._norm(lines)
        solved = np.abs(residual).max(axis=0) <= PENCIL.backward_error * (size * moved + largest)
        most = PENCIL.doubtful_growth * SPARSE_SOLVER.largest_probe_growth
        return np.asarray(solved & (moved <= most * largest))

    def _weights(self, lines: _Lines) -> tuple[ComplexArray, ...]:
        """Return the coefficients of `parts` at each line."""
        return lines.stiffness, lines.mass, np.full(len(lines.mass), 1j)

    def _multiply(self, lines: _Lines, X: ComplexArray) -> ComplexArray:
        """Return Z X in scaled DOFs, shape (n, n_lines, r)."""
        out = lines.correction[:, :, None] * _times(self.U.T, X)
        out = _times(self.U, out)
        for A, weight in zip(self.parts, self._weights(lines), strict=False):
            out += weight[:, None] * _times(A, X)
        return out

    def _norm(self, lines: _Lines) -> RealArray:
        """Return a bound of the maximum norm of Z in scaled DOFs at each line."""
        size = np.abs(self.U)
        out = (size @ (np.abs(lines.correction) * size.sum(axis=0)[:, None])).max(axis=0)
        for norm, weight in zip(self.norms, self._weights(lines), strict=False):
            out = out + norm * np.abs(weight)
        return np.asarray(out)


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
        if not _may_save_time(len(lines), self.least):
            return None
        key = np.concatenate((state.factor, state.loss, state.rate)).tobytes()
        if key != self._key:
            self._key, self._weights = key, StateWeights.find(system, state)
            self._pencils.clear()
        if self._weights is None or not self._weights.saves_time(len(lines), self.least):
            return None
        highest = _round_up_frequency(float(lines.max(initial=0.0)))
        if highest not in self._pencils:
            omega = 2.0 * np.pi * highest
            self._pencils[highest] = Pencil.decompose(self._weights, matrices, system, omega)
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
    flat = X.reshape(len(X), math.prod(X.shape[1:]))  # U may have no columns
    if np.iscomplexobj(A):
        product = np.asarray(A @ flat, dtype=np.complex128)
    else:
        product = (A @ np.ascontiguousarray(flat).view(np.float64)).view(np.complex128)
    return product.reshape(len(A), *X.shape[1:])
