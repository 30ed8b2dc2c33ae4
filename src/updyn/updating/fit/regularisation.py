"""Regularisation of a fit by Tikhonov's method or by truncated singular values.

The strength is chosen from the problem linearised at the end of a fit, and the fit is repeated
until it settles (Haber & Oldenburg, Comput. Geosci. 4 (2000) 41).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.group import is_number
from updyn.text_table import format_count
from updyn.updating.fit.method import Fit, Method, Regularisation, Starts, divide_by_std
from updyn.updating.fit.methods import METHODS, methods_with
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.settings import NULL_SPACE, REGULARISATION
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.noise.known import WrappedNoise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.session import Stopped

__all__ = [
    "CHOICES",
    "Regularised",
    "SingularSpectrum",
    "add_regularisation",
    "check_regularise",
    "corner",
    "discrepancy",
    "keeps_to_directions",
    "minimum",
]


@dataclass(frozen=True, slots=True, eq=False)
class SingularSpectrum:
    """Linear problem min |A z - b|^2, A = U diag(s) V^T, in standard deviations of the residual.

    `s`, shape (k,), descends; `beta` is U^T b, and `V` has the shape (n, k). `rest` is the squared
    norm of the residual that no z can reduce, `n_values` the number of residuals, and `fixed` the
    number of further unknowns, which are not regularised.
    """

    s: RealArray
    beta: RealArray
    V: RealArray
    rest: float
    n_values: float
    fixed: int = 0

    @classmethod
    def of(
        cls,
        A: RealArray,
        b: RealArray,
        rest: float = 0.0,
        n_values: float = 0.0,
        fixed: int = 0,
    ) -> SingularSpectrum:
        """Return the spectrum for A, shape (m, n), and b; `n_values` is m by default."""
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
        beta = U.T @ b
        beyond = (
            b - U @ beta
        )  # not |b|^2 - |beta|^2, which is rounding if A can represent nearly all of b
        return cls(s, beta, Vt.T, rest + float(beyond @ beyond), n_values or float(len(b)), fixed)

    def tikhonov_filter(self, strength: float) -> RealArray:
        """Return the filter factors of Tikhonov's method, s^2 / (s^2 + strength^2)."""
        return np.asarray(self.s**2 / np.maximum(self.s**2 + strength**2, np.finfo(float).tiny))

    def truncation_filter(self, number: int) -> RealArray:
        """Return the filter factors of a truncation: 1 for the first `number`, else 0."""
        return np.where(np.arange(len(self.s)) < number, 1.0, 0.0)

    def solution(self, filters: RealArray) -> RealArray:
        """Return z for given filter factors, shape (n,)."""
        return np.asarray(self.V @ self._components(filters))

    def distance(self, filters: RealArray) -> float:
        """Return |z| for given filter factors."""
        return float(np.linalg.norm(self._components(filters)))

    def misfit(self, filters: RealArray) -> float:
        """Return |A z - b| for given filter factors, including the irreducible part."""
        return float(np.sqrt(np.sum(((1.0 - filters) * self.beta) ** 2) + self.rest))

    def freedom(self, filters: RealArray) -> float:
        """Return the effective number of unknowns, the trace of the influence matrix."""
        return float(filters.sum()) + self.fixed

    def gcv(self, filters: RealArray) -> float:
        """Return the generalised cross-validation function."""
        # Golub, Heath & Wahba, Technometrics 21 (1979) 215.
        return (
            self.n_values
            * self.misfit(filters) ** 2
            / max(self.n_values - self.freedom(filters), 1e-6) ** 2
        )

    def curvature(self, strength: float) -> float:
        """Return the curvature of the L-curve, log |z| over log |A z - b|, positive at its corner.

        Hansen & O'Leary, SIAM J. Sci. Comput. 14 (1993) 1487; here from the derivatives of the
        filter factors with respect to t = log(strength): df/dt = -2 f (1 - f).
        """
        f = self.tikhonov_filter(strength)
        g, squared = 1.0 - f, self.beta**2
        along = squared / np.maximum(self.s, np.finfo(float).tiny ** 0.25) ** 2
        P, D = float(np.sum(g**2 * squared)) + self.rest, float(np.sum(f**2 * along))
        if P <= 0.0 or D <= 0.0:
            return 0.0
        dP, dD = 4.0 * float(np.sum(f * g**2 * squared)), -4.0 * float(np.sum(f**2 * g * along))
        ddP = 8.0 * float(np.sum(f * g**2 * (2.0 * f - g) * squared))
        ddD = 8.0 * float(np.sum(f**2 * g * (2.0 * g - f) * along))
        x, y = dP / (2.0 * P), dD / (2.0 * D)
        xx, yy = ddP / (2.0 * P) - 2.0 * x**2, ddD / (2.0 * D) - 2.0 * y**2
        speed = (x**2 + y**2) ** 1.5
        if speed <= 0.0:
            return 0.0
        return float((x * yy - xx * y) / speed)

    def _components(self, filters: RealArray) -> RealArray:
        positive = self.s > 0.0
        return np.asarray(
            np.where(positive, filters * self.beta / np.where(positive, self.s, 1.0), 0.0)
        )


