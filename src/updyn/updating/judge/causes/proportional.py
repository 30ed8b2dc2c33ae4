"""Viscous damping in proportion to the stiffness or the mass of groups that the model lacks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.judge.causes.altered import AlteredPart, compute_log_ratio
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, IrreparableFault, divide_data, divide_odds
from updyn.updating.judge.causes.rates import (
    ALL,
    MATRICES,
    RayleighIncrement,
    compute_rayleigh_slopes,
)
from updyn.updating.problem.problem import FRFPart

__all__ = ["ProportionalDamping"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Units of the Rayleigh coefficients.
_UNITS = {"stiffness_damping": "s", "mass_damping": "1/s"}


@dataclass(frozen=True, slots=True)
class ProportionalDamping(IrreparableFault):
    """A group, or all groups, has viscous damping of `value` times its stiffness or mass.

    Its channel is the unknown that the model lacks: ``"floors.mass_damping"``.
    `varying_loss_factor` varies with frequency as this damping does.
    """

    n_places: int = 1
    varying_loss_factor: Fault | None = None

    kind: ClassVar[str] = "missing-viscous"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True
    has_constant_size: ClassVar[bool] = True
    alters_model: ClassVar[bool] = True
    odds: ClassVar[float] = 1e-2

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the damping of each group, and of all, whose coefficient is not an unknown."""
        for name in evidence.slopes_by_rate:
            yield cls((name,))

    def slope(self, evidence: Evidence) -> _Complex:
        """Return the derivative of the model's ln H by the coefficient."""
        (name,) = self.channels
        if not self.value and name in evidence.slopes_by_rate:
            return evidence.slopes_by_rate[name]
        return compute_rayleigh_slopes(
            self._increment.alter_part(evidence.part), evidence.x, [name]
        )[name]

    def repair_with_model(self, evidence: Evidence) -> FRF:
        """Return the data divided by H with the damping over the model's H."""
        return divide_data(
            evidence.frf, compute_log_ratio(evidence.part, self._increment, evidence.x)
        )

    def correct_part(self, part: FRFPart, x: _Real) -> FRFPart:
        """Return the part whose model has the damping."""
        return AlteredPart.of(part, self._increment) if self.is_plausible() else part

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return a loss factor that varies with frequency and has nearly the same effect."""
        return () if self.varying_loss_factor is None else (self.varying_loss_factor,)

    def is_plausible(self) -> bool:
        """Return whether the damping is positive."""
        return self.value > 0.0

    @property
    def prior(self) -> float:
        """Prior odds that the model lacks the damping of this group."""
        return divide_odds(self.odds, self.n_places)

    @property
    def _increment(self) -> RayleighIncrement:
        return RayleighIncrement.from_name(self.channels[0], self.value)

    def statement(self) -> str:
        """Return a sentence with the damping and its loss factor."""
        rates = self._increment
        of = "all groups" if rates.group == ALL else f"the group {rates.group!r}"
        times, share = MATRICES[rates.quantity], self.value / (2.0 * np.pi)
        loss = f"{share:.3g} / f" if times == "mass" else f"{2.0 * np.pi * self.value:.3g} f"
        return (
            f"The model lacks viscous damping of {of}: {self.value:.4g} {_UNITS[rates.quantity]}"
            f" times the {times}, a loss factor of {loss}, f in Hz."
        )

    @property
    def remedy(self) -> str:
        """Advice to the user."""
        rates = self._increment
        return (
            f'Give the model an unknown for it: [[parameter]] with groups = "{rates.group}" and'
            f' quantity = "{rates.quantity}" in the job, or unknowns +='
            f' updyn.parameters(model, {rates.quantity}="{rates.group}").'
        )
