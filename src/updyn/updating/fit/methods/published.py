"""Methods whose published iteration can be replaced by a guarded one on the same equation."""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar

from updyn.arrays import RealArray
from updyn.errors import OptionError, suggest
from updyn.updating.fit.method import Method, descend_to_scale
from updyn.updating.fit.methods.linear import Amounts, PlainIteration, linear_step, linearise
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import LineResidual, ResidualSet

__all__ = ["GUARDED", "PublishedMethod"]

#: Solver with bounds, a trust region and priors, common to these methods.
GUARDED = "trust-region"


class PublishedMethod(Method):
    """Base class of methods with an option ``solver``: the published iteration, or `GUARDED`.

    Derived classes set `SOLVERS`: `GUARDED` and the name of the published one, the default first.
    """

    __slots__ = ()

    solver: str

    SOLVERS: ClassVar[tuple[str, ...]]

    def __post_init__(self) -> None:
        if self.solver not in self.SOLVERS:
            raise OptionError(
                f"solver {self.solver!r}: {suggest(str(self.solver), self.SOLVERS)}",
                key=("solver",),
            )

    @property
    def is_plain(self) -> bool:
        """Whether the iteration is the published one, without bounds and priors."""
        return self.solver != GUARDED

    @property
    def failure_remedy(self) -> str:
        """Advice if the iteration breaks down."""
        if self.is_plain:
            return f"Use solver={GUARDED!r}, or the default method."
        return ""

    def check_priors(self, problem: Problem) -> None:
        """Raise OptionError if an unknown has a prior, for the published iteration."""
        if self.is_plain and problem.coordinates.prior[1].any():
            raise OptionError(
                f"solver {self.solver!r} is the plain iteration and does not support priors; use"
                f" {GUARDED!r}",
                key=("solver",),
            )

    def iterate(
        self,
        problem: Problem,
        residual: LineResidual | ResidualSet[Any],
        x: RealArray,
        monitor: Monitor,
    ) -> tuple[RealArray, str]:
        """Minimise a residual from x; return the end, shape (n,), and the reason for it.

        The published iteration linearises the residual in the amounts (`Amounts`). Raises
        SolverError if it diverges or the model cannot be solved at the start.
        """
        if self.is_plain:
            step = partial(linear_step, problem, Amounts.find(problem.coordinates.parameters))
            plain = PlainIteration(self.max_iterations, self.tolerance)
            return plain.run(problem, partial(linearise, problem, residual), step, x, monitor)
        linearise(problem, residual, x)  # raises an error that names the line if singular
        guarded = TrustRegion(self.max_iterations, self.tolerance)
        outcome = descend_to_scale(problem, residual, x, monitor, guarded)
        return outcome.x, outcome.reason
