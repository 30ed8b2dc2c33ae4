"""Which part of the data is fitted, and which is held out to judge the fit by."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from updyn.dofs import Dof, DofSet
from updyn.errors import DataError
from updyn.frf import FRF

__all__ = ["Split", "split_data"]


@dataclass(frozen=True, slots=True)
class Split:
    """Data that are fitted and data that are held out.

    Attributes
    ----------
    whole : FRF
        All data.
    fitted : FRF
        What is fitted.
    responses : tuple of str
        Labels of the responses that are held out.
    band : tuple of (float, float) or None
        Band that is held out, in Hz.
    held : FRF or None
        What is held out.
    """

    whole: FRF
    fitted: FRF
    responses: tuple[str, ...] = ()
    band: tuple[float, float] | None = None
    held: FRF | None = None


def split_data(frf: FRF, validation: Iterable[str | Dof] | tuple[float, float] | None) -> Split:
    """Hold responses, or a band, out of the data.

    Parameters
    ----------
    frf : FRF
        All data.
    validation : iterable of str or Dof, or (float, float), optional
        Responses, or a band in Hz.

    Raises
    ------
    DataError
        If the band or the responses are not understood, or nothing is left to fit.
    DofError
        If a response is not in the data.
    """
    given = [] if validation is None else list(validation)
    if not given:
        return Split(frf, frf)
    if all(isinstance(v, int | float) for v in given):
        if len(given) != 2:
            raise DataError(
                f"validation {given!r}: expected two frequencies in Hz, or response labels"
            )
        low, high = float(given[0]), float(given[1])  # type: ignore[arg-type]
        held = frf.select(band=(low, high))
        kept = frf.freq[(frf.freq < low) | (frf.freq > high)]
        if kept.size == 0:
            raise DataError(
                f"validation band {low:g} to {high:g} Hz holds all lines: nothing is left to fit"
            )
        return Split(frf, frf.select(lines=kept), band=(low, high), held=held)
    chosen = DofSet(given)  # type: ignore[arg-type]
    at = np.sort(frf.responses.match(chosen, "validation response").index)
    rest = np.setdiff1d(np.arange(len(frf.responses)), at)
    if rest.size == 0:
        raise DataError("validation holds out all responses: nothing is left to fit")
    held_set, fitted_set = frf.responses[at], frf.responses[rest]
    return Split(
        frf,
        frf.select(responses=fitted_set),
        tuple(held_set.labels),
        held=frf.select(responses=held_set),
    )
