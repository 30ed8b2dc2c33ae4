"""`ModalSpace`: a model in its modes; `Conversion`: its structural damping as poles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.control.ports import Port, port_matrix
from updyn.control.settings import MODAL_SPACE
from updyn.control.structure import CompiledStructure
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.kept_basis import begin_reduction
from updyn.dynamics.modes import modes
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.dynamics.reduction import Reduction
from updyn.errors import ModelError, SolverError
from updyn.group import LossTable
from updyn.linalg.solver import check_backend
from updyn.model import Model

__all__ = [
    "Conversion",
    "Lossy",
    "Matrices",
    "ModalProjection",
    "ModalSpace",
    "derivative_factors",
    "laplace_variable",
    "modal_space",
    "projection",
    "shared_projection",
]


#: A, B, C, D.
Matrices = tuple[RealArray, RealArray, RealArray, RealArray]
_TWO_PI = 2.0 * np.pi


class Conversion(Protocol):
    """A set of candidates from which `updyn.control.target` selects.

    An omitted candidate still contributes its static flexibility if the output is a displacement.
    """

    @property
    def name(self) -> str:
        """Name of the conversion."""

    @property
    def frequency(self) -> RealArray:
        """Natural frequency of each candidate in Hz, shape (n,)."""

    @property
    def always_kept(self) -> BoolArray:
        """Mask of candidates that are always kept: rigid-body motion."""

    def costs(self, freq: RealArray, level: RealArray) -> RealArray:
        """Return the largest change without each candidate relative to a level, shape (n,)."""

    def response(self, kept: BoolArray, freq: RealArray) -> ComplexArray:
        """Return the response with a selection of candidates, shape (n_f, n_y, n_u)."""

    def matrices(self, kept: BoolArray) -> Matrices:
        """Return real A, B, C, D with a selection of candidates."""


def laplace_variable(freq: RealArray) -> ComplexArray:
    """Return s = i omega at lines in Hz."""
    return np.asarray(2j * np.pi * freq, dtype=np.complex128)


def derivative_factors(powers: IndexArray, s: ComplexArray) -> ComplexArray:
    """Return s to the power (0, 1, 2) of each output, shape (n_f, n_y, 1)."""
    return np.asarray((s[:, None] ** powers)[:, :, None])


@dataclass(frozen=True, slots=True, eq=False)
class Lossy:
    """Structural damping of a group in real modes: phi^T (gamma K_e) phi in 1/s2, (r, r)."""

    name: str
    matrix: RealArray
    table: LossTable | None

    def relative(self, freq: RealArray) -> RealArray:
        """Return the factor at lines in Hz, shape (n_f,); constant beyond a table."""
        if self.table is None:
            return np.ones(len(freq))
        return self.table.at(np.clip(freq, self.table.freq[0], self.table.freq[-1]), self.name)


@dataclass(frozen=True, slots=True, eq=False)
class ModalSpace:
    """A structure in r real modes with phi^T M phi = 1.

    `omega` is in rad/s, ascending, 0 for the first `rigid` modes. `outputs` and `inputs`, shapes
    (n_y, r) and (n_u, r), are shapes at the ports. `viscous` is phi^T C phi in 1/s, positive
    semidefinite; `lossy` does not act on rigid-body modes. `solver`, a certified reduced model with
    these vectors, is valid at any line of the band.
    """

    omega: RealArray
    rigid: int
    outputs: RealArray
    inputs: RealArray
    viscous: RealArray
    lossy: tuple[Lossy, ...]
    source: str
    solver: ReducedSolver | None = None

    def __len__(self) -> int:
        return len(self.omega)

    @property
    def has_table(self) -> bool:
        """Whether a loss factor depends on frequency."""
        return any(part.table is not None for part in self.lossy)

    def structural(self, freq: float) -> RealArray:
        """Return phi^T D phi at a frequency in Hz, shape (r, r), in 1/s2, positive semidefinite."""
        return self.weighted_sum(lambda part: float(part.relative(np.array([freq]))[0]))

    def weighted_sum(self, weight: Callable[[Lossy], Any]) -> RealArray:
        """Return the weighted sum of the groups' matrices without negative eigenvalues, (r, r)."""
        total = np.zeros((len(self), len(self)))
        for part in self.lossy:
            total += weight(part) * part.matrix
        return nearest_semidefinite(total)

    def loss_factors(self) -> RealArray:
        """Return the loss factor of each mode by strain energy, shape (r,); 0 for rigid bodies."""
        out = np.zeros(len(self))
        for i in range(self.rigid, len(self)):
            lossy_energy = sum(
                float(p.relative(self.omega[[i]] / _TWO_PI)[0]) * p.matrix[i, i] for p in self.lossy
            )
            out[i] = lossy_energy / self.omega[i] ** 2 + self.viscous[i, i] / self.omega[i]
        return out


