"""`count_unstable`: stability of a periodic response by the harmonic Nyquist criterion.

A perturbation exp(s t) times a periodic function satisfies (I + H(s + i k omega) T(s)) p = 0, with
the receptances H at all shifted harmonics and the Fourier coefficients T of the elements' tangents
(Hill's method in the deformations of the elements). Its Floquet exponents are the zeros of

    D(s) = det(I + H T),    periodic in s with the period i omega.

D has the poles of the linear model, which is stable, and D -> 1 for Re s -> infinity. The number of
exponents with a positive real part is therefore the winding of D between s = -i omega / 2 and
i omega / 2 (Wereley, PhD thesis, MIT 1991, chapter 4: generalised Nyquist criterion for periodic
systems). Only receptances on the imaginary axis are used, for which structural damping is defined;
D(-s) is the conjugate of D(s).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp

from updyn.arrays import ComplexArray, IndexArray, IntArray, RealArray
from updyn.dynamics.periodic.balance import Balance, Evaluation
from updyn.dynamics.periodic.settings import STABILITY
from updyn.nonlinear.element import PeriodForce

__all__ = ["count_unstable"]


def count_unstable(balance: Balance, found: Evaluation) -> int:
    """Return the number of Floquet exponents with a positive real part."""
    # At s = 0 with the real stiffness, D is the real determinant of the balance, which changes its
    # sign at turning points.
    sign, _ = np.linalg.slogdet(found.jacobian)
    if balance.transfer.rational is None:
        # The winding needs receptances down to 0 Hz, outside of tables of loss factors.
        return int(sign < 0.0)
    poles = _find_poles(balance, found)
    # A perturbation moves all modes that the elements can move.
    needed = int(poles.imag.max(initial=0.0) / found.omega) + 1
    top = max(int(balance.fourier.harmonics[-1]), min(needed, STABILITY.most_harmonics))
    counts, fractions = [], []
    # D is periodic only in the limit of many harmonics; if it is not, more are added.
    for more in range(STABILITY.most_more_harmonics + 1):
        k = np.arange(-top - more, top + more + 1)
        winding = _wind(_Determinant(balance, found, k), poles, float(sign))
        counts.append(max(round(winding), 0))
        fractions.append(abs(winding - round(winding)))
        if fractions[-1] <= STABILITY.largest_fraction:
            break
    return counts[int(np.argmin(fractions))]


def _find_poles(balance: Balance, found: Evaluation) -> ComplexArray:
    """Return poles s of the modes that the elements can move, without and with their mean tangent.

    Only those with a positive imaginary part; near them, the phase of D turns quickly.
    """
    rational, n = balance.transfer.rational, balance.n_elements
    assert rational is not None
    poles, at = rational.poles()
    rows, columns = rational.rows[:n, at], rational.columns[at, :n]
    m, theta = rational.power, rational.theta[at]
    residue = np.abs(rows) * np.abs(columns.T) / np.abs(m * theta * poles ** (m - 1))
    width = np.maximum(np.abs(poles.real), STABILITY.offset * found.omega)
    size = [_measure_tangent(force, found.omega) for force in found.period]
    kept = (np.array(size)[:, None] * residue).sum(axis=0) / width > STABILITY.least_gain
    mean = [np.mean(force.stiffness.diagonal()) for force in found.period]
    loop = (columns * mean) @ rows
    moved = np.linalg.eigvals(
        np.linalg.solve(np.eye(kept.sum()) + loop[np.ix_(kept, kept)], np.diag(theta[kept]))
    )
    return np.append(poles[kept], replace(rational, theta=moved).poles()[0])


def _measure_tangent(force: PeriodForce, omega: float) -> float:
    """Return the largest stiffness of an element, with that of its damping."""
    stiffness = np.abs(force.stiffness.data).max(initial=0.0)
    return float(stiffness + omega * np.abs(force.damping).max())


def _wind(determinant: _Determinant, poles: ComplexArray, sign: float) -> float:
    """Return the negative turns of D over a period, from half of it by symmetry.

    `sign` is that of D at s = 0.
    """
    omega = determinant.omega
    width = np.maximum(np.abs(poles.real), STABILITY.offset * omega)
    near = poles.imag[:, None] + width[:, None] * np.array(STABILITY.pole_offsets)
    folded = np.abs(near - omega * np.rint(near / omega)).ravel()
    nu = np.unique(np.append(np.linspace(0.0, 0.5 * omega, STABILITY.first_points), folded))
    phase = determinant.phase(nu)
    for _ in range(STABILITY.most_refinements):
        turn = np.angle(np.exp(1j * np.diff(phase)))
        wide = np.flatnonzero(np.abs(turn) > STABILITY.largest_turn)
        if not len(wide):
            break
        middle = 0.5 * (nu[wide] + nu[wide + 1])
        nu = np.insert(nu, wide + 1, middle)
        phase = np.insert(phase, wide + 1, determinant.phase(middle))
    total = float(turn.sum())
    if determinant.is_held:
        first = float(np.angle(sign * np.exp(1j * phase[0])))
        # A half turn is one exponent more: a count cannot be negative.
        total += first if first < 0.5 * np.pi else first - 2.0 * np.pi
    return -total / np.pi


class _Determinant:
    """D on the line s = epsilon + i nu, from receptances and the tangents of all elements."""

    __slots__ = ("_balance", "_decay", "_k", "_tangents", "is_held", "omega")

    def __init__(self, balance: Balance, found: Evaluation, k: IntArray) -> None:
        self._balance, self.omega, self._k = balance, found.omega, k
        # The line passes rigid-body modes, whose poles are at 0, on the right.
        self._decay = STABILITY.offset * found.omega
        self._tangents = [_Tangent(force, found.omega, k) for force in found.period]
        #: Whether D is defined at s = 0.
        self.is_held = balance.transfer.static is not None

    def phase(self, nu: RealArray) -> RealArray:
        """Return the phase of D at some frequencies in rad/s, shape (n_nu,)."""
        n, n_k = self._balance.n_elements, len(self._k)
        shifted = nu[:, None] + self.omega * self._k
        H, _ = self._balance.transfer.at(np.abs(shifted).ravel(), self._decay)
        H = H[:, :n, :n].reshape(len(nu), n_k, n, n)
        H = np.where((shifted < 0.0)[:, :, None, None], H.conj(), H)
        D = np.empty((len(nu), n, n_k, n, n_k), dtype=np.complex128)
        s = (self._decay + 1j * nu).astype(np.complex128)
        for f in range(n):
            T = self._tangents[f].at(s)
            D[:, :, :, f] = H[:, :, :, f].transpose(0, 2, 1)[..., None] * T[:, None]
        size = n * n_k
        sign, _ = np.linalg.slogdet(np.eye(size) + D.reshape(len(nu), size, size))
        return np.asarray(np.angle(sign))


class _Tangent:
    """Harmonics of the force of an element per perturbation exp(s t) times exp(i l omega t)."""

    __slots__ = ("_columns", "_damping", "_k", "_lag", "_later", "_omega", "_same", "_wave")

    def __init__(self, force: PeriodForce, omega: float, k: IntArray) -> None:
        self._omega, self._k = omega, k
        values, n = force.stiffness.diagonal(), len(force.force)
        self._same, self._damping = _toeplitz(values, k), _toeplitz(force.damping, k)
        self._columns, self._later = _select_memory(force, values)
        #: Samples since the reversals.
        self._lag = (np.arange(n)[:, None] - self._columns) % n
        self._wave = np.exp(2j * np.pi / n * np.outer(np.arange(n), k))

    def at(self, s: ComplexArray) -> ComplexArray:
        """Return the harmonics k of the force by those of the deformation, (n_s, n_k, n_k)."""
        moving = self._damping * (s[:, None, None] + 1j * self._omega * self._k)
        out = self._same + moving
        if len(self._columns):
            # A force with memory follows the perturbation at the time of the reversal.
            n = len(self._wave)
            fading = np.exp(-2.0 * np.pi / n / self._omega * np.outer(s, np.arange(n)))
            back = self._wave.conj().T @ (self._later * fading[:, self._lag]) / n
            out = out + back @ self._wave[self._columns]
        return np.asarray(out)


def _select_memory(force: PeriodForce, same: RealArray) -> tuple[IndexArray, RealArray]:
    """Return the reversals, (n_r,), and the derivatives by their deformations, (n, n_r).

    `same` are those by the deformation of each sample itself.
    """
    stiffness = sp.csr_array(force.stiffness)
    n = len(same)
    rows = np.repeat(np.arange(n), np.diff(stiffness.indptr))
    columns, values = stiffness.indices, stiffness.data
    later = (rows != columns) & (values != 0.0)
    reversals, place = np.unique(columns[later], return_inverse=True)
    out = np.zeros((n, len(reversals)))
    np.add.at(out, (rows[later], place), values[later])
    return reversals.astype(np.intp), out


def _toeplitz(values: RealArray, k: IntArray) -> ComplexArray:
    """Return the Fourier coefficient k - l of samples of a period, shape (n_k, n_k)."""
    coefficients = np.fft.fft(values) / len(values)
    return np.asarray(coefficients[(k[:, None] - k) % len(values)])
