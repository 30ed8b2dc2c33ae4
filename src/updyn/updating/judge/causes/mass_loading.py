"""Mass loading by a roving sensor, at another place in each row of the data."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import IrreparableFault

__all__ = ["MassLoading"]


class MassLoading(IrreparableFault):
    """A mass of `value` kg at the response of each row only.

    H_ij / (1 - omega^2 m H_ii) is measured instead of H_ij (Ewins, Modal Testing, 2nd ed. 2000,
    section 3.4).
    """

    __slots__ = ()

    kind: ClassVar[str] = "mass-loading"
    unit: ClassVar[str] = "kg"
    has_free_size: ClassVar[bool] = True
    is_positive: ClassVar[bool] = True
    advice: ClassVar[str] = (
        "Check whether a sensor was moved. If so, make each row a separate test with the mass"
        " in its model ([test] sensor_masses), or use dummy masses."
    )

    @classmethod
    def applies_to(cls, frf: FRF) -> bool:
        """Return whether the receptances of the excited structure are symmetric."""
        return frf.force is None

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the only fault of this kind, if the responses are translations."""
        turns = any(dof.direction.startswith("R") for dof in evidence.frf.responses)
        if len(evidence.frf.responses) > 1 and not turns:
            yield cls()

    def repair(self, frf: FRF) -> FRF:
        """Raise a `DataError` with the remedy: the data alone do not determine the correction."""
        raise DataError(
            "mass loading cannot be corrected from the data alone, because the correction needs the"
            " drive point of every sensor: make each row a separate test with the mass in its model"
            " (updyn.sensor_masses), or use dummy masses"
        )

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return omega^2 H_ii / (1 - omega^2 m H_ii)."""
        a = evidence.drive_point_response
        return np.broadcast_to((a / (1.0 - self.value * a))[:, :, None], evidence.frf.values.shape)

    def log_change(self, evidence: Evidence) -> ComplexArray:
        """Return -ln(1 - omega^2 m H_ii)."""
        log_correction = np.log(1.0 - self.value * evidence.drive_point_response)[:, :, None]
        return np.broadcast_to(-log_correction, evidence.frf.values.shape)

    def statement(self) -> str:
        """Return a sentence with the mass."""
        return f"A roving sensor adds a mass of {self.value:.4g} kg at the response of each row."
