"""Lowest eigenpairs of (K, M). Both may be singular, but not on the same motion.

The pencil M phi = nu (K + s M) phi, nu = 1 / (lambda + s), s > 0, is definite: nu = 0 for massless
motions, 1 / s for rigid-body motions. The relative error of lambda is about eps (lambda + s)^2 /
(lambda s), so two passes move s near the wanted eigenvalues.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TypeVar

import numpy as np
import scipy.linalg as sl

from updyn.arrays import NumberArray, RealArray
from updyn.dynamics.lanczos import BlockLanczos, RealPencil
from updyn.dynamics.settings import EIGEN, LANCZOS
from updyn.errors import SolverError
from updyn.group import Matrix
from updyn.linalg.direct import Direct, factorise
from updyn.linalg.threads import use_one_thread

__all__ = [
    "all_dense_pairs",
    "all_pairs",
    "complex_pairs",
    "mass_rank",
    "pairs_up_to",
    "real_pairs",
    "state_space_pairs",
    "weakest_dof",
]


Pairs = tuple[NumberArray, NumberArray]
T = TypeVar("T")


@use_one_thread
def mass_rank(M: Matrix) -> int:
    """Return the number of independent motions with mass: the number of finite eigenvalues.

    With more than `EIGEN.dense_dofs` DOFs with mass, their number is returned as an upper limit.
    """
    massive = np.flatnonzero(np.diff(M.indptr))
    massive = massive[M.diagonal()[massive] != 0.0]
    if len(massive) == 0 or len(massive) > EIGEN.dense_dofs:
        return len(massive)
    block = M[massive][:, massive].toarray()
    unit = 1.0 / np.sqrt(np.abs(np.diag(block)))
    values = np.linalg.eigvalsh(unit[:, None] * block * unit)
    return int((np.abs(values) > EIGEN.zero_share * len(massive)).sum())


@use_one_thread
def weakest_dof(K: Matrix, M: Matrix) -> int:
    """Return the DOF that moves most in the motion with least stiffness and mass."""
    A = (K + _first_shift(K, M) * M).toarray()
    unit = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(A)), np.finfo(np.float64).tiny))
    _, vectors = np.linalg.eigh(unit[:, None] * A * unit)
    return int(np.argmax(np.abs(vectors[:, 0] * unit)))


@use_one_thread
def pairs_up_to(K: Matrix, M: Matrix, value: float, most: int) -> Pairs:
    """Return the eigenpairs up to a value in 1/s2 and the next one, `most` pairs at most."""
    number, n = None, min(20, most)
    if np.isfinite(value):
        pencil = RealPencil(K, M)
        number = _count_below(pencil, value)
    if number is not None:
        n = min(number + 1, most)
        if number < most and _is_lanczos(K, M, n):
            with suppress(SolverError):
                return _solve_up_to(pencil, value, number)
    found = real_pairs(K, M, n)
    while found[0][-1] <= value and n < most:
        n = min(2 * n, most)
        found = real_pairs(K, M, n)
    return found


@use_one_thread
def real_pairs(K: Matrix, M: Matrix, n: int) -> Pairs:
    """Return the n lowest eigenvalues of K phi = lambda M phi (1/s2, ascending), and their vectors.

    K and M must be positive semidefinite except for rounding.
    """
    if _is_lanczos(K, M, n):
        return _solve_large(RealPencil(K, M), n, _first_shift(K, M))
    if _has_few_masses(M):
        solve = partial(_few_masses, K, M, n)
    else:
        solve = partial(_dense, K.toarray(), M.toarray(), n)
    shift, (value, _) = _definite(solve, _first_shift(K, M))
    try:
        return solve(_second_shift(value, shift, EIGEN.dense_shift))
    except SolverError:
        if value[0] >= 0:
            raise
        return solve(shift)


def all_pairs(
    K: Matrix, M: Matrix, n: int
) -> tuple[NumberArray, NumberArray, tuple[RealArray, RealArray, RealArray]]:
    """Return the n lowest eigenpairs of a small model, and a basis that diagonalises it.

    The basis is (V, diagonal of V^T K V, diagonal of V^T M V), the last 0 for motions without mass.
    """
    return all_dense_pairs(K.toarray(), M.toarray(), n)


@use_one_thread
def all_dense_pairs(
    k: RealArray, m: RealArray, n: int
) -> tuple[NumberArray, NumberArray, tuple[RealArray, RealArray, RealArray]]:
    """Return `all_pairs` of dense matrices."""
    shift, (value, _) = _definite(partial(_dense, k, m, n), _first_shift(k, m))
    for s in dict.fromkeys((_second_shift(value, shift, EIGEN.dense_shift), shift)):
        try:
            nu, V = _decompose(k, m, s, 0)
        except SolverError:
            continue
        if nu[-n] > 0:
            lowest = slice(None, -n - 1, -1)
            return (1.0 / nu[lowest] - s), V[:, lowest], (V, 1.0 - s * nu, nu)
    raise SolverError(_SINGULAR)


def _is_dense(n_dofs: int, n_modes: int) -> bool:
    """Return whether a dense solver finds some modes of a model faster than a sparse one."""
    return n_dofs <= EIGEN.dense_dofs or 4 * (n_modes + EIGEN.additional_modes) > n_dofs


def _definite(solve: Callable[[float], T], shift: float) -> tuple[float, T]:
    """Return a shift s for which K + s M is definite, and the result with it."""
    for _ in range(3):
        try:
            return shift, solve(shift)
        except SolverError:
            shift *= 1e3
    return shift, solve(shift)


def _first_shift(K: Matrix | RealArray, M: Matrix | RealArray) -> float:
    k, m = np.abs(K.diagonal()), np.abs(M.diagonal())
    has = (m > 0) & (k > 0)
    if not has.any():
        return 1.0
    return EIGEN.first_shift * float((k[has] / m[has]).max())


def _second_shift(value: RealArray, shift: float, share: float) -> float:
    # If all wanted modes are rigid-body modes, their values are rounding; keep the first shift.
    top = float(value[-1])
    if top > 1e-9 * shift:
        return share * top
    return shift


def _dense(K: RealArray, M: RealArray, n: int, shift: float) -> Pairs:
    nu, vectors = _decompose(K, M, shift, len(K) - n)
    if not nu[0] > 0:
        raise SolverError(_SINGULAR)
    return (1.0 / nu - shift)[::-1], vectors[:, ::-1]


def _decompose(K: RealArray, M: RealArray, shift: float, first: int) -> Pairs:
    """Return nu, ascending from the first-th, and V with V^T (K + s M) V = 1, V^T M V = nu."""
    A = K + shift * M
    # Scale to a unit diagonal, independent of units and of rotations or translations.
    diagonal = np.diag(A)
    if (diagonal <= 0).any():
        raise SolverError(_SINGULAR)
    unit = 1.0 / np.sqrt(diagonal)
    A, B = unit[:, None] * A * unit, unit[:, None] * M * unit
    try:
        nu, vectors = sl.eigh(B, A, subset_by_index=(first, len(K) - 1))
    except np.linalg.LinAlgError as error:
        raise SolverError(_SINGULAR) from error
    if not np.isfinite(nu).all():
        raise SolverError(_SINGULAR)
    return nu, unit[:, None] * vectors


def _has_few_masses(M: Matrix) -> bool:
    """Return whether a model is large but for its DOFs with mass."""
    return bool(M.shape[0] > EIGEN.dense_dofs >= np.count_nonzero(np.diff(M.indptr)))


def _is_lanczos(K: Matrix, M: Matrix, n: int) -> bool:
    """Return whether modes are computed by the Lanczos method."""
    return not _has_few_masses(M) and not _is_dense(K.shape[0], n)


def _few_masses(K: Matrix, M: Matrix, n: int, shift: float) -> Pairs:
    """Solve a large model with mass on few DOFs exactly, by its flexibility at these DOFs."""
    heavy = np.flatnonzero(np.diff(M.indptr))
    lu = _factor(K + shift * M)
    weight, axes = np.linalg.eigh(M[heavy][:, heavy].toarray())
    kept = weight > EIGEN.zero_share * weight[-1]
    root = np.zeros((K.shape[0], int(kept.sum())))
    root[heavy] = axes[:, kept] * np.sqrt(weight[kept])
    moved = lu.solve(root)
    flexibility = root.T @ moved
    nu, y = np.linalg.eigh((flexibility + flexibility.T) / 2)
    nu, y = nu[::-1][:n], y[:, ::-1][:, :n]
    if not (np.isfinite(nu).all() and len(nu) == n and nu[-1] > 0):
        raise SolverError(_SINGULAR)
    return 1.0 / nu - shift, moved @ y


_SINGULAR = (
    "the model has a motion with neither stiffness nor mass, or its stiffness is far from positive:"
    " no modes can be computed"
)


def _factor(A: Matrix) -> Direct:
    try:
        return factorise(A)
    except RuntimeError as error:
        raise SolverError(_SINGULAR) from error


def _solve_large(pencil: RealPencil, n: int, shift: float) -> Pairs:
    """Return modes of a large model, with a shift suitable for them, and prove that none is missed.

    The proof is Sylvester's law of inertia.
    """

    def begin(at: float) -> BlockLanczos:
        return BlockLanczos.begin(pencil, at)

    def estimate(at: float) -> tuple[BlockLanczos, RealArray]:
        process = begin(at)
        return process, process.solve(n, LANCZOS.crude_tolerance)[0]

    shift, (process, value) = _definite(estimate, shift)
    second = _second_shift(value, shift, EIGEN.sparse_shift)
    if not LANCZOS.least_shift * second <= shift <= LANCZOS.most_shift * second:
        try:
            process = begin(second)
        except SolverError:
            if value[0] >= 0:
                raise
            process = begin(shift)
    for again in (False, True):
        found, vectors = (process.repeat() if again else process).solve(n + EIGEN.additional_modes)
        at = _find_gap(found, n)
        there = None if at is None else _count_below(pencil, 0.5 * (found[at - 1] + found[at]))
        if there is None or there == at:
            return found[:n], vectors[:, :n]
    raise _make_count_error(there, at)


def _solve_up_to(pencil: RealPencil, most: float, number: int) -> Pairs:
    """Return the eigenpairs below a value, whose number is known, and the next one."""
    process, same = BlockLanczos.begin(pencil, EIGEN.sparse_shift * most), EIGEN.equal_values
    for again in (False, True):
        wanted = number + EIGEN.additional_modes
        value, vectors = (process.repeat() if again else process).solve(wanted)
        # The value may be an eigenvalue itself, which rounding counts or not.
        below, up_to = (int((value < f * most).sum()) for f in (1 - same, 1 + same))
        if below <= number <= up_to:
            return value[: up_to + 1], vectors[:, : up_to + 1]
    raise _make_count_error(number, up_to)


def _make_count_error(there: int | None, found: int | None) -> SolverError:
    return SolverError(
        f"the eigenvalue solver found {found} modes below a frequency that {there} modes lie below"
    )


def _find_gap(value: RealArray, n: int) -> int | None:
    """Return the number of values before the first gap after the n-th; None without a gap."""
    gaps = np.flatnonzero(np.diff(value) > EIGEN.equal_values * np.abs(value[1:])) + 1
    gaps = gaps[gaps >= n]
    return int(gaps[0]) if gaps.size else None


def _count_below(pencil: RealPencil, value: float) -> int | None:
    """Return the number of eigenvalues below a value; None if the factors do not show it."""
    try:
        return pencil.factor(-value).negative
    except SolverError:  # the value is an eigenvalue
        return None


@use_one_thread
def complex_pairs(K: Matrix, M: Matrix, n: int, omega: float) -> Pairs:
    """Return at least n eigenpairs of complex symmetric K phi = lambda M phi near zero, in 1/s2.

    Massless motions are omitted; `omega` in rad/s, the highest wanted frequency, is a scale.
    """
    N = K.shape[0]
    shift = EIGEN.sparse_shift * omega**2
    if _is_dense(N, n):
        A = (K + shift * M).toarray()
        unit = 1.0 / np.sqrt(np.abs(np.diag(A)))
        scaled = unit[:, None] * A * unit
        nu, vectors = sl.eig(sl.solve(scaled, unit[:, None] * M.toarray() * unit, assume_a="sym"))
        kept = np.flatnonzero(np.abs(nu) > EIGEN.zero_share * np.abs(nu).max())
        return 1.0 / nu[kept] - shift, unit[:, None] * vectors[:, kept]
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

    lu = _factor(K + shift * M)
    step = LinearOperator(
        (N, N), matvec=lambda x: lu.solve((M @ x).astype(np.complex128)), dtype=np.complex128
    )
    start = np.random.default_rng(0).standard_normal(N).astype(np.complex128)
    try:
        nu, vectors = eigs(
            step,
            k=n + EIGEN.additional_modes,
            which="LM",
            v0=lu.solve((M @ start).astype(np.complex128)),
        )
    except ArpackError as error:
        raise SolverError(f"the eigenvalue solver failed: {error}") from error
    return 1.0 / nu - shift, vectors


@use_one_thread
def state_space_pairs(K: Matrix, C: Matrix, M: Matrix, omega: float) -> Pairs:
    """Return lambda = -s^2 and vectors of s^2 M + s C + K for the roots s above the real axis."""
    # Only these are valid, because structural damping (complex K) is defined for positive
    # frequencies. First companion linearisation (Tisseur & Meerbergen, SIAM Review 43 (2001) 235,
    # eq. 3.4), with the time scaled by `omega` and each DOF to a unit diagonal: regular even if M
    # is singular. lambda = omega^2 (1 + i eta).
    k, c, m = K.toarray(), omega * C.toarray(), omega**2 * M.toarray()
    unit = 1.0 / np.sqrt(np.abs(np.diag(k)) + np.abs(np.diag(c)) + np.abs(np.diag(m)))
    k, c, m = (unit[:, None] * a * unit for a in (k, c, m))
    N = len(k)
    eye, nil = np.eye(N), np.zeros((N, N))
    (alpha, beta), vectors = sl.eig(
        np.block([[nil, eye], [-k, -c]]), np.block([[eye, nil], [nil, m]]), homogeneous_eigvals=True
    )
    finite = np.flatnonzero(np.abs(beta) > EIGEN.zero_share * np.abs(alpha))
    s = alpha[finite] / beta[finite]
    above = s.imag > 1e-5
    return -((s[above] * omega) ** 2), unit[:, None] * vectors[:N, finite[above]]
