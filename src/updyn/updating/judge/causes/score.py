"""Misfit of the data with a fault at one point of the unknowns, to first order."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.misfit import add_perfect_fit
from updyn.updating.judge.causes.settings import CAUSE_MISFIT

__all__ = ["fit_first_order"]


_MaybeFault = TypeVar("_MaybeFault", bound=Fault | None)


def fit_first_order(evidence: Evidence, fault: _MaybeFault) -> tuple[float, _MaybeFault]:
    """Return the least cost with a fault, or without, to first order, and the sized fault."""
    # The cost is -2 ln of the likelihood with the noise level estimated, and of the prior of the
    # unknowns.
    frf = evidence.frf
    if fault is not None and not (fault.has_free_size and fault.value == 0.0):
        frf = fault.repair_with_model(evidence)
    unit, offset = evidence.rms_misfit, evidence.offset_to_start
    b = evidence.adapted_misfit if frf is evidence.frf else evidence.adapt_to(frf)
    if fault is not None and fault.has_free_size:
        d = np.zeros_like(b)
        d[: -len(offset)] = stack_real_imag(evidence.weight * fault.slope(evidence)) / unit
        size = float(np.linalg.norm(d))
        d = evidence.project_out_unknowns(frf, d)
        # An effect that the unknowns can produce is attributed to them.
        if np.linalg.norm(d) > CAUSE_MISFIT.dependent_share * size:
            step = float(d @ b / (d @ d))
            b = b - step * d
            fault = replace(fault, value=fault.value + step)
    e, held = b[: -len(offset)], b[-len(offset) :]
    power = 2.0 * float(e @ e) * unit**2 / e.size
    return evidence.n_values * float(np.log(add_perfect_fit(power))) + float(held @ held), fault
