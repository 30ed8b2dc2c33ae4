"""Measured FRFs that a plant approximates: channels of ports, noise, initial poles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.ports import Port
from updyn.control.settings import MEASURED_PLANT
from updyn.control.target import ResponseTarget
from updyn.dofs import DofSet
from updyn.errors import DataError, DofError
from updyn.frf import FRF, QUANTITIES
from updyn.modal.identify import identify_modes
from updyn.updating.problem.noise.known import Coherence

__all__ = ["PortMeasurement", "select_measurement"]


_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class PortMeasurement:
    """A measurement between ports: the values, and the poles of its modes in the band, in rad/s.

    `deviation`, shape (n_f, n_y, n_u), are standard deviations of the values, 0 if unknown; `noise`
    is their source.
    """

    target: ResponseTarget
    deviation: RealArray
    poles: ComplexArray
    noise: str

    def reference(self, tolerance: float) -> RealArray:
        """Return the denominator of relative errors, so large that noise is within a tolerance."""
        noise = MEASURED_PLANT.accepted_stds * self.deviation
        return np.maximum(self.target.reference, noise / tolerance)


def select_measurement(
    frf: FRF,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    quantities: tuple[str, ...],
    band: tuple[float, float],
) -> PortMeasurement:
    """Return the measurement between ports, over a band in Hz."""
    inside = (frf.freq >= band[0]) & (frf.freq <= band[1]) & (frf.freq > 0.0)
    if int(inside.sum()) < MEASURED_PLANT.least_lines:
        raise DataError(
            f"plant: {int(inside.sum())} lines of the measurement lie from {band[0]:g} to"
            f" {band[1]:g} Hz; it has {len(frf.freq)} from {frf.freq[0]:g} to {frf.freq[-1]:g} Hz,"
            f" and a plant requires at least {MEASURED_PLANT.least_lines}"
        )
    data = frf.select(lines=frf.freq[inside])
    out, into = (
        _weights(outputs, data.responses, "output"),
        _weights(inputs, data.references, "input"),
    )
    s = 2j * np.pi * data.freq
    power = np.array([QUANTITIES[q] for q in quantities]) - QUANTITIES[data.quantity]
    rate = (s[:, None] ** power)[:, :, None]
    values = (out @ data.values @ into.T) * rate
    variance, noise = _variance(data)
    deviation = np.sqrt(out**2 @ variance @ into.T**2) * np.abs(rate)
    nothing = np.zeros(values.shape)
    target = ResponseTarget.at(data.freq, values, quantities, nothing, slow=False)
    modes = identify_modes(data)
    damping = 0.5 * np.nan_to_num(modes.loss_factor, nan=0.01)
    poles = _TWO_PI * modes.frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
    return PortMeasurement(target, deviation, np.asarray(poles), noise)


def _weights(ports: tuple[Port, ...], dofs: DofSet, what: str) -> RealArray:
    weights = np.zeros((len(ports), len(dofs)))
    for row, port in enumerate(ports):
        try:
            match = dofs.match(DofSet(port.weights), what)
        except DofError as error:
            raise DofError(f"port {port.name!r} of the measurement: {error}") from error
        weights[row, match.index] = match.sign * np.array(list(port.weights.values()))
    return weights


def _variance(frf: FRF) -> tuple[RealArray, str]:
    """Return the variance of the values, and its source."""
    if frf.variance is not None:
        return frf.variance, "variance"
    if frf.coherence is not None and frf.averages not in (None, 1):
        return Coherence.of_data(frf).variance(frf.values, frf), "coherence"
    return np.zeros(frf.values.shape), "not known"
