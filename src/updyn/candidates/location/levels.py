"""`LevelData`: the FRFs of all levels and their weights, as data of one linear model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.candidates.location.motion import Motion, RandomMotion, SineMotion
from updyn.candidates.location.settings import LOCATION
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.judge.levels.detect import check_levels, detect_nonlinearity
from updyn.updating.judge.levels.homogeneity import scatter_variance, stated_variance
from updyn.updating.problem.noise import NoiseChoice
from updyn.updating.problem.noise.known import smooth_variance
from updyn.updating.problem.parameters import ParameterSet, collect_unknowns
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.random_forward import find_spread
from updyn.updating.problem.residuals import OutputError

__all__ = ["LevelData"]


@dataclass(frozen=True, slots=True, eq=False)
class LevelData:
    """FRFs of the same channels at n_l levels, ascending, with the linear model of their channels.

    `part` has the model without elements, its unknowns, and the first of the `tests`; `errors` are
    the weights of each, as for a fit. `receptances`, `weights` (n_l, n_f, n_i, n_j) and `levels`
    (n_l, n_f) are the data in m/N, the square roots of 2 / E|dH|^2 in N/m, and the amplitudes of
    the force in N, or the RMS of a random one.
    `depends_on_level` is the result of `detect_nonlinearity`. `scatter` is the variance E|dH|^2 of
    each test by the scatter of neighbouring lines, a bound of its noise; None if that is stated.
    """

    part: FRFPart
    tests: Sequence[FRF]
    errors: Sequence[OutputError]
    receptances: ComplexArray
    weights: RealArray
    levels: RealArray
    depends_on_level: bool
    scatter: Sequence[RealArray | None]

    @classmethod
    def of(
        cls, model: Model, tests: Sequence[FRF], unknowns: ParameterSet, noise: NoiseChoice
    ) -> LevelData:
        """Return the data of at least two levels; raise DataError if they do not fit together."""
        ordered = [_without_zero(test) for test in check_levels(tests)]
        if len(ordered) < 2:
            raise DataError("a nonlinearity is located by FRFs at two levels or more, found one")
        linear = collect_unknowns(p for p in unknowns if not p.of_element)
        part = FRFPart.build(replace(model, nonlinear={}), ordered[0], linear)
        receptances = np.array([test.values * part.sign / _rate(part) for test in ordered])
        levels = np.array([test.level for test in ordered])
        stated = [stated_variance(test, noise) for test in ordered]
        scatter = [
            scatter_variance(test) if variance is None else None
            for test, variance in zip(ordered, stated, strict=True)
        ]
        known = [
            one for pair in zip(stated, scatter, strict=True) for one in pair if one is not None
        ]
        errors = [_make_error(variance) for variance in known]
        depends = detect_nonlinearity(ordered, noise=noise).is_nonlinear
        weights = _weigh(part, errors)
        return cls(part, ordered, errors, receptances, weights, levels, depends, scatter)

    @property
    def is_noise_stated(self) -> bool:
        """Whether the noise of all tests is stated."""
        return all(variance is None for variance in self.scatter)

    def estimate_noise(self, squares: RealArray) -> LevelData:
        """Return the data with noise by squared residuals of a fit, (n_l, n_f, n_i, n_j) in m2/N2.

        Between lines that are wider apart than peaks, the scatter is that of the response; it
        remains an upper bound. The lower one is the error of computed periodic responses.
        """
        errors = []
        about = zip(self.tests, self.errors, self.scatter, squares, strict=True)
        for test, error, scatter, one in about:
            if scatter is None:
                errors.append(error)
                continue
            size = np.abs(test.values)
            law = smooth_variance(one * np.abs(_rate(self.part)) ** 2, size, 1)
            least = (LOCATION.least_noise * np.hypot(size, np.sqrt(np.mean(size**2)))) ** 2
            errors.append(_make_error(np.maximum(np.minimum(scatter, law.at(size)), least)))
        return replace(self, errors=errors, weights=_weigh(self.part, errors))

    def detect_dependence(self) -> LevelData:
        """Return the data with the dependence on the level that their noise permits to detect."""
        tests = [
            replace(test, variance=2.0 / error.weight**2, coherence=None)
            for test, error in zip(self.tests, self.errors, strict=True)
        ]
        return replace(self, depends_on_level=detect_nonlinearity(tests).is_nonlinear)

    @property
    def omega(self) -> RealArray:
        """Circular frequencies of the lines in rad/s."""
        return 2.0 * np.pi * self.part.frf.freq

    @property
    def n_forces(self) -> int:
        """Number of real numbers of the forces of an element: one complex each line and level."""
        return int(2 * self.levels.size * self.receptances.shape[3])

    @property
    def n_spare(self) -> int:
        """Number of real data less those of the forces of an element and the linear unknowns."""
        n_unknowns = len(self.part.coordinates.parameters)
        return max(self.n_numbers - self.n_forces - n_unknowns, 1)

    def motion(self, amplitude: RealArray) -> Motion:
        """Return the motion of a deformation with amplitudes (n_l, n_f, n_j) in m."""
        if not self.part.frf.is_random:
            return SineMotion(amplitude, self.omega)
        pairs = zip(self.tests, amplitude, strict=True)
        spread = np.stack([find_spread(test, one) for test, one in pairs], axis=1)
        return RandomMotion(np.maximum(spread, np.finfo(np.float64).tiny ** 0.25), self.omega)

    def softened(self) -> LevelData:
        """Return the data with errors relative to |H| added, which widen minima."""
        error = LOCATION.soft_error * np.abs(self.receptances)
        safe = np.where(self.weights > 0.0, self.weights, 1.0)
        weights = np.where(self.weights > 0.0, 1.0 / np.hypot(1.0 / safe, error), 0.0)
        return replace(self, weights=weights)

    def soften(self, share: float) -> list[OutputError]:
        """Return the weights of the tests with errors relative to |H| added."""
        return [
            OutputError(1.0 / np.hypot(1.0 / error.weight, share * np.abs(test.values)))
            for error, test in zip(self.errors, self.tests, strict=True)
        ]

    def reduce_weights(self, costs: RealArray) -> list[OutputError]:
        """Return the weights of the tests, reduced at lines with large residuals.

        `costs` (n_l, n_f) are half the weighted sums of squares. Weights are those of Cauchy
        (Holland & Welsch, Commun. Stat. Theory Methods 6 (1977) 813).
        """
        mean_squares = costs / self.tests[0].values[0].size
        return [
            OutputError(error.weight / np.sqrt(1.0 + one)[:, None, None])
            for error, one in zip(self.errors, mean_squares, strict=True)
        ]

    @property
    def n_numbers(self) -> int:
        """Number of real data."""
        return 2 * self.receptances.size


def _without_zero(test: FRF) -> FRF:
    """Return a test without a line at 0 Hz, where no level is stated."""
    return test if test.freq[0] > 0.0 else test.select(lines=test.freq[1:])


def _make_error(variance: RealArray) -> OutputError:
    """Return the weights of a test with the variance E|dH|^2."""
    return OutputError(np.sqrt(2.0 / np.maximum(variance, np.finfo(np.float64).tiny)))


def _weigh(part: FRFPart, errors: Sequence[OutputError]) -> RealArray:
    """Return the weights of the receptances of all tests, (n_l, n_f, n_i, n_j) in N/m."""
    weights = np.array([error.weight for error in errors])
    return np.asarray(weights * np.abs(_rate(part)) * np.abs(part.sign))


def _rate(part: FRFPart) -> ComplexArray:
    """Return the factor from receptance to the quantity of the data, (n_f, 1, 1)."""
    return np.asarray((part.frf.s**part.frf.power)[:, None, None])
