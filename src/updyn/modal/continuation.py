"""Analytic continuation of measured FRFs from i omega + a to i omega, by a rational model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from updyn.errors import DataError
from updyn.frf import FRF
from updyn.modal.settings import DECAY_REMOVAL, VECTOR_FITTING
from updyn.modal.vector_fitting import RationalBasis, fit_by_cross_validation

__all__ = ["remove_decay"]


def remove_decay(frf: FRF) -> FRF:
    """Return FRFs on the axis of real frequency; data without a decay unchanged."""
    # Accelerances H(i omega + decay) of records with an exponential window are fitted by a
    # rational function of -s^2 with common poles, exact for structural damping; the change of the
    # fit to i omega is added to the data, so their deviations are kept. A line at 0 Hz is
    # unchanged: the window affects it only to second order.
    if not frf.decay:
        return frf
    moving = frf.freq > 0.0
    if not frf.values[moving].any():
        return replace(frf, decay=0.0)
    omega = 2.0 * np.pi * frf.freq[moving]
    least = 2 * DECAY_REMOVAL.lines_per_pole  # a pole in each half of the lines
    if len(omega) < least:
        raise DataError(
            f"the damping of an exponential window is taken out of at least {least} lines above 0"
            f" Hz, found {len(omega)}; widen the band, or leave the damping in (remove_damping ="
            " False)",
            key=("band",),
        )
    unit = float(omega[-1])
    with_decay, without_decay = (
        np.asarray(-(((1j * omega + a) / unit) ** 2)) for a in (frf.decay, 0.0)
    )
    power = 2 - frf.modal_power
    factor = ((1j * omega + frf.decay) ** power)[:, None]
    flat = frf.values[moving].reshape(len(omega), -1) * factor
    size = np.sqrt(np.mean(np.abs(flat) ** 2, axis=0))
    size = np.maximum(size, DECAY_REMOVAL.least_level * size.max())
    most = max(1, min(DECAY_REMOVAL.most_poles, len(omega) // DECAY_REMOVAL.lines_per_pole))
    at = np.linspace(omega[0] / unit, 1.0, min(VECTOR_FITTING.first_poles, most) + 2)[1:-1]
    begin = (at**2 * (1.0 + 1j * VECTOR_FITTING.new_loss_factor)).astype(np.complex128)
    fitted, _ = fit_by_cross_validation(
        RationalBasis(2, mirrored=False), with_decay, flat / size, begin, most
    )
    change = (fitted.at(without_decay) - fitted.at(with_decay)) * size
    back = ((1j * omega) ** power)[:, None]
    values = frf.values.copy()
    values[moving] = ((flat + change) / back).reshape(values[moving].shape)
    return replace(frf, values=values, decay=0.0)
