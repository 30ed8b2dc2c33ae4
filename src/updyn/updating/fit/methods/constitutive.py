"""Modified error in the constitutive relations (Ladeveze et al. 1994; Deraemaeker et al. 2002)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import LineSolver
from updyn.errors import DataError, OptionError
from updyn.frf import QUANTITIES
from updyn.linalg.threads import use_one_thread
from updyn.sensitivity import Unknowns, contract
from updyn.updating.fit.method import Fit, Method, descend_to_scale
from updyn.updating.fit.methods.linear import linearise, make_unweighted_fit
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LineResidual, ResidualSet
from updyn.updating.problem.session import Stopped

__all__ = [
    "ConstitutiveError",
    "ConstitutiveMethod",
    "adjoint_fields",
    "constitutive_weights",
]


_NAME = "constitutive"
_NOTE = (
    "The error in the constitutive relations weights the data by the effect of model errors, not by"
    " noise, and its standard deviations assume an independent residual of equal size; use maximum"
    " likelihood for noisy data."
)


@dataclass(frozen=True, slots=True)
class ConstitutiveMethod(Method):
    """Error in the constitutive relations with a measurement term (method ``"constitutive"``).

    Fields u, v, w that balance the forces, K v - omega^2 M w = f, may violate the stress-strain
    relations (u - v) and the force-acceleration relations (u - w), and may differ from the
    measurement. The least such error,

        E = 1/2 |u - v|_K^2 + omega^2/2 |u - w|_M^2 + r / (1 - r) 1/2 |Pi u - h_X|_G^2,

    is summed over lines and references and minimised over the unknowns (Ladeveze, Nedjar & Reynier,
    AIAA J. 32 (1994) 1485; Deraemaeker, Ladeveze & Leconte, Comput. Methods Appl. Mech. Eng. 191
    (2002) 2427, whose form this is, here with damping; Banerjee, Walsh, Aquino & Bonnet, Comput.
    Methods Appl. Mech. Eng. 253 (2013) 60). The fields are eliminated exactly. `weight` is r, above
    0 and at most 1: near 0 this is the output error with fixed weights; at 1, with all DOFs
    measured, the equation error in the norm of the energy.
    """

    weight: float = 0.5
    max_iterations: int = 100
    tolerance: float = 1e-10

    name: ClassVar[str] = _NAME
    reference: ClassVar[str] = (
        "Ladeveze, Nedjar & Reynier 1994; Deraemaeker, Ladeveze & Leconte 2002"
    )
    needs_exact: ClassVar[str] = (
        "tier 'reduced' does not compute the fields of all DOFs, whose energy 'constitutive' needs;"
        " use tier 'sparse'"
    )

    def __post_init__(self) -> None:
        if not 0.0 < self.weight <= 1.0:
            raise OptionError(
                f"weight {self.weight:g}: the weight of the measurement is above 0 and at most 1",
                key=("weight",),
            )

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x; the noise is estimated from the residual, equal everywhere."""
        with monitor.stage(_NAME):
            try:
                residual = ResidualSet(
                    tuple(_make_residual(part, self.weight) for part in problem.parts)
                )
                linearise(problem, residual, x)  # raises an error that names the line if singular
                settings = TrustRegion(self.max_iterations, self.tolerance)
                outcome = descend_to_scale(problem, residual, x, monitor, settings)
            except Stopped:
                return Fit.without_jacobian(x, "stopped")
            kind = "spread of the error in the constitutive relations"
            return make_unweighted_fit(problem, residual, outcome.x, outcome.reason, kind, _NOTE)


