"""`RandomForward`: FRFs of a model with nonlinear elements under a random force.

Each element is replaced by a spring and a damper (`updyn.dynamics.linearisation`), one force after
another. `FixedRandomForward` has them at given standard deviations of the motion.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.dynamics.linearisation import Linearisation, LinearisedMotion, couple, deform
from updyn.dynamics.settings import RANDOM
from updyn.errors import DataError, SolverError
from updyn.force_spectrum import find_rms
from updyn.frf import FRF
from updyn.nonlinear.gaussian import derive_linear_force, linearise
from updyn.updating.problem.local_elements import (
    ElementForward,
    ElementReceptances,
    Receptances,
    find_receptances,
    find_static_receptances,
    stack_references,
)

if TYPE_CHECKING:
    from updyn.updating.problem.problem import FRFPart

__all__ = ["FixedRandomForward", "RandomForward", "find_spread"]


@dataclass(frozen=True, slots=True, eq=False)
class _LinearisedForward(ElementForward, ABC):
    """FRFs of a model whose elements are replaced by springs and dampers, other ones by force."""

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
        found = ElementReceptances.of(self.local, part, x, np.ones(1), derivatives=derivatives)
        out, slopes = [], []
        for j, one in enumerate(self._linearise(part, x, derivatives=derivatives)):
            H, dH = one.respond(found, part, j)
            out.append(H)
            slopes += [] if dH is None else [dH]
        return stack_references(part, x, lines, rate, out, slopes)

    def forces(self, part: FRFPart, x: RealArray) -> ComplexArray:
        """Return the forces of the elements over that of the force, shape (n_f, n_e, n_j)."""
        found = ElementReceptances.of(self.local, part, x, np.ones(1), derivatives=False)
        each = enumerate(self._linearise(part, x, derivatives=False))
        return np.stack([one.force(found, part, j) for j, one in each], axis=2)

    @abstractmethod
    def _linearise(
        self, part: FRFPart, x: RealArray, *, derivatives: bool
    ) -> Iterator[_Equivalent]:
        """Yield the springs and dampers for each force."""


@dataclass(frozen=True, slots=True, eq=False)
class RandomForward(_LinearisedForward):
    """The FRFs of the linearised model under the random force of the data.

    Spectral densities of the force are those of the data.
    """

    def solved_lines(self, frf: FRF) -> RealArray:
        """Return the lines, and others over the band of the force."""
        return np.union1d(frf.freq, _spread_lines(frf))

    def key(self, frf: FRF) -> list[object]:
        """Return the spectrum of the force."""
        return ["random", _spectrum(frf)]

    def _linearise(
        self, part: FRFPart, x: RealArray, *, derivatives: bool
    ) -> Iterator[_Equivalent]:
        for j, balance in enumerate(self._balances(part, x)):
            motion = balance.solve()
            own = self._derive(part, x, j, balance, motion) if derivatives else ()
            yield _Equivalent(motion.stiffness, motion.damping, *own)

    def spreads(self, part: FRFPart, x: RealArray) -> RealArray:
        """Return the mean and the standard deviations of the elements, (3, n_e, n_j).

        They are those of deformation, in m (rad), and velocity, in m/s (rad/s).
        """
        found = [balance.solve() for balance in self._balances(part, x)]
        return np.stack([np.vstack([one.mean, one.spread]) for one in found], axis=2)

    def measured(self, part: FRFPart) -> tuple[RealArray, BoolArray]:
        """Return the measured standard deviations, (2, n_e, n_j), and which are known, (n_e,).

        They are integrals over the measured lines, of elements whose DOFs are all responses. Those
        that every other line changes do not resolve the resonances, and count as unknown.
        """
        amplitudes, known = self.local.measured(part)
        spread, coarse = (find_spread(part.frf, amplitudes, step) for step in (1, 2))
        difference = np.abs(coarse - spread) / np.maximum(spread, np.finfo(np.float64).tiny)
        return spread, known & (difference.max(axis=(0, 2)) <= RANDOM.resolved)

    def _balances(self, part: FRFPart, x: RealArray) -> Iterator[Linearisation]:
        """Yield the equations of the motion of the elements under each force."""
        values, (freq, density) = part.values(x), _spectrum(part.frf).T
        elements, static = self.local.at(values), self._static(part, values)
        for j, label in enumerate(part.frf.references.labels):

            def deform_at(omega: RealArray, j: int = j) -> ComplexArray:
                return self._deformations(part, values, j, omega, derivatives=False)[0]

            name = f"{part.frf.level_text}, force at {label}"
            yield Linearisation(elements, deform_at, static, freq, density, name, RANDOM.error)

    def _deformations(
        self, part: FRFPart, values: RealArray, j: int, omega: RealArray, *, derivatives: bool
    ) -> tuple[ComplexArray, ComplexArray | None]:
        """Return deformations for forces of the elements and one force, (n_f, n_e, n_e + 1)."""
        return find_receptances(
            self.local,
            part.solver,
            part.unknowns,
            values,
            omega / (2.0 * np.pi),
            (part.rows[:0], part.columns[j : j + 1]),
            derivatives,
            lines=_spread_lines(part.frf),
        )

    def _derive(
        self, part: FRFPart, x: RealArray, j: int, balance: Linearisation, motion: LinearisedMotion
    ) -> tuple[RealArray, RealArray]:
        """Return the derivatives of stiffnesses and dampings by the unknowns, (n, n_e) each."""
        values, static, n = part.values(x), None, len(self.local.elements)
        if balance.has_mean:
            _, slopes = find_static_receptances(self.local, part, values, derivatives=True)
            assert slopes is not None
            static = slopes[:, 0, :n, :n].real

        def derive(omega: RealArray) -> ComplexArray:
            _, slopes = self._deformations(part, values, j, omega, derivatives=True)
            assert slopes is not None
            return slopes

        owned = zip(self.local.owners.tolist(), self.local.places, strict=True)
        places = [(owner, *place) for owner, place in owned]
        return balance.derive(motion, derive, static, places, part.n)

    def _static(self, part: FRFPart, values: RealArray) -> RealArray | None:
        """Return the deformations for static forces of the elements; None if the model is free."""
        n = len(self.local.elements)
        try:
            H, _ = find_static_receptances(self.local, part, values, derivatives=False)
        except SolverError:
            if not self.local.are_odd:
                raise
            return None
        return H[0, :n, :n].real


@dataclass(frozen=True, slots=True, eq=False)
class FixedRandomForward(_LinearisedForward):
    """The FRFs with the springs and dampers of a given motion of the elements.

    `motion`, (3, n_e, n_j), has means and standard deviations as of `RandomForward.spreads`.
    """

    motion: RealArray

    def key(self, frf: FRF) -> list[object]:
        """Return the motion."""
        return ["fixed random", self.motion]

    def _linearise(
        self, part: FRFPart, x: RealArray, *, derivatives: bool
    ) -> Iterator[_Equivalent]:
        elements = self.local.at(part.values(x))
        for mean, sigma, sigma_v in self.motion.transpose(2, 0, 1).tolist():
            motions = list(zip(elements, sigma, sigma_v, mean, strict=True))
            forces = [linearise(*one) for one in motions]
            stiffness = np.array([one.stiffness for one in forces])
            damping = np.array([one.damping for one in forces])
            if not derivatives:
                yield _Equivalent(stiffness, damping)
                continue
            slopes = [derive_linear_force(*one) for one in motions]
            dk, dc = np.zeros((2, part.n, len(elements)))
            for owner, (e, i) in zip(self.local.owners, self.local.places, strict=True):
                dk[owner, e], dc[owner, e] = slopes[e][1:, 3 + i]
            yield _Equivalent(stiffness, damping, dk, dc)


@dataclass(frozen=True, slots=True, eq=False)
class _Equivalent:
    """Stiffness and damping of each element, (n_e,), with derivatives by unknowns, (n, n_e)."""

    stiffness: RealArray
    damping: RealArray
    dk: RealArray | None = None
    dc: RealArray | None = None

    def dynamic_stiffness(self, omega: RealArray) -> ComplexArray:
        """Return the stiffness of each element at frequencies in rad/s, (n_f, n_e)."""
        return np.asarray(self.stiffness + 1j * omega[:, None] * self.damping)

    def force(self, found: ElementReceptances, part: FRFPart, j: int) -> ComplexArray:
        """Return the forces of the elements over force j, (n_f, n_e)."""
        H, n = found.H[:, 0], len(self.stiffness)
        D = self.dynamic_stiffness(2.0 * np.pi * part.frf.freq)
        return np.asarray(D * deform(H[:, :n][..., [*range(n), n + j]], D))

    def respond(
        self, found: ElementReceptances, part: FRFPart, j: int
    ) -> tuple[ComplexArray, ComplexArray | None]:
        """Return the responses to force j, (n_f, n_i), and their derivatives, (n, n_f, n_i)."""
        omega, n = 2.0 * np.pi * part.frf.freq, len(self.stiffness)
        H, dH = found.H[:, 0], None if found.dH is None else found.dH[:, :, 0]
        D = self.dynamic_stiffness(omega)
        q = deform(H[:, :n][..., [*range(n), n + j]], D)
        out = H[:, n:, n + j] - np.einsum("fie,fe->fi", H[:, n:, :n], D * q)
        if dH is None or self.dk is None or self.dc is None:
            return out, None
        forces = (self.dk[:, None] + 1j * omega[:, None] * self.dc[:, None]) * q
        direct = dH[..., n + j] - np.einsum("pfoe,fe->pfo", dH[..., :n], D * q)
        direct -= np.einsum("foe,pfe->pfo", H[..., :n], forces)
        A = couple(H[:, :n], D)
        dq = np.linalg.solve(A, direct[:, :, :n].transpose(1, 2, 0)).transpose(2, 0, 1)
        return out, direct[:, :, n:] - np.einsum("fie,pfe->pfi", H[:, n:, :n], D * dq)


def find_spread(frf: FRF, amplitudes: RealArray, step: int = 1) -> RealArray:
    """Return standard deviations of deformations and velocities, (2, ...), over the lines.

    `amplitudes`, (n_f, ...), are those of the deformations under a sine of the level of the data.
    """
    spectrum = _spectrum(frf)
    density = np.interp(frf.freq, spectrum[:, 0], spectrum[:, 1], left=0.0, right=0.0)
    shape = (len(frf.freq), *[1] * (amplitudes.ndim - 1))
    squared = density.reshape(shape) / find_rms(spectrum) ** 2 * amplitudes**2
    both = np.stack([squared, (2.0 * np.pi * frf.freq.reshape(shape)) ** 2 * squared])
    return np.sqrt(np.trapezoid(both[:, ::step], frf.freq[::step], axis=1))


def _spectrum(frf: FRF) -> RealArray:
    """Return the spectrum of the force of data with a random force."""
    if frf.spectrum is None:
        raise DataError("excitation: expected data of a random force, with a level")
    return frf.spectrum


def _spread_lines(frf: FRF) -> RealArray:
    """Return lines in Hz over the band of the force."""
    low, high = _spectrum(frf)[[0, -1], 0].tolist()
    return np.linspace(low, high, 1 + RANDOM.reduced_lines)[1:]
