"""The line at 0 Hz of measured FRFs, at which a free model has no response."""

from __future__ import annotations

import warnings

from updyn.dynamics.response import response_like
from updyn.errors import SolverError, UpdynWarning
from updyn.frf import FRF
from updyn.model import Model

__all__ = ["leave_out_zero_line"]


def leave_out_zero_line(model: Model, frf: FRF, name: str = "") -> FRF:
    """Return the data without their line at 0 Hz, with a warning, if the model is free.

    `name` is that of the test, for the warning. If it is the only line, it is kept, and the
    solution raises an error. The DOFs of the data must be in the model.
    """
    if frf.freq[0] == 0.0 and len(frf.freq) > 1 and model.nonlinear:
        text = "the line at 0 Hz is left out: a model with nonlinear elements has no response there"
        warnings.warn(f"test {name!r}: {text}" if name else text, UpdynWarning, stacklevel=4)
        return frf.select(lines=frf.freq[1:])
    if frf.freq[0] > 0.0 or len(frf.freq) == 1 or not _is_free(model, frf):
        return frf
    text = "the line at 0 Hz is left out: the model is free, and its response there is not defined"
    warnings.warn(f"test {name!r}: {text}" if name else text, UpdynWarning, stacklevel=4)
    return frf.select(lines=frf.freq[1:])


def _is_free(model: Model, frf: FRF) -> bool:
    """Return whether the dynamic stiffness is singular at 0 Hz (with the decay of the data)."""
    try:
        response_like(model, frf, frf.freq[:1])
    except SolverError as error:
        return not isinstance(error.__cause__, MemoryError)
    return False
