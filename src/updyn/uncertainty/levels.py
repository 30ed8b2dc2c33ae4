"""`assess_levels`: the information of each force level, and of a further one."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.periodic.response import PeriodicResponse
from updyn.dynamics.periodic.settings import BALANCE
from updyn.dynamics.response import response
from updyn.dynamics.settings import REDUCTION
from updyn.errors import OptionError, SolverError, UpdynWarning
from updyn.group import is_number
from updyn.text_table import format_count
from updyn.uncertainty.deviations import find_deviations
from updyn.uncertainty.level_result import CandidateLevel, FittedLevel, LevelAssessment
from updyn.uncertainty.restored import RestoredFit, restore
from updyn.uncertainty.settings import LEVEL_CANDIDATES
from updyn.uncertainty.surrogate import Surrogate
from updyn.updating.problem.noise import NoiseChoice, NoiseModel, choose_noise
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["assess_levels", "check_candidates"]


def assess_levels(
    result: UpdateResult | JointResult,
    candidates: Iterable[float] | None = None,
    *,
    noise: NoiseChoice = None,
    accuracy: float = REDUCTION.accuracy,
) -> LevelAssessment:
    """Compute the information of each force level of an update, and of further levels.

    Parameters
    ----------
    result : UpdateResult or JointResult
        A fit of nonlinear elements by ``"maximum-likelihood"``, to FRFs at one or several force
        levels.
    candidates : iterable of float, optional
        Force amplitudes in N (N m) of one further test each. By default half the lowest level,
        those of the tests (repeated), the geometric mean of neighbours, and twice the highest.
    noise : str or mapping, optional
        Noise of a further test, as for `updyn.update`; by default that of the test nearest in
        level: the same ``relative`` and ``floor``, or the same variance or coherence.
    accuracy : float
        Large models are reduced about the estimate, with this error (`updyn.update`).

    Returns
    -------
    LevelAssessment
        Standard deviations with all tests, without each, with each alone, and with each candidate
        in addition.

    Raises
    ------
    OptionError
        If no model has nonlinear elements, no test states a level, a candidate is not above 0, or
        the method of the result has no likelihood.
    SolverError
        If the model cannot be solved at the estimate.

    Notes
    -----
    The Fisher information of a test is sum over its values of 2 / E|dH|^2 Re(dH/dx^H dH/dx), with
    the exact derivatives at the estimate x; that of independent tests adds up, and its inverse is
    the covariance by the Cramer-Rao bound (Pintelon & Schoukens, System Identification, 2nd ed.
    2012, section 9.11). Priors count as data. The data of a further test are predicted: the same
    channels, lines and direction of the sweep as the test nearest in level. A prediction depends on
    the estimate; the information of a level at which an element begins to act changes most.

    Examples
    --------
    >>> import numpy as np
    >>> groups = {"spring": updyn.Group([[1e4]], loss_factor=0.03), "mass": updyn.Group(mass=[[1]])}
    >>> model = updyn.Model.from_groups(groups, ["1:X"])
    >>> model = model.with_elements({"joint": (updyn.JenkinsElement(4e3, 2.0), "1:X")})
    >>> freq = np.linspace(15.0, 22.0, 36)
    >>> tests = [updyn.response(model, freq, ["1:X"], ["1:X"], level=F).frf for F in (0.02, 0.04)]
    >>> unknowns = updyn.parameters(model, stiffness="spring", nonlinear="joint.slip_force")
    >>> result = updyn.update(model, tests, unknowns, noise={"relative": 0.01}, starts=0)
    >>> found = updyn.assess_levels(result, [0.03, 2.0])
    >>> found.best.level, found.best.determines
    (2.0, ('joint.slip_force',))
    """
    fit = _FittedTests.of(result, accuracy)
    chosen = fit.choose_candidates()
    if candidates is not None:
        chosen = check_candidates(candidates)
    return LevelAssessment(
        fit.restored.first.parameters,
        fit.restored.first.values,
        fit.deviations(fit.triangles),
        tuple(fit.assess_test(i) for i in range(len(fit.names))),
        tuple(fit.assess_candidate(level, noise) for level in chosen),
        fit.unit,
    )


def check_candidates(candidates: Iterable[float]) -> list[float]:
    """Return the levels of candidates; raise OptionError if one is not above 0."""
    levels = list(candidates)
    for level in levels:
        if not is_number(level) or not 0.0 < level < np.inf:
            raise OptionError(
                f"candidates: {level!r}; expected a force amplitude above 0", key=("candidates",)
            )
    if not levels:
        raise OptionError("candidates: expected at least one level", key=("candidates",))
    return [float(level) for level in levels]


@dataclass(frozen=True, slots=True, eq=False)
class _FittedTests:
    """The tests of an update: names, median levels (nan if not stated), and information.

    `triangles` are reduced Jacobians by the optimiser's coordinates, (k, n) each, in standard
    deviations of the noise; `noises` are the noise models at the estimate.
    """

    restored: RestoredFit
    names: tuple[str, ...]
    levels: RealArray
    noises: tuple[NoiseModel, ...]
    triangles: tuple[RealArray, ...]

    @classmethod
    def of(cls, result: UpdateResult | JointResult, accuracy: float) -> _FittedTests:
        """Return the tests of an update, with reduced models if the models are large."""
        restored = _reduce(restore(result), accuracy)
        if restored.problem.is_linear:
            raise OptionError(
                "the models have no nonlinear elements, and their FRFs are equal at all levels;"
                " updyn.plan selects sensors, forces and lines for them"
            )
        names = []
        for name, one in result.results.items():
            names.append(name or one.frf.level_text or "test")
        levels = []
        for one in restored.results:
            level = one.frf.level
            levels.append(np.nan if level is None else float(np.median(level)))
        if np.isnan(levels).all():
            raise OptionError(
                "no test states the amplitude of its force; expected FRF.level of at least one"
            )
        noises = restored.noises()
        triangles = []
        for part, noise in zip(restored.problem.parts, noises, strict=True):
            triangles.append(_linearise(part, noise, restored))
        return cls(restored, tuple(names), np.array(levels), noises, tuple(triangles))

    @property
    def unit(self) -> str:
        """Unit of the levels."""
        references = {label for r in self.restored.results for label in r.frf.references.labels}
        return "N m" if all("R" in label for label in references) else "N"

    def deviations(self, triangles: Sequence[RealArray]) -> dict[str, float]:
        """Return the standard deviation of each unknown with some tests and the priors."""
        coordinates, x = self.restored.problem.coordinates, self.restored.x
        rows = np.vstack([*triangles, np.zeros((0, len(x)))])
        return find_deviations(rows, coordinates, x)

    def choose_candidates(self) -> list[float]:
        """Return levels below, at, between and above those of the tests."""
        found: list[float] = []
        for level in np.sort(self.levels[~np.isnan(self.levels)]).tolist():
            if not found or not _is_same(level, found[-1]):
                found.append(level)
        between = [float(np.sqrt(low * high)) for low, high in pairwise(found)]
        ends = [LEVEL_CANDIDATES.below * found[0], LEVEL_CANDIDATES.above * found[-1]]
        return sorted([*found, *between, *ends])

    def assess_test(self, i: int) -> FittedLevel:
        """Return the information of a test."""
        others = [R for k, R in enumerate(self.triangles) if k != i]
        alone = self.deviations([self.triangles[i]])
        return FittedLevel(self.names[i], float(self.levels[i]), self.deviations(others), alone)

    def assess_candidate(self, level: float, noise: NoiseChoice) -> CandidateLevel:
        """Return the information of a further test."""
        i = int(np.nanargmin(np.abs(np.log(self.levels / level))))
        about = level, self.names[i], _is_same(level, float(self.levels[i]))
        try:
            part, note = self._predict(i, level)
            own = self.noises[i].bulk
            if noise is not None:
                own = choose_noise(noise, part.frf)
            triangle = _linearise(part, own, self.restored)
        except SolverError as error:
            unknown = dict.fromkeys(self.restored.names, np.nan)
            return CandidateLevel(*about, unknown, np.nan, note=f"not computed: {error}")
        before, after = (self.deviations([*self.triangles, *more]) for more in ([], [triangle]))
        ratios, determines = [], []
        for name, std in before.items():
            if np.isfinite(std):
                ratios.append(np.log(after[name] / std))
            elif np.isfinite(after[name]):
                determines.append(name)
        gain = -float(np.expm1(np.mean(ratios))) if ratios else 0.0
        return CandidateLevel(*about, after, gain, tuple(determines), note)

    def _predict(self, i: int, level: float) -> tuple[FRFPart, str]:
        """Return the part of test i with the predicted data of another level, and a remark."""
        part, one = self.restored.problem.parts[i], self.restored.results[i]
        frf = part.frf
        channels = frf.freq, frf.responses, frf.references, frf.quantity
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UpdynWarning)  # the remark states them
            if frf.spectrum is not None:
                spectrum = frf.spectrum * [1.0, (level / float(self.levels[i])) ** 2]
                noise = response(one.model, *channels, excitation="random", spectrum=spectrum)
                data, remark = noise.frf, ""
            else:
                sine = response(one.model, *channels, level=level, sweep=frf.sweep or "up")
                data, remark = sine.frf, _describe_response(sine)
        values = data.values * part.gains(self.restored.x)
        force: dict[str, Any] = {"level": data.level, "spectrum": data.spectrum}
        return replace(part, frf=replace(frf, values=values, **force)), remark


def _is_same(level: float, other: float) -> bool:
    return abs(level - other) <= LEVEL_CANDIDATES.same * other


def _describe_response(found: PeriodicResponse) -> str:
    """Return a remark on lines without stable motion and on left-out harmonics; may be empty."""
    notes = []
    unstable = int((~found.stable).any(axis=1).sum())
    if unstable:
        notes.append(f"unstable at {format_count(unstable, 'line')}")
    if found.truncation.max() > BALANCE.largest_truncation:
        notes.append(f"error of {100.0 * found.truncation.max():.2g} % by higher harmonics")
    return ", ".join(notes)


def _reduce(restored: RestoredFit, accuracy: float) -> RestoredFit:
    """Return the fit with reduced models about the estimate, if the models are large."""
    if all(part.solver.tier == "dense" for part in restored.problem.parts):
        return restored
    surrogate = Surrogate(restored.whole, restored.results, accuracy)
    surrogate.begin(restored.x)
    return restored.with_problem(surrogate.problem())


def _linearise(part: FRFPart, noise: NoiseModel, restored: RestoredFit) -> RealArray:
    """Return the reduced Jacobian of a test at the estimate, for noise of unit variance."""
    variance = noise.variance(part.responses(restored.x), part.frf) * restored.inflation**2
    residual = OutputErrorSet((OutputError(np.sqrt(2.0 / variance)),))
    local = residual.local(Problem.of([part]), restored.x)
    if local is None:
        raise SolverError("the model cannot be solved at the estimate")
    return local.R
