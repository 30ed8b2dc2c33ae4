"""Two channels with exchanged cables or labels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations
from typing import ClassVar, Self

from updyn.frf import FRF
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault, find_channels, list_sides
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES

__all__ = ["SwappedChannels"]


class SwappedChannels(Fault):
    """Two responses, or two references, are exchanged."""

    __slots__ = ()

    kind: ClassVar[str] = "swapped"
    pair_noun: ClassVar[str] = "sensors"
    exchanges_data: ClassVar[bool] = True
    is_local: ClassVar[bool] = True

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield the pairs of responses, and of references, with the same kind of motion."""
        for dofs, names in list_sides(evidence.frf):
            named = list(zip(dofs, names, strict=True))[: CAUSE_CANDIDATES.most_swapped]
            for (a, first), (b, second) in combinations(named, 2):
                if a.direction.startswith("R") == b.direction.startswith("R"):
                    yield cls((first, second))

    def repair(self, frf: FRF) -> FRF:
        """Return the data with the two channels exchanged."""
        indices = find_channels(self.channels, frf)
        parts = {}
        for name in ("values", "variance", "coherence"):
            whole = getattr(frf, name)
            if whole is not None:
                whole = whole.copy()
                if len(indices.rows):
                    whole[:, indices.rows] = whole[:, indices.rows[::-1]]
                else:
                    whole[:, :, indices.columns] = whole[:, :, indices.columns[::-1]]
                parts[name] = whole
        return replace(frf, **parts)

    def statement(self) -> str:
        """Return a sentence with the two channels."""
        return f"{self.channels[0]} and {self.channels[1]} are exchanged."
