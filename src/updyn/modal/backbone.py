"""Fit of one mode with an amplitude-dependent pole to a leaning peak.

In first-order harmonic balance, p(a) = p + c a with the square a of the motion of the mode (A. H.
Nayfeh & D. T. Mook, Nonlinear Oscillations, 1979, section 4.1); a is the solution of a cubic
equation at each line, for a force of equal amplitude at all lines and references. Residues and
polynomial follow by linear least squares, as in `refine`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, NumberArray, RealArray
from updyn.modal.refine import Errors, LineWindow, Weights, WindowFit, fit_residues
from updyn.modal.settings import CHANNEL_FIT, POLE_REFINEMENT

__all__ = ["Backbone", "Level", "fit_backbone", "motion", "predict_gain"]


def motion(x: ComplexArray, pole: complex, shift: complex, width: float) -> RealArray:
    """Return the square of the motion of a mode relative to that of the linear peak, shape (n,).

    `width` is the distance of the half-power points from the pole.
    """
    # With X = (x - pole) / width and C = shift / width, a |X - C a|^2 = 1. The smallest
    # solution is returned; there are up to three above 1.54 widths.
    X, C = (x - pole) / width, shift / width
    square, crossed = np.abs(X) ** 2, 2.0 * (X.conj() * C).real
    # 1 / a = square / 3 + t is the largest root of b^3 - square b^2 + crossed b - |C|^2 (Cardano).
    third = crossed / 3.0 - square**2 / 9.0
    half = 0.5 * (square * (crossed / 3.0 - 2.0 * square**2 / 27.0) - abs(C) ** 2)
    root = np.sqrt(np.maximum(half**2 + third**3, 0.0))
    single = -np.copysign(np.cbrt(np.abs(half) + root), half)
    size = np.sqrt(np.maximum(-third, 0.0))
    cosine = np.clip(-half / np.maximum(size**3, CHANNEL_FIT.smallest_divisor), -1.0, 1.0)
    several = 2.0 * size * np.cos(np.arccos(cosine) / 3.0)
    one = half**2 + third**3 >= 0.0
    t = np.where(one, single - third / np.where(single == 0.0, 1.0, single), several)
    return np.asarray(1.0 / np.maximum(square / 3.0 + t, CHANNEL_FIT.smallest_divisor))


@dataclass(frozen=True, slots=True, eq=False)
class _LeaningWindow(LineWindow):
    """A window whose free pole depends on the motion of its mode, by `shift` at unit motion."""

    shift: complex = 0.0

    def fractions(self, poles: ComplexArray) -> ComplexArray:
        """Return the functions of the pole, shape (n_f, 1 or 2)."""
        (pole,) = poles.tolist()
        width = float(self.width(poles)[0])
        moved_pole = pole + self.shift * motion(self.x, pole, self.shift, width)
        # The residue of an accelerance is proportional to the pole, or to its square if it has a
        # mirror image (`Axis.modal`).
        direct_term = (moved_pole / pole) ** (2 if self.basis.mirrored else 1) / (
            self.x - moved_pole
        )
        if not self.basis.mirrored:
            return np.asarray(direct_term[:, None])
        image = (moved_pole / pole).conj() ** 2 / (self.x - moved_pole.conj())
        return np.stack([direct_term + image, 1j * (direct_term - image)], axis=1)

    def slopes(self, pole: complex) -> NumberArray:
        """Return derivatives by parts of pole and shift in units of the width, (rows, m, 4)."""
        width, mirrored = float(self.width(np.array([pole]))[0]), self.basis.mirrored
        a = motion(self.x, pole, self.shift, width)[:, None]
        moved_pole, x = pole + self.shift * a, self.x[:, None]
        by_pole, by_shift = np.array([1.0, 1.0j, 0.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0j])
        # derivative of a |x - there|^2 = width^2
        distance, direct = x - moved_pole, by_pole + a * by_shift
        wider = width * (-by_pole.real if mirrored else by_pole.imag)
        stiff = np.abs(distance) ** 2 - 2.0 * a * (distance.conj() * self.shift).real
        rise = (
            2.0 * (wider + a * (distance.conj() * direct).real) / np.where(stiff == 0.0, 1.0, stiff)
        )
        change = direct + self.shift * rise
        turned = change / moved_pole - by_pole / pole
        direct_term = moved_pole / pole * (turned + change / distance) / distance
        if not mirrored:
            return np.asarray(width * direct_term[:, None])
        direct_term = (moved_pole / pole) ** 2 * (2.0 * turned + change / distance) / distance
        back = x - moved_pole.conj()
        image = (
            (moved_pole / pole).conj() ** 2 * (2.0 * turned.conj() + change.conj() / back) / back
        )
        pair = (direct_term + image, 1j * (direct_term - image))
        return np.stack([self.basis.parts(width * one) for one in pair], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The squared motion of a mode in the runs of a measurement.

    `runs`, shape (p,), is the run of each channel; `of_runs`, shape (J,), the squared motion of
    each run relative to the largest.
    """

    runs: IndexArray
    of_runs: RealArray

    @classmethod
    def of(cls, residues: ComplexArray, runs: IndexArray) -> Level:
        """Return the level for forces of equal amplitude, from residues of all channels."""
        squares = np.bincount(runs, np.abs(residues) ** 2)
        return cls(runs, squares / max(float(squares.max()), CHANNEL_FIT.smallest_divisor))

    def join(self, by_run: list[NumberArray]) -> NumberArray:
        """Return the values of all channels, shape (p, ...), from those of each run."""
        out = np.zeros((len(self.runs), *by_run[0].shape[1:]), dtype=by_run[0].dtype)
        for run, values in enumerate(by_run):
            out[self.runs == run] = values
        return out


