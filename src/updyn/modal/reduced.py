"""`ReducedModes`: modes of a large model in a basis that grows wherever they are not accurate.

Basis. The rigid-body modes and the modes of the full model at the start. Where modes are not
accurate enough, P^-1 r is added for each of their residuals r = (K - lambda M) phi, with P = K +
s M factorised there (Davidson, J. Comput. Phys. 17 (1975) 87). If shapes are measured, the basis of
the start has their static derivatives, P^-1 (K' - lambda M') phi, too. The vectors of earlier
points serve later ones, so that few points need a factorisation.

Error. With nu = 1 / (lambda + s), P^-1/2 M P^-1/2 has the eigenvalues nu, and the residual of phi
of unit modal mass is, relative to nu,

    rho = |r| / sqrt(lambda + s),    |r|^2 = r^T P^-1 r.

The angle between the spans of exact and computed shapes of a cluster is at most rho / gap, with the
relative distance gap = |lambda' - lambda| / (lambda' + s) to the nearest other mode (Davis & Kahan,
SIAM J. Numer. Anal. 7 (1970) 1); within the cluster, shapes also turn by rho^2 / (gap own gap). The
relative error of a frequency is at most (lambda + s) / (2 lambda) rho^2 / gap (Parlett, The
Symmetric Eigenvalue Problem (1998), theorem 11.7.1). As group matrices are positive semidefinite,
P of another state is at least P times the smallest ratio of their factors (Prud'homme et al., J.
Fluids Eng. 124 (2002) 70), so that the factorised P of one point serves others. Sylvester's law of
inertia shows modes that the basis misses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from updyn.arrays import BoolArray, RealArray
from updyn.dynamics import eigen
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.basis import Basis
from updyn.dynamics.shifted import Shifted
from updyn.linalg.solver import Factorised
from updyn.linalg.threads import use_one_thread
from updyn.modal.sensitivity import CompleteBasis, RealModes, assemble, derivative_forces
from updyn.modal.settings import MODE_DERIVATIVE, MODE_REDUCTION
from updyn.sensitivity import Unknowns

__all__ = ["ModeErrors", "ReducedModes"]


@dataclass(frozen=True, slots=True, eq=False)
class ModeErrors:
    """Bounds of the relative errors of modes, shape (n,), and P^-1 r as columns, (N, n).

    `gap`, shape (n,), is the relative distance of a mode's cluster to the nearest other mode.
    """

    shape: RealArray
    frequency: RealArray
    gap: RealArray
    correction: RealArray


@dataclass(slots=True, eq=False)
class ReducedModes:
    """Modes of a model at any state of its unknowns, in a basis common to all states."""

    #: The compiled model.
    system: AffineSystem
    #: Terms that the unknowns drive.
    unknowns: Unknowns
    #: Permitted error of a shape relative to its size, in the norm of P; the error of a frequency
    #: is of the order of its square.
    accuracy: float
    #: Sparse factorisation.
    backend: str
    #: Whether the basis has to represent derivatives of shapes, too.
    for_shapes: bool = False
    #: Number of changes of the basis and of the factorised P.
    n_changes: int = field(default=0, init=False)
    _basis: Basis | None = field(default=None, init=False)
    _shifted: Shifted = field(init=False)
    _stack: RealArray = field(init=False)
    _n_rigid: int = field(default=0, init=False)
    _reference: tuple[Factorised, State] | None = field(default=None, init=False)
    _enriched: tuple[State, int] | None = field(default=None, init=False)
    _has_derivatives: bool = field(default=False, init=False)

    @property
    def size(self) -> int:
        """Number of basis vectors."""
        return 0 if self._basis is None else self._basis.size

    @property
    def factorisations(self) -> int:
        """Number of factorisations of the full model by the reduction."""
        return self._shifted.count if self.size else 0

    @use_one_thread
    def lowest(self, state: State, n: int, highest: float) -> RealModes:
        """Return the lowest `n` modes at a state, and more up to `highest` in Hz, not certified."""
        if self._basis is None:
            self._begin(RealModes.lowest(self.system, state, n, highest), state)
        assert self._basis is not None
        r = self.size
        k, m = (
            (self._weights(state, quantity) @ self._stack).reshape(r, r)
            for quantity in ("stiffness", "mass")
        )
        # All groups leave rigid-body motions free; other values are rounding.
        k[: self._n_rigid] = k[:, : self._n_rigid] = 0.0
        _, _, (C, stiffness, mass) = eigen.all_dense_pairs(k, m, min(n + self._n_rigid, r))
        elastic = np.flatnonzero(mass > 0.0)[::-1][self._n_rigid :]
        value = stiffness[elastic] / mass[elastic]
        number = max(n, int(np.searchsorted(value, (2.0 * np.pi * highest) ** 2)) + 1)
        kept = elastic[:number]
        shapes = self._basis.expand(C[:, kept] / np.sqrt(mass[kept]))
        rigid = self._basis.blocks[0][:, : self._n_rigid]
        K, M = (assemble(self.system, state, quantity) for quantity in ("stiffness", "mass"))
        whole = CompleteBasis(self._basis.blocks, C, stiffness, mass)
        return RealModes(K, M, value[:number], shapes, rigid, complete=False, whole=whole)

    @use_one_thread
    def certify_or_enrich(
        self, state: State, values: RealArray, modes: RealModes, number: int
    ) -> bool:
        """Certify the lowest `number` modes and return True, or enrich the basis and return False.

        `modes` are those of `lowest` at the state, and `values` the unknowns. If repeated
        enrichment fails, modes of the full model are added and accepted.
        """
        if self.for_shapes and not self._has_derivatives:
            self._add_shape_derivatives(state, values, modes, number)
            return False
        errors = self.bound_errors(modes, state, number)
        bad = self._find_inaccurate(errors, modes)
        if bad.any() and not self._is_reference(state):
            self._factorise(state)
            errors = self.bound_errors(modes, state, number)
            bad = self._find_inaccurate(errors, modes)
        tries = self._count_tries(state)
        if tries > MODE_REDUCTION.most_tries or not bad.any():
            if 0 < tries <= MODE_REDUCTION.most_tries and not self._has_all(state, modes, number):
                self._add_full_modes(state, modes)
                return False
            self._enriched = None
            return True
        if tries == MODE_REDUCTION.most_tries:
            self._add_full_modes(state, modes)
            return False
        self._enriched = state, tries + 1
        self._append(errors.correction[:, bad])
        if self.size > MODE_REDUCTION.most_vectors:
            self._restart(modes)
        return False

    def add(self, modes: RealModes) -> None:
        """Add modes of the full model to the basis."""
        self._append(modes.shapes)

    # -- basis ---------------------------------------------------------------------------------
    def _begin(self, modes: RealModes, state: State) -> None:
        self._shifted = Shifted(self.system, float(modes.value[0]), self.backend)
        self._basis = Basis(self.system, self._shifted.find_dof_scale(state))
        self._restart(modes)

    def _restart(self, modes: RealModes) -> None:
        """Begin the basis anew with some modes."""
        assert self._basis is not None
        self._basis = Basis(self.system, self._basis.weight)
        if modes.rigid.shape[1]:
            self._basis.append(modes.rigid.copy())
        self._n_rigid, self._has_derivatives = self._basis.size, False
        self._append(modes.shapes)

    def _append(self, X: RealArray) -> None:
        assert self._basis is not None
        self._basis.append(X.copy())
        self._stack = np.stack([A.ravel() for A in self._basis.terms])
        self.n_changes += 1

    def _add_full_modes(self, state: State, modes: RealModes) -> None:
        """Add the modes of the full model at a state, which are then accepted."""
        highest = float(np.sqrt(modes.value[-1])) / (2.0 * np.pi)
        self.add(RealModes.lowest(self.system, state, len(modes.value), highest))
        self._enriched = state, MODE_REDUCTION.most_tries + 1

    def _add_shape_derivatives(
        self, state: State, values: RealArray, modes: RealModes, number: int
    ) -> None:
        """Add the static derivatives of shapes, twice iterated, as far as the basis lacks them."""
        self._has_derivatives = True
        factorised, _ = self._reference_at(state)
        shifted = modes.value[:number] + self._shifted.top
        for forces in self._derivative_forces(values, modes, number):
            F = forces / np.sqrt(shifted)
            for _ in range(MODE_REDUCTION.derivative_moments):
                missing, square = self._deflate(state, factorised.solve(np.asfortranarray(F)), F)
                F = shifted * (modes.M @ missing)
                self._append(_principal(missing, square))

    def _deflate(self, state: State, D: RealArray, F: RealArray) -> tuple[RealArray, RealArray]:
        """Return the part of D = P^-1 F that the basis lacks, X, and X^T P X."""
        assert self._basis is not None
        P = self._basis.weighted_sum(self._shifted.weights(state, -self._shifted.top))
        forces = self._basis.project(F)
        coordinates = scipy.linalg.solve(P, forces, assume_a="pos")
        return D - self._basis.expand(coordinates), D.T @ F - coordinates.T @ forces

    def _derivative_forces(
        self, values: RealArray, modes: RealModes, number: int
    ) -> Iterator[RealArray]:
        """Yield (K' - lambda M') phi by the logarithm of each unknown, shape (N, n)."""
        lead, square = modes.shapes[:, :number], modes.value[:number]
        forces: dict[int, RealArray] = {}
        for owner, rows, force, is_mass in derivative_forces(
            self.system, self.unknowns, values, lead
        ):
            total = forces.setdefault(owner, np.zeros_like(lead))
            total[rows] += values[owner] * (-square * force if is_mass else force)
        yield from forces.values()

    # -- error ---------------------------------------------------------------------------------
    def bound_errors(self, modes: RealModes, state: State, number: int) -> ModeErrors:
        """Return bounds of the errors of the lowest `number` modes at a state.

        If P was factorised at another state, its bounds are larger.
        """
        lead = modes.shapes[:, :number]
        residual = modes.K @ lead - (modes.M @ lead) * modes.value[:number]
        factorised, factorised_at = self._reference or self._factorise(state)
        share = _smallest_ratio(state, factorised_at)
        if share < MODE_REDUCTION.least_ratio:
            inaccurate = np.full(number, np.inf)
            return ModeErrors(inaccurate, inaccurate, np.ones(number), np.zeros_like(residual))
        correction = factorised.solve(np.asfortranarray(residual))
        shifted = modes.value[:number] + self._shifted.top
        square = np.maximum(np.einsum("in,in->n", residual, correction), 0.0) / (share * shifted)
        energy, gap, own_gap = np.zeros((3, number))
        for cluster, distance in _clusters(modes.value, number, self._shifted.top):
            energy[cluster], gap[cluster] = square[cluster].sum(), distance
            own_gap[cluster] = _own_gaps(modes.value[cluster], self._shifted.top)
        shape = np.sqrt(energy) / gap + energy / (gap * own_gap)
        frequency = 0.5 * energy / gap * shifted / modes.value[:number]
        return ModeErrors(shape, frequency, gap, correction)

    def _find_inaccurate(self, errors: ModeErrors, modes: RealModes) -> BoolArray:
        """Return a mask of the modes whose error is more than permitted and than rounding."""
        bad = ~(errors.shape <= self.accuracy)
        if bad.any():
            rounding = modes.rounding[: len(bad)] / errors.gap
            bad &= ~(errors.shape <= self.accuracy + rounding)
        return bad

    def _count_tries(self, state: State) -> int:
        """Return the number of enrichments at this state so far."""
        if self._enriched is None or not _is_same(self._enriched[0], state):
            return 0
        return self._enriched[1]

    def _has_all(self, state: State, modes: RealModes, number: int) -> bool:
        """Return whether no mode is missed, up to the gap after the last accurate one."""
        if len(modes.value) == number:
            return True
        between = 0.5 * (modes.value[number - 1] + modes.value[number])
        frequency = float(np.sqrt(between)) / (2.0 * np.pi)
        below = self._shifted.count_modes_below(state, frequency)
        self._reference = None
        return below is None or below == number + self._n_rigid

    def _factorise(self, state: State) -> tuple[Factorised, State]:
        self._reference, self.n_changes = None, self.n_changes + 1
        factorised = self._shifted.factorise(
            state, -self._shifted.top, error=MODE_REDUCTION.solution_error
        )
        self._reference = factorised, state
        return self._reference

    def _reference_at(self, state: State) -> tuple[Factorised, State]:
        if self._reference is None or not self._is_reference(state):
            return self._factorise(state)
        return self._reference

    def _is_reference(self, state: State) -> bool:
        return self._reference is not None and _is_same(state, self._reference[1])

    def _weights(self, state: State, quantity: str) -> RealArray:
        is_quantity = np.array([term.quantity == quantity for term in self.system.terms])
        return np.asarray(is_quantity * state.factor)


def _clusters(value: RealArray, number: int, shift: float) -> Iterator[tuple[slice, float]]:
    """Yield clusters of the lowest modes, each with the relative distance to the next other one."""
    relative = np.diff(value) / (value[1:] + shift)
    is_end = relative > MODE_REDUCTION.cluster_gap
    first = 0
    while first < number:
        last = first
        while last < number - 1 and not is_end[last]:
            last += 1
        below = relative[first - 1] if first else 1.0
        above = relative[last] if last < len(relative) else 1.0
        yield slice(first, last + 1), float(max(min(below, above), np.finfo(np.float64).tiny))
        first = last + 1


def _own_gaps(value: RealArray, shift: float) -> RealArray:
    """Return the relative distance of each mode of a cluster to the next one that is not equal."""
    distance = np.abs(value[:, None] - value) / (value + shift)
    distance[distance <= MODE_DERIVATIVE.equal_eigenvalues] = np.inf
    return np.asarray(distance.min(axis=1))


def _principal(X: RealArray, square: RealArray) -> RealArray:
    """Return the principal directions of X that matter, with its Gram matrix."""
    energy, axes = np.linalg.eigh(0.5 * (square + square.T))
    return np.asarray(X @ axes[:, energy > MODE_REDUCTION.derivative_error**2])


def _smallest_ratio(state: State, other: State) -> float:
    """Return the smallest ratio of factors of two states."""
    used = other.factor > 0.0
    return float((state.factor[used] / other.factor[used]).min(initial=np.inf))


def _is_same(state: State, other: State) -> bool:
    return state is other or np.array_equal(state.factor, other.factor)