@dataclass(frozen=True, slots=True, eq=False)
class ConstitutiveError(LineResidual):
    """r = L^-1 (h - h_X), L L^H = S + slack; half its square is the error E by line and reference.

    `slack`, shape (n_f, n_i), is (1 - r) / r / G in m/N, the accepted squared difference from the
    measurement over energy; None for 0. `level` makes the residual the size of a relative misfit.
    `compliance`, shape (N,), replaces W: the error is then one of forces.

    With coefficients c_t of Z = sum c_t A_t the error in the relations of each matrix is measured
    in the energy of a_t A_t (a = kappa, omega^2 mu, omega c), and W = sum |c_t|^2 / a_t A_t.
    Stationarity gives

        Z u - W lambda = f,    Z^H lambda = -G Pi^T (Pi u - h_X).

    With P = Z^-1 Pi^T and S = P^T W conj(P), the misfit of the model's h is h - h_X = (1 + S G) d,
    and E = 1/2 (h - h_X)^H (S + 1/G)^-1 (h - h_X). Derivatives use adjoint fields: P and
    Y = Z^-1 W conj(P) serve all unknowns, S' = P^T W' conj(P) - P^T Z' Y - (P^T Z' Y)^H, and
    dr = L^-1 (h' - 1/2 S' (S + 1/G)^-1 (h - h_X)) up to a rotation that changes neither E nor its
    derivatives.
    """

    slack: RealArray | None
    level: float
    compliance: RealArray | None = None
    name: str = _NAME

    @property
    def cache_key(self) -> RealArray:
        """Level, slack and compliance."""
        parts = [np.ravel(a) for a in (self.slack, self.compliance) if a is not None]
        return np.concatenate([[self.level], *parts])

    def on(self, part: FRFPart, lines: slice) -> Self:
        """Return the residual with the slack of a block of lines."""
        if self.slack is None:
            return self
        return replace(self, slack=self.slack[lines])

    def partition(self, part: FRFPart) -> list[slice]:
        """Return the blocks of lines."""
        n_i = len(part.rows)
        return part.partition(
            4 * n_i + len(part.columns) + part.n * n_i * n_i // part.solver.system.n
        )

    @use_one_thread
    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return residual, shape (n_f, n_i, n_j), and derivatives, shape (n, n_f, n_i, n_j)."""
        system, unknowns, values = part.solver.system, part.unknowns, part.values(x)
        freq, state = part.frf.freq[lines], part.state(x)
        omega = 2.0 * np.pi * freq
        P, U, S, moved, c = adjoint_fields(part, state, freq, self.compliance)
        measured = part.frf.converted("receptance").values[lines] * part.sign
        misfit = U[part.rows].transpose(1, 0, 2) - measured
        slopes = unknowns.slopes(system, state, values, omega)
        assert isinstance(part.solver, LineSolver)
        Y = part.solver.solve_forces(c, moved, freq)
        crossed = contract(system, unknowns, slopes, P, Y)
        change = -(crossed + crossed.conj().swapaxes(2, 3))
        if self.compliance is None:
            weights = _weight_slopes(system, unknowns, c, slopes).astype(np.complex128)
            change += contract(system, unknowns, weights, P, P.conj())
        C = S.copy()
        if self.slack is not None:
            at = np.arange(C.shape[1])
            C[:, at, at] += self.slack
        L = np.linalg.cholesky(C)
        r = np.linalg.solve(L, misfit)
        J = contract(system, unknowns, -slopes, P, U)
        J -= 0.5 * (change @ np.linalg.solve(C, misfit))
        J *= (part.coordinates.slope(x) / self.level)[:, None, None, None]
        return np.asarray(r / self.level), np.asarray(np.linalg.solve(L, J))


def adjoint_fields(
    part: FRFPart, state: State, freq: RealArray, compliance: RealArray | None = None
) -> tuple[ComplexArray, ComplexArray, ComplexArray, ComplexArray, ComplexArray]:
    """Return P, U, S, W conj(P) and c: fields of unit forces, in m/N, and their products with W.

    P, shape (N, n_f, n_i), is the motion for forces on responses; U, shape (N, n_f, n_j), on
    references. S = P^T W conj(P), shape (n_f, n_i, n_i), is Hermitian; c, shape (n_terms, n_f), are
    the coefficients of Z. `compliance`, shape (N,), is the diagonal of W, by default that of the
    constitutive relations.
    """
    system = part.solver.system
    c, w = constitutive_weights(system, state, 2.0 * np.pi * freq)
    loaded, place = np.unique(np.concatenate([part.rows, part.columns]), return_inverse=True)
    fields = part.solver.solve(c, loaded, freq)
    n_i = len(part.rows)
    P, U = fields[:, :, place[:n_i]], fields[:, :, place[n_i:]]
    if compliance is None:
        moved = np.zeros_like(P)
        for t, term in enumerate(system.terms):
            moved[term.row_index] += w[t][None, :, None] * term.times(P[term.row_index].conj())
    else:
        moved = compliance[:, None, None] * P.conj()
    S = np.einsum("nfi,nfk->fik", P, moved)
    return P, U, 0.5 * (S + S.conj().swapaxes(1, 2)), moved, c


def _weight_slopes(
    system: AffineSystem, unknowns: Unknowns, c: ComplexArray, slopes: ComplexArray
) -> RealArray:
    """Return the derivatives of the drives' weights in W, shape (n_d, n_f)."""
    drive_coefficients = c[unknowns.at]
    elastic = np.array(
        [system.terms[t].quantity == "stiffness" for t in unknowns.at], dtype=np.bool_
    )[:, None]
    size = np.where(elastic, np.abs(drive_coefficients.real), np.abs(drive_coefficients))
    safe = np.where(size > 0.0, size, 1.0)
    change = (drive_coefficients.conj() * slopes).real
    scale = np.where(elastic, np.sign(drive_coefficients.real) * slopes.real, change / safe)
    return np.asarray(2.0 * change / safe - np.abs(drive_coefficients) ** 2 * scale / safe**2)


