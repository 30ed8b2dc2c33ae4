"""Response function method with full coordinates (Lin & Ewins 1990, 1994)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError
from updyn.frf import QUANTITIES
from updyn.linalg.threads import use_one_thread
from updyn.model import GROUP_QUANTITIES
from updyn.sensitivity import contract
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods.linear import (
    check_unknowns,
    describe_unmeasured,
    make_unweighted_fit,
)
from updyn.updating.fit.methods.published import PublishedMethod
from updyn.updating.fit.monitor import Monitor
from updyn.updating.problem.noise import NoiseModel, level_by_unit
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LineResidual
from updyn.updating.problem.session import Stopped

__all__ = [
    "ComplexResponseFunctionMethod",
    "ResponseEquation",
    "ResponseFunctionMethod",
]


_NOTE = (
    "Both sides of its equation contain the measured FRFs, so noise biases the estimate; the"
    " standard deviations do not include this bias. {}Use maximum likelihood for noisy data."
)
_UNBOUNDED = "The published iteration has no bounds. "


@dataclass(frozen=True, slots=True)
class ResponseFunctionMethod(PublishedMethod):
    """(h_A - h_X) = H_A dZ h_X with the measured column h_X of all DOFs (method ``"rfm"``).

    H_A - H_X = H_A (Z_X - Z_A) H_X holds for any size of change (Lin & Ewins, "Model updating using
    FRF data", 15th Int. Seminar on Modal Analysis, Leuven 1990, pp. 141-162; "Analytical model
    improvement using frequency response functions", Mech. Syst. Signal Process. 8 (1994) 437-458;
    eqs. 4-6 of Bao, Wang & Cheng 2010). With dZ = sum of K_e dkappa_e - omega^2 M_e dmu_e it is
    linear in the unknowns, and repeated because H_A, its weight, changes with the model. Damping is
    not updated (see ``"complex-rfm"``).

    With `expand`, DOFs without a sensor take the model's motion, and only measured rows are used
    (Lin & Ewins 1994; Imregun, Visser & Ewins, Mech. Syst. Signal Process. 9 (1995) 187-202). The
    equation is then not linear, and the iteration may diverge or converge to another point.
    """

    max_iterations: int = 300
    tolerance: float = 1e-10
    solver: str = "gauss-newton"
    expand: bool = False

    SOLVERS: ClassVar[tuple[str, ...]] = ("gauss-newton", "trust-region")
    name: ClassVar[str] = "rfm"
    label: ClassVar[str] = "response function equation"
    reference: ClassVar[str] = "Lin & Ewins 1990, 1994"
    needs: ClassVar[str] = "every DOF measured (or expand = true)"
    needs_exact: ClassVar[str] = (
        "tier 'reduced' does not compute the motion of all DOFs, which 'rfm' needs; use tier"
        " 'sparse'"
    )
    cannot: ClassVar[tuple[str, ...]] = tuple(
        q for q in GROUP_QUANTITIES if q not in ("stiffness", "mass")
    )
    instead: ClassVar[str] = "leave it out, or use 'complex-rfm' for loss factors"

    def describe_obstacle(self, problem: Problem) -> str:
        """Return the number of DOFs whose motion is taken from the model, as a sentence."""
        missing = describe_unmeasured(problem)
        if missing:
            missing += ": their motion is that of the present model."
        return f"{missing} {Method.describe_obstacle(self, problem)}".strip()

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x; the noise is estimated from the residual, equal everywhere."""
        self.check_priors(problem)
        check_unknowns(problem, self, priors=True)
        residual = ResponseEquation(self.name, self.expand)
        for part in problem.parts:
            residual.check(part)
        with monitor.stage(self.name):
            try:
                x, reason = self.iterate(problem, residual, x, monitor)
            except Stopped:
                return Fit.without_jacobian(x, "stopped")
            note = _NOTE.format(_UNBOUNDED if self.is_plain else "")
            return make_unweighted_fit(
                problem, residual, x, reason, "spread of the response function equation", note
            )


