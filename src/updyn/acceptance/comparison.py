"""`ModesCompared`: computed and measured modes paired, weighted and with their errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from updyn.acceptance.computed import ComputedModes, Spread
from updyn.acceptance.effective_mass import DIRECTION_NAMES, MassShares
from updyn.acceptance.similarity import PrincipalPair, ShapeSet
from updyn.arrays import IndexArray, RealArray
from updyn.correlation.clusters import Subspace
from updyn.correlation.modes import ModeCorrelation, correlate_modes, weigh_sensors
from updyn.correlation.shapes import find_moving
from updyn.dynamics.guyan import reduced_mass
from updyn.dynamics.modes import Modes
from updyn.errors import DataError, SolverError
from updyn.modal import ModeSet

__all__ = ["ModesCompared", "PairedMode", "ReducedMass"]


@dataclass(frozen=True, slots=True)
class PairedMode:
    """A pair of modes: numbers among the computed and the measured modes, and their subspace."""

    computed: int
    measured: int
    subspace: Subspace | None


@dataclass(frozen=True, slots=True, eq=False)
class ReducedMass:
    """The mass at the sensors and the cross-orthogonality of the model's modes with each other.

    `matrix`, shape (k, k), in kg; `own`, shape (n, n), is the identity without errors of the
    reduction.
    """

    matrix: RealArray
    own: RealArray

    def error_of_mass(self, j: int) -> float:
        """Return the relative error of the modal mass of a mode."""
        return float(abs(self.own[j, j] - 1.0))

    def error_between(self, j: int, others: IndexArray) -> float:
        """Return the largest cross-orthogonality of a mode with others, 0 without errors."""
        size = np.sqrt(self.own[j, j] * self.own[others, others])
        return float(np.max(np.abs(self.own[j, others]) / size, initial=0.0))


@dataclass(frozen=True, eq=False)
class ModesCompared:
    """Computed and measured modes and their correlation.

    `seen` are the computed modes that move at the sensors, which `correlation` numbers from 0.
    `std_frequency` (Hz), shape (m,), and `std_shapes`, shape (k, m), are nan where not known.
    """

    computed: ComputedModes
    measured: ModeSet
    correlation: ModeCorrelation
    seen: IndexArray
    std_frequency: RealArray
    std_shapes: RealArray
    band: tuple[float, float]
    directions: str = DIRECTION_NAMES

    @classmethod
    def of(
        cls,
        computed: ComputedModes,
        measured: ModeSet,
        std: tuple[float | None, float | None],
        band: tuple[float, float],
        directions: str,
    ) -> ModesCompared:
        """Pair modes; `std` are shares assumed for frequencies and shapes without deviations."""
        modes, seen = computed.as_modes(), np.arange(computed.number)
        if measured.has_shapes:
            seen = np.flatnonzero(find_moving(modes.at(measured.dofs), modes.shapes))
            if not len(seen):
                raise DataError("no mode of the model moves at the sensors of the measured modes")
        real = Modes(measured.frequency, measured.loss_factor, measured.real_shapes, measured.dofs)
        correlation = correlate_modes(modes.select(seen), real)
        return cls(
            computed,
            measured,
            correlation,
            seen,
            _assume(measured.std_frequency, std[0], measured.frequency),
            _std_of_shapes(measured, std[1]),
            band,
            directions,
        )

    @cached_property
    def pairs(self) -> list[PairedMode]:
        """The pairs by ascending measured frequency; `computed` counts all computed modes."""
        pairs, found = self.correlation.pairs, []
        for j, k in zip(pairs.first.tolist(), pairs.second.tolist(), strict=True):
            subspace = [s for s in self.correlation.subspaces if k in s.measured]
            found.append(PairedMode(int(self.seen[j]), k, subspace[0] if subspace else None))
        return found

    @cached_property
    def masses(self) -> MassShares | None:
        """Effective masses of the computed modes; None if not defined."""
        return self.computed.mass_shares(self.directions)

    @cached_property
    def spreads(self) -> dict[int, Spread]:
        """Spreads of the computed modes that are compared."""
        return {j: self.computed.spread(j) for j in self.compared.tolist()}

    @cached_property
    def compared(self) -> IndexArray:
        """Computed modes that are paired, or seen and in the band, ascending."""
        frequency = self.computed.frequency[self.seen]
        inside = (frequency >= self.band[0]) & (frequency <= self.band[1])
        inside[self.correlation.pairs.first] = True
        for one in self.correlation.subspaces:
            inside[one.computed] = True
        return self.seen[inside]

    @cached_property
    def at_sensors(self) -> RealArray:
        """The compared shapes at the sensors, with their signs, shape (k, n_compared)."""
        at_sensors = self.computed.as_modes().at(self.measured.dofs)
        return np.asarray(at_sensors[:, self.compared], dtype=np.float64)

    def weight_shapes(self, weight: RealArray) -> tuple[ShapeSet, ShapeSet]:
        """Return the compared and the measured shapes, weighted by a matrix (k, k)."""
        match = self.computed.model.dofs.match(self.measured.dofs)
        roots = [
            self.spreads[j].shape[match.index] * match.sign[:, None] for j in self.compared.tolist()
        ]
        noise = [np.diag(std) for std in self.std_shapes.T]
        return (
            ShapeSet.of(self.at_sensors, roots, weight),
            ShapeSet.of(self.measured.real_shapes, noise, weight),
        )

    @cached_property
    def plain(self) -> tuple[ShapeSet, ShapeSet]:
        """Shapes for MAC; rotations are scaled to the size of translations."""
        return self.weight_shapes(np.diag(weigh_sensors(self.correlation.measured)))

    @cached_property
    def reduced_mass(self) -> ReducedMass | str:
        """The mass at the sensors by static condensation, or why there is none."""
        try:
            matrix = reduced_mass(self.computed.model, self.measured.dofs)
        except SolverError as error:
            return str(error)
        return ReducedMass(matrix, self.at_sensors.T @ matrix @ self.at_sensors)

    @cached_property
    def mass_weighted(self) -> tuple[ShapeSet, ShapeSet]:
        """Shapes for cross-orthogonality, weighted by a root of the reduced mass."""
        assert isinstance(self.reduced_mass, ReducedMass)
        value, vectors = np.linalg.eigh(self.reduced_mass.matrix)
        return self.weight_shapes((vectors * np.sqrt(np.maximum(value, 0.0))).T)

    def position(self, j: int) -> int:
        """Return the position of a computed mode among the compared ones."""
        return int(np.searchsorted(self.compared, j))

    def principal_pair(self, pair: PairedMode, shapes: tuple[ShapeSet, ShapeSet]) -> PrincipalPair:
        """Return the shapes of a pair, or the least similar ones of its subspace."""
        computed, measured = np.array([pair.computed]), np.array([pair.measured])
        n = 1
        if pair.subspace is not None:
            computed, measured = self.seen[pair.subspace.computed], pair.subspace.measured
            n = int(np.isin(self.correlation.pairs.second, measured).sum())
        at = np.searchsorted(self.compared, computed)
        return shapes[0].pair(shapes[1], at, measured, n)

    def others(self, pair: PairedMode) -> IndexArray:
        """Return positions among the compared modes of those outside a pair or its subspace."""
        own = np.array([pair.computed])
        if pair.subspace is not None:
            own = self.seen[pair.subspace.computed]
        return np.flatnonzero(~np.isin(self.compared, own))

    def find_unmeasured(self) -> Iterator[int]:
        """Yield computed modes in the band without a pair."""
        paired = {pair.computed for pair in self.pairs}
        for j in range(self.computed.number):
            if self.band[0] <= self.computed.frequency[j] <= self.band[1] and j not in paired:
                yield j


def _assume(std: RealArray, share: float | None, size: RealArray) -> RealArray:
    """Return standard deviations, with a share of the size where they are not known."""
    if share is None:
        return std
    return np.where(np.isnan(std), share * size, std)


def _std_of_shapes(measured: ModeSet, share: float | None) -> RealArray:
    """Return standard deviations of shapes; where not known, a share of the rms of the shape."""
    shapes = measured.real_shapes
    std = np.full(shapes.shape, np.nan) if measured.std_shapes is None else measured.std_shapes
    if not len(shapes):
        return std
    return _assume(std, share, np.broadcast_to(np.sqrt(np.mean(shapes**2, axis=0)), std.shape))
