"""Damping added by an exponential window."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.missing_viscous import count_viscous_places
from updyn.updating.judge.causes.proportional import ProportionalDamping
from updyn.updating.judge.causes.rates import ALL
from updyn.updating.problem.problem import FRFPart

__all__ = ["WindowDamping"]


class WindowDamping(Fault):
    """Records were multiplied by exp(-value t): the data are H at i omega + value, value in 1/s."""

    __slots__ = ()

    kind: ClassVar[str] = "window-damping"
    unit: ClassVar[str] = "1/s"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True
    has_constant_size: ClassVar[bool] = True
    is_positive: ClassVar[bool] = True
    advice: ClassVar[str] = (
        "Check the settings of the analyser: its stated decay is more accurate than an estimate."
        " Write this, or the stated value:"
    )
    distinguishing_test: ClassVar[str] = (
        "The settings of the analyser, or a record without a window, would distinguish them."
    )

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the only fault of this kind."""
        yield cls()

    def repair(self, frf: FRF) -> FRF:
        """Return the data with their decay, with which a model is evaluated for comparison."""
        return replace(frf, decay=frf.decay + self.value)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return d ln H / d (i omega)."""
        return evidence.slope_by_frequency / (2j * np.pi)

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return the model's ln H(i omega + value) / H(i omega)."""
        return evidence.log_ratio_with_decay(self.value)

    def correct_part(self, part: FRFPart, x: RealArray) -> FRFPart:
        """Return the part whose model is evaluated with the decay of the data."""
        return part.with_data(self.repair(part.frf)) if self.is_plausible() else part

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return viscous damping in proportion to all mass, which has nearly the same effect."""
        # (s + a)^2 M = s^2 M + 2 a s M + a^2 M: only the stiffness a^2 M and the powers of s
        # between quantities distinguish a window from it.
        n_places = count_viscous_places(part)
        return (ProportionalDamping((f"{ALL}.mass_damping",), 2.0 * self.value, n_places=n_places),)

    def statement(self) -> str:
        """Return a sentence with the decay and its loss factor."""
        return (
            f"An exponential window exp(-{self.value:.4g} t) added damping to all modes: a loss"
            f" factor of {self.value / np.pi:.3g} / f, f in Hz."
        )
