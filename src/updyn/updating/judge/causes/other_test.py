"""A sensor whose data come from another test, with the structure in another state."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import BoolArray, ComplexArray
from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import (
    Fault,
    find_channels,
    list_channels,
    list_sides,
    remove_channels,
)
from updyn.updating.judge.causes.misfit import remove_weight
from updyn.updating.judge.causes.settings import CHANNEL_FAULT
from updyn.updating.problem.problem import FRFPart

__all__ = ["OtherTest"]


class OtherTest(Fault):
    """While a sensor was measured, all stiffnesses were exp(-2 value) times those for the others.

    Its resonances are at exp(-value) times the frequencies of the others. K and exp(-2 value) K
    have the accelerances A(f) and A(exp(value) f).
    """

    __slots__ = ()

    kind: ClassVar[str] = "other-test"
    has_free_size: ClassVar[bool] = True
    is_additive: ClassVar[bool] = True
    omits_channels: ClassVar[bool] = True
    is_local: ClassVar[bool] = True
    advice: ClassVar[str] = (
        "Check when and how it was measured. If the structure was in another state, omit it:"
    )
    remark: ClassVar[str] = "Or make it a separate test."

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each sensor with several factors, if there are others for comparison."""
        # The values of an omitted sensor have a variance above their square.
        frf = evidence.frf
        assert frf.variance is not None
        clear = np.abs(frf.values) ** 2 > frf.variance
        for channels in list_channels(frf):
            is_own = find_channels(channels, frf).channel_mask(frf)
            if clear[:, is_own].any() and clear[:, ~is_own].any():
                yield from (cls(channels, shift) for shift in CHANNEL_FAULT.shifts)

    def repair(self, frf: FRF) -> FRF:
        """Return the data without the sensor or the force."""
        return remove_channels(self, frf)

    def mask_channels(self, frf: FRF) -> FRF:
        """Return the data in which the sensor has no weight."""
        return remove_weight(frf, self._channel_mask(frf))

    def adapt_to(self, evidence: Evidence) -> Self:
        """Return the fault with the shift that fits the data best at a point."""

        def squared_error(one: Self) -> float:
            e = evidence.misfit(one.repair_with_model(evidence))
            return float(e @ e)

        best = replace(self, value=0.0)
        grids = zip(CHANNEL_FAULT.grid_half_widths, CHANNEL_FAULT.grid_points, strict=True)
        for half, n in grids:
            steps = np.linspace(-half, half, n).tolist()
            best = min((replace(self, value=best.value + v) for v in steps), key=squared_error)
        return best

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return the other sensor of its direction, if only one: either may be wrong."""
        (own,) = self.channels
        for dofs, names in list_sides(part.frf):
            directions = {name: dof.direction for name, dof in zip(names, dofs, strict=True)}
            others = [
                name for name in names if name != own and directions[name] == directions.get(own)
            ]
            if len(others) == 1:
                yield replace(self, channels=(others[0],), value=-self.value)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return d ln A / d ln f at the channels, with A the accelerance."""
        frf = evidence.frf
        power = QUANTITIES["accelerance"] - frf.modal_power
        return (frf.freq[:, None, None] * evidence.slope_by_frequency + power) * self._channel_mask(
            frf
        )

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return the model's ln A(exp(value) f) / A(f) at the channels."""
        return evidence.log_ratio_with_scaled_axis(self.value) * self._channel_mask(evidence.frf)

    def _channel_mask(self, frf: FRF) -> BoolArray:
        """Return which channels are of the other test, shape (n_i, n_j)."""
        return find_channels(self.channels, frf).channel_mask(frf)

    def is_plausible(self) -> bool:
        """Return whether the factor is between 0.5 % and 30 %."""
        return CHANNEL_FAULT.least_shift < abs(self.value) < CHANNEL_FAULT.most_shift

    def statement(self) -> str:
        """Return a sentence with the factor of the resonances."""
        return (
            f"The resonances of {self.channel_text} are at {np.exp(-self.value):.4g} times the"
            " frequencies of the other channels: its data seem to be from another test, or another"
            " state of the structure."
        )
