"""`UpdatedModes`: undamped modes of an updated model and their derivatives by the unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.excitation import fix_base
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.linalg.solver import check_backend
from updyn.modal.loss_factor import LossFactor
from updyn.modal.reduced import ReducedModes
from updyn.modal.sensitivity import RealModes, differentiate_modes, separate_repeated_modes
from updyn.modal.settings import MODE_REDUCTION
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.uncertainty.restored import estimate_of, solver_options
from updyn.updating.fit.reducing import are_modes_reduced
from updyn.updating.result import UpdateResult

__all__ = ["ModeDerivatives", "UpdatedModes"]


@dataclass(frozen=True, slots=True, eq=False)
class ModeDerivatives:
    """Derivatives of one mode by the values of the unknowns.

    `frequency` (Hz) and `loss_factor`, shape (n,); `shape`, shape (N, n), of the shape of unit
    modal mass.
    """

    frequency: RealArray
    loss_factor: RealArray
    shape: RealArray


@dataclass(frozen=True, slots=True, eq=False)
class UpdatedModes:
    """The lowest `number` modes of an updated model, without rigid-body modes.

    `modes` has them and may have more. `values`, shape (n,), are the estimate, and `state` that of
    the compiled model there.
    """

    model: Model
    system: AffineSystem
    unknowns: Unknowns
    values: RealArray
    state: State
    modes: RealModes
    number: int

    @classmethod
    def of(
        cls, result: UpdateResult, n: int | None, highest: float, tier: str | None
    ) -> UpdatedModes:
        """Compute the lowest `n` modes at the estimate, or those up to `highest` in Hz."""
        model = result.start
        if isinstance(result.data, FRF):
            model = fix_base(model, result.data)
        system = AffineSystem.compile(model)
        unknowns, values = Unknowns.find(system, result.parameters), estimate_of(result)
        state = unknowns.state(system, values)
        if are_modes_reduced(tier, system.n):
            backend = check_backend(solver_options(result)[1])
            reduced = ReducedModes(
                system, unknowns, MODE_REDUCTION.accuracy_of_shapes, backend, for_shapes=True
            )
            modes = _certified_modes(reduced, state, values, n, highest)
        else:
            modes = RealModes.lowest(system, state, n or 1, 0.0 if n else highest)
        number = min(n, len(modes.value)) if n else int(np.sum(modes.frequency <= highest))
        if not number:
            raise OptionError(
                f"the updated model has no elastic mode up to {highest:g} Hz; the first one is at"
                f" {modes.frequency[0]:.6g} Hz. updyn.predict_modes(result, n) returns the lowest n"
            )
        separated = separate_repeated_modes(
            modes, system, unknowns, values, lambda shapes: shapes[:0], np.zeros((0, 0))
        )
        return cls(model, system, unknowns, values, state, separated, number)

    def loss_factor(self, k: int) -> LossFactor:
        """Return the loss factor of a mode."""
        about = self.system, self.unknowns, self.state, self.values
        return LossFactor.of(*about, self.modes.shapes[:, k], float(self.modes.value[k]))

    def differentiate(self, k: int) -> ModeDerivatives:
        """Return the derivatives of a mode."""
        every = np.arange(self.system.n)
        about = self.system, self.unknowns, self.values
        by_value, by_shape = differentiate_modes(self.modes, np.array([k]), *about, every)
        value, shape, loss = by_value[0], by_shape[0].T, self.loss_factor(k)
        by_loss = loss.derivatives(value, loss.force @ shape, np.ones(len(value)))
        frequency = self.modes.frequency[k] * value / (2.0 * self.modes.value[k])
        return ModeDerivatives(np.asarray(frequency), by_loss, shape)


def _certified_modes(
    reduced: ReducedModes, state: State, values: RealArray, n: int | None, highest: float
) -> RealModes:
    """Return the lowest modes of a reduced model whose error is certified."""
    while True:
        modes = reduced.lowest(state, n or 1, 0.0 if n else highest)
        number = n or max(int(np.sum(modes.frequency <= highest)), 1)
        if reduced.certify_or_enrich(state, values, modes, min(number, len(modes.value))):
            return modes
