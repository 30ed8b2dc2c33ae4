"""Fitting inside a reduced model that is proved where the fit ends.

A basis made at one point answers exactly there, and worse the further the unknowns move. So the fit is made inside the
basis of its start, and not too far from there; where it ends, the full residual says whether the basis still holds; if
not, a new one is made there and the fit goes on. As values and slopes are those of the whole model at the point of the
basis, few rounds suffice.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.reduced.reduction import Certificate, Reduction
from updyn.dynamics.reduced.solver import NOT_CONDENSED
from updyn.errors import OptionError
from updyn.updating.fit import Fit, Method
from updyn.updating.monitor import Monitor
from updyn.updating.noise import NoiseModel
from updyn.updating.problem import Problem
from updyn.updating.residuals import LogError
from updyn.updating.session import Stopped

__all__ = ["Reducing", "fallback", "is_reduced"]

_Vector = NDArray[np.float64]

#: Larger models than this are reduced where no tier is forced, if there are at least so many lines.
_DOFS, _LINES = 20_000, 40
#: A fit may go so far from the point of its basis (logarithms of factors; loss factors, those or half their value), and
#: make so many steps while it has not yet arrived.
_LEASH, _LOSS, _BRIEF = 0.2, 0.05, 12
_ROUNDS = 12
#: A basis from within this share of that is enriched; from further off a new one is smaller.
_NEAR = 0.25
#: A larger basis is compressed.
_LARGE = 400
#: So many DOFs without a sensor are kept track of, for advice.
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
        raise OptionError(NOT_CONDENSED)
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
    _x: _Vector = field(init=False)
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
        start = self.exact.coordinates.to_x(self.exact.coordinates.parameters.start)
        self._make(start)
        self._enrich(start)  # also the figures of the start come from it
        self.first = self._solver

    def inside(self, problem: Problem) -> Problem:
        """Return a problem with the latest reduced model."""
        return replace(problem, solver=self._solver)

    def fit(self, problem: Problem, strategy: Method, noise: NoiseModel, monitor: Monitor) -> tuple[Problem, Fit]:
        """Fit within a box about the point of the basis; make a new one where that ends, until it is proved there.

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
        x, near, left = strategy.search(problem, monitor), False, strategy.max_iterations
        fit = Fit.blind(x, "stopped")
        try:
            for number in range(_ROUNDS):
                with monitor.stage("reduce"):
                    if number == 0:
                        x = self._better(problem, x) if _outside(x, self._box()) else x
                    elif _outside(x, self._box(_NEAR)):
                        self._make(x)
                    else:
                        self._enrich(x)
                problem, box = self.inside(problem), self._box()
                boxed = replace(problem, coordinates=replace(problem.coordinates, box=box))
                before, steps = len(monitor.history), left if near else min(left, _BRIEF)
                fit = replace(strategy, max_iterations=steps).fit(boxed, noise, monitor, x)  # type: ignore[type-var]
                left = max(left - (len(monitor.history) - before), 0)
                near, x = not _outside(fit.x, box), fit.x
                if fit.reason in ("stopped", "failed"):
                    break
                if left == 0 or (near and fit.reason != "max-iterations"):
                    with monitor.stage("reduce"):
                        self._check(x)
                    if self.proved or left == 0:
                        break
            else:
                with monitor.stage("reduce"):
                    self._check(x)
        except Stopped:  # the values are kept, without their proof
            fit = replace(fit, reason="stopped")
        return problem, self._noted(fit)

    def _better(self, problem: Problem, x: _Vector) -> _Vector:
        """Make the reduced model where a search ended, far off, unless the start is as good after all."""
        start = self.exact.coordinates.to_x(self.exact.coordinates.parameters.start)
        before = LogError().local(problem, start)
        self._make(x)
        after = LogError().local(self.inside(problem), x)
        if before is not None and (after is None or before.cost < after.cost):
            self._make(start)
            return start
        return x

    def _box(self, share: float = 1.0) -> tuple[_Vector, _Vector]:
        """Return how far the unknowns may go in this basis."""
        factor = self.exact.coordinates.parameters.is_factor
        leash = share * np.where(factor, _LEASH, np.maximum(_LOSS, 0.5 * np.abs(self._x)))
        return self._x - leash, self._x + leash

    def _noted(self, fit: Fit) -> Fit:
        found = self.certificate
        if found is None or self.proved or fit.reason in ("stopped", "failed"):
            return fit
        note = (
            f"The reduced model could not be proved where the fit ended: its error there may be {found.error:.1g} of "
            f"the largest receptance of a line, not {self.accuracy:g}."
        )
        reason = "max-iterations" if fit.reason == "converged" else fit.reason
        return replace(fit, reason=reason, note=f"{note} {fit.note}".strip())

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
            **fallback(self._reduction.used, self._reduction.backend),
        }

    def _make(self, x: _Vector) -> None:
        """Make a reduced model at x: good as a rule, but not proved."""
        state = self.exact.state(x)
        self._reduction.build(state)
        if self._reduction.basis.size > _LARGE:
            self._reduction.compress(state, self.exact.frf.freq)
        self._use(x)

    def _enrich(self, x: _Vector) -> None:
        """Add to the reduced model what it lacks at x."""
        self.certificate = self._reduction.certify(self.exact.state(x), self.exact.frf.freq)
        self._use(x)

    def _use(self, x: _Vector) -> None:
        self._made += 1
        self._x, self.proved = x, False
        self._solver = self._reduction.solver(f"reduced {self._made}")

    def _check(self, x: _Vector) -> None:
        found = self._reduction.certify(self.exact.state(x), self.exact.frf.freq, enrich=False)
        self.certificate, self.proved = found, found.error <= self.accuracy


def fallback(used: dict[str, int], backend: str) -> dict[str, str]:
    """Return, for the record, who solved what the backend could not; nothing where it always could.

    Parameters
    ----------
    used : dict of str to int
        Solves by backend.
    backend : str
        The one that was chosen.
    """
    others = [f"{name} {number}" for name, number in used.items() if name != backend]
    return {"fallback": f"{', '.join(others)} of {sum(used.values())} solves"} if others else {}


def _outside(x: _Vector, box: tuple[_Vector, _Vector]) -> bool:
    """Whether a point lies outside a box, or on one of its walls."""
    margin = 1e-6 * (box[1] - box[0])
    return bool(((x <= box[0] + margin) | (x >= box[1] - margin)).any())