def nearest_semidefinite(A: RealArray) -> RealArray:
    """Return the nearest positive semidefinite matrix (Higham 1988)."""
    A = 0.5 * (A + A.T)
    values, vectors = np.linalg.eigh(A)
    if not len(values) or values[0] >= 0.0:
        return A
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


@dataclass(frozen=True, slots=True, eq=False)
class ModalProjection:
    """A model on the relevant basis vectors between some ports in a band, for any of its states.

    `matrices` are the terms of `system` on the basis, each of shape (r, r); `outputs` and `inputs`,
    shapes (n_y, r) and (n_u, r), are the basis at the ports; `band` is in Hz.
    """

    system: AffineSystem
    matrices: tuple[RealArray, ...]
    outputs: RealArray
    inputs: RealArray
    rigid: int
    band: tuple[float, float]
    source: str
    solver: ReducedSolver | None

    def combine(self, state: State, quantity: str) -> RealArray:
        """Return the stiffness, mass or total viscous damping of a state, shape (r, r)."""
        total = np.zeros_like(self.matrices[0])
        for term, matrix, factor, rate in zip(
            self.system.terms, self.matrices, state.factor, state.rate, strict=True
        ):
            if term.quantity == quantity:
                total += factor * matrix
            elif quantity == "viscous" and rate:
                total += factor * rate * matrix
        return total

    def space(self, state: State) -> ModalSpace:
        """Return the modes of a state; raises ModelError for an indefinite stiffness."""
        rigid = self.rigid
        omega, shapes = _modes(
            self.combine(state, "stiffness"), self.combine(state, "mass"), rigid, self.band
        )
        lossy = []
        for term, matrix, factor, loss in zip(
            self.system.terms, self.matrices, state.factor, state.loss, strict=True
        ):
            if loss:
                damping = shapes.T @ (factor * loss * matrix) @ shapes
                # A rigid-body motion has no strain: these entries are rounding.
                damping[:rigid] = 0.0
                damping[:, :rigid] = 0.0
                lossy.append(Lossy(term.group, damping, term.table))
        viscous = nearest_semidefinite(shapes.T @ self.combine(state, "viscous") @ shapes)
        solver = self.solver
        if solver is not None:
            solver = replace(solver, system=replace(solver.system, start=state))
        return ModalSpace(
            omega,
            rigid,
            self.outputs @ shapes,
            self.inputs @ shapes,
            viscous,
            tuple(lossy),
            self.source,
            solver,
        )


def modal_space(
    model: Model,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    band: tuple[float, float],
) -> ModalSpace:
    """Return the relevant modes of a model between some ports in a band."""
    structure = CompiledStructure.of(model)
    found = projection(structure, inputs, outputs, band)
    return found.space(structure.system.start)


def projection(
    structure: CompiledStructure,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    band: tuple[float, float],
    *,
    backend: str | None = None,
) -> ModalProjection:
    """Return a model on the relevant basis vectors between some ports, as `modal_space`."""
    return _Projector(structure, inputs, outputs, band).at_start(backend)


def shared_projection(
    structure: CompiledStructure,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    band: tuple[float, float],
    training: Sequence[State],
    states: Sequence[State],
    *,
    backend: str | None = None,
) -> tuple[ModalProjection, BoolArray]:
    """Return a model on one basis for several states, and for which of them it is accurate.

    The fields of the `training` states enrich the basis if it lacks them; its error at `states` is
    estimated from residuals. Other arguments as for `modal_space`.
    """
    making = _Projector(structure, inputs, outputs, band)
    if structure.system.n <= MODAL_SPACE.whole_dofs:
        return making.whole(), np.ones(len(states), dtype=np.bool_)
    reduction, _ = making.reduce(backend)
    accuracy = MODAL_SPACE.basis_accuracy
    lines = np.array(MODAL_SPACE.checked_shares) * band[1]
    lines = lines[lines >= band[0]]
    reduction.enrich(training[: MODAL_SPACE.enriching_states], lines)
    # An accurate basis is not enriched further.
    reduction.enrich(training[MODAL_SPACE.enriching_states :], lines, allowed=0.5 * accuracy)
    holds = reduction.residual_errors(states, lines) <= accuracy
    source = f"{reduction.basis.size} basis vectors of a reduced model, one basis for all members"
    return making.of(reduction, source), holds