def minimum(spectrum: SingularSpectrum, low: float, high: float) -> float:
    """Return the strength in [low, high] of least generalised cross-validation."""
    return _best(lambda strength: spectrum.gcv(spectrum.tikhonov_filter(strength)), low, high)


def corner(spectrum: SingularSpectrum, low: float, high: float) -> float:
    """Return the strength in [low, high] at the corner of the L-curve, its largest curvature."""
    return _best(lambda strength: -spectrum.curvature(strength), low, high)


def discrepancy(spectrum: SingularSpectrum, low: float, high: float) -> float:
    """Return the largest strength in [low, high] whose misfit known noise explains."""
    # Compensated discrepancy principle (Hansen, Discrete Inverse Problems, SIAM 2010, section
    # 5.2), with one standard deviation more, for the components of the residual that the unknowns
    # can change only: the others would add their scatter, sqrt(2 n_values).
    from scipy.optimize import brentq

    def excess(log: float) -> float:
        given_up = 1.0 - spectrum.tikhonov_filter(float(np.exp(log)))
        expected, scatter = np.sum(given_up), np.sqrt(2.0 * np.sum(given_up**2))
        return float(np.sum((given_up * spectrum.beta) ** 2) - expected - scatter)

    logs = np.linspace(np.log(low), np.log(high), REGULARISATION.grid_points)
    within = np.flatnonzero([excess(t) <= 0.0 for t in logs])
    if not within.size:
        return low
    last = int(within[-1])
    if last == REGULARISATION.grid_points - 1:
        return high
    return float(np.exp(brentq(excess, logs[last], logs[last + 1], xtol=1e-10)))


def _best(cost: Callable[[float], float], low: float, high: float) -> float:
    """Return the strength of least cost: the best of a grid, refined between its neighbours."""
    from scipy.optimize import minimize_scalar

    logs = np.linspace(np.log(low), np.log(high), REGULARISATION.grid_points)
    at = int(np.argmin([cost(float(np.exp(t))) for t in logs]))
    bounds = logs[max(at - 1, 0)], logs[min(at + 1, REGULARISATION.grid_points - 1)]
    found = minimize_scalar(
        lambda t: cost(float(np.exp(t))), bounds=bounds, method="bounded", options={"xatol": 1e-8}
    )
    best = logs[at]
    if found.fun <= cost(float(np.exp(best))):
        best = found.x
    return float(np.exp(best))


#: Criteria for the strength of Tikhonov's method.
_STRENGTHS: dict[str, Callable[[SingularSpectrum, float, float], float]] = {
    "gcv": minimum,
    "l-curve": corner,
    "discrepancy": discrepancy,
}
CHOICES = (*_STRENGTHS, "tsvd")


