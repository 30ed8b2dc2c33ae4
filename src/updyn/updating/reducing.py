"""Fitting inside a reduced model that is proved where the fit ends.

A basis made at one point answers exactly there, and worse the further the unknowns move. So the fit is made inside the
basis of its start; where it ends, the full residual says whether the basis still holds; if not, a new one is made there
and the fit goes on. As values and slopes are those of the whole model at the point of the basis, few rounds suffice.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.reduced.reduction import Certificate, Reduction
from updyn.errors import OptionError
from updyn.updating.fit import Fit, Method
from updyn.updating.monitor import Monitor
from updyn.updating.noise import NoiseModel
from updyn.updating.problem import Problem
from updyn.updating.session import Stopped

__all__ = ["Reducing", "is_reduced"]

#: Larger models than this are reduced where no tier is forced, if there are at least so many lines.
_DOFS, _LINES = 20_000, 40
_ROUNDS = 8
_LARGE = 400
_ELSEWHERE = 200


def is_reduced(tier: str | None, n: int, n_lines: int, method: str | None = None) -> bool:
    """Return whether a model is to be reduced.

    Parameters
    ----------
    tier : str or None
        The tier that is forced.
    n, n_lines : int
        Degrees of freedom and lines.
    method : str, optional
        Of the update.

    Raises
    ------
    OptionError
        If the reduced tier is forced on a method that needs the exact one.
    """
    condenses = method == "equation-error"
    if tier == "reduced" and condenses:
        raise OptionError(
            "tier 'reduced': the condensed equation error needs Z_red = H^-1, which multiplies the error of a reduced "
            "model by the condition number of H; use tier 'sparse', or another method"
        )
    return tier == "reduced" or (tier is None and not condenses and n > _DOFS and n_lines >= _LINES)


@dataclass(slots=True, eq=False)
class Reducing:
    """The reduced models of a run, one after the other.

    Parameters
    ----------
    exact : Problem
        All data, and the whole model.
    accuracy : float
        Wanted: the error of a receptance as a share of the largest of its line.

    Attributes
    ----------
    first : FieldSolver or None
        The reduced model of the start, once it is made.
    certificate : Certificate or None
        The latest proof.
    proved : bool
        Whether it is about the point where the fit ended.
    """

    exact: Problem
    accuracy: float
    first: FieldSolver | None = field(default=None, init=False)
    certificate: Certificate | None = field(default=None, init=False)
    proved: bool = field(default=False, init=False)
    _solver: FieldSolver = field(init=False)
    _reduction: Reduction = field(init=False)
    _made: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        problem, freq = self.exact, self.exact.frf.freq
        others = problem.solver.others(np.union1d(problem.rows, problem.columns))
        self._reduction = Reduction(
            problem.solver.system,
            problem.rows,
            problem.columns,
            (float(freq[0]), float(freq[-1])),
            problem.solver.backend,
            self.accuracy,
            others[:: max(1, -(-len(others) // _ELSEWHERE))],
            problem.session.check,
        )

    def begin(self) -> None:
        """Make the reduced model of the start.

        Raises
        ------
        SolverError
            If the model cannot be solved there.
        Stopped
            If the user wants to stop.
        """
        self._make(self.exact.coordinates.to_x(self.exact.coordinates.parameters.start))
        self.first = self._solver

    def inside(self, problem: Problem) -> Problem:
        """Return a problem with the latest reduced model."""
        return replace(problem, solver=self._solver)

    def fit(self, problem: Problem, strategy: Method, noise: NoiseModel, monitor: Monitor) -> tuple[Problem, Fit]:
        """Fit, and prove the reduced model where the fit ends; make a new one there and fit again until it holds.

        Parameters
        ----------
        problem : Problem
            From `inside`.
        strategy, noise, monitor
            As for `Method.fit`.

        Returns
        -------
        problem : Problem
            With the last reduced model.
        fit : Fit
            The last fit.
        """
        fit = strategy.fit(problem, noise, monitor)
        for last in (*[False] * _ROUNDS, True):
            if fit.reason in ("stopped", "failed"):
                break
            try:
                with monitor.stage("reduce"):
                    self._check(fit.x)
                    if self.proved or last or fit.reason == "max-iterations":
                        break
                    self._make(fit.x)
            except Stopped:  # the values are kept, without their proof
                fit = replace(fit, reason="stopped")
                break
            problem = self.inside(problem)
            fit = strategy.fit(problem, noise, monitor, fit.x)
        found = self.certificate
        if found is not None and not self.proved and fit.reason not in ("stopped", "failed"):
            note = (
                f"The reduced model could not be proved where the fit ended: its error there may be "
                f"{found.error:.1g} of the largest receptance of a line, not {self.accuracy:g}."
            )
            fit = replace(fit, note=f"{note} {fit.note}".strip())
        return problem, fit

    @property
    def record(self) -> dict[str, float | int | str]:
        """What the result states."""
        found = self.certificate
        if found is None:
            return {"accuracy": self.accuracy}
        error = found.error if self.proved else "not checked where the fit ended"
        return {
            "accuracy": self.accuracy,
            "basis": found.size,
            "error": error,
            "lines checked": len(found.lines),
            "factorisations": found.factorisations,
        }

    def _make(self, x: NDArray[np.float64]) -> None:
        """Make and prove the reduced model at x."""
        state, freq = self.exact.state(x), self.exact.frf.freq
        self._made += 1
        self._reduction.build(state)
        if self._reduction.basis.size > _LARGE:
            self._reduction.compress(state, freq)
        self.certificate = self._reduction.certify(state, freq)
        self._solver = self._reduction.solver(f"reduced {self._made}")

    def _check(self, x: NDArray[np.float64]) -> None:
        found = self._reduction.certify(self.exact.state(x), self.exact.frf.freq, enrich=False)
        self.certificate, self.proved = found, found.error <= self.accuracy
