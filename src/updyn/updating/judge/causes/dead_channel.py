"""A sensor or a force whose data are zeros throughout."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from updyn.frf import FRF
from updyn.updating.judge.causes.fault import each_sensor, place_of, without
from updyn.updating.judge.causes.shown import LIKELY, Shown, ShownFault
from updyn.updating.problem.problem import Part

__all__ = ["DeadChannel"]

#: Level of the model, as a share of its loudest channel, from which it has a response.
_HEARD = 1e-8
#: Lines at which the model is asked.
_LINES = 8


class DeadChannel(ShownFault):
    """All values of a sensor, or of a force, are exactly zero, which no measurement is."""

    __slots__ = ()

    kind: ClassVar[str] = "dead-channel"
    odds: ClassVar[float] = 1e-2
    leaves_out: ClassVar[bool] = True

    @classmethod
    def shown(cls, frf: FRF) -> Iterable[Shown]:
        """Yield each sensor without a value, where others have some."""
        for channels in each_sensor(frf):
            there = place_of(channels, frf).within(frf)
            # A value that is not zero is certain where a channel works.
            log_odds = len(frf.freq) * np.count_nonzero(there) + float(np.log(cls.odds))
            if log_odds > LIKELY and not frf.values[:, there].any():
                yield Shown(cls(channels), log_odds, float(there.mean()))

    def is_expected(self, part: Part) -> bool:
        """Return whether the model has no response there, as by symmetry or without a connection.

        Raises
        ------
        SolverError
            If the model is singular at a line.
        """
        few = part.thinned(_LINES)
        level = np.abs(few.responses(few.coordinates.home)).max(axis=0)
        there = place_of(self.channels, part.frf).within(part.frf)
        return bool(level[there].max() <= _HEARD * level.max())

    @property
    def written(self) -> str:
        """``dead-channel:7:X``."""
        return self.named

    def repair(self, frf: FRF) -> FRF:
        """Return the data without the channels.

        Raises
        ------
        DataError
            If nothing else is left.
        """
        return without(self, frf)

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return (
            f'Leave it out: repair = ["{self.written}"] under [test]; look at the cable and at how'
            " the file was written."
        )

    def statement(self) -> str:
        """Return which channels hold zeros."""
        return f"{self.does('holds', 'hold')} nothing but zeros: a dead channel, or lost data."