def check_regularise(
    regularise: str | float | None, method: str, *, reducing: bool = False
) -> None:
    """Raise OptionError if the option `regularise` of `updyn.update` is not valid for a method."""
    if regularise is None:
        return
    if isinstance(regularise, str):
        if regularise not in CHOICES and re.fullmatch(r"tsvd:[1-9]\d*", regularise) is None:
            raise OptionError(
                f"regularise {regularise!r}: {suggest(regularise, CHOICES)}; or 'tsvd:N' with a"
                " whole number N, or a strength above 0",
                key=("regularise",),
            )
    elif not is_number(regularise) or not 0.0 < regularise < np.inf:
        raise OptionError(
            f"regularise = {regularise!r}: expected a strength above 0, or one of"
            f" {', '.join(CHOICES)}",
            key=("regularise",),
        )
    if reducing and keeps_to_directions(regularise):
        raise OptionError(
            f"regularise {regularise!r} fixes directions at the start, and a reduced model is"
            " accurate only near the point of its basis; use tier 'sparse', or 'gcv'",
            key=("regularise",),
        )
    if not METHODS.find(method).can_regularise:
        able = ", ".join(methods_with("can_regularise"))
        raise OptionError(
            f"regularise: method {method!r} cannot be regularised; use one of {able}",
            key=("regularise",),
        )


def keeps_to_directions(regularise: str | float | None) -> bool:
    """Return whether an option restricts a fit to directions found at its start."""
    return isinstance(regularise, str) and regularise.startswith("tsvd")


def add_regularisation(strategy: Method, method: str, regularise: str | float | None) -> Method:
    """Return the method with regularisation; unchanged if `regularise` is None."""
    check_regularise(regularise, method)
    if regularise is None:
        return strategy
    return Regularised(strategy, regularise, strategy.max_iterations, strategy.tolerance)


