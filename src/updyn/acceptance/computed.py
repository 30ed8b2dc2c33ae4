"""`ComputedModes`: undamped modes of a model, with the spread that its unknowns give them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.acceptance.effective_mass import DIRECTION_NAMES, MassShares, unit_motions
from updyn.arrays import RealArray
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.modes import Modes
from updyn.errors import DataError, SolverError
from updyn.modal.sensitivity import RealModes, assemble
from updyn.model import Model
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.posterior import Posterior
from updyn.uncertainty.updated_modes import UpdatedModes
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["ComputedModes", "Spread"]


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Changes of a mode by r independent combinations of the unknowns, one standard deviation each.

    `frequency` in Hz, shape (r,), and `shape` of unit modal mass, shape (N, r); nan where an
    undetermined combination changes them.
    """

    frequency: RealArray
    shape: RealArray


@dataclass(frozen=True, slots=True, eq=False)
class ComputedModes:
    """The lowest `number` undamped modes of a model, without rigid-body modes.

    `updated` and `posterior` are None for a model without uncertain unknowns.
    """

    model: Model
    modes: RealModes
    number: int
    updated: UpdatedModes | None = None
    posterior: Posterior | None = None

    @classmethod
    def of_model(cls, model: Model, highest: float) -> ComputedModes:
        """Compute the modes of a model up to a frequency in Hz."""
        system = AffineSystem.compile(model)
        modes = RealModes.lowest(system, system.start, 1, highest)
        number = int(np.sum(modes.frequency <= highest))
        if not number:
            raise DataError(
                f"the model has no elastic mode up to {highest:g} Hz; the first one is at"
                f" {modes.frequency[0]:.6g} Hz"
            )
        return cls(model, modes, number)

    @classmethod
    def of_update(
        cls,
        source: UpdateResult | JointResult | Draws,
        result: UpdateResult,
        highest: float,
        tier: str | None,
    ) -> ComputedModes:
        """Compute the modes of an updated model up to a frequency in Hz."""
        updated = UpdatedModes.of(result, None, highest, tier)
        return cls(updated.model, updated.modes, updated.number, updated, Posterior.of(source))

    @property
    def frequency(self) -> RealArray:
        """Natural frequencies in Hz, shape (n,)."""
        return self.modes.frequency[: self.number]

    @property
    def shapes(self) -> RealArray:
        """Shapes of unit modal mass, shape (N, n)."""
        return self.modes.shapes[:, : self.number]

    @property
    def is_free(self) -> bool:
        """Whether the structure has rigid-body modes."""
        return bool(self.modes.rigid.shape[1])

    def as_modes(self) -> Modes:
        """Return the modes for a correlation."""
        loss = np.full(self.number, np.nan)
        return Modes(self.frequency, loss, self.shapes, self.model.dofs)

    def spread(self, k: int) -> Spread:
        """Return the spread of a mode; empty without uncertain unknowns."""
        if self.updated is None or self.posterior is None:
            return Spread(np.zeros(0), np.zeros((len(self.shapes), 0)))
        root = self.posterior.root
        try:
            slope = self.updated.differentiate(k)
        except SolverError:
            unknown = np.full((len(self.shapes), root.shape[1]), np.nan)
            return Spread(unknown[0], unknown)
        frequency, shape = slope.frequency @ root, slope.shape @ root
        if np.isnan(self.posterior.propagate(slope.frequency, float(self.frequency[k]))):
            frequency = np.full_like(frequency, np.nan)
        size = float(np.abs(self.shapes[:, k]).max())
        if np.isnan(self.posterior.propagate(slope.shape, size)).any():
            shape = np.full_like(shape, np.nan)
        return Spread(frequency, shape)

    def mass_shares(self, directions: str) -> MassShares | None:
        """Return the effective masses of the modes in some of X, Y and Z; None if not defined."""
        if self.is_free:
            return None
        return MassShares.of(self.shapes, self.modes.M, self.model.dofs, directions)

    def spread_mass(self, k: int, direction: str) -> RealArray:
        """Return the changes of the effective mass share with the unknowns, shape (r,)."""
        if self.updated is None or self.posterior is None:
            return np.zeros(0)
        updated, root = self.updated, self.posterior.root
        motion = unit_motions(self.model.dofs)[:, DIRECTION_NAMES.index(direction)]
        shape, change = self.shapes[:, k], self.spread(k).shape
        loads = np.empty((len(motion), root.shape[1]))
        for i, step in enumerate(root.T):
            masses = []
            for sign in (1.0, -1.0):
                state = updated.unknowns.state(updated.system, updated.values + sign * step)
                masses.append(assemble(updated.system, state, "mass") @ motion)
            loads[:, i] = 0.5 * (masses[0] - masses[1])
        load = self.modes.M @ motion
        total, participation = float(motion @ load), float(shape @ load)
        by_shape = 2.0 * participation * (load @ change + shape @ loads)
        return np.asarray((by_shape - participation**2 * (motion @ loads) / total) / total)
