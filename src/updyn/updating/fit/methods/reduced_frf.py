"""FRF method on unit matrices reduced once by a fixed transformation (Xu Zhangming)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem, Term
from updyn.dynamics.fields import LineSolver
from updyn.errors import SolverError
from updyn.sensitivity import Unknowns
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods.linear import (
    Amounts,
    PlainIteration,
    check_unknowns,
    describe_unmeasured,
    linear_step,
    linearise,
    make_unweighted_fit,
    scaled_solution,
)
from updyn.updating.fit.methods.settings import REDUCED_FRF
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.local import Local
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import EquationError

__all__ = ["ReducedFrfMethod", "reduce_independently"]


_NAME = "reduced-frf"
_NOTE = (
    "The matrices were reduced by one fixed transformation{}, which is not exact at other lines nor"
    " after a change of stiffness: even exact data give a biased estimate, and its standard"
    " deviations do not include this bias. The iteration has no bounds. Use equation-error or"
    " maximum likelihood, which condense exactly."
)


@dataclass(frozen=True, slots=True)
class ReducedFrfMethod(Method):
    """e_j - Z_r h_X = dZ_r h_X with independently reduced matrices (method ``"reduced-frf"``).

    The method of Xu Zhangming that Bao, Wang & Cheng 2010 (section 1, their [8]) compare with their
    own. K_e, M_e and C_e of every unit become T^T K_e T and so on, with one real transformation T
    onto the measured DOFs, of the undamped model at its start; stiffness, mass and damping are
    identified in turn (`separate`), each by a linear solve. The paper does not print its formulas;
    T is that of Guyan (AIAA J. 3 (1965) 380) or of one `frequency` in Hz (Leung, Int. J. Numer.
    Meth. Engng 12 (1978) 1705; Paz, AIAA J. 22 (1984) 724).

    T is exact only at its own frequency and for the stiffnesses of the start. The estimate is wrong
    even without noise, unless eliminated DOFs have no inertia and each belongs to one unit.
    """

    max_iterations: int = 1000
    tolerance: float = 1e-10
    frequency: float = 0.0
    separate: bool = True

    name: ClassVar[str] = _NAME
    label: ClassVar[str] = "force equation of the reduced model"
    reference: ClassVar[str] = "Xu Zhangming, as in Bao, Wang & Cheng 2010"
    needs: ClassVar[str] = "the drive point of every reference"
    needs_exact: ClassVar[str] = (
        "tier 'reduced': 'reduced-frf' makes another reduction itself; use tier 'sparse'"
    )

    @property
    def failure_remedy(self) -> str:
        """Advice if the iteration breaks down."""
        return "Use lines where its reduced model is exact enough, or 'equation-error'."

    def describe_obstacle(self, problem: Problem) -> str:
        """Return the error of the reduced model at the start, as a sentence."""
        texts = []
        for part in problem.parts:
            missing = describe_unmeasured(Problem.of([part]))
            if missing:
                errors = _errors(part, self.frequency)
                texts.append(f"{part.name}: {missing}, {_describe_error(part.frf.freq, errors)}")
        text = " ".join(texts).removeprefix(": ")
        return f"{text} {Method.describe_obstacle(self, problem)}".strip()

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x; the noise is estimated from the residual, equal everywhere."""
        check_unknowns(problem, self)
        residual = _ReducedEquationError(frequency=self.frequency)
        for part in problem.parts:
            residual.check(part)
        with monitor.stage(_NAME):
            parts = [reduce_independently(part, x, self.frequency) for part in problem.parts]
            reduced = Problem.of(parts)
            amounts = Amounts.find(problem.coordinates.parameters)
            step = partial(_step_in_turn if self.separate else linear_step, reduced, amounts)
            settings = PlainIteration(self.max_iterations, self.tolerance)
            x, reason = settings.run(
                reduced, partial(linearise, reduced, residual), step, x, monitor
            )
            where = " (static)"
            if self.frequency:
                where = f" (at {self.frequency:g} Hz)"
            return make_unweighted_fit(
                reduced,
                residual,
                x,
                reason,
                "spread of the reduced equation error",
                _NOTE.format(where),
            )


@dataclass(frozen=True, slots=True)
class _ReducedEquationError(EquationError):
    """Equation error of the reduced model, whose only DOFs are the measured ones."""

    name: str = _NAME
    frequency: float = 0.0

    @property
    def cache_key(self) -> str:
        return f"frequency={self.frequency!r}"


