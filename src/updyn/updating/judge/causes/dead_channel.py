"""A sensor or a force whose data are all zero."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from updyn.frf import FRF
from updyn.updating.judge.causes.fault import find_channels, list_channels, remove_channels
from updyn.updating.judge.causes.settings import CAUSE_ODDS, CAUSE_SEARCH, DATA_FAULT
from updyn.updating.judge.causes.shown import DataFault, Detection
from updyn.updating.problem.problem import FRFPart

__all__ = ["DeadChannel"]


class DeadChannel(DataFault):
    """All values of a sensor or a force are exactly zero, which no measurement produces."""

    __slots__ = ()

    kind: ClassVar[str] = "dead-channel"
    odds: ClassVar[float] = 1e-2
    omits_channels: ClassVar[bool] = True
    advice: ClassVar[str] = "Omit it:"
    remark: ClassVar[str] = "Check the cable and the export of the file."

    @classmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Yield each sensor without values if others have some."""
        for channels in list_channels(frf):
            mask = find_channels(channels, frf).channel_mask(frf)
            # A value of a working channel is certainly not zero.
            log_odds = len(frf.freq) * np.count_nonzero(mask) + float(np.log(cls.odds))
            if log_odds > CAUSE_ODDS.likely_log_odds and not frf.values[:, mask].any():
                yield Detection(cls(channels), log_odds, float(mask.mean()))

    def is_expected(self, part: FRFPart) -> bool:
        """Return whether the model has no response there, as by symmetry."""
        few = part.thin(CAUSE_SEARCH.glance_lines)
        level = np.abs(few.responses(few.coordinates.start)).max(axis=0)
        mask = find_channels(self.channels, part.frf).channel_mask(part.frf)
        return bool(level[mask].max() <= DATA_FAULT.least_response * level.max())

    @property
    def repair_text(self) -> str:
        """Text of the fault: ``dead-channel:7:X``."""
        return self.name

    def repair(self, frf: FRF) -> FRF:
        """Return the data without the channels."""
        return remove_channels(self, frf)

    def statement(self) -> str:
        """Return a sentence with the channels."""
        return (
            f"{self.begin_sentence('contains', 'contain')} only zeros: a dead channel or lost data."
        )