@dataclass(frozen=True, slots=True, eq=False)
class Backbone:
    """A fit of one mode with an amplitude-dependent pole.

    `pole` is that at small motion, `shift` its change at the largest motion; `fits` are those of
    the channels of each run. By the real and imaginary parts of pole and shift, in units of the
    width: `normal`, shape (4, 4), is the Gauss-Newton matrix of the cost, `gradients`, shape (p,
    4), its gradient by channel, and `follow`, shape (p, 4), the derivatives of the residues.
    """

    pole: complex
    shift: complex
    level: Level
    fits: list[WindowFit]
    normal: RealArray
    gradients: RealArray
    follow: ComplexArray

    @property
    def cost(self) -> float:
        """Sum of squared residuals in units of their standard deviations."""
        return sum(fit.cost for fit in self.fits)

    @property
    def residues(self) -> ComplexArray:
        """Residue of each channel, shape (p,)."""
        return self.level.join([fit.residues[0] for fit in self.fits])

    def agreement(self, width: float) -> float:
        """Return the squared shift relative to its variance between channels."""
        # By chance it has Hotelling's T^2 distribution with p - 1 degrees of freedom, also if the
        # residuals are not noise (H. White, Econometrica 50 (1982) 1-25).
        follow = np.linalg.lstsq(self.normal, self.gradients.T, rcond=None)[0][2:]
        shift = np.array([self.shift.real, self.shift.imag]) / width
        return float(shift @ np.linalg.lstsq(follow @ follow.T, shift, rcond=None)[0])

    def motion(self, window: LineWindow) -> RealArray:
        """Return the squared motion of the largest run at the lines of a window."""
        width = float(window.width(np.array([self.pole]))[0])
        return motion(window.x, self.pole, self.shift, width)

    def spread(self, window: LineWindow, weights: Weights) -> Errors:
        """Return the errors of the pole and of its residues."""
        pole = np.array([self.pole])
        values, vectors = np.linalg.eigh(self.normal)
        kept = values > len(values) * np.finfo(float).eps * values.max(initial=0.0)
        root = vectors[:, kept] / np.sqrt(2.0 * values[kept])
        of_residue, of_pole = window.inflation_with_poles(pole, weights)
        moving = np.sqrt(of_pole[0])
        noise = []
        for fit in self.fits:
            variance = np.trace(fit.columns.covariance(fit.pole_columns[0]), axis1=1, axis2=2).real
            variance = variance * (0.5 if window.basis.mirrored else 1.0) * fit.level[:, 0] ** 2
            noise.append(np.broadcast_to(variance, len(fit.error)))
        of_noise = self.level.join(noise) * of_residue[0]
        std = float(window.width(pole)[0]) * moving * np.linalg.norm(root[:2], axis=1)
        return Errors(of_noise, moving * (self.follow @ root).T, std)

    def response(self, window: LineWindow) -> ComplexArray:
        """Return the contribution of the mode to the channels of a window, shape (p, n)."""
        parts = []
        for run, level in enumerate(self.level.of_runs.tolist()):
            in_run = self.level.runs == run
            fractions = _select_channels(window, in_run, level * self.shift).fractions(
                np.array([self.pole])
            )
            weights = self.residues[in_run, None]
            if window.basis.mirrored:
                weights = np.hstack([weights.real, weights.imag])
            parts.append(weights @ fractions.T)
        return np.asarray(self.level.join(parts))


