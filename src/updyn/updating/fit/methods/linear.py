"""Parts of the classical methods: amounts in which Z is linear, and the plain iteration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from updyn.arrays import IndexArray, RealArray
from updyn.errors import OptionError, ParameterError, SolverError
from updyn.updating.fit.method import UNBIASED, Fit, Method, residual_std
from updyn.updating.fit.methods.settings import LINEAR_STEP
from updyn.updating.fit.monitor import Monitor, condition
from updyn.updating.fit.settings import TRUST_REGION
from updyn.updating.fit.trust_region import Step
from updyn.updating.problem.local import Local, join_locals
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import LineResidual, ResidualSet, reduce_cached
from updyn.updating.problem.session import Stopped

__all__ = [
    "Amounts",
    "PlainIteration",
    "basic_solution",
    "check_unknowns",
    "describe_negative",
    "describe_unmeasured",
    "linear_step",
    "linearise",
    "make_unweighted_fit",
    "scaled_solution",
]


#: Quantity that each damping value multiplies.
_BASES = {"loss_factor": "stiffness", "stiffness_damping": "stiffness", "mass_damping": "mass"}


@dataclass(frozen=True, slots=True)
class Amounts:
    """Quantities in which Z is linear.

    Z is bilinear in the stiffness factor kappa and the loss factor gamma of a group, but linear in
    the parts of the complex stiffness kappa (1 + i gamma) K. If both are unknown (`pairs` of
    indices), the amount of the loss factor is kappa gamma; likewise for the Rayleigh coefficients.
    (A linked unknown with a power other than 1 remains nonlinear and is linearised.)
    """

    pairs: tuple[tuple[int, int], ...]

    @classmethod
    def find(cls, parameters: ParameterSet) -> Amounts:
        """Return the damping unknowns whose stiffness or mass is unknown too."""
        pairs = []
        for j, p in enumerate(parameters):
            bases = {(d.group, _BASES[d.quantity]) for d in p.acts_on if d.quantity in _BASES}
            sharing = []
            for i, q in enumerate(parameters):
                powers = {(d.group, d.quantity): d.power for d in q.acts_on}
                if bases & powers.keys():
                    sharing.append((i, all(powers.get(base) == 1.0 for base in bases)))
            if len(sharing) == 1 and sharing[0][1]:
                pairs.append((sharing[0][0], j))
        return cls(tuple(pairs))

    def transform_jacobian(self, J: RealArray, values: RealArray) -> RealArray:
        """Return derivatives by the amounts, shape (m, n), from those by the values, same shape."""
        out = J.copy()
        for i, j in self.pairs:
            # At constant kappa gamma, the loss factor decreases with increasing stiffness.
            out[:, i] -= J[:, j] * (values[j] / values[i])
            out[:, j] /= values[i]
        return out

    def apply_change(self, values: RealArray, change: RealArray) -> RealArray:
        """Return the values after a change of the amounts, both shape (n,)."""
        amounts = values.copy()
        for i, j in self.pairs:
            amounts[j] *= values[i]
        out = amounts + change
        moved = out.copy()
        for i, j in self.pairs:
            moved[j] = out[j] / out[i] if out[i] != 0.0 else np.inf
        return moved


@dataclass(frozen=True, slots=True)
class PlainIteration:
    """Plain iteration: repeated linear solves with full steps.

    Converged if a step (logarithms of factors; loss factors) is not longer than `tolerance`, or is
    rounding. With `halving`, a step that does not lower the cost is halved; stalled after 20
    halvings.
    """

    max_iterations: int
    tolerance: float
    halving: bool = False

    def run(
        self,
        problem: Problem,
        evaluate: Callable[[RealArray], Local],
        solve: Callable[[Local, RealArray], RealArray],
        x: RealArray,
        monitor: Monitor,
    ) -> tuple[RealArray, str]:
        """Iterate from x; return the final point, shape (n,), and the reason for the end.

        `evaluate` returns the local problem at a point, `solve` the values that solve the linear
        problem there. Raises SolverError if the iteration diverges, or the model cannot be solved.
        """
        before = np.inf
        try:
            current = evaluate(x)
            if monitor.step(Step(x, current, 0.0, True)):
                return x, "stopped"
            for number in range(1, self.max_iterations + 1):
                values = problem.coordinates.to_values(x)
                found = self.next_point(
                    problem, evaluate, values, solve(current, x), current, number
                )
                if found is None:
                    return x, "stalled"
                moved, proposed, share = found
                length = float(np.abs(moved - x).max())
                x, current = moved, proposed
                stop = monitor.step(Step(x, current, length, True))
                rounding = TRUST_REGION.step_rounding if length >= before else 0.0
                if share == 1.0 and length <= max(self.tolerance, rounding):
                    return x, "converged"
                if stop:
                    return x, "stopped"
                before = length
        except Stopped:
            return x, "stopped"
        return x, "max-iterations"

    def next_point(
        self,
        problem: Problem,
        evaluate: Callable[[RealArray], Local],
        values: RealArray,
        wanted: RealArray,
        current: Local,
        number: int,
    ) -> tuple[RealArray, Local, float] | None:
        """Return the next point, its local problem, and the share of the step taken, or None.

        `values` and `wanted` are the unknowns before the step and after the full step.
        """
        share = 1.0
        for _ in range(LINEAR_STEP.most_halvings + 1):
            try:
                moved = _apply_step(
                    problem, values, values + share * (wanted - values), current, number
                )
                proposed = evaluate(moved)
                if (
                    not self.halving
                    or proposed.cost < current.cost
                    or _is_rounding(problem, moved, values)
                ):
                    return moved, proposed, share
            except SolverError:
                if not self.halving:
                    raise
            share *= 0.5
        return None


def _apply_step(
    problem: Problem, before: RealArray, values: RealArray, current: Local, number: int
) -> RealArray:
    """Return x after a step to given values; refuse factors that are not positive."""
    parameters = problem.coordinates.parameters
    size = condition(current.R)
    is_what = (
        f"has condition number {size:.2g}"
        if size < LINEAR_STEP.singular_condition
        else "is singular"
    )
    where = f"in step {number}, whose linear problem {is_what}: the plain iteration has diverged."
    if not np.isfinite(values).all() or (np.abs(values) > LINEAR_STEP.diverged_value).any():
        raise SolverError(f"The unknowns grow without limit {where}")
    negative = np.flatnonzero(parameters.is_factor & (values <= 0.0))
    if negative.size:
        raise SolverError(f"{describe_negative(parameters, before, values, negative)} {where}")
    return problem.coordinates.to_x(values)


def describe_negative(
    parameters: ParameterSet, before: RealArray, after: RealArray, negative: IndexArray
) -> str:
    """Return the beginning of a sentence on the factors that a step makes negative."""
    worst = int(negative[np.argmin(after[negative] / before[negative])])
    text = f"{parameters[worst].name} would become negative (from {before[worst]:.3g} to"
    text += f" {after[worst]:.3g})"
    if negative.size > 1:
        text += f", with {negative.size - 1} more,"
    return text


def _is_rounding(problem: Problem, x: RealArray, values: RealArray) -> bool:
    return bool(np.abs(x - problem.coordinates.to_x(values)).max() <= TRUST_REGION.step_rounding)


def describe_unmeasured(problem: Problem) -> str:
    """Return the largest number of unmeasured DOFs of a test, as the beginning of a sentence."""
    most = max(problem.parts, key=lambda part: part.solver.system.n - len(set(part.rows.tolist())))
    n = most.solver.system.n
    missing = n - len(set(most.rows.tolist()))
    if not missing:
        return ""
    return f"{missing} of {n} DOFs were not measured"


def linear_step(problem: Problem, amounts: Amounts, local: Local, x: RealArray) -> RealArray:
    """Return the values, shape (n,), that minimise the residual linearised at x in the amounts."""
    values = problem.coordinates.to_values(x)
    J = amounts.transform_jacobian(local.R / problem.coordinates.slope(x), values)
    return amounts.apply_change(values, scaled_solution(J, -local.q))


def scaled_solution(A: RealArray, b: RealArray) -> RealArray:
    """Solve A x = b by least squares with columns of unit length, independent of units."""
    norms = np.linalg.norm(A, axis=0)
    scale = np.where(norms > 0.0, norms, 1.0)
    return basic_solution(A / scale, b) / scale


def basic_solution(A: RealArray, b: RealArray) -> RealArray:
    """Solve A x = b by least squares with pivoted QR; the basic solution if A is rank-deficient."""
    # It takes the condensed equation error to the paper's result in its five iterations from both
    # readings of its error rates; least-norm solutions move along the undetermined direction.
    # Among columns equally long to rounding, the first is chosen on every processor.
    weight = 1.0 - LINEAR_STEP.tie_share * np.arange(A.shape[1])
    Q, R, order = scipy.linalg.qr(A * weight, mode="economic", pivoting=True)
    size = np.abs(np.diag(R))
    rank = int((size > 1e-13 * size[0]).sum()) if size.size else 0
    out = np.zeros(A.shape[1])
    out[order[:rank]] = scipy.linalg.solve_triangular(R[:rank, :rank], (Q.T @ b)[:rank])
    return out * weight


def linearise(problem: Problem, residual: LineResidual | ResidualSet[Any], x: RealArray) -> Local:
    """Return the reduced problem of all tests at x; SolverError if it cannot be solved there."""
    return join_locals(
        [reduce_cached(residual.of(i), part, x) for i, part in enumerate(problem.parts)], problem.n
    )


def check_unknowns(problem: Problem, method: Method, *, priors: bool = False) -> None:
    """Refuse unknowns that a method cannot update, and priors unless `priors`."""
    for p in problem.coordinates.parameters:
        for d in p.acts_on:
            if d.quantity in method.cannot:
                raise ParameterError(
                    f"method {method.name!r} cannot update {d.quantity} (unknown {p.name!r});"
                    f" {method.instead}"
                )
    if not priors and problem.coordinates.prior[1].any():
        raise OptionError(
            f"method {method.name!r}, the plain iteration, does not support priors; omit prior_std"
        )


def make_unweighted_fit(
    problem: Problem,
    residual: LineResidual | ResidualSet[Any],
    x: RealArray,
    reason: str,
    kind: str,
    note: str,
) -> Fit:
    """Return the fit that ended at x; noise is estimated from the residual, equal everywhere."""
    try:
        local = linearise(problem, residual, x)
    except Stopped:
        return Fit.without_jacobian(x, "stopped")
    sigma = residual_std(local, problem.n_values, problem.n)
    record = {"kind": kind, "chi_square": 1.0, "inflation": 1.0}
    R = local.R / sigma if sigma > 0 else local.R
    records = (record,) * len(problem.parts)
    return Fit(x, reason, R, records, note, better=UNBIASED if note else "")