@dataclass(frozen=True, slots=True)
class ResponseEquation(LineResidual):
    """r = (H_A - H_X) / level, with derivatives -H_A Z' h_X that contain the measured motion.

    Receptances are divided by the rms of the measured receptances of the same unit (translation or
    rotation, of motion and of force). With `expand`, unmeasured DOFs take the model's motion.
    """

    name: str
    expand: bool = False

    @property
    def cache_key(self) -> str:
        """Whether unmeasured motion is expanded."""
        return f"expand={self.expand}"

    def check(self, part: FRFPart) -> None:
        """Raise DataError if a DOF was not measured, or the data hold no receptance at 0 Hz."""
        if QUANTITIES[part.frf.quantity] and part.frf.freq[0] == 0.0:
            raise DataError(
                f"{self.name}: the 0 Hz line of {part.frf.quantity} holds no receptance; leave"
                " it out"
            )
        missing = np.setdiff1d(np.arange(part.solver.system.n), part.rows)
        if missing.size and not self.expand:
            dofs = part.solver.system.dofs
            shown = ", ".join(str(dofs[int(i)]) for i in missing[:5]) + (
                ", ..." if missing.size > 5 else ""
            )
            raise DataError(
                f"{self.name} needs the motion of all {part.solver.system.n} DOFs of the model;"
                f" {missing.size} were not measured ({shown}). Use a method that condenses the"
                " model, such as 'equation-error' or the default, or expand=True, which takes the"
                " missing motion from the model"
            )

    @use_one_thread
    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return residual, shape (n_f, n_i, n_j), and derivatives, shape (n, n_f, n_i, n_j)."""
        solver, system, values = part.solver, part.solver.system, part.values(x)
        freq, omega, state = (
            part.frf.freq[lines],
            2.0 * np.pi * part.frf.freq[lines],
            part.state(x),
        )
        measured = part.frf.converted("receptance")
        h = measured.values[lines] * part.sign
        loaded, place = np.unique(np.concatenate([part.rows, part.columns]), return_inverse=True)
        fields = solver.solve(system.coefficients(state, omega), loaded, freq)
        V, U = fields[:, :, place[: len(part.rows)]], fields[:, :, place[len(part.rows) :]]
        motion = U.copy()
        motion[part.rows] = h.transpose(1, 0, 2)
        slopes = -part.unknowns.slopes(system, state, values, omega)
        weight = 1.0 / level_by_unit(measured)
        J = contract(system, part.unknowns, slopes, V, motion)
        J *= part.coordinates.slope(x)[:, None, None, None] * weight
        return weight * (solver.at(U, part.rows).transpose(1, 0, 2) - h), J


@dataclass(frozen=True, slots=True)
class ComplexResponseFunctionMethod(ResponseFunctionMethod):
    """(h_A - h_X) = H_A dZ h_X with complex stiffness K_e (1 + i gamma_e) (``"complex-rfm"``).

    The response function method with structural damping among its unknowns (Lin & Zhu, "Model
    updating of damped structures using FRF data", Mech. Syst. Signal Process. 20 (2006) 2200-2218).
    Real rows are stacked on imaginary ones. The unknowns are the real and the imaginary part of
    kappa_e (1 + i gamma_e), in which Z is linear; in the trust region kappa_e and gamma_e. Viscous
    dampers of the model keep their values.
    """

    max_iterations: int = 300
    tolerance: float = 1e-10
    solver: str = "gauss-newton"
    expand: bool = False

    name: ClassVar[str] = "complex-rfm"
    label: ClassVar[str] = "response function equation, complex stiffnesses"
    needs_exact: ClassVar[str] = (
        "tier 'reduced' does not compute the motion of all DOFs, which 'complex-rfm' needs; use"
        " tier 'sparse'"
    )
    reference: ClassVar[str] = "Lin & Zhu 2006"
    cannot: ClassVar[tuple[str, ...]] = tuple(
        q for q in ResponseFunctionMethod.cannot if q != "loss_factor"
    )
    instead: ClassVar[str] = "its damping is structural; leave it out, or use the default"
