"""Force residual with dynamic expansion (Farhat & Hemez 1993; Hemez, the paper's [5])."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.fields import LineSolver
from updyn.errors import DataError
from updyn.frf import QUANTITIES
from updyn.linalg.threads import use_one_thread
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods.constitutive import ConstitutiveError, adjoint_fields
from updyn.updating.fit.methods.linear import (
    check_unknowns,
    describe_unmeasured,
    make_unweighted_fit,
)
from updyn.updating.fit.methods.published import PublishedMethod
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LineResidual, ResidualSet
from updyn.updating.problem.session import Stopped

__all__ = ["ForceResidual", "ForceResidualMethod"]


_NAME = "force-residual"
_NOTE = (
    "The equation contains the measured motion, so noise biases the estimate; the standard"
    " deviations do not include this bias. {}Use maximum likelihood for noisy data."
)
_UNBOUNDED = "The published iteration has no bounds. "


@dataclass(frozen=True, slots=True)
class ForceResidualMethod(PublishedMethod):
    """||Z(p) h - f|| minimised over the unknowns and the unmeasured motion (``"force-residual"``).

    Alternately, the measured motion is expanded to all DOFs with the least unbalanced force, and
    the residual, linear in the unknowns, is minimised (Farhat & Hemez, AIAA J. 31 (1993) 1702; for
    frequency responses Hemez, as Bao, Wang & Cheng 2010 quote him in [5]). Both steps lower the
    same sum of squares, but slowly if most of the motion is expanded; ``"trust-region"`` eliminates
    the motion and needs far fewer steps. Moments are divided by the length at which rotational and
    translational stiffnesses of the start are equal.
    """

    max_iterations: int = 2000
    tolerance: float = 1e-10
    solver: str = "alternating"

    SOLVERS: ClassVar[tuple[str, ...]] = ("alternating", "trust-region")
    name: ClassVar[str] = _NAME
    reference: ClassVar[str] = "Farhat & Hemez 1993; Hemez, as in Bao, Wang & Cheng 2010"
    needs_exact: ClassVar[str] = (
        "tier 'reduced' does not compute the motion of all DOFs, which 'force-residual' needs;"
        " use tier 'sparse'"
    )

    def describe_obstacle(self, problem: Problem) -> str:
        """Return the number of DOFs whose motion is expanded with the model, as a sentence."""
        missing = describe_unmeasured(problem)
        if missing:
            missing += (
                ": their motion is expanded with the present model, whose errors it contains."
            )
        return f"{missing} {Method.describe_obstacle(self, problem)}".strip()

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x; the noise is estimated from the residual, equal everywhere."""
        self.check_priors(problem)
        check_unknowns(problem, self, priors=True)
        for part in problem.parts:
            _check(part)
        errors = [ForceResidual(_compliance(part), _level(part)) for part in problem.parts]
        residual = ResidualSet(tuple(errors))
        eliminated = ResidualSet(tuple(part.condensed_error for part in residual.errors))
        with monitor.stage(_NAME):
            try:
                least: ResidualSet[Any] = residual if self.is_plain else eliminated
                x, reason = self.iterate(problem, least, x, monitor)
            except Stopped:
                return Fit.without_jacobian(x, "stopped")
            note = _NOTE.format(_UNBOUNDED if self.is_plain else "")
            return make_unweighted_fit(
                problem, eliminated, x, reason, "spread of the force residual", note
            )


@dataclass(frozen=True, slots=True, eq=False)
class ForceResidual(LineResidual):
    """r = Z h - e_j with h expanded at the same point, and its derivatives with h held.

    Rows are divided by the square root of `compliance`, shape (N,): 1 for forces, the square of a
    length for moments; `level` is a further divisor. The least force for which the model moves as
    measured at the sensors is -C conj(P) S^-1 (h_A - h_X), with C the compliance, P = Z^-1 on the
    sensors and S = P^T C conj(P); the expanded motion is h_A plus the motion due to that force.
    """

    compliance: RealArray
    level: float
    name: str = _NAME

    @property
    def cache_key(self) -> RealArray:
        """Compliance and level."""
        return np.append(self.compliance, self.level)

    @property
    def condensed_error(self) -> ConstitutiveError:
        """The same sum of squares with the expanded motion eliminated, with exact derivatives."""
        return ConstitutiveError(None, self.level, self.compliance, _NAME)

    def partition(self, part: FRFPart) -> list[slice]:
        """Return the blocks of lines."""
        return part.partition(2 * len(part.rows) + (4 + part.n) * len(part.columns))

    @use_one_thread
    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return residual, shape (n_f, N, n_j), and derivatives, shape (n, n_f, N, n_j)."""
        system, unknowns, freq = part.solver.system, part.unknowns, part.frf.freq[lines]
        state = part.state(x)
        _, U, S, moved, c = adjoint_fields(part, state, freq, self.compliance)
        measured = part.frf.converted("receptance").values[lines] * part.sign
        misfit = U[part.rows].transpose(1, 0, 2) - measured
        force = -(moved.transpose(1, 0, 2) @ np.linalg.solve(S, misfit)).transpose(1, 0, 2)
        assert isinstance(part.solver, LineSolver)
        motion = U + part.solver.solve_forces(c, force, freq)
        slopes = unknowns.slopes(system, state, part.values(x), 2.0 * np.pi * freq)
        J = np.zeros((part.n, *force.shape), dtype=np.complex128)
        for d, (p, t) in enumerate(zip(unknowns.owner, unknowns.at, strict=True)):
            term = system.terms[t]
            J[p, term.row_index] += slopes[d][None, :, None] * term.times(motion[term.row_index])
        weight = 1.0 / (np.sqrt(self.compliance) * self.level)
        J *= part.coordinates.slope(x)[:, None, None, None] * weight[None, :, None, None]
        r = np.asarray(force * weight[:, None, None], dtype=np.complex128)
        return r.transpose(1, 0, 2), J.transpose(0, 2, 1, 3)


def _check(part: FRFPart) -> None:
    if QUANTITIES[part.frf.quantity] and part.frf.freq[0] == 0.0:
        raise DataError(
            f"{_NAME}: the 0 Hz line of {part.frf.quantity} holds no receptance; leave it out"
        )


def _compliance(part: FRFPart) -> RealArray:
    """Return 1 for forces, and for moments the square of a length."""
    # At that length the medians of rotational and translational stiffness are equal.
    system = part.solver.system
    turns = np.asarray(system.dofs.axes) >= 3
    if turns.all() or not turns.any():
        return np.ones(system.n)
    elastic = np.array([float(term.quantity == "stiffness") for term in system.terms])
    entries, rows = system.real_values(elastic), system.rows_of_entries()
    diagonal = np.zeros(system.n)
    is_diagonal = rows == system.indices
    diagonal[rows[is_diagonal]] = np.abs(entries[is_diagonal])
    positive = diagonal > 0.0
    rotational, translational = diagonal[turns & positive], diagonal[~turns & positive]
    squared = 1.0
    if rotational.size and translational.size:
        squared = float(np.median(rotational) / np.median(translational))
    return np.where(turns, squared, 1.0)


def _level(part: FRFPart) -> float:
    """Return the square root of the number of lines times references."""
    return float(np.sqrt(part.n_lines * len(part.columns)))