@dataclass(frozen=True, slots=True, eq=False)
class _Projector:
    """The inputs of a projection."""

    structure: CompiledStructure
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    band: tuple[float, float]

    @property
    def model(self) -> Model:
        return self.structure.model

    @property
    def system(self) -> AffineSystem:
        return self.structure.system

    def at_start(self, backend: str | None) -> ModalProjection:
        if self.system.n <= MODAL_SPACE.whole_dofs:
            return self.whole()
        reduction, source = self.reduce(backend)
        return self.of(reduction, source)

    def whole(self) -> ModalProjection:
        matrices = []
        for term in self.system.terms:
            whole = np.zeros((self.system.n, self.system.n))
            local = term.local
            whole[np.ix_(term.rows, term.rows)] = (
                local if isinstance(local, np.ndarray) else local.toarray()
            )
            matrices.append(whole)
        eye = np.eye(self.system.n)
        source = f"all {self.system.n} DOFs of the model"
        rigid = _rigid_motions(self.model).shape[1]
        return self._build_projection(
            self.system, matrices, lambda dofs: eye[dofs], rigid, source, None
        )

    def reduce(self, backend: str | None) -> tuple[Reduction, str]:
        """Return the basis at the start, and its description."""
        (into, _), (out, _) = self._ports
        system, band, accuracy = self.system, self.band, MODAL_SPACE.basis_accuracy
        reduction = Reduction(system, out, into, band, check_backend(backend), accuracy)
        lines, structure = np.linspace(band[0], band[1], 400), self.structure
        begin_reduction(reduction, structure.source, structure.kept_basis, system.start, lines)
        found = reduction.certify(system.start, lines)
        # Rounding affects the model, too: no basis is free of it.
        lacking = found.error - found.rounding
        if lacking > accuracy:
            raise SolverError(
                f"plant: {found.size} basis vectors reach an error of {lacking:.1g} of the largest"
                f" receptance of a line; expected {accuracy:g}; narrow the band"
            )
        return (
            reduction,
            f"{found.size} basis vectors of a reduced model, error at most {found.error:.1g}",
        )

    def of(self, reduction: Reduction, source: str) -> ModalProjection:
        solver, basis = reduction.solver("plant"), reduction.basis
        return self._build_projection(
            solver.system, basis.terms, basis.at, self._count_rigid(reduction), source, solver
        )

    def _count_rigid(self, reduction: Reduction) -> int:
        """Return the number of rigid-body motions in a basis, at least those seen at the ports."""
        slow = max(self.band[0], MODAL_SPACE.slow_share * self.band[1])
        if reduction.shifted.count_modes_below(self.system.start, slow) == 0:
            return 0
        lacking = reduction.measure_outside(self.system.start, _rigid_motions(self.model))
        return int((lacking < MODAL_SPACE.slow_share**2).sum())

    @property
    def _ports(self) -> tuple[tuple[IndexArray, RealArray], tuple[IndexArray, RealArray]]:
        return (
            port_matrix(self.inputs, self.model, "input"),
            port_matrix(self.outputs, self.model, "output"),
        )

    def _build_projection(
        self,
        system: AffineSystem,
        matrices: Sequence[RealArray],
        at: Callable[[IndexArray], RealArray],
        rigid: int,
        source: str,
        solver: ReducedSolver | None,
    ) -> ModalProjection:
        (into, weights_in), (out, weights_out) = self._ports
        return ModalProjection(
            system,
            tuple(matrices),
            weights_out @ at(out),
            weights_in @ at(into),
            rigid,
            self.band,
            source,
            solver,
        )


def _rigid_motions(model: Model) -> RealArray:
    """Return the rigid-body modes, shape (N, r), with unit modal mass."""
    n = 8
    while True:
        try:
            found = modes(model, n)
        except ModelError:  # the model has fewer modes: try one less
            n -= 1
            if n == 0:
                raise
            continue
        rests = found.frequency == 0.0
        if not rests.all() or n == model.n_dofs:
            return np.asarray(found.shapes[:, rests])
        n = min(2 * n, model.n_dofs)


def _modes(
    K: RealArray, M: RealArray, rigid: int, band: tuple[float, float]
) -> tuple[RealArray, RealArray]:
    """Return frequencies in rad/s and shapes; the first `rigid` frequencies are 0."""
    top = (_TWO_PI * band[1]) ** 2
    P = K + top * M
    try:
        share, shapes = scipy.linalg.eigh(
            top * M, P
        )  # share = top / (lambda + top): 1 at rest, 0 without mass
    except scipy.linalg.LinAlgError as error:
        raise ModelError(
            "plant: a motion has neither stiffness nor mass, or a negative one"
        ) from error
    share, shapes = share[::-1], shapes[:, ::-1]
    if share[0] > 1.0 + MODAL_SPACE.unstable_share:
        raise ModelError(
            f"plant: the stiffness is indefinite (omega^2 = {top * (1.0 / share[0] - 1.0):.3g} 1/s2"
            " of a mode): the structure is unstable and has no stable plant"
        )
    least = 1.0 / (1.0 + MODAL_SPACE.massless_factor**2)
    share = np.clip(share, least, 1.0)
    square = top * (1.0 / share - 1.0)
    square[:rigid] = 0.0
    shapes = shapes * np.sqrt(top / share)  # phi^T (K + top M) phi = lambda + top
    return np.sqrt(square), shapes
