"""The complex mode indicator function (CMIF): singular values of the FRF matrix at each line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import DataError
from updyn.frf import FRF, unit
from updyn.modal.sides import Sides, as_accelerance

__all__ = ["Indicator", "cmif"]


@dataclass(frozen=True, slots=True, eq=False)
class Indicator:
    """The complex mode indicator function.

    `freq`, shape (n_f,), are lines in Hz, without 0 Hz; `values`, shape (n_f, k), the singular
    values of the accelerances, descending, with k the smaller of the numbers of responses and
    references.
    """

    freq: RealArray
    values: RealArray
    unit: str


def cmif(frf: FRF) -> Indicator:
    """Return the complex mode indicator function of a measurement.

    The first singular value has a peak at every mode. With several references, the second one also
    has a peak at close modes.

    Parameters
    ----------
    frf : FRF
        The measurement; converted to accelerance.

    Returns
    -------
    Indicator
        If rotations and translations were measured, rotations are multiplied by the length that
        makes them as large as translations.

    Raises
    ------
    DataError
        If 0 Hz is the only line.

    Notes
    -----
    C. Y. Shih, Y. G. Tsuei, R. J. Allemang, D. L. Brown, "Complex mode indication function and its
    application to spatial domain parameter estimation", Mech. Syst. Signal Process. 2 (1988)
    367-377.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> from updyn.modal import cmif
    >>> cmif(chain.measure()).values.shape
    (60, 2)
    """
    moving = np.flatnonzero(np.abs(frf.s) > 0.0)
    if not moving.size:
        raise DataError("cmif: 0 Hz is the only line; expected lines above")
    found = as_accelerance(frf.select(lines=frf.freq[moving]))
    sides = Sides.of(found)
    scaled = found.values * sides.row_scale[:, None] * sides.column_scale
    units = {
        unit(found.quantity, i, j) for i in found.responses.labels for j in found.references.labels
    }
    # Scaled rotations have the unit of translations.
    name = units.pop() if len(units) == 1 else unit(found.quantity, "1:X", "1:X")
    return Indicator(found.freq, np.linalg.svd(scaled, compute_uv=False), name)
