"""Viscous damping in proportion to the stiffness or the mass of groups that the model lacks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray
from updyn.remedy import Remedy
from updyn.updating.judge.causes.altering import AlteringFault
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.rates import (
    ALL,
    MATRICES,
    RayleighIncrement,
    compute_rayleigh_slopes,
)
from updyn.updating.problem.problem import FRFPart

__all__ = ["ProportionalDamping"]


#: Units of the Rayleigh coefficients.
_UNITS = {"stiffness_damping": "s", "mass_damping": "1/s"}


@dataclass(frozen=True, slots=True)
class ProportionalDamping(AlteringFault):
    """A group, or all groups, has viscous damping of `value` times its stiffness or mass.

    Its channel is the unknown that the model lacks: ``"floors.mass_damping"``.
    `varying_loss_factor` varies with frequency as this damping does.
    """

    varying_loss_factor: Fault | None = None

    kind: ClassVar[str] = "missing-viscous"
    is_positive: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the damping of each group, and of all, whose coefficient is not an unknown."""
        for name in evidence.slopes_by_rate:
            yield cls((name,))

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return the derivative of the model's ln H by the coefficient."""
        (name,) = self.channels
        if not self.value and name in evidence.slopes_by_rate:
            return evidence.slopes_by_rate[name]
        return compute_rayleigh_slopes(
            self.alteration.alter_part(evidence.part), evidence.x, [name]
        )[name]

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return a loss factor that varies with frequency and has nearly the same effect."""
        return () if self.varying_loss_factor is None else (self.varying_loss_factor,)

    @property
    def alteration(self) -> RayleighIncrement:
        """The additional damping."""
        return RayleighIncrement.from_name(self.channels[0], self.value)

    def statement(self) -> str:
        """Return a sentence with the damping and its loss factor."""
        rates = self.alteration
        of = "all groups" if rates.group == ALL else f"the group {rates.group!r}"
        times, share = MATRICES[rates.quantity], self.value / (2.0 * np.pi)
        loss = f"{share:.3g} / f" if times == "mass" else f"{2.0 * np.pi * self.value:.3g} f"
        return (
            f"The model lacks viscous damping of {of}: {self.value:.4g} {_UNITS[rates.quantity]}"
            f" times the {times}, a loss factor of {loss}, f in Hz."
        )

    @property
    def remedy(self) -> Remedy:
        """Advice to the user."""
        rates = self.alteration
        return Remedy.table(
            "Give the model an unknown for it:",
            "[[parameter]]",
            {"groups": rates.group, "quantity": rates.quantity},
            f'In Python: unknowns += updyn.parameters(model, {rates.quantity}="{rates.group}").',
        )
