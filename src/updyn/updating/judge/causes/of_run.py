"""Search for causes in the tests of a run: during its search for an answer, and after its fit."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

from updyn.arrays import RealArray
from updyn.errors import SolverError
from updyn.updating.fit.monitor import CAUSES, FAULTS, Monitor
from updyn.updating.judge.adequacy import Adequacy
from updyn.updating.judge.assessment import Judgement
from updyn.updating.judge.causes.data_alone import find_data_faults, with_variance
from updyn.updating.judge.causes.diagnosis import Diagnosis, find_obstacle, is_far_from_start
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.levels.of_run import find_level_dependence
from updyn.updating.judge.trust import claim_validated
from updyn.updating.problem.data import Split
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.session import Stopped

__all__ = ["CauseSearch", "Causes"]


@dataclass(frozen=True, slots=True)
class Causes:
    """Causes of the residual of a fit, and why a necessary search was not made (empty if it was).

    `is_overruling`: a cause ended the search for an answer. `level_dependence` is how the modes of
    the tests change with the force level; empty if they do not.
    """

    findings: tuple[Finding, ...] = ()
    was_searched: bool = False
    not_searched: str = ""
    is_overruling: bool = False
    level_dependence: str = ""

    @property
    def has_no_cause(self) -> bool:
        """Whether a complete search found no cause."""
        return self.was_searched and not self.findings and not self.not_searched


@dataclass(slots=True, eq=False)
class CauseSearch:
    """Search for causes in all data of a run, including held-out data, with the whole models."""

    exact: Problem
    splits: Sequence[Split]
    noises: Sequence[NoiseModel]
    _diagnoses: dict[int, Diagnosis] = field(default_factory=dict, init=False)
    _overruling: dict[int, list[Finding]] = field(default_factory=dict, init=False)

    def detect_data_fault(self, monitor: Monitor) -> bool:
        """Return whether a fault explains the residual of a fit from the start."""
        # The search for another answer then ends, because that answer would not be that of the
        # structure.
        if not self.exact.is_linear:
            return False
        with monitor.stage(FAULTS):
            for i, noise in enumerate(self.noises):
                whole = self._whole_part(monitor.problem.parts[i], i)
                if find_obstacle(whole, noise):
                    continue
                with suppress(SolverError):
                    found = self._diagnose(i, whole, noise).find_causes()
                    if any(one.overruling for one in found):
                        self._overruling[i] = found
        return bool(self._overruling)

    def search_after_fit(self, found: Judgement, monitor: Monitor) -> Causes:
        """Return the causes of the residual of a fit, from a search if it is not noise."""
        if found.fit.reason in ("stopped", "failed"):
            return Causes()
        if not self.exact.is_linear:
            if all(map(_leaves_noise, found.adequacy)):
                return Causes()
            return Causes(not_searched="the model has nonlinear elements")
        out: list[Finding] = []
        was_searched, not_searched = False, ""
        with monitor.stage(CAUSES), suppress(Stopped):
            for i, noise in enumerate(self.noises):
                whole = self._whole_part(monitor.problem.parts[i], i)
                if i in self._overruling:
                    out += self._overruling[i]
                    was_searched = True
                elif not self._is_explained(monitor.problem.parts[i], i, found):
                    reason = find_obstacle(whole, noise)
                    if not reason:
                        try:
                            out += self._diagnose(i, whole, noise).find_causes([found.fit.x])
                            was_searched = True
                            continue
                        except SolverError as error:
                            reason = f"the search for causes failed ({error})"
                    not_searched = reason
                    out += find_data_faults(whole, noise)
        levels = find_level_dependence(
            with_variance(split.whole, noise) if noise.size_known else split.whole
            for split, noise in zip(self.splits, self.noises, strict=True)
        )
        return Causes(tuple(out), was_searched, not_searched, bool(self._overruling), levels)

    def _diagnose(self, i: int, whole: FRFPart, noise: NoiseModel) -> Diagnosis:
        """Return the search in a test, which keeps its findings."""
        return self._diagnoses.setdefault(i, Diagnosis(whole, noise))

    def _whole_part(self, part: FRFPart, i: int) -> FRFPart:
        """Return the part of a test with its whole model and all of its data."""
        exact = self.exact.parts[i]
        whole = replace(part, solver=exact.solver, variants=exact.variants)
        return whole.with_data(self.splits[i].whole)

    def _is_explained(self, part: FRFPart, i: int, found: Judgement) -> bool:
        """Return whether a fit leaves noise, predicts held-out data, and stays near its start."""
        noisy = _leaves_noise(found.adequacy[i])
        predicted = claim_validated([found.correlation[i]]).holds is not False
        x: RealArray = found.fit.x
        return noisy and predicted and not is_far_from_start(part, x)


def _leaves_noise(adequacy: Adequacy | None) -> bool:
    """Return whether the residual of a part is noise as far as it was tested."""
    return adequacy is not None and adequacy.outcome in ("noise", "exact", "untested")