@dataclass(frozen=True, slots=True)
class Regularised(Method):
    """Method with regularisation: `how` is one of `CHOICES`, ``"tsvd:N"``, or a strength."""

    method: Method
    how: str | float
    max_iterations: int
    tolerance: float

    def search(self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor) -> Starts:
        """Return the starting points of the wrapped method."""
        self._check(problem)
        return self.method.search(problem, noises, monitor)

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x and choose the strength of the regularisation."""
        free, number = self._check(problem)
        once = replace(self.method, max_iterations=self.max_iterations)  # type: ignore[type-var]
        run = _RegularisedFits(problem, once, monitor, free)
        if keeps_to_directions(self.how):
            return run.fit_truncated(noises, x, number)
        if isinstance(self.how, str):
            return run.fit_chosen_strength(noises, x, self.how)
        return run.fit_given_strength(noises, x, float(self.how))

    def _check(self, problem: Problem) -> tuple[BoolArray, int | None]:
        """Return which unknowns have no prior, and the requested number of directions or None."""
        free = problem.coordinates.prior[1] == 0.0
        if not free.any():
            raise OptionError(
                "regularise: every unknown has a prior already",
                key=("regularise",),
            )
        number = None
        if isinstance(self.how, str) and ":" in self.how:
            number = int(self.how.partition(":")[2])
            if number > free.sum():
                raise OptionError(
                    f"regularise {self.how!r}: expected at most"
                    f" {format_count(int(free.sum()), 'direction')}, one for each unknown without a"
                    " prior",
                    key=("regularise",),
                )
        return free, number


@dataclass(frozen=True, slots=True)
class _RegularisedFits:
    """Regularised fits of one problem.

    `free`, shape (n,), are the unknowns without a prior. `unit` is the unit of the residual, known
    after the first fit; all strengths refer to it.
    """

    problem: Problem
    method: Method
    monitor: Monitor
    free: BoolArray
    unit: float | None = None

    # -- Tikhonov ----------------------------------------------------------------------------------
    def fit_given_strength(
        self, noises: Sequence[NoiseModel], x: RealArray, strength: float
    ) -> Fit:
        """Fit with a given strength, relative to the noise of an almost unregularised fit."""
        first = self._fit_with_prior(noises, x, min(strength, REGULARISATION.weakest))
        if _has_failed(first):
            return first
        run = self._set_unit(first)
        fit = run._fit_with_prior(run._fix_noise(noises, first), first.x, strength)
        if _has_failed(fit):
            return fit
        return run._tikhonov(fit, strength / _inflation(fit), "stated", [strength])

    def fit_chosen_strength(self, noises: Sequence[NoiseModel], x: RealArray, how: str) -> Fit:
        """Fit with the strength that a criterion chooses at the end of the fit."""
        strength, tried, settled = REGULARISATION.weakest, list[float](), False
        fit = self._fit_with_prior(noises, x, strength)
        noises, run = self._fix_noise(noises, fit), self._set_unit(fit)
        for _ in range(REGULARISATION.most_strengths):
            if _has_failed(fit):
                break
            tried.append(strength / _inflation(fit))
            spectrum = run._spectrum(fit)
            low, high = _strength_range(spectrum)
            wanted = _STRENGTHS[how](spectrum, low, high) * _inflation(fit)
            settled = abs(np.log(wanted / strength)) < REGULARISATION.settled_log
            if settled:
                break
            strength = wanted
            fit = run._fit_with_prior(noises, fit.x, strength)
        if _has_failed(fit):
            return fit
        return run._tikhonov(fit, strength / _inflation(fit), how, tried, settled)

    def _fit_with_prior(self, noises: Sequence[NoiseModel], x: RealArray, strength: float) -> Fit:
        """Fit with a prior of standard deviation 1 / strength on each unknown without one."""
        coordinates = self.problem.coordinates
        # The prior of a value is in the unit of the value, which may differ from that of x.
        start = coordinates.start
        units = np.where(coordinates.parameters.is_log, 1.0, coordinates.slope(start))
        items = []
        for p, unit in zip(coordinates.parameters, units, strict=True):
            items.append(replace(p, prior_std=p.prior_std or float(unit) / strength))
        problem = self._replace_coordinates(
            replace(coordinates, parameters=ParameterSet(tuple(items)), unit=self.unit)
        )
        return self.method.fit(problem, noises, self.monitor, x)

    def _tikhonov(
        self, fit: Fit, strength: float, how: str, tried: list[float], settled: bool = True
    ) -> Fit:
        spectrum = self._spectrum(fit)
        low, high = _strength_range(spectrum)
        low, high = min(low, strength), max(high, strength)
        curve = np.geomspace(low, high, REGULARISATION.curve_points).tolist()
        filters = list(map(spectrum.tikhonov_filter, curve))
        record: dict[str, Any] = {
            "how": how,
            "strength": strength,
            "prior_std": 1.0 / strength,
            "effective unknowns": spectrum.freedom(spectrum.tikhonov_filter(strength)),
            "tried": tried,
            **_trace_curve(
                spectrum, filters, "strengths", curve, spectrum.tikhonov_filter(strength)
            ),
        }
        if how == "l-curve":
            record["curvature"] = list(map(spectrum.curvature, curve))
        note = self._describe(how, strength, spectrum, settled)
        weight = np.where(self.free, strength, 0.0)
        return replace(fit, regularisation=Regularisation(weight, None, note, record))

    def _describe(
        self, how: str, strength: float, spectrum: SingularSpectrum, settled: bool
    ) -> str:
        if how != "stated" and strength <= 1.01 * REGULARISATION.weakest:
            return f"Regularisation ({how}) is not necessary: the data determine the unknowns."
        text = (
            f"Regularised ({how}): values are pulled to their start as by priors of standard"
            f" deviation {1.0 / strength:.3g}. The standard deviations include these priors, but"
            " not the bias."
        )
        if not settled:
            text += " The strength had not converged after the last round."
        if how == "l-curve" and spectrum.gcv(spectrum.tikhonov_filter(strength)) > spectrum.gcv(
            spectrum.tikhonov_filter(REGULARISATION.weakest)
        ):
            text += (
                " The corner of the L-curve raises the misfit by more than the noise justifies,"
                " which biases well determined unknowns, too; 'gcv' does not."
            )
        return text

    # -- truncated singular values -----------------------------------------------------------------
    def fit_truncated(self, noises: Sequence[NoiseModel], x: RealArray, number: int | None) -> Fit:
        """Fit from the start along the leading singular vectors, renewed at each end."""
        home = self.problem.coordinates.start
        fit = self._fit_with_prior(noises, x, REGULARISATION.weakest)
        noises, run = self._fix_noise(noises, fit), self._set_unit(fit)
        within: RealArray | None = None
        settled, number_kept, tried = False, 0, list[int]()
        for _ in range(REGULARISATION.most_turns):
            if _has_failed(fit):
                break
            spectrum = run._spectrum(fit)
            number_kept = (
                _count_by_gcv(spectrum) if number is None else min(number, _rank(spectrum))
            )
            wanted = self._directions(spectrum, number_kept)
            settled = within is not None and _span_same_space(within, wanted)
            if settled:
                break
            within = wanted
            tried.append(number_kept)
            problem = self._replace_coordinates(
                replace(self.problem.coordinates, within=within, unit=run.unit)
            )
            fit = self.method.fit(problem, noises, self.monitor, self._project(home, fit.x, within))
        if _has_failed(fit) or within is None:
            return fit
        spectrum = run._spectrum(fit)
        numbers = list(range(_rank(spectrum) + 1))
        filters = list(map(spectrum.truncation_filter, numbers))
        record = {
            "how": "tsvd",
            "kept": number_kept,
            "of": int(self.free.sum()),
            "tried": tried,
            **_trace_curve(
                spectrum, filters, "numbers", numbers, spectrum.truncation_filter(number_kept)
            ),
        }
        note = (
            f"Regularised (tsvd): {number_kept} of {int(self.free.sum())} directions are fitted;"
            " along the others the unknowns stay at their start, which the standard deviations"
            " treat as exact."
        )
        if not settled:
            note += " The directions had not converged after the last round."
        return replace(fit, regularisation=Regularisation(np.zeros(len(x)), within, note, record))

    def _directions(self, spectrum: SingularSpectrum, number: int) -> RealArray:
        """Return orthonormal directions: leading singular vectors, and the unknowns with priors."""
        n = len(self.free)
        with_prior = np.flatnonzero(~self.free)
        out = np.zeros((n, number + len(with_prior)))
        out[self.free, :number] = spectrum.V[:, :number]
        out[with_prior, number + np.arange(len(with_prior))] = 1.0
        return out

    def _project(self, home: RealArray, x: RealArray, within: RealArray) -> RealArray:
        """Return the projection of x on the directions through home, cut off at the first bound."""
        path = within @ (within.T @ (x - home))
        lower, upper = self.problem.coordinates.bounds
        home = np.clip(home, lower, upper)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(
                path > 0, (upper - home) / path, np.where(path < 0, (lower - home) / path, np.inf)
            )
        return np.asarray(
            np.clip(home + min(1.0, float(room.min(initial=np.inf))) * path, lower, upper)
        )

    # -- shared ------------------------------------------------------------------------------------
    def _replace_coordinates(self, coordinates: Coordinates) -> Problem:
        return self.problem.with_coordinates(coordinates)

    def _set_unit(self, fit: Fit) -> _RegularisedFits:
        return replace(self, unit=fit.unit)

    def _fix_noise(self, noises: Sequence[NoiseModel], fit: Fit) -> Sequence[NoiseModel]:
        """Return noise models fixed at the first fit's residual, the same for all strengths."""
        if _has_failed(fit):
            return noises
        fixed_noises = []
        try:
            for part, noise in zip(self.problem.parts, noises, strict=True):
                share = self.problem.share(part)
                fixed_noises.append(
                    _FixedNoise(noise.refit(part.responses(fit.x), part.frf, share))
                )
        except Stopped:  # the next fit stops as well
            return noises
        return fixed_noises

    def _spectrum(self, fit: Fit) -> SingularSpectrum:
        """Return the spectrum of the problem linearised at the end of a fit, about the start."""
        # Unknowns with a prior adapt to the others; they are eliminated together with it.
        assert fit.local is not None
        local = fit.local if self.unit is None else divide_by_std(fit.local, self.unit / fit.unit)
        scale = _inflation(fit)
        home, weight = self.problem.coordinates.prior
        A = np.vstack([local.R, np.diag(weight)]) / scale
        b = np.append(local.R @ (fit.x - home) - local.q, np.zeros(len(weight))) / scale
        fixed = int((~self.free).sum())
        Q = scipy.linalg.qr(A[:, ~self.free])[0][:, fixed:] if fixed else np.eye(len(A))
        length = float(fit.noise[0].get("correlation_length", 1.0)) if fit.noise else 1.0
        rest = max(2.0 * local.cost - float(local.q @ local.q), 0.0) / scale**2
        of_frfs = 2.0 * self.problem.n_values
        of_modes = self.problem.n_numbers - of_frfs
        n_values = max(of_frfs / length + of_modes, len(weight) + 1.0)
        return SingularSpectrum.of(Q.T @ A[:, self.free], Q.T @ b, rest, n_values, fixed)


