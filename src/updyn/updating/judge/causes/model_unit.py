"""A model in inconsistent units: one factor on all stiffnesses, or on all masses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.fault import IrreparableFault

__all__ = ["UNITS_OF_MODELS", "ModelUnit"]

#: Factor for all stiffnesses or all masses, and the mistake that it corrects.
UNITS_OF_MODELS: tuple[tuple[str, float, str], ...] = (
    ("stiffness", 1e3, "stiffnesses in N/mm instead of N/m"),
    ("stiffness", 1e-3, "stiffnesses in N/m instead of N/mm"),
    ("stiffness", 1e6, "moduli in MPa instead of Pa"),
    ("stiffness", 1e-6, "moduli in Pa instead of MPa"),
    ("stiffness", 1e9, "moduli in GPa instead of Pa"),
    ("mass", 1e-3, "masses in kg instead of tonnes"),
    ("mass", 1e3, "masses in tonnes instead of kg"),
    ("mass", 1.0 / 9.80665, "weights in N instead of masses in kg"),
    ("mass", 0.0254 / 9.80665, "weights in lbf instead of masses in lbf s2/in"),
)


@dataclass(frozen=True, slots=True)
class ModelUnit(IrreparableFault):
    """All stiffnesses or masses of the model have to be multiplied by `value`, due to `mistake`.

    Units are tried only if model and data have nothing in common.
    """

    quantity: str = "stiffness"
    mistake: str = ""

    kind: ClassVar[str] = "model-unit"
    concerns_model: ClassVar[bool] = True
    odds: ClassVar[float] = 1e-2
    advice: ClassVar[str] = (
        "Check the units of the model: those of force, mass and length have to be consistent,"
        " such as N, kg and m, or N, tonnes and mm."
    )

    @classmethod
    def list_mistakes(cls) -> Iterator[Self]:
        """Yield the common mistakes."""
        for quantity, factor, mistake in UNITS_OF_MODELS:
            yield cls((), factor, quantity, mistake)

    def convert_data(self, frf: FRF) -> FRF:
        """Return the data as they would be for a structure in the units of the model."""
        # With a times the stiffness K and b times the mass M, the receptance at omega is 1/a times
        # that of K and M at omega sqrt(b/a).
        a, b = (self.value, 1.0) if self.quantity == "stiffness" else (1.0, self.value)
        stretch = float(np.sqrt(b / a))
        # Other quantities than receptance contain powers of the frequency.
        factor = a * stretch**frf.power if frf.quantity in QUANTITIES else 1.0
        variance = None if frf.variance is None else factor**2 * frf.variance
        return replace(
            frf,
            freq=stretch * frf.freq,
            decay=stretch * frf.decay,
            values=factor * frf.values,
            variance=variance,
        )

    def statement(self) -> str:
        """Return a sentence with the factor and the mistake."""
        return (
            f"The model explains the data with {self.value:.6g} times its {self.quantity}:"
            f" {self.mistake}."
        )