def _make_residual(part: FRFPart, weight: float) -> ConstitutiveError:
    """Return the residual whose slack is proportional to S at the start of the unknowns.

    Raises DataError if the data hold no receptance at 0 Hz.
    """
    if QUANTITIES[part.frf.quantity] and part.frf.freq[0] == 0.0:
        raise DataError(
            f"{_NAME}: the 0 Hz line of {part.frf.quantity} holds no receptance; leave it out"
        )
    blank = ConstitutiveError(np.zeros((len(part.frf.freq), len(part.rows))), 1.0)
    spread = np.concatenate(
        list(part.map_lines(_diagonal, [(lines,) for lines in blank.partition(part)]))
    )
    spread = np.maximum(spread, np.finfo(float).tiny)
    size = np.abs(part.frf.converted("receptance").values) ** 2
    level = float(np.sqrt(np.mean(size / spread[:, :, None]))) or 1.0
    return ConstitutiveError((1.0 - weight) / weight * spread, level)


def _diagonal(part: FRFPart, item: tuple[slice]) -> RealArray:
    x = part.coordinates.start
    S = adjoint_fields(part, part.state(x), part.frf.freq[item[0]])[2]
    return np.asarray(np.einsum("fii->fi", S).real)


def constitutive_weights(
    system: AffineSystem, state: State, omega: RealArray
) -> tuple[ComplexArray, RealArray]:
    """Return the coefficients of Z and of the energy norm W, shapes (n_terms, n_f)."""
    # W = sum of w_t A_t with w = |c|^2 over kappa (stiffness), omega^2 mu (mass), omega c
    # (viscous). With an energy of u - v weighted by kappa K, stresses (1 + i gamma) kappa K v
    # differ from those of u by W lambda.
    c = system.coefficients(state, omega)
    elastic = np.array([term.quantity == "stiffness" for term in system.terms])[:, None]
    scale = np.where(elastic, np.abs(c.real), np.abs(c))
    return c, np.asarray(np.abs(c) ** 2 / np.where(scale > 0.0, scale, 1.0))
