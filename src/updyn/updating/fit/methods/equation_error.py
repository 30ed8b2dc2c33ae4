"""The paper's method: condensed equation error (Bao, Wang & Cheng, PIERS 2010)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.reduced_solver import NOT_CONDENSED
from updyn.errors import SolverError
from updyn.updating.fit.method import UNBIASED, Fit, divide_by_std, residual_std
from updyn.updating.fit.methods.linear import basic_solution, describe_negative
from updyn.updating.fit.methods.published import PublishedMethod
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import Step
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.residuals import EquationError
from updyn.updating.problem.session import Record, Stopped

__all__ = ["EquationErrorMethod"]


@dataclass(frozen=True, slots=True)
class EquationErrorMethod(PublishedMethod):
    """r = Z_red h_X - e_j at every line and reference (method ``"equation-error"``).

    `tolerance` is a relative step for ``"trust-region"``, and for ``"gauss-newton"`` epsilon of the
    paper's stopping rule ||Z_red H_X - I||_inf <= epsilon.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    solver: str = "trust-region"

    SOLVERS: ClassVar[tuple[str, ...]] = ("trust-region", "gauss-newton")
    name: ClassVar[str] = "equation-error"
    label: ClassVar[str] = "fit of the condensed force equation"
    reference: ClassVar[str] = "Bao, Wang & Cheng 2010"
    needs: ClassVar[str] = "the drive point of every reference"
    needs_exact: ClassVar[str] = NOT_CONDENSED
    can_regularise: ClassVar[bool] = True

    def fit(
        self,
        problem: Problem,
        noises: Sequence[NoiseModel],
        monitor: Monitor,
        x: RealArray,
    ) -> Fit:
        """Fit the unknowns from x; the noise is estimated from the residual, equal everywhere."""
        self.check_priors(problem)
        residual = EquationError()
        with monitor.stage(self.name):
            if self.is_plain:
                x, reason = _gauss_newton(problem, x, monitor, self.max_iterations, self.tolerance)
            else:
                for part in problem.parts:
                    residual.check(part)
                try:
                    x, reason = self.iterate(problem, residual, x, monitor)
                except Stopped:
                    return Fit.without_jacobian(x, "stopped")
        try:
            local = residual.local(problem, x)
        except Stopped:
            return Fit.without_jacobian(x, "stopped")
        assert local is not None
        sigma = residual_std(local, problem.n_values, problem.n)
        record = {"kind": "spread of the equation error", "chi_square": 1.0, "inflation": 1.0}
        note = (
            "The equation error is biased by noise in the measurement; the standard deviations do"
            " not include this bias. Use maximum likelihood for noisy data."
        )
        R = local.R / sigma if sigma > 0 else local.R
        scaled = divide_by_std(local, sigma)
        records = (record,) * len(problem.parts)
        return Fit(x, reason, R, records, note, scaled, sigma, better=UNBIASED)


def _gauss_newton(
    problem: Problem, x: RealArray, monitor: Monitor, max_iterations: int, epsilon: float
) -> tuple[RealArray, str]:
    """Iterate as published: solve eq. (22) for the changes of X, Y and gamma, update, repeat."""
    # Real rows are stacked on imaginary rows, with real unknowns (eqs. 12, 20-22); no step control
    # and no bounds. Raises SolverError if the iteration diverges.
    coordinates = problem.coordinates
    length, before = 0.0, x
    for number in range(max_iterations + 1):
        try:
            cost, R, change, error = problem.recall(
                "gauss-newton", x, partial(_plain_step, problem, x)
            )
        except Stopped:
            return before, "stopped"
        stop = monitor.step(Step(x, Local(float(cost), R, np.zeros(len(R))), length, True))
        if error <= epsilon:
            return x, "converged"
        if stop or number == max_iterations:
            return x, "stopped" if stop else "max-iterations"
        values = coordinates.to_values(x)
        parameters = coordinates.parameters
        negative = np.flatnonzero(parameters.is_factor & (values + change <= 0.0))
        if negative.size:
            raise SolverError(
                f"{describe_negative(parameters, values, values + change, negative)} in step"
                f" {number + 1}: the plain iteration has diverged."
            )
        moved = coordinates.to_x(values + change)
        before, x, length = x, moved, float(np.abs(moved - x).max())
    return x, "max-iterations"


def _plain_step(problem: Problem, x: RealArray) -> Record:
    """Return cost, R of the Jacobian, change of the values (eq. 22) and ||Z_red H_X - I||_inf."""
    residuals, slopes, error = [], [], 0.0
    for part in problem.parts:
        for block in EquationError().blocks(part, x):
            residuals.append(block[0].ravel())
            slopes.append(block[1].reshape(problem.n, -1))
            error = max(error, float(np.abs(block[0]).sum(axis=2).max()))
    r = np.concatenate(residuals)
    S = np.concatenate(slopes, axis=1).T
    A, b = np.vstack([S.real, S.imag]), -np.concatenate([r.real, r.imag])
    change = basic_solution(A / problem.coordinates.slope(x), b)
    return (
        np.array(0.5 * float(b @ b)),
        np.asarray(np.linalg.qr(A, mode="r")),
        change,
        np.array(error),
    )
