"""Message on modes with level-dependent stiffness."""

from __future__ import annotations

import numpy as np

from updyn.modal.mode_set import ModeSet

__all__ = ["describe_leaning"]

#: Largest number of peaks in a message.
_NAMED = 8


def describe_leaning(modes: ModeSet) -> str:
    """Return the leaning peaks of measured modes as text; empty for none."""
    leaning = np.flatnonzero(np.isfinite(modes.lean))
    if not len(leaning):
        return ""
    named = [f"{modes.frequency[k]:.6g} Hz ({modes.lean[k]:+.2g} Hz)" for k in leaning[:_NAMED]]
    which = ", ".join(named) + ", ..." * (len(leaning) > _NAMED)
    what = f"peak at {which} leans" if len(leaning) == 1 else f"peaks at {which} lean"
    return (
        f"The {what}: the stiffness depends on the level. In brackets the shift of the frequency"
        " from small motion to the largest one."
    )