def reduce_independently(part: FRFPart, x: RealArray, frequency: float) -> FRFPart:
    """Return the part on a model of the measured DOFs alone: every matrix A becomes T^T A T.

    T is computed for the unknowns x at `frequency`, in Hz. Raises SolverError if the undamped
    structure with its measured DOFs held is singular there.
    """
    system, rows = part.solver.system, part.rows
    share = {"stiffness": 1.0, "mass": -((2.0 * np.pi * frequency) ** 2)}
    undamped = part.state(x).factor * np.array(
        [share.get(term.quantity, 0.0) for term in system.terms]
    )
    try:
        T = part.solver.condense(
            undamped[:, None].astype(np.complex128), rows, np.array([frequency])
        )[1][:, 0].real
    except SolverError as error:
        raise SolverError(
            f"{_NAME}: no transformation at {frequency:g} Hz ({error}); choose another with"
            " frequency="
        ) from None
    n = len(rows)
    row_index, entries = np.arange(n), np.arange(n * n)
    terms = tuple(_project_term(term, T, row_index, entries) for term in system.terms)
    dofs = system.dofs[rows]
    small = AffineSystem(
        terms, system.start, n * np.arange(n + 1), np.tile(row_index, n), dofs, decay=system.decay
    )
    return replace(
        part,
        solver=LineSolver(small, "dense", part.solver.backend),
        unknowns=Unknowns.find(small, part.coordinates.parameters),
        rows=row_index,
        columns=np.array([int(np.flatnonzero(rows == c)[0]) for c in part.columns], dtype=np.intp),
        # The name is part of the cache key: this is another model at the same x.
        name=f"{part.name} reduced at {frequency!r} Hz from {part.values(x).tolist()}",
    )


def _errors(part: FRFPart, frequency: float) -> RealArray:
    """Return the relative error of the reduced FRFs at the start, as the median of each line."""
    x = part.coordinates.start
    exact = part.responses(x)
    size = np.maximum(np.abs(exact), np.finfo(float).tiny)
    reduced = reduce_independently(part, x, frequency).responses(x)
    return np.asarray(np.median(np.abs(reduced - exact) / size, axis=(1, 2)))


def _describe_error(freq: RealArray, errors: RealArray) -> str:
    """Return the error of the reduced FRFs, and up to which line it is small, as text."""
    text = (
        "and the transformation that replaces them is not exact: at the start of the fit, the FRFs"
        f" differ by {100.0 * np.median(errors):.2g} % (median of all lines)"
    )
    wrong = np.flatnonzero(errors > REDUCED_FRF.small_error)
    if not wrong.size:
        return f"{text}."
    if wrong[0] == 0:
        return f"{text}, and by more than 10 % from the first line on."
    return f"{text}, and by less than 10 % only up to {freq[wrong[0] - 1]:.4g} Hz."


def _project_term(term: Term, T: RealArray, row_index: IndexArray, entries: IndexArray) -> Term:
    part = np.ascontiguousarray(T[term.row_index])
    A = np.ascontiguousarray(part.T @ (term.local @ part))
    A = 0.5 * (A + A.T)
    return replace(term, rows=row_index, local=A, slots=entries, data=A.ravel())


def _step_in_turn(problem: Problem, amounts: Amounts, local: Local, x: RealArray) -> RealArray:
    """Return the values, shape (n,), after separate steps for stiffness, mass and damping."""
    parameters = problem.coordinates.parameters
    values = problem.coordinates.to_values(x)
    J = amounts.transform_jacobian(local.R / problem.coordinates.slope(x), values)
    change, residual = np.zeros(len(x)), -local.q
    # A linked unknown belongs to the first quantity on which it acts; all quantities other than
    # stiffness and mass count as damping.
    steps: dict[str, list[int]] = {"stiffness": [], "mass": [], "damping": []}
    for i, p in enumerate(parameters):
        quantity = p.acts_on[0].quantity
        steps[quantity if quantity in steps else "damping"].append(i)
    for columns in steps.values():
        change[columns] = scaled_solution(J[:, columns], residual)
        residual = residual - J[:, columns] @ change[columns]
    return amounts.apply_change(values, change)
