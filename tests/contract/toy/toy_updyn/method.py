"""A method: Gauss-Newton steps on the log error, without control."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.updating.fit.method import Fit, Method
from updyn.updating.problem.residuals import LogError


@dataclass(frozen=True, slots=True)
class OneStep(Method):
    """Plain Gauss-Newton on the log error."""

    max_iterations: int = 20
    tolerance: float = 1e-10

    name: ClassVar[str] = "toy-method"
    reference: ClassVar[str] = "Gauss 1809"

    def fit(self, problem, noises, monitor, x):
        """Step until the step is short."""
        residual = LogError()
        for _ in range(self.max_iterations):
            local = residual.local(problem, x)
            step = np.linalg.lstsq(local.R, -local.q, rcond=None)[0]
            x = x + step
            if np.abs(step).max() < self.tolerance:
                return Fit(x, "converged", local.R)
        return Fit(x, "max-iterations", local.R)
