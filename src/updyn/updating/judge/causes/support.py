"""A held structure, while the model is free."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import IrreparableFault
from updyn.updating.judge.causes.holding import is_free
from updyn.updating.judge.causes.settings import SUPPORT_FAULT

__all__ = ["Suspension"]


class Suspension(IrreparableFault):
    """The structure is suspended at `value` Hz, while the model is free.

    Distributed springs in proportion to the mass, K + (2 pi value)^2 M, increase the squares of all
    natural frequencies by the same amount; the rigid-body modes are then at `value`.
    """

    __slots__ = ()

    kind: ClassVar[str] = "support"
    concerns_model: ClassVar[bool] = True
    unit: ClassVar[str] = "Hz"
    has_free_size: ClassVar[bool] = True
    is_positive: ClassVar[bool] = True
    odds: ClassVar[float] = 2e-3
    imitated_kinds: ClassVar[tuple[str, ...]] = ("missing-mode",)
    advice: ClassVar[str] = (
        "Check how the structure was supported in the test; add springs to the ground to the"
        " model, as a group whose stiffness is an unknown, or remove the supports and measure"
        " again."
    )

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield several frequencies of the suspension, if the model is free."""
        if not is_free(evidence.part):
            return
        freq = evidence.frf.freq
        low = [share * freq[0] for share in SUPPORT_FAULT.low_shares]
        high = [share * freq[-1] for share in SUPPORT_FAULT.high_shares]
        for value in low + high:
            if value > 0.0:
                yield cls((), float(value))

    @property
    def ends_search(self) -> bool:
        """True: further causes would be errors of this model of the support."""
        return True

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return the derivative of the model's ln H by the frequency of the suspension."""
        low, high = (
            evidence.log_ratio_on_suspension(self.value * f)
            for f in (1.0 - SUPPORT_FAULT.frequency_step, 1.0 + SUPPORT_FAULT.frequency_step)
        )
        return np.asarray((high - low) / (2.0 * SUPPORT_FAULT.frequency_step * self.value))

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return the model's ln H of K + (2 pi value)^2 M over that of K."""
        return evidence.log_ratio_on_suspension(self.value)

    def statement(self) -> str:
        """Return a sentence with the frequency of the suspension."""
        return (
            f"The structure seems to be supported, while the model is free: a suspension at"
            f" {self.value:.3g} Hz explains the data."
        )
