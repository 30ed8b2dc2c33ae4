"""Reduced models: a basis from a few real factorisations, with an error certified by residuals.

Basis. The vectors are X_k = (K - s_k M)^-1 E at a few real shifts s_k in the band, with E the unit
loads at sensors and forces, then the next moments (K - s_k M)^-1 M X if loads are few, and
(K - s_k M)^-1 D X for the damping: a block rational Krylov space (Ruhe, Linear Algebra Appl. 58
(1984) 391; Grimme, PhD thesis, Univ. of Illinois 1997, for the moments matched from both sides).

Error. Z is symmetric and projected on one basis from both sides, so the residuals r = e - Z V q of
the loads i and j give the exact error r_i^T Z^-1 r_j. As V^T r = 0, the residual measures only
missing directions. For these, far from resonance, Z is close to the definite P = K + omega_max^2 M,
and with y_j = P^-1 r_j (one solve for each reference)

    error_ij ~ r_i^T y_j = e_i^T y_j - q_i^T V^T Z y_j.

The basis is enriched by the y_j until the error is small enough at some lines. The stated error
covers all lines and channels: the difference to a larger basis, which includes the y_j not added,
plus the error by residuals in that basis. It is valid also near natural frequencies missing in the
basis, where Z is not close to P. Sylvester's law of inertia at the shifts proves for a new basis
that no mode in the band is missing.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import scipy.linalg

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.basis import Basis, whiten
from updyn.dynamics.certificate import Certificate, ErrorEstimate, square_norms
from updyn.dynamics.fields import split_into_blocks
from updyn.dynamics.line_residuals import ChannelDofs, LineResiduals
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.dynamics.settings import BASIS, REDUCTION
from updyn.dynamics.shifted import Shifted
from updyn.errors import OptionError, SolverError
from updyn.linalg.solver import Factorised
from updyn.linalg.threads import use_one_thread

__all__ = ["Reduction", "VectorsPerState"]

#: Coefficients of the terms, lines in Hz, and receptances of shape (n_rows, n_lines, n_columns).
_Response: TypeAlias = "tuple[ComplexArray, RealArray, ComplexArray]"


@dataclass(frozen=True, slots=True)
class VectorsPerState:
    """The vectors that each state adds to a basis for many states.

    `shifts` are in squares of the highest frequency, one for each state in turn; `depth` is the
    number of moments; `combinations` are random ones of the sensors, in addition to the references;
    `lossy` adds vectors for the forces of damping.
    """

    shifts: tuple[float, ...] = field(default_factory=lambda: (REDUCTION.search_shift,))
    depth: int = 2
    combinations: int = field(default_factory=lambda: REDUCTION.sensor_combinations)
    lossy: bool = True


@dataclass(slots=True, eq=False)
class Reduction:
    """A growing basis for the receptance of a model between some DOFs, in a band."""

    #: The compiled model.
    system: AffineSystem
    #: DOFs of responses and of references.
    rows: IndexArray
    columns: IndexArray
    #: Lowest and highest line in Hz.
    band: tuple[float, float]
    #: Sparse factorisation.
    backend: str
    #: Permitted error of a receptance relative to the largest of its line.
    accuracy: float = REDUCTION.accuracy
    #: Other readable DOFs, without certified accuracy.
    extra: IndexArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    #: Called after every long step; its exceptions stop the work.
    poll: Callable[[], object] = lambda: None
    #: The current basis.
    basis: Basis = field(init=False)
    #: Factorisations of the full model.
    shifted: Shifted = field(init=False)
    _channels: ChannelDofs = field(init=False)

    def __post_init__(self) -> None:
        if not 1e-10 <= self.accuracy <= 0.1:
            raise OptionError(
                f"accuracy = {self.accuracy!r}: expected a share of the largest receptance between"
                " 1e-10 and 0.1",
                key=("accuracy",),
            )
        self._channels = ChannelDofs(self.rows, self.columns, self.system.dofs)
        top = float((2.0 * np.pi * self.band[1]) ** 2)
        self.shifted = Shifted(self.system, top, self.backend)

    @use_one_thread
    def build(self, state: State) -> None:
        """Build a new basis for a state; SolverError if a factorisation at a shift fails."""
        self._begin(state)
        loads = np.zeros((self.system.n, len(self._loaded_dofs)), order="F")
        loads[self._loaded_dofs, np.arange(len(self._loaded_dofs))] = 1.0
        low, high = (2.0 * np.pi * self.band[0]) ** 2, self.shifted.top
        points = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(
            np.pi * np.arange(REDUCTION.first_shifts) / (REDUCTION.first_shifts - 1)
        )
        below = dict(self._expand(state, float(s), loads, self._depth) for s in points)
        for _ in range(REDUCTION.most_shifts - REDUCTION.first_shifts):
            gap = self._find_gap(state, below)
            if gap is None:
                break
            shift, number = self._expand(state, 0.5 * (gap[0] + gap[1]), loads, self._depth)
            below[shift] = number

    @use_one_thread
    def build_around(
        self, states: Sequence[State], seed: int = 0, across: VectorsPerState | None = None
    ) -> None:
        """Build a new basis of low accuracy for many states, the start first, for a search.

        Each state adds, by one factorisation, the fields of the references and of two random
        combinations of the sensors, which differ between states (tangential interpolation:
        Gallivan, Vandendorpe & Van Dooren, SIAM J. Matrix Anal. Appl. 26 (2004) 328). States that
        cannot be factorised are skipped. `across` gives other shifts and vectors, for accuracy in
        the whole band.
        """
        self._begin(states[0])
        rng, across = np.random.default_rng(seed), across or VectorsPerState()
        for number, state in enumerate(states):
            shift = across.shifts[number % len(across.shifts)] * self.shifted.top
            with suppress(SolverError):
                loads = self._combined_loads(rng, across.combinations)
                self._expand(state, shift, loads, across.depth, lossy=across.lossy)
        if self.basis.size == 0:
            raise SolverError("tier 'reduced': the model is singular at the start")

    @use_one_thread
    def extend(self, states: Sequence[State], seed: int = 0) -> None:
        """Extend the basis by one factorisation for each state; states that fail are skipped."""
        rng, shifts = np.random.default_rng(seed), itertools.cycle(REDUCTION.further_shifts)
        for state in states:
            shift = next(shifts) * self.shifted.top
            with suppress(SolverError):
                loads = self._combined_loads(rng, REDUCTION.sensor_combinations)
                self._expand(state, shift, loads, 1)

    @property
    def _loaded_dofs(self) -> IndexArray:
        return self._channels.loaded

    @property
    def _depth(self) -> int:
        moments = -(-REDUCTION.vectors_per_shift // len(self._loaded_dofs))
        return min(moments, REDUCTION.most_moments)

    # -- construction --------------------------------------------------------------------------
    def _begin(self, state: State) -> None:
        """Begin a basis with the scale of each DOF at a state."""
        self.basis = Basis(self.system, self.shifted.find_dof_scale(state))

    def _combined_loads(self, rng: np.random.Generator, combinations: int) -> RealArray:
        """Return unit loads at the references and at random combinations of the sensors."""
        groups = (self.columns, REDUCTION.most_references), (self.rows, combinations)
        loads = []
        for dofs, most in groups:
            dofs_in_group = np.unique(dofs)
            weights = np.eye(len(dofs_in_group))
            if len(dofs_in_group) > most:
                weights = rng.standard_normal((len(dofs_in_group), most))
            F = np.zeros((self.system.n, weights.shape[1]))
            F[dofs_in_group] = weights
            loads.append(F)
        return np.asfortranarray(np.hstack(loads))

    def _expand(
        self, state: State, shift: float, loads: RealArray, depth: int, *, lossy: bool = True
    ) -> tuple[float, int | None]:
        """Add the basis vectors of a shift; return it and the number of modes below, if known."""
        shift, factorised, X = self.shifted.solve(state, shift, loads)
        damping, inertial = self._damping_weights(state), self._mass_weights(state)
        vectors, lost = [X], None
        if lossy and damping.any():
            lost = factorised.solve(self.system.multiply(damping, X))
        self.poll()
        for _ in range(depth - 1):
            vectors.append(factorised.solve(self.system.multiply(inertial, vectors[-1])))
        if lost is not None:
            vectors.append(lost)
        self.basis.append(np.hstack(vectors))
        return shift, factorised.negative

    def _find_gap(self, state: State, below: dict[float, int | None]) -> tuple[float, float] | None:
        """Return neighbouring shifts with missed or too many modes between them, or None."""
        values = scipy.linalg.eigvalsh(
            self.basis.weighted_sum(self._mass_weights(state)),
            self.basis.weighted_sum(self.shifted.weights(state, -self.shifted.top)),
        )
        squares = 1.0 / np.maximum(values, np.finfo(np.float64).tiny) - self.shifted.top
        room = max(2, len(self._loaded_dofs) * self._depth)
        shifts = sorted(below)
        for low, high in itertools.pairwise(shifts):
            first, last = below[low], below[high]
            if first is None or last is None:
                continue
            found = int(((squares > low) & (squares <= high)).sum())
            if last - first > room or found < last - first:
                return low, high
        return None

    # -- matrices ------------------------------------------------------------------------------
    def _damping_weights(self, state: State) -> RealArray:
        """Return the weight of each term in D + omega C at the top of the band."""
        return self.system.coefficients(state, np.array([2.0 * np.pi * self.band[1]]))[:, 0].imag

    def _mass_weights(self, state: State) -> RealArray:
        return np.array([t.quantity == "mass" for t in self.system.terms]) * state.factor

    # -- use ---------------------------------------------------------------------------------
    def solver(self, label: str = "reduced") -> ReducedSolver:
        """Return the solver in the current basis."""
        return self._solver_of(self.basis, label)

    def _solver_of(self, basis: Basis, label: str = "reduced") -> ReducedSolver:
        observed = np.union1d(self._loaded_dofs, self.extra)
        return ReducedSolver.project(self.system, basis, observed, self.backend, label)

    @use_one_thread
    def compress(self, state: State, freq: RealArray) -> None:
        """Reduce the basis to that of the fields at a state, by proper orthogonal decomposition."""
        # The dropped directions change the receptance by far less than the permitted error.
        r = self.basis.size
        gram = np.zeros((r, r))
        for q, H in self._yield_responses(state, freq, self._loaded_dofs):
            scaled = (
                q / np.sqrt(np.abs(H[:, :, self._channels.forced]).max(axis=(0, 2)))[:, None]
            ).reshape(r, -1)
            gram += scaled.real @ scaled.real.T + scaled.imag @ scaled.imag.T
        # In the norm of P, the error of a receptance is about the product of its fields' errors.
        self._truncate(state, gram, 0.01 * self.accuracy)

    @use_one_thread
    def compress_around(
        self, states: Sequence[State], freq: RealArray, share: float, largest: int | None = None
    ) -> RealArray:
        """Reduce the basis to fields at many states; return rms changes, shape (n_rows, n_columns).

        `share` is the root of the share of the energy that may be dropped, on the scale of the
        first state; more is dropped if more than `largest` vectors remained.
        """
        # Each field of a reference is accompanied by one of a random combination of the sensors,
        # because the accuracy of a receptance depends on both. Each state uses every n-th line,
        # with its own offset.
        rng = np.random.default_rng(len(states))
        metric = self.basis.weighted_sum(self.shifted.weights(states[0], -self.shifted.top))
        solver = self.solver()
        gram, total = np.zeros_like(metric), 0
        before: list[_Response] = []
        most = max(1, min(REDUCTION.lines_per_state, REDUCTION.lines_of_states // len(states)))
        stride = -(-len(freq) // most)
        for number, state in enumerate(states):
            lines = freq[number % stride :: stride]
            c = solver.system.coefficients(state, 2.0 * np.pi * lines)
            try:
                q = solver.solve(c, self._loaded_dofs, lines)
            except SolverError:  # skip the state
                continue
            before.append((c, lines, solver.at(q, self.rows)[:, :, self._channels.forced]))
            mixed = q @ rng.standard_normal((len(self._loaded_dofs), REDUCTION.sensor_combinations))
            q = np.concatenate([q[:, :, np.unique(self._channels.forced)], mixed], axis=2)
            q = q.reshape(len(q), -1)
            q = q / np.sqrt(square_norms(q, metric)[0])
            gram += q.real @ q.real.T + q.imag @ q.imag.T
            total += q.shape[1]
            self.poll()
        self._truncate(states[0], gram, share**2 * total, largest)
        return self._measure_changes(before)

    def _measure_changes(self, before: Sequence[_Response]) -> RealArray:
        """Return rms changes of receptances over the largest of the line, (n_rows, n_columns)."""
        solver = self.solver()
        found = [np.zeros((len(self.rows), 0, len(self.columns)))]
        for c, lines, H in before:
            with suppress(SolverError):
                change = np.abs(solver.at(solver.solve(c, self.columns, lines), self.rows) - H)
                found.append(change / np.abs(H).max(axis=(0, 2), keepdims=True))
        shares = np.concatenate(found, axis=1)
        return np.asarray(np.sqrt((shares**2).sum(axis=1) / max(shares.shape[1], 1)))

    def _truncate(
        self, state: State, gram: RealArray, allowed: float, largest: int | None = None
    ) -> None:
        """Drop the directions of least energy in P up to a total, for fields with a Gram matrix.

        More are dropped if more than `largest` remained.
        """
        C = np.linalg.cholesky(
            self.basis.weighted_sum(self.shifted.weights(state, -self.shifted.top))
        )
        energy, axes = np.linalg.eigh(C.T @ gram @ C)
        dropped = int(np.searchsorted(np.cumsum(np.maximum(energy, 0.0)), allowed))
        if largest is not None:
            dropped = max(dropped, len(energy) - largest)
        self.basis.rotate(
            scipy.linalg.solve_triangular(C, axes[:, dropped:], lower=True, trans="T")
        )

    # -- certification -------------------------------------------------------------------------
    @use_one_thread
    def certify(
        self, state: State, freq: RealArray, *, enrich: bool = True, count: int | None = None
    ) -> Certificate:
        """Return the error at a state, and enrich the basis until the error is small enough.

        The certified error exceeds the permitted one if enrichment was insufficient.
        """
        # Every pass computes residuals at `count` other lines, including the strongest; the last
        # adds nothing to the basis.
        count = REDUCTION.lines_per_pass if count is None else count
        (found,) = self._certify_states([state], freq, enrich=enrich, count=count)
        return found

    @use_one_thread
    def certify_or_enrich(self, state: State, freq: RealArray) -> Certificate | None:
        """Return the error at a state; if it is too large, enrich the basis and return None."""
        # This is for a point that changes with the basis, which makes an earlier error invalid.
        with self.shifted.hold():
            definite, size = self.shifted.factor_definite(state), self.basis.size
            level = np.linalg.norm(self._receptance(state, freq), axis=(1, 2))
            lines = _choose_lines(freq, level, REDUCTION.lines_per_pass, 0)
            estimate = self._check_and_estimate(definite, state, freq, lines, self.accuracy)
            if estimate is None:
                self._enrich_in_passes(
                    definite, state, freq, level, REDUCTION.enriched_share * self.accuracy, first=1
                )
                return None
            if estimate.reduction > self.accuracy:
                worst = _choose_worst_lines(freq, estimate.shares, REDUCTION.lines_per_pass)
                self._check_all(definite, state, worst, REDUCTION.enriched_share * self.accuracy)
                return None
            self.basis = self.basis.take_leading(size)
            return estimate.certificate(size, tuple(lines), self.shifted.count)

    @use_one_thread
    def errors(self, states: Sequence[State], freq: RealArray) -> RealArray:
        """Return `Certificate.error` at several states without changes of the basis."""
        # Close states share a factorisation: P of one is as definite for the next, and at most 1 +
        # 0.1 times as large.
        found = self._certify_states(states, freq, enrich=False, count=REDUCTION.lines_per_pass)
        return np.array([certificate.error for certificate in found])

    def _certify_states(
        self, states: Sequence[State], freq: RealArray, *, enrich: bool, count: int
    ) -> list[Certificate]:
        return [
            self._certify(definite, state, freq, enrich=enrich, count=count)
            for definite, state in self.shifted.factor_definites(states)
        ]

    def _certify(
        self, definite: Factorised, state: State, freq: RealArray, *, enrich: bool, count: int
    ) -> Certificate:
        level = np.linalg.norm(self._receptance(state, freq), axis=(1, 2))
        lines = _choose_lines(freq, level, count, 0)
        for number in range(1, REDUCTION.most_passes + 1):
            growing = enrich and number < REDUCTION.most_passes
            # In the first pass the basis may already suffice, so no margin is required.
            margin = REDUCTION.enriched_share if number > 1 else 1.0
            allowed = margin * self.accuracy if growing else np.inf
            size = self.basis.size
            estimate = self._check_and_estimate(definite, state, freq, lines, allowed)
            if estimate is None:
                lines = _choose_lines(freq, level, count, number)
                continue
            if not growing or estimate.reduction <= self.accuracy:
                break
            lines = _choose_worst_lines(freq, estimate.shares, count)
        assert estimate is not None
        self.basis = self.basis.take_leading(size)
        return estimate.certificate(size, tuple(lines), self.shifted.count)

    def _check_and_estimate(
        self,
        definite: Factorised,
        state: State,
        freq: RealArray,
        lines: Sequence[float],
        allowed: float,
    ) -> ErrorEstimate | None:
        """Check some lines and return the error at all lines, or None if the basis has grown."""
        # The directions missing at these lines are then part of the basis, as its larger part.
        size = self.basis.size
        checked = self._check_in_groups(definite, state, lines, allowed)
        missing = [directions for _, directions in checked]
        if self.basis.size > size:
            return None
        self.basis.extend(self._orthonormalise(missing, state))
        self._omit_rounding_errors(size, state)
        return self._estimate(definite, state, freq, size)

    @use_one_thread
    def enrich_until_accurate(
        self, states: Sequence[State], freq: RealArray, *, accuracy: float | None = None
    ) -> None:
        """Enrich the basis at some states until the residuals at some lines are small enough."""
        allowed = REDUCTION.enriched_share * (self.accuracy if accuracy is None else accuracy)
        for definite, state in self.shifted.factor_definites(states):
            level = np.linalg.norm(self._receptance(state, freq), axis=(1, 2))
            self._enrich_in_passes(definite, state, freq, level, allowed)

    def _enrich_in_passes(
        self,
        definite: Factorised,
        state: State,
        freq: RealArray,
        level: RealArray,
        allowed: float,
        first: int = 0,
    ) -> None:
        """Check lines in passes from number `first` until none misses more than is permitted."""
        # What a last pass misses is still added: `allowed` is a share of the permitted error.
        permitted = allowed / REDUCTION.enriched_share
        for number in range(first, REDUCTION.most_passes):
            lines = _choose_lines(freq, level, REDUCTION.lines_per_pass, number)
            if self._check_all(definite, state, lines, allowed) <= permitted:
                break

    @use_one_thread
    def enrich(
        self, states: Sequence[State], freq: RealArray, *, allowed: float | None = None
    ) -> None:
        """Enrich the basis by missing directions at some lines of several states, in their order.

        Errors up to `allowed`, by default a fifth of the permitted error, add nothing.
        """
        allowed = REDUCTION.enriched_share * self.accuracy if allowed is None else allowed
        for definite, state in self.shifted.factor_definites(states):
            self._check_all(definite, state, freq.tolist(), allowed)

    @use_one_thread
    def enrich_around(self, states: Sequence[State], freq: RealArray) -> None:
        """Enrich the basis once by missing directions at several states, at different lines."""
        stride = -(-len(freq) // REDUCTION.lines_per_pass)
        for number, (definite, state) in enumerate(self.shifted.factor_definites(states)):
            lines = freq[number % stride :: stride]
            self._check_all(
                definite, state, lines.tolist(), REDUCTION.enriched_share * self.accuracy
            )

    @use_one_thread
    def measure_outside(self, state: State, X: RealArray) -> RealArray:
        """Return squared sines of principal angles (in P) between motions and basis, ascending."""
        if not X.shape[1]:
            return np.zeros(0)
        weights = self.shifted.weights(state, -self.shifted.top)
        PX = self.system.multiply(weights, X)
        within = self.basis.project(PX)
        shared = within.T @ scipy.linalg.solve(
            self.basis.weighted_sum(weights), within, assume_a="pos"
        )
        return np.asarray(1.0 - scipy.linalg.eigvalsh(shared, X.T @ PX)[::-1])

    @use_one_thread
    def enrich_with_nearby_factor(
        self,
        definite: Factorised,
        state: State,
        freq: RealArray,
        level: RealArray,
        number: int,
        accuracy: float,
    ) -> bool:
        """Enrich the basis at a few lines by P of another state; return whether it has grown.

        `level` is the approximate magnitude of the response at each line; each pass (`number`) uses
        other lines.
        """
        # P of another state is definite, too, so P^-1 r is a preconditioned residual. A few passes
        # make the basis accurate for stiffnesses that differ by a factor of e.
        size = self.basis.size
        lines = _choose_lines(freq, level, REDUCTION.nearby_parts, number)[1:-1]
        self._check_all(definite, state, lines, REDUCTION.enriched_share * accuracy)
        return self.basis.size > size

    @use_one_thread
    def residual_errors(self, states: Sequence[State], freq: RealArray) -> RealArray:
        """Return the largest relative error at some lines of each state, without basis changes."""
        solver, worst = self.solver(), np.zeros(len(states))
        for number, (definite, state) in enumerate(self.shifted.factor_definites(states)):
            for some in self._group_lines(freq):
                lines = LineResiduals(solver, self.basis, self._channels, state, some)
                errors = np.abs(lines.errors(definite.solve(lines.residual())))
                share = float((errors / self._channels.levels(lines.H)).max())
                worst[number] = max(worst[number], REDUCTION.error_factor * share)
            self.poll()
        return worst

    def _orthonormalise(self, pieces: list[RealArray], state: State) -> RealArray:
        """Return a basis of the columns of pieces, (N, k), orthonormal in K + omega_max^2 M."""
        # The weakest directions, due to rounding, are omitted. The pieces are consumed to save
        # memory.
        W = _join_columns(pieces)
        joined_basis = Basis(self.system, self.basis.weight)
        joined_basis.extend(W)
        gram = joined_basis.weighted_sum(self.shifted.weights(state, -self.shifted.top))
        if not gram.size:
            return W
        C = whiten(gram)[:, ::-1]  # the largest first
        for first in range(0, len(W), BASIS.rows_per_step):
            part = slice(first, first + BASIS.rows_per_step)
            W[part, : C.shape[1]] = W[part] @ C
        return W[:, : C.shape[1]]

    def _omit_rounding_errors(self, size: int, state: State) -> None:
        """Omit combinations of missing directions that consist of rounding errors.

        Missing directions, the vectors after the first `size`, would be orthogonal to these in P,
        were it not for rounding errors.
        """
        P = self.basis.weighted_sum(self.shifted.weights(state, -self.shifted.top))
        scale = 1.0 / np.sqrt(np.maximum(np.diag(P)[size:], np.finfo(np.float64).tiny))
        inside = whiten(P[:size, :size]).T @ P[:size, size:]
        rest = P[size:, size:] - inside.T @ inside
        outside, axes = np.linalg.eigh(scale[:, None] * rest * scale)
        kept = outside > BASIS.outside_share
        if not kept.all():
            self.basis = self.basis.combine_last(size, scale[:, None] * axes[:, kept])

    def _estimate(
        self, definite: Factorised, state: State, freq: RealArray, size: int
    ) -> ErrorEstimate:
        """Return the error of the first `size` basis vectors, by comparison with all."""
        wide, narrow = self.solver(), self._solver_of(self.basis.take_leading(size))
        P = self.basis.weighted_sum(self.shifted.weights(state, -self.shifted.top))
        found = ErrorEstimate.by_comparison(
            wide, narrow, self.basis, self._channels, P, definite, state, freq
        )
        self.poll()
        return found

    def _receptance(self, state: State, freq: RealArray) -> ComplexArray:
        """Return the reduced model's receptance, shape (n_f, n_rows, n_columns)."""
        return np.concatenate(
            [H for _, H in self._yield_responses(state, freq, self.columns)], axis=1
        ).transpose(1, 0, 2)

    def _yield_responses(
        self, state: State, freq: RealArray, loaded: IndexArray
    ) -> Iterator[tuple[ComplexArray, ComplexArray]]:
        """Yield coordinates and response of the reduced model, by blocks of lines."""
        solver = self.solver()
        pencil = solver.pencil(state, freq)
        for block in split_into_blocks(len(freq), solver.block_size(len(loaded))):
            c = solver.system.coefficients(state, 2.0 * np.pi * freq[block])
            q = solver.solve(c, loaded, freq[block], pencil)
            yield q, solver.at(q, self.rows)

    def _check_all(
        self, definite: Factorised, state: State, lines: Sequence[float], allowed: float
    ) -> float:
        """Add the important missing directions at some lines; return the largest error found."""
        checked = self._check_in_groups(definite, state, lines, allowed)
        return max((error for error, _ in checked), default=0.0)

    def _check_in_groups(
        self, definite: Factorised, state: State, lines: Sequence[float], allowed: float
    ) -> Iterator[tuple[float, RealArray]]:
        """Check some lines, few together; yield the error and missing directions, shape (N, k)."""
        for some in self._group_lines(np.array(lines)):
            yield self._check_lines(definite, state, some, allowed)
            self.poll()

    def _group_lines(self, lines: RealArray) -> Iterator[RealArray]:
        """Yield few lines at a time, fewer for a larger model because of the size of residuals."""
        of_one = 2 * self.system.n * len(self._channels.forced) * np.dtype(np.float64).itemsize
        step = min(max(REDUCTION.together_bytes // of_one, 1), REDUCTION.lines_together)
        for first in range(0, len(lines), step):
            yield lines[first : first + step]

    def _check_lines(
        self, definite: Factorised, state: State, lines: RealArray, allowed: float
    ) -> tuple[float, RealArray]:
        """Return the error at some lines; add missing directions above `allowed`, or return all."""
        # Directions missing at several lines are added once: with Y = P^-1 R, R^T Y is their Gram
        # matrix in P (in single precision Y^T P Y, because R^T Y is inaccurate).
        solver = self.solver()
        checked = LineResiduals(solver, self.basis, self._channels, state, lines)
        R = checked.residual()
        Y = definite.solve(R)
        gram = Y.T @ (definite.times(Y) if definite.error else R)
        sizes = np.sqrt(np.maximum(np.diag(gram), 0.0)).reshape(len(lines), 2, -1)
        sizes = np.maximum(np.hypot(sizes[:, 0], sizes[:, 1]), np.finfo(np.float64).tiny)
        errors = np.abs(checked.errors(Y)) / self._channels.levels(checked.H)
        error = REDUCTION.error_factor * float(errors.max())
        # The weight of each force of a line is its part in the largest error, in any unit.
        shares = REDUCTION.error_factor * errors.max(axis=1) / sizes
        weight = np.repeat(shares[:, None], 2, axis=1).ravel()
        gram = weight[:, None] * gram * weight
        gram = 0.5 * (gram + gram.T)
        if error > allowed:
            size, axes = np.linalg.eigh(gram)
            negligible = (REDUCTION.negligible_share * allowed) ** 2
            kept = size > max(negligible, definite.error**2 * size[-1])
            # Already P-orthogonal to the basis, because V^T R = 0.
            self.basis.extend(Y @ (weight[:, None] * axes[:, kept] / np.sqrt(size[kept])))
            if kept.any():
                return error, Y[:, :0]
        missing = []
        for of_line in np.split(np.arange(len(gram)), len(lines)):
            size, axes = np.linalg.eigh(gram[np.ix_(of_line, of_line)])
            most = size > REDUCTION.compared_share**2 * size[-1]
            missing.append(Y[:, of_line] @ (weight[of_line, None] * axes[:, most]))
        return error, np.hstack(missing)


def _join_columns(pieces: list[RealArray]) -> RealArray:
    """Return the arrays, (N, k) each, side by side; each is released after its copy."""
    out = np.empty((len(pieces[0]), sum(piece.shape[1] for piece in pieces)))
    first = 0
    pieces.reverse()
    while pieces:
        piece = pieces.pop()
        out[:, first : first + piece.shape[1]] = piece
        first += piece.shape[1]
    return out


def _choose_worst_lines(freq: RealArray, shares: RealArray, count: int) -> list[float]:
    """Return the line of the largest share in each piece of the band."""
    pieces = np.array_split(np.arange(len(freq)), min(count, len(freq)))
    return [float(freq[p[np.argmax(shares[p])]]) for p in pieces]


def _choose_lines(freq: RealArray, level: RealArray, count: int, number: int) -> list[float]:
    """Choose both end lines, and the strongest, weakest and random lines of band pieces."""
    if len(freq) <= count:
        return freq.tolist()  # type: ignore[no-any-return]
    rng = np.random.default_rng(number)
    edges = np.round((np.arange(1, count) + rng.uniform(-0.5, 0.5)) * len(freq) / count).astype(int)
    pieces = [p for p in np.split(np.arange(len(freq)), np.clip(edges, 0, len(freq))) if p.size]
    choose = (lambda p: p[np.argmax(level[p])], lambda p: p[np.argmin(level[p])], rng.choice)
    picked = {0, len(freq) - 1}
    for i, piece in enumerate(pieces):
        picked.add(int(choose[(i + number) % 3](piece)))
    return freq[sorted(picked)].tolist()  # type: ignore[no-any-return]
