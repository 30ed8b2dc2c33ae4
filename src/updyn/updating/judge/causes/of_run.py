"""Search for causes in the tests of a run: during its search for an answer, and after its fit."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.updating.fit.monitor import CAUSES, Monitor
from updyn.updating.judge.assessment import Judgement
from updyn.updating.judge.causes.data_alone import findings_in
from updyn.updating.judge.causes.diagnosis import diagnosed, strained, unseen
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.trust import claim_validated
from updyn.updating.problem.data import Split
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.session import Stopped

__all__ = ["Causes", "CausesOfRun"]


@dataclass(frozen=True, slots=True)
class Causes:
    """Causes of the residual of a fit.

    Attributes
    ----------
    findings : tuple of Finding
        The causes found.
    searched : bool
        Whether a search for causes in the residual of a test was made.
    unseen : str
        Why a necessary search was not made; empty if it was.
    overruling : bool
        Whether a cause ended the search for an answer.
    """

    findings: tuple[Finding, ...] = ()
    searched: bool = False
    unseen: str = ""
    overruling: bool = False

    @property
    def cleared(self) -> bool:
        """Whether a complete search found no cause."""
        return self.searched and not self.findings and not self.unseen


@dataclass(slots=True, eq=False)
class CausesOfRun:
    """Search for causes in all data of a run, including held-out data, with the whole models.

    Parameters
    ----------
    exact : Problem
        Whole model of each test.
    splits : sequence of Split
        Data of each test.
    noises : sequence of NoiseModel
        Noise of each test.
    monitor : Monitor
        Monitor of the run.
    """

    exact: Problem
    splits: Sequence[Split]
    noises: Sequence[NoiseModel]
    monitor: Monitor
    _overruling: dict[int, list[Finding]] = field(default_factory=dict, init=False)

    def detect_data_fault(self) -> bool:
        """Return whether a fault explains the residual of a fit from the start.

        The search for another answer then ends, because that answer would not be that of the
        structure.

        Raises
        ------
        Stopped
            If the user stops the run.
        """
        with self.monitor.stage(CAUSES):
            for i, noise in enumerate(self.noises):
                whole = self._whole(i)
                if unseen(whole, noise):
                    continue
                with suppress(SolverError):
                    found = diagnosed(whole, noise)
                    if any(one.overruling for one in found):
                        self._overruling[i] = found
        return bool(self._overruling)

    def after(self, found: Judgement) -> Causes:
        """Return the causes of the residual of a fit, from a search if it is not noise."""
        if found.fit.reason in ("stopped", "failed"):
            return Causes()
        out: list[Finding] = []
        searched, because = False, ""
        with self.monitor.stage(CAUSES), suppress(Stopped):
            for i, noise in enumerate(self.noises):
                whole = self._whole(i)
                if i in self._overruling:
                    out += self._overruling[i]
                    searched = True
                elif not self._is_explained(i, found):
                    why = unseen(whole, noise)
                    if not why:
                        try:
                            out += diagnosed(whole, noise, [found.fit.x])
                            searched = True
                            continue
                        except SolverError as error:
                            why = f"the search for causes failed ({error})"
                    because = why
                    out += findings_in(whole, noise)
        return Causes(tuple(out), searched, because, bool(self._overruling))

    def _whole(self, i: int) -> Part:
        """Return the part of a test with its whole model and all of its data."""
        part, exact = self.monitor.problem.parts[i], self.exact.parts[i]
        whole = replace(part, solver=exact.solver, variants=exact.variants)
        return whole.with_data(self.splits[i].whole)

    def _is_explained(self, i: int, found: Judgement) -> bool:
        """Return whether a fit leaves noise, predicts held-out data, and stays near its start."""
        adequacy = found.adequacy[i]
        noisy = adequacy is not None and adequacy.outcome in ("noise", "exact", "untested")
        predicted = claim_validated([found.correlation[i]]).holds is not False
        x: NDArray[np.float64] = found.fit.x
        return noisy and predicted and not strained(self.monitor.problem.parts[i], x)
