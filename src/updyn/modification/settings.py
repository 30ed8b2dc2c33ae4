"""Numbers that decide how a modification is compared with the structure."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MODIFICATION"]


@dataclass(frozen=True)
class ModificationSettings:
    """Numbers of the comparison of modes."""

    #: [modes] Number of further modes of the changed model that may pair with the modes of the
    #: structure. Effort: a mass that is added lowers modes from above into the range; few do.
    further_modes: int = 2
    #: [1] Relative difference of two models that are equal. Rounding: far above that of a product,
    #: far below a change that matters.
    rounding: float = 1e-9


MODIFICATION = ModificationSettings()
