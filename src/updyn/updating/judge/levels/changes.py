"""`ModeChange`: frequency and damping of a mode at several levels.

At the lowest level, H = sum of A_r / (lambda_r - omega^2), with lambda_r = omega_r^2 (1 + i eta_r).
A force on one deformation mainly changes lambda_r: with constant A_r, the changes at another level
minimise the weighted difference between its FRFs and those of the lowest level (equivalent
linearisation in modal coordinates; Worden & Tomlinson, Nonlinearity in Structural Dynamics, 2001,
section 2.5). The gain of each channel may differ, as calibrations do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.updating.judge.levels.settings import LEVEL_TEST

__all__ = ["FollowedModes", "ModeChange"]

#: Elements that change frequency and damping with the level, by their signs. A leaning peak is
#: wider than a linear one of the same damping.
_TYPICAL = {
    (1, -1): "a hardening spring or a gap, with friction",
    (1, 0): "a hardening spring or a gap",
    (1, 1): "a hardening spring or a gap",
    (0, -1): "friction that slips",
    (0, 1): "damping that rises with the velocity",
    (-1, -1): "friction that slips",
    (-1, 0): "a softening spring",
    (-1, 1): "a joint that begins to slip, or a softening spring",
}


@dataclass(frozen=True, slots=True, eq=False)
class ModeChange:
    """A mode at several levels.

    Parameters
    ----------
    levels : ndarray of float, shape (n_l,)
        Force amplitudes in N (N m), ascending.
    pole : ndarray of complex, shape (n_l,)
        f_r^2 (1 + i eta_r) of the equivalent linear mode in Hz^2.
    std : ndarray of complex, shape (n_l,)
        Standard deviations of the real and the imaginary part of the change from the first level,
        where they are 0.
    freedom : float
        Degrees of freedom of the noise from which they follow.
    significance : float
        Probability below which a change of one of the parts is significant.

    Examples
    --------
    >>> import numpy as np
    >>> from updyn.updating.judge.levels.changes import ModeChange
    >>> std = np.array([0.0, 0.01 + 0.01j])
    >>> mode = ModeChange(np.array([1.0, 9.0]), np.array([100 + 1j, 121 + 1j]), std, 30, 0.01)
    >>> mode.frequency
    array([10.00025   , 11.000413])
    >>> mode.typical
    'a hardening spring or a gap'
    """

    levels: RealArray
    pole: ComplexArray
    std: ComplexArray
    freedom: float
    significance: float

    @property
    def frequency(self) -> RealArray:
        """Natural frequency in Hz at each level."""
        return np.sqrt(self.pole.real)

    @property
    def loss_factor(self) -> RealArray:
        """Loss factor at each level."""
        return np.asarray(self.pole.imag / self.pole.real)

    @property
    def p_values(self) -> tuple[float, float]:
        """Probabilities of changes of stiffness and damping as large by noise."""
        change = self.pole[1:] - self.pole[0]
        std, freedom = self.std[1:], self.freedom
        return _p_value(change.real, std.real, freedom), _p_value(change.imag, std.imag, freedom)

    @property
    def trend(self) -> tuple[int, int]:
        """Signs of significant changes of stiffness and damping with the level, else 0.

        Elastic forces do not change the damping, which is the imaginary part of the pole.
        """
        change = self.pole - self.pole[0]
        signs = []
        for p, part in zip(self.p_values, (change.real, change.imag), strict=True):
            largest = part[np.argmax(np.abs(part))]
            signs.append(int(np.sign(largest)) if p < self.significance else 0)
        return signs[0], signs[1]

    @property
    def typical(self) -> str:
        """Element of which the trend is typical; empty without a change."""
        return _TYPICAL.get(self.trend, "")

    def describe(self) -> str:
        """Return the changes up to the highest level as text."""
        base, last = self.pole[0], self.pole[-1]
        frequency = 100.0 * (self.frequency[-1] / self.frequency[0] - 1.0)
        std_frequency = 50.0 * self.std[-1].real / last.real
        damping, std_damping = (
            100.0 * x / base.imag for x in (last.imag - base.imag, self.std[-1].imag)
        )
        return (
            f"mode at {self.frequency[0]:.5g} Hz: frequency {frequency:+.2g} +-"
            f" {std_frequency:.1g} %, damping {damping:+.2g} +- {std_damping:.1g} %, typical of"
            f" {self.typical or 'no element'}"
        )


def _p_value(change: RealArray, std: RealArray, freedom: float) -> float:
    """Return the probability of the largest of several changes by noise (Bonferroni)."""
    from scipy.special import stdtr  # slow to import and rarely needed

    ratio = np.max(np.abs(change) / np.maximum(std, np.finfo(float).tiny))
    return float(min(1.0, 2.0 * len(change) * stdtr(freedom, -ratio)))


@dataclass(frozen=True, slots=True, eq=False)
class FollowedModes:
    """Modes fitted to the lowest level, whose poles are followed to other levels.

    `pole` (m,) in Hz^2; `residues` (m, p) of receptances; `square` are squared lines in Hz^2,
    `rate` the factor (n_f,) from receptance to the data, `values`, `fit` and `variance` (n_f, p)
    the data, their fit, and their variance.
    """

    pole: ComplexArray
    residues: ComplexArray
    square: RealArray
    rate: ComplexArray
    values: ComplexArray
    fit: ComplexArray
    variance: RealArray

    @classmethod
    def of(cls, frf: FRF, variance: RealArray, modes: ModeSet) -> FollowedModes | None:
        """Return the modes with known damping, or None without any; all lines are above 0 Hz."""
        known = np.isfinite(modes.loss_factor) & (modes.loss_factor > 0.0)
        if not known.any():
            return None
        pole = modes.frequency[known] ** 2 * (1.0 + 1j * modes.loss_factor[known])
        n_f, square, rate = len(frf.freq), frf.freq**2, frf.s**frf.power
        values, variance = frf.values.reshape(n_f, -1), variance.reshape(n_f, -1)
        modal = rate[:, None] / (pole - square[:, None])
        # Modes outside the band act as a mass or a spring.
        columns = np.hstack([modal, rate[:, None], rate[:, None] / square[:, None]])
        size = np.linalg.norm(columns, axis=0)
        columns = columns / size
        solved = np.empty((columns.shape[1], values.shape[1]), dtype=np.complex128)
        for c, weight in enumerate(1.0 / np.sqrt(variance.T)):
            weighted = columns * weight[:, None]
            solved[:, c] = np.linalg.lstsq(weighted, values[:, c] * weight, rcond=None)[0]
        residues = solved[: len(pole)] / size[: len(pole), None]
        return cls(pole, residues, square, rate, values, columns @ solved, variance)

    def with_variance(self, variance: RealArray) -> FollowedModes:
        """Return the same modes with another variance of the data."""
        return replace(self, variance=variance.reshape(self.values.shape))

    def average(self, values: RealArray) -> RealArray:
        """Return the average of values, (n_f, ...), for each mode, weighted by information."""
        slope = np.abs(self.rate[:, None] / (self.pole - self.square[:, None]) ** 2) ** 2
        weight = np.einsum("fr,rp,fp->rfp", slope, np.abs(self.residues) ** 2, 1.0 / self.variance)
        total = np.einsum("rfp,fp->r", weight, values.reshape(self.variance.shape))
        return np.asarray(total / weight.sum(axis=(1, 2)))

    def follow(
        self, values: ComplexArray, variance: RealArray, start: ComplexArray
    ) -> tuple[ComplexArray, ComplexArray]:
        """Return the changes of the poles at a level, and standard deviations of their parts."""
        n_f = len(self.square)
        data = values.reshape(n_f, -1) - self.values
        weight = 1.0 / (self.variance + variance.reshape(n_f, -1))
        at, damping = self._scan(data, weight, start), 0.0
        cost = self._cost(data, weight, at)
        for _ in range(LEVEL_TEST.most_steps):
            normal, scores = self._equations(data, weight, at)
            loaded = normal + damping * np.diag(np.diag(normal))
            step = np.linalg.lstsq(loaded, scores.sum(axis=(0, 1)), rcond=None)[0]
            proposed = at + step[::2] + 1j * step[1::2]
            lower = self._cost(data, weight, proposed)
            if lower > cost:
                damping = max(10.0 * damping, 1e-3)
                continue
            decrease, at, cost, damping = cost - lower, proposed, lower, 0.1 * damping
            if decrease < LEVEL_TEST.settled_decrease:
                break
        std = _standard_deviations(*self._equations(data, weight, at))
        return at, np.asarray(std[::2] + 1j * std[1::2])

    def _predict(self, change: ComplexArray) -> ComplexArray:
        """Return the change of the FRFs for changes of the poles, shape (n_f, p)."""
        square = self.square[:, None]
        terms = 1.0 / (self.pole + change - square) - 1.0 / (self.pole - square)
        return np.asarray(self.rate[:, None] * (terms @ self.residues))

    def _cost(self, data: ComplexArray, weight: RealArray, change: ComplexArray) -> float:
        residual = self._remove_gain(data - self._predict(change), weight)
        return float(np.sum(weight * np.abs(residual) ** 2))

    def _remove_gain(self, values: ComplexArray, weight: RealArray) -> ComplexArray:
        """Return values (..., n_f, p) less the best multiple of the fit of each channel."""
        weighted = weight * self.fit.conj()
        size = np.maximum(np.sum(weighted * self.fit, axis=0).real, np.finfo(float).tiny)
        gain = np.sum(weighted * values, axis=-2, keepdims=True) / size
        return np.asarray(values - gain * self.fit)

    def _scan(self, data: ComplexArray, weight: RealArray, start: ComplexArray) -> ComplexArray:
        """Return the start or, if it is better, one with other frequencies, mode by mode."""
        best, least = start.copy(), self._cost(data, weight, start)
        for r in range(len(best)):
            for share in LEVEL_TEST.scanned_changes:
                proposed = best.copy()
                proposed[r] = share * self.pole[r].real
                cost = self._cost(data, weight, proposed)
                if cost < least:
                    best, least = proposed, cost
        return best

    def _equations(
        self, data: ComplexArray, weight: RealArray, change: ComplexArray
    ) -> tuple[RealArray, RealArray]:
        """Return the normal matrix (2 m, 2 m) and the score of each value (n_f, p, 2 m)."""
        residual = self._remove_gain(data - self._predict(change), weight)
        slope = -self.rate[:, None] / (self.pole + change - self.square[:, None]) ** 2
        J = self._remove_gain(slope.T[:, :, None] * self.residues[:, None], weight)  # (m, n_f, p)
        gram = np.einsum("rfp,fp,sfp->rs", J.conj(), weight, J)
        m = len(self.pole)
        normal = np.empty((m, 2, m, 2))
        normal[:, 0, :, 0] = normal[:, 1, :, 1] = gram.real
        normal[:, 0, :, 1], normal[:, 1, :, 0] = -gram.imag, gram.imag
        back = np.moveaxis(J.conj() * (weight * residual), 0, 2)
        scores = np.stack([back.real, back.imag], axis=3).reshape(*residual.shape, 2 * m)
        return normal.reshape(2 * m, 2 * m), scores


def _standard_deviations(normal: RealArray, scores: RealArray) -> RealArray:
    """Return standard deviations from the variance of the data, shape (2 m,).

    They are larger if the residuals of channels are correlated, as with noise of the force
    (clustered variance; Liang & Zeger, Biometrika 73 (1986) 13).
    """
    solved = np.linalg.lstsq(normal, np.eye(len(normal)), rcond=None)[0]
    size = np.sqrt(np.diag(normal))
    together = np.sum((scores.sum(axis=1) / size) ** 2)
    ratio = together / max(float(np.sum((scores / size) ** 2)), np.finfo(float).tiny)
    return np.asarray(np.sqrt(0.5 * max(1.0, ratio) * np.diag(solved)))
