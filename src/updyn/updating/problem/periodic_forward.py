"""`PeriodicForward`: FRFs of a model with nonlinear elements under a sine, by harmonic balance.

`EquivalentForward` replaces each element by its describing function at a given amplitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.dynamics.periodic.at_lines import LineBalance, LineEvaluation
from updyn.dynamics.periodic.balance import make_fourier
from updyn.dynamics.periodic.fourier import Fourier
from updyn.dynamics.periodic.settings import LINE_BALANCE
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.over_lines import describe_first_harmonic
from updyn.updating.problem.local_elements import (
    ElementForward,
    ElementReceptances,
    LocalElements,
    Receptances,
    add_element_slopes,
    require_level,
    stack_references,
)
from updyn.updating.problem.settings import LEVELS

if TYPE_CHECKING:
    from updyn.updating.problem.problem import FRFPart

__all__ = ["EquivalentForward", "PeriodicForward"]


@dataclass(frozen=True, slots=True, eq=False)
class EquivalentForward(ElementForward):
    """The receptances with each element replaced by its describing function.

    `amplitudes` are those of the deformations at the lines `freq`, (n, n_e, n_j) in m (rad);
    between them, they are interpolated.
    """

    freq: RealArray
    amplitudes: RealArray

    is_linear: ClassVar[bool] = False
    is_whole: ClassVar[bool] = True

    @classmethod
    def at_rest(cls, local: LocalElements, frf: FRF) -> EquivalentForward:
        """Return the receptances at vanishing amplitude."""
        shape = 1, len(local.elements), len(frf.references)
        return cls(local, frf.freq[:1], np.full(shape, LEVELS.vanishing_amplitude))

    @property
    def dofs(self) -> IndexArray:
        """DOFs of the elements."""
        return self.local.dofs

    def key(self, frf: FRF) -> list[object]:
        """Return the amplitudes."""
        return ["equivalent", self.freq, self.amplitudes]

    def _interpolate(self, freq: RealArray) -> RealArray:
        flat = self.amplitudes.reshape(len(self.freq), -1).T
        out = np.stack([np.interp(freq, self.freq, row) for row in flat], axis=1)
        return out.reshape(len(freq), *self.amplitudes.shape[1:])

    def receptances(
        self,
        part: FRFPart,
        x: RealArray,
        lines: slice,
        rate: ComplexArray,
        *,
        derivatives: bool,
    ) -> Receptances:
        """Return the receptances at a block of lines."""
        k = np.ones(1)
        found = ElementReceptances.of(self.local, part, x, k, derivatives=derivatives)
        n, elements = len(self.local.elements), self.local.at(part.values(x))
        omega = 2.0 * np.pi * part.frf.freq
        amplitudes = self._interpolate(part.frf.freq)
        H, dH = found.H[:, 0], None if found.dH is None else found.dH[:, :, 0]
        out, slopes = [], []
        for j in range(len(part.columns)):
            N, dN = _describe(elements, amplitudes[:, :, j], omega)
            J = np.eye(n) + H[:, :n, :n] * N[:, None, :]
            Q = np.linalg.solve(J, H[:, :n, n + j, None])[:, :, 0]
            F = N * Q
            out.append(H[:, n:, n + j] - np.einsum("fie,fe->fi", H[:, n:, :n], F))
            if dH is None:
                continue
            direct = dH[:, :, :, n + j] - np.einsum("pfoe,fe->pfo", dH[..., :n], F)
            by_element = [
                -H[:, :, e] * (dN[e][:, column] * Q[:, e])[:, None]
                for e, column in self.local.places
            ]
            right = add_element_slopes(direct, by_element, self.local.owners)
            dQ = np.linalg.solve(J, right[:, :, :n].transpose(1, 2, 0)).transpose(2, 0, 1)
            moved = np.einsum("fie,pfe->pfi", H[:, n:, :n], N * dQ)
            slopes.append(right[:, :, n:] - moved)
        return stack_references(part, x, lines, rate, out, slopes)


@dataclass(frozen=True, slots=True, eq=False)
class Nearest:
    """The solutions x (m, n_e, n_c) of the evaluation nearest to the measured values so far.

    `distance` is the sum of the relative distances of all lines.
    """

    x: RealArray
    distance: float


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicForward(ElementForward):
    """The first harmonic of the periodic response at the level of the data.

    At a line with several solutions, the stable one nearest to the measured values is used. If
    there is a `memory`, evaluations begin at its solutions by reference.
    """

    memory: dict[int, Nearest] | None = None

    @property
    def fourier(self) -> Fourier:
        """Transforms of the harmonics: odd ones if all elements are odd."""
        return make_fourier(
            is_free=self.local.are_odd,
            harmonics=LINE_BALANCE.harmonics,
            samples=LINE_BALANCE.samples,
        )

    def solved_lines(self, frf: FRF) -> RealArray:
        """Return the harmonics of the lines."""
        return np.unique(np.outer(self.fourier.harmonics, frf.freq))

    def key(self, frf: FRF) -> list[object]:
        """Return the level."""
        return ["periodic", require_level(frf)]

    def receptances(
        self,
        part: FRFPart,
        x: RealArray,
        lines: slice,
        rate: ComplexArray,
        *,
        derivatives: bool,
    ) -> Receptances:
        """Return the receptances at a block of lines."""
        found = self._linear(part, x, derivatives=derivatives)
        n = len(self.local.elements)
        out, slopes = [], []
        for j in range(len(part.columns)):
            balance, now = self._solve(part, x, found, j)
            out.append(balance.respond(now, np.arange(len(balance.omega))))
            if found.dH is not None:
                inputs = [*range(n), n + j]
                direct, by_element = balance.derive(now, found.dH[..., inputs], self.local.places)
                slopes.append(add_element_slopes(direct, list(by_element), self.local.owners))
        return stack_references(part, x, lines, rate, out, slopes)

    def amplitudes(self, part: FRFPart, x: RealArray) -> RealArray:
        """Return the amplitudes of the deformations at all lines, (n_f, n_e, n_j) in m (rad)."""
        found, first = self._linear(part, x, derivatives=False), self.fourier.first
        out = []
        for j in range(len(part.columns)):
            balance, now = self._solve(part, x, found, j)
            coordinates = now.x.reshape(-1, now.x.shape[2])
            Q = balance.fourier.to_complex(coordinates)[:, first]
            out.append(np.abs(Q).reshape(now.x.shape[:2]))
        return np.stack(out, axis=2)

    def forces(self, part: FRFPart, x: RealArray) -> ComplexArray:
        """Return the first harmonics of the forces of elements over that of the force.

        The shape is (n_f, n_e, n_j).
        """
        found, first = self._linear(part, x, derivatives=False), self.fourier.first
        out = [
            self._solve(part, x, found, j)[1].forces[:, :, first] for j in range(len(part.columns))
        ]
        return np.asarray(np.stack(out, axis=2) / require_level(part.frf)[:, None, None])

    def _linear(self, part: FRFPart, x: RealArray, *, derivatives: bool) -> ElementReceptances:
        k = self.fourier.harmonics.astype(np.float64)
        return ElementReceptances.of(self.local, part, x, k, derivatives=derivatives)

    def _solve(
        self, part: FRFPart, x: RealArray, found: ElementReceptances, j: int
    ) -> tuple[LineBalance, LineEvaluation]:
        """Return the balance with one force and its solution at each line."""
        n = len(self.local.elements)
        elements = self.local.at(part.values(x))
        omega, level = 2.0 * np.pi * part.frf.freq, require_level(part.frf)
        balance = LineBalance(
            elements, self.fourier, omega, level, found.H[..., [*range(n), n + j]]
        )
        lines = np.arange(len(omega))
        x = np.zeros((len(omega), n, balance.fourier.size))
        best = np.full(len(omega), np.inf)

        def compare(candidate: RealArray, at: IndexArray) -> None:
            if not len(at):
                return
            now = balance.evaluate(candidate, at)
            distance = _distances(part, balance.respond(now, at), j, at)
            distance = np.where(balance.is_stable(now), distance, distance + LEVELS.unstable)
            nearer = distance < best[at]
            x[at[nearer]], best[at[nearer]] = candidate[nearer], distance[nearer]

        known = None if self.memory is None else self.memory.get(j)
        near = None if known is None else known.x
        for candidate, is_solved in balance.find_all(near):
            compare(candidate[is_solved], lines[is_solved])
        far = np.flatnonzero(best > LEVELS.far)
        if len(far) and len(part.rows) >= n:
            for candidate, at in self._solve_near_data(part, balance, found.H, far, j):
                compare(candidate, at)
        if not np.isfinite(best).all():
            missing = part.frf.freq[int(np.argmin(np.isfinite(best)))]
            raise SolverError(f"no periodic response was found at {missing:g} Hz")
        tried: set[tuple[int, int, float]] = set()
        # The branches of known solutions were looked for at the first evaluation.
        for _ in range(LINE_BALANCE.jump_passes if near is None else 0):
            before, jumps = best.sum(), balance.jumps(x)
            for at, source in ((jumps + 1, jumps), (jumps, jumps + 1)):
                # A solution leads to the same one at the next line again.
                moves = list(zip(at.tolist(), source.tolist(), best[source].tolist(), strict=True))
                is_new = np.array([move not in tried for move in moves], dtype=np.bool_)
                is_new &= best[at] > LEVELS.far
                tried.update(moves)
                at, source = at[is_new], source[is_new]
                candidate, is_solved = balance.move(x[source], source, at)
                compare(candidate[is_solved], at[is_solved])
            if best.sum() == before:
                break
        distance = float(best.sum())
        # A rejected step may end on other branches, which must not become those of the next one.
        if self.memory is not None and (known is None or distance <= known.distance):
            self.memory[j] = Nearest(x, distance)
        return balance, balance.evaluate(x, lines)

    def _solve_near_data(
        self, part: FRFPart, balance: LineBalance, H: ComplexArray, far: IndexArray, j: int
    ) -> Iterator[tuple[RealArray, IndexArray]]:
        """Yield solutions near the measured motion at some lines, and these lines.

        The measured motion may lie on a branch that neither amplitudes nor neighbours reach.
        """
        first = self.fourier.first
        Q = np.zeros((len(far), balance.n_elements, len(self.fourier.harmonics)), np.complex128)
        Q[:, :, first] = self.local.estimate(part, H[:, first])[far, :, j]
        motion = balance.to_coordinates(Q)
        found, is_solved = balance.solve(motion, far)
        found, motion, far = found[is_solved], motion[is_solved], far[is_solved]
        if not len(far):
            return
        yield found, far
        # Near a turning point, it may be the unstable one of a pair of solutions.
        pair = ~balance.is_stable(balance.evaluate(found, far))
        if pair.any():
            deflated = balance.deflate(found[pair], far[pair])
            other, is_solved = deflated.solve(motion[pair], far[pair])
            yield other[is_solved], far[pair][is_solved]


def _distances(part: FRFPart, H: ComplexArray, j: int, at: IndexArray) -> RealArray:
    """Return the relative distance of responses (k, n_i) from those measured at lines, (k,)."""
    frf = part.frf
    H = H * part.sign[:, j] * (frf.s[at] ** frf.power)[:, None]
    measured = frf.values[at, :, j]
    size = np.abs(H) ** 2 + np.abs(measured) ** 2
    share = np.abs(H - measured) ** 2 / np.maximum(size, np.finfo(np.float64).tiny)
    return np.asarray(share.mean(axis=1))


def _describe(
    elements: Sequence[NonlinearElement], amplitudes: RealArray, omega: RealArray
) -> tuple[ComplexArray, list[ComplexArray]]:
    """Return describing functions over the deformation, (n_f, n_e), and their derivatives."""
    samples = LINE_BALANCE.samples
    found = [
        describe_first_harmonic(element, amplitudes[:, e], omega, samples)
        for e, element in enumerate(elements)
    ]
    return np.stack([value for value, _ in found], axis=1), [slopes for _, slopes in found]