def fit_backbone(
    window: LineWindow, pole: complex, weights: Weights, level: Level, shift: complex = 0.0
) -> Backbone:
    """Fit a window by one mode with an amplitude-dependent pole, from initial pole and shift."""
    current, damping = _fit_at(window, pole, shift, weights, level), 0.0
    for _ in range(POLE_REFINEMENT.most_steps):
        step, expected_decrease = _compute_step(current, damping)
        if expected_decrease < POLE_REFINEMENT.settled_decrease * min(1.0, current.cost):
            break
        width = float(window.width(np.array([current.pole]))[0])
        step *= width / max(1.0, float(np.max(np.abs(step))))
        proposed = _fit_at(window, current.pole + step[0], current.shift + step[1], weights, level)
        if proposed.cost <= current.cost:
            current, damping = proposed, 0.1 * damping
        else:
            damping = max(10.0 * damping, 1e-3)
    return current


def predict_gain(window: LineWindow, linear: WindowFit, at: int, level: Level) -> float:
    """Return the expected decrease of the cost by a first step from a linear fit, for pole `at`."""
    every = np.ones(len(level.runs), dtype=np.bool_)
    equations = _Equations.of(
        _select_channels(window, every, 0.0), linear, at, level.of_runs[level.runs]
    )
    gradient = np.sum(equations.gradients, axis=0)
    return float(gradient @ np.linalg.lstsq(equations.normal, gradient, rcond=None)[0])


def _compute_step(current: Backbone, damping: float) -> tuple[ComplexArray, float]:
    """Return a step of pole and shift in units of the width, and its expected decrease."""
    loaded = current.normal + damping * np.diag(np.diag(current.normal))
    gradient = np.sum(current.gradients, axis=0)
    step = np.linalg.lstsq(loaded, gradient, rcond=None)[0]
    return np.asarray(step[::2] + 1j * step[1::2]), float(gradient @ step)


def _select_channels(window: LineWindow, chosen: BoolArray, shift: complex) -> _LeaningWindow:
    subtracted = window.subtracted if len(window.subtracted) == 1 else window.subtracted[chosen]
    parts = (
        window.basis,
        window.x,
        window.Y[chosen],
        window.fixed_poles,
        subtracted,
        window.envelope,
    )
    return _LeaningWindow(*parts, shift)


def _fit_at(
    window: LineWindow, pole: complex, shift: complex, weights: Weights, level: Level
) -> Backbone:
    """Return the fit for a pole and its shift, with its Gauss-Newton equations."""
    normal = np.zeros((4, 4))
    fits, gradients, follow = [], [], []
    for run, share in enumerate(level.of_runs.tolist()):
        in_run = level.runs == run
        leaning = _select_channels(window, in_run, share * shift)
        found = fit_residues(leaning, np.array([pole]), weights.of_channels(in_run))
        equations = _Equations.of(leaning, found, 0, np.full(np.count_nonzero(in_run), share))
        normal += equations.normal
        gradients.append(equations.gradients)
        follow.append(equations.follow)
        fits.append(found)
    ends = complex(pole), complex(shift)
    return Backbone(*ends, level, fits, normal, level.join(gradients), level.join(follow))


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Gauss-Newton equations of one run, by real and imaginary parts of pole and shift.

    Shapes as in `Backbone`: `normal` (4, 4), `gradients` and `follow` (p, 4).
    """

    normal: RealArray
    gradients: RealArray
    follow: ComplexArray

    @classmethod
    def of(cls, window: _LeaningWindow, found: WindowFit, at: int, share: RealArray) -> _Equations:
        """Return the equations at the fit of a run, in the approximation of Kaufman (`refine`).

        `at` is the pole that depends on the motion; `share`, shape (p,), its shift by channel.
        """
        slopes = window.slopes(complex(found.poles[at]))
        m, flat = slopes.shape[1], slopes.reshape(len(slopes), -1)
        residues, error = found.residues[at] / found.level[:, 0], found.error / found.level
        mix: NumberArray = residues[:, None]
        if window.basis.mirrored:
            mix = np.stack([residues.real, residues.imag], axis=1)
            error = np.hstack([error.real, error.imag])
        one = np.ones_like(share)
        mix = mix[:, :, None] * np.stack([one, one, share, share], axis=1)[:, None]  # (p, m, 4)
        back = found.columns.divide_by_variance(error) @ flat.conj()
        products, along = found.columns.project_out(flat)
        products = products.reshape(-1, m, 4, m, 4)
        along = along[:, found.pole_columns[at]].reshape(len(along), m, m, 4)
        products, along = (np.broadcast_to(a, (len(mix), *a.shape[1:])) for a in (products, along))
        normal = np.einsum("pmt,pmtnu,pnu->tu", mix.conj(), products, mix).real
        gradients = np.sum(mix.conj() * back.reshape(-1, m, 4), axis=1).real
        change = -np.einsum("pkmt,pmt->pkt", along, mix)
        of_residue = change[:, 0] + 1j * change[:, 1] if m == 2 else change[:, 0]
        return cls(normal, gradients, of_residue * found.level)
