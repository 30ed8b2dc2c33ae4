"""FRF sensitivity method: linearised output error (Ting; Xu Zhangming; Imregun et al.)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods.least_squares import judged
from updyn.updating.fit.methods.linear import Amounts, Plain, check_unknowns, linear_step, local_of
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import Each, OutputError

__all__ = ["FrfSensitivityMethod"]

_NOTE = (
    "This iteration knows no bounds and weighs all lines alike, so that the largest peaks decide;"
    " use maximum likelihood where the data are noisy or the start is far."
)


@dataclass(frozen=True, slots=True)
class FrfSensitivityMethod(Method):
    """H_X - H_A = -H_A Z' H_A dp on measured DOFs, iterated (method ``"frf-sensitivity"``).

    The sensitivity of the FRF, as Bao, Wang & Cheng 2010 (section 1) report it of Xu Zhangming
    (their [4]) and, without damping, of Ting (their [6]); with all it needs in Imregun, Visser &
    Ewins, Mech. Syst. Signal Process. 9 (1995) 187-202. It is exact here, -v_i^T Z' u_j, for any
    choice of measured DOFs.

    The residual is that of ``"output-error"``, and so is the minimum. The way there differs: plain
    Gauss-Newton steps in the factors and loss factors themselves. No trust region, no bounds, no
    logarithms, no priors. A step that is too long is taken as it is, and where it makes a factor
    negative the method has failed.

    Parameters
    ----------
    max_iterations : int
        Largest number of steps.
    tolerance : float
        Relative step at which it has converged.
    halving : bool
        Whether a step that does not lower the misfit is halved, at most 20 times.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    halving: bool = False

    name: ClassVar[str] = "frf-sensitivity"
    label: ClassVar[str] = "linearised FRFs"
    reference: ClassVar[str] = "Ting; Xu Zhangming; Imregun, Visser & Ewins 1995"
    needs_exact: ClassVar[str] = (
        "tier 'reduced' holds near its start only, and 'frf-sensitivity' takes steps of any length;"
        " use tier 'sparse', or method 'output-error'"
    )

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: NDArray[np.float64],
    ) -> Fit:
        """Fit the unknowns from x; weights are equal, standard deviations those of the noise."""
        check_unknowns(problem, self)
        errors = [replace(OutputError.of_data(part), name=self.name) for part in problem.parts]
        residual = Each(tuple(errors))
        advice = "Use method 'output-error'" + ("." if self.halving else ", or halving=True.")
        settings = Plain(self.max_iterations, self.tolerance, advice, self.halving)
        step = partial(linear_step, problem, Amounts(()))  # no pairs: linearised in kappa and gamma
        with monitor.stage(self.name):
            x, reason = settings.run(
                problem, partial(local_of, problem, residual), step, x, monitor
            )
            return judged(problem, residual, x, reason, _NOTE, noises)
