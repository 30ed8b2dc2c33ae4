"""Message on modes with level-dependent stiffness."""

from __future__ import annotations

import numpy as np

from updyn.modal.mode_set import ModeSet
from updyn.modal.settings import UNEXPLAINED_PEAK

__all__ = ["describe_leaning"]


def describe_leaning(modes: ModeSet) -> str:
    """Return the leaning peaks of measured modes as text; empty for none."""
    leaning = np.flatnonzero(np.isfinite(modes.lean))
    if not len(leaning):
        return ""
    most = UNEXPLAINED_PEAK.listed_peaks
    named = [f"{modes.frequency[k]:.6g} Hz ({modes.lean[k]:+.2g} Hz)" for k in leaning[:most]]
    which = ", ".join(named) + ", ..." * (len(leaning) > most)
    what = f"peak at {which} leans" if len(leaning) == 1 else f"peaks at {which} lean"
    return (
        f"The {what}: the stiffness depends on the level. In brackets the shift of the frequency"
        " from small motion to the largest one."
    )
