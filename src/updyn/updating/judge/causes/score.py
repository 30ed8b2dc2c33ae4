"""How well a fault explains the data at one point of the unknowns, to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from updyn.updating.judge.causes.evidence import SMALLEST, Evidence, stacked
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import n_seen

__all__ = ["fitted"]

#: Sine of the angle between a fault and what the unknowns can do, from which they differ.
_DISTINCT = 1e-6

_MaybeFault = TypeVar("_MaybeFault", bound=Fault | None)


def fitted(evidence: Evidence, fault: _MaybeFault) -> tuple[float, _MaybeFault]:
    """Return how badly a fault explains the data at best, to first order, and its size.

    Parameters
    ----------
    evidence : Evidence
        Model and data at the point.
    fault : Fault or None
        Which; None: there is none.

    Returns
    -------
    cost : float
        -2 ln of the likelihood with the noise estimated, the unknowns' spread counted; all unknowns
        adapt, and the size of the fault where it tunes.
    fault : Fault or None
        The fault by its best size.
    """
    frf = evidence.frf
    if fault is not None and not (fault.tunes and fault.value == 0.0):
        frf = fault.undo(evidence)
    unit = evidence.unit
    home = evidence.home
    b = np.concatenate([evidence.misfit(frf) / unit, home])
    b = evidence.left(frf, b)
    if fault is not None and fault.tunes:
        d = np.zeros_like(b)
        d[: -len(home)] = stacked(evidence.weight * fault.slope(evidence)) / unit
        size = float(np.linalg.norm(d))
        d = evidence.left(frf, d)
        # What the unknowns can do as well is left to them.
        if np.linalg.norm(d) > _DISTINCT * size:
            step = float(d @ b / (d @ d))
            b -= step * d
            fault = replace(fault, value=fault.value + step)
    e, held = b[: -len(home)], b[-len(home) :]
    power = 2.0 * float(e @ e) * unit**2 / e.size
    return n_seen(evidence.frf) * float(np.log(power + SMALLEST**2)) + float(held @ held), fault
