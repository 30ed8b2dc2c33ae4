"""FRF sensitivity method: linearised output error (Ting; Xu Zhangming; Imregun et al.)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

from updyn.arrays import RealArray
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods.least_squares import make_sandwich_fit
from updyn.updating.fit.methods.linear import (
    Amounts,
    PlainIteration,
    check_unknowns,
    linear_step,
    linearise,
)
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet

__all__ = ["FrfSensitivityMethod"]

_NOTE = (
    "This iteration has no bounds and weights all lines equally, so the largest peaks dominate; use"
    " maximum likelihood if the data are noisy or the start is far from the answer."
)


@dataclass(frozen=True, slots=True)
class FrfSensitivityMethod(Method):
    """H_X - H_A = -H_A Z' H_A dp on measured DOFs, iterated (method ``"frf-sensitivity"``).

    The sensitivity of the FRF, as Bao, Wang & Cheng 2010 (section 1) report it of Xu Zhangming
    (their [4]) and, without damping, of Ting (their [6]); in full in Imregun, Visser & Ewins, Mech.
    Syst. Signal Process. 9 (1995) 187-202. It is exact here, -v_i^T Z' u_j, for any measured DOFs.

    Residual and minimum are those of ``"output-error"``, but steps are plain Gauss-Newton steps in
    the values, without trust region, bounds, logarithms or priors: the method fails if a factor
    becomes negative. `halving` halves a step that does not lower the misfit, at most 20 times.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    halving: bool = False

    name: ClassVar[str] = "frf-sensitivity"
    label: ClassVar[str] = "linearised FRFs"
    reference: ClassVar[str] = "Ting; Xu Zhangming; Imregun, Visser & Ewins 1995"
    needs_exact: ClassVar[str] = (
        "tier 'reduced' is accurate near its start only, and 'frf-sensitivity' takes long steps;"
        " use tier 'sparse', or method 'output-error'"
    )

    @property
    def failure_remedy(self) -> str:
        """Advice if the iteration breaks down."""
        if self.halving:
            return "Use method 'output-error'."
        return "Use method 'output-error', or halving=True."

    def describe_obstacle(self, problem: Problem) -> str:
        """Return a sentence on the share of the first step over which the FRFs are linear."""
        x, evaluate = (
            problem.coordinates.start,
            partial(linearise, problem, self._residual(problem)),
        )
        current, values = evaluate(x), problem.coordinates.to_values(x)
        halved = PlainIteration(1, self.tolerance, halving=True)
        found = halved.next_point(problem, evaluate, values, _step(problem, current, x), current, 1)
        text = "The misfit does not decrease along the first step, however short."
        if found is not None:
            share = found[2]
            text = (
                f"The misfit decreases only along the first 1/{1.0 / share:.0f} of the first step:"
                " the start is too far for FRFs that are linearised there."
            )
            if share == 1.0:
                text = "The FRFs are not linear enough in the unknowns for whole steps."
        return f"{text} {Method.describe_obstacle(self, problem)}".strip()

    def _residual(self, problem: Problem) -> OutputErrorSet:
        errors = [replace(OutputError.of_data(part), name=self.name) for part in problem.parts]
        return OutputErrorSet(tuple(errors))

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: RealArray,
    ) -> Fit:
        """Fit the unknowns from x; weights are equal, standard deviations those of the noise."""
        check_unknowns(problem, self)
        residual = self._residual(problem)
        settings = PlainIteration(self.max_iterations, self.tolerance, self.halving)
        step = partial(_step, problem)
        with monitor.stage(self.name):
            x, reason = settings.run(
                problem, partial(linearise, problem, residual), step, x, monitor
            )
            return make_sandwich_fit(problem, residual, x, reason, _NOTE, noises)


def _step(problem: Problem, local: Local, x: RealArray) -> RealArray:
    """Return the values after a full step, linearised in the stiffness and the loss factor."""
    return linear_step(problem, Amounts(()), local, x)