@dataclass(frozen=True, slots=True)
class _FixedNoise(WrappedNoise):
    """Noise model that is not refitted."""

    base: NoiseModel

    @property
    def scale_known(self) -> bool:
        return self.base.scale_known

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        return self.base.variance(H, frf)

    def negative_log_likelihood(self, H: ComplexArray, frf: FRF) -> float:
        return self.base.negative_log_likelihood(H, frf)

    def figures(self) -> dict[str, Any]:
        return self.base.figures()


def _has_failed(fit: Fit) -> bool:
    """Return whether a fit has no local problem, or was stopped or failed."""
    return fit.local is None or fit.reason in ("stopped", "failed")


def _inflation(fit: Fit) -> float:
    """Return the inflation of the noise, including serial correlation."""
    found = float(fit.noise[0].get("inflation", 1.0)) if fit.noise else 1.0
    return found if found > 0.0 and np.isfinite(found) else 1.0


def _strength_range(spectrum: SingularSpectrum) -> tuple[float, float]:
    return REGULARISATION.weakest, max(float(spectrum.s[0]), 10.0 * REGULARISATION.weakest)


def _rank(spectrum: SingularSpectrum) -> int:
    return int((spectrum.s > NULL_SPACE.rank_tolerance * spectrum.s[0]).sum())


def _count_by_gcv(spectrum: SingularSpectrum) -> int:
    """Return the number of singular values with the least generalised cross-validation."""
    return int(
        np.argmin([spectrum.gcv(spectrum.truncation_filter(k)) for k in range(_rank(spectrum) + 1)])
    )


def _span_same_space(before: RealArray, now: RealArray) -> bool:
    """Return whether two sets of orthonormal directions span the same space."""
    if before.shape != now.shape:
        return False
    return now.shape[1] == 0 or bool(
        np.linalg.svd(before.T @ now, compute_uv=False)[-1] > REGULARISATION.settled_cosine
    )


def _trace_curve(
    spectrum: SingularSpectrum,
    filters: list[RealArray],
    axis: str,
    along: list[Any],
    at_fit: RealArray,
) -> dict[str, list[Any] | float]:
    """Return misfit over distance for the record, linearised at the end of the fit."""
    return {
        axis: along,
        "misfit": list(map(spectrum.misfit, filters)),
        "distance": list(map(spectrum.distance, filters)),
        "gcv": list(map(spectrum.gcv, filters)),
        "misfit here": spectrum.misfit(at_fit),
        "distance here": spectrum.distance(at_fit),
    }
