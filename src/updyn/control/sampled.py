"""`sampled`: discretise a plant for a digital controller, with a delay of its input."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.plant import Plant
from updyn.control.servo.state_space import StateSpace, bilinear, interval_matrices
from updyn.control.settings import DISCRETISATION
from updyn.errors import DataError, OptionError, suggest
from updyn.group import is_number

__all__ = ["sampled"]

_Matrices = tuple[RealArray, RealArray, RealArray, RealArray]

_METHODS = ("zoh", "tustin")


def sampled(
    plant: Plant,
    dt: float,
    method: str = "zoh",
    delay: float = 0.0,
    *,
    prewarp: float | None = None,
) -> Plant:
    """Return a sampled plant: x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k].

    Parameters
    ----------
    plant : Plant
        A continuous plant; may have rigid-body motion.
    dt : float
        Sampling interval in s.
    method : {"zoh", "tustin"}
        ``"zoh"``: the input is held over each interval, as by the converter of a drive; exact at
        the samples. ``"tustin"``: s = 2 (z - 1) / (dt (z + 1)) without a hold, for comparison with
        a continuous plant, or for a plant that is not driven by a converter.
    delay : float
        Delay of the input in s (computation, transport, current loop), of any length. Each started
        interval adds one state per input. For ``"tustin"`` a whole number of intervals.
    prewarp : float, optional
        Frequency in Hz at which ``"tustin"`` has the response of the continuous plant exactly.

    Returns
    -------
    Plant
        With `Plant.dt`, and the delay in `Plant.delay` in intervals, rounded up. `Plant.error`
        remains that of the continuous plant. ``facts["sampling"]`` contains ``method``, ``dt``,
        ``delay`` (in s), ``prewarp`` (in Hz or None), ``deviation`` and
        ``deviation_without_hold``: the largest difference of a channel in the band from hold x
        continuous plant x exp(-s delay), and from the same without the hold, as shares of the
        channel's peak; and ``above_nyquist``: natural frequencies in Hz above half the sampling
        rate, which are aliased.

    Raises
    ------
    OptionError
        If the plant is already sampled, `dt` is not above 0, the band extends above half the
        sampling rate, the method is unknown, the delay is negative or not possible, `prewarp` is
        not below half the sampling rate, or the plant has a pole at the singularity of the
        substitution of ``"tustin"`` (s = 2 / dt).

    Notes
    -----
    Hold: exponential of the matrix augmented with the input (Van Loan 1978, IEEE Trans. Autom.
    Control 23, p. 395), without an inverse of A. Delay by a part of an interval: the input changes
    once
    within each interval (Franklin, Powell & Workman, Digital Control of Dynamic Systems, 3rd ed.,
    section 4.3). Bilinear substitution and prewarping: ibid., chapter 6.

    Examples
    --------
    >>> digital = updyn.sampled(plant, 1e-3, delay=1.5e-3)  # doctest: +SKIP
    """
    interval = _interval(plant, dt)
    if method not in _METHODS:
        raise OptionError(f"method {method!r} of sampling; {suggest(str(method), _METHODS)}")
    whole, part = _intervals(delay, interval, len(plant.inputs), plant.n_states)
    if method == "zoh":
        if prewarp is not None:
            raise OptionError(
                "prewarp belongs to method 'tustin'; a held input is exact at every frequency"
            )
        prompt = _hold_input(plant, interval, part)
    else:
        if part:
            raise OptionError(
                f"delay {delay:g} s is {delay / interval:g} intervals of {interval:g} s; method"
                " 'tustin' requires a whole number of them, nearest"
                f" {round(delay / interval) * interval:g} s ('zoh' accepts any delay)"
            )
        prompt = _tustin(plant, interval, prewarp)
    warped = None if prewarp is None else float(prewarp)
    facts = {"method": method, "dt": interval, "delay": float(delay), "prewarp": warped}
    facts |= _deviations(plant, _with_matrices(plant, prompt, dt=interval), float(delay), whole)
    return _with_matrices(
        plant,
        _delay_input(*prompt, whole),
        dt=interval,
        delay=whole + bool(part),
        facts={**plant.facts, "sampling": facts},
    )


def _with_matrices(plant: Plant, matrices: _Matrices, **more: Any) -> Plant:
    A, B, C, D = matrices
    return replace(plant, A=A, B=B, C=C, D=D, **more)


# -- options --------------------------------------------------------------------------------------
def _interval(plant: Plant, dt: float) -> float:
    if plant.dt is not None:
        raise OptionError(
            f"the plant is already sampled, every {plant.dt:g} s; sample the continuous plant"
        )
    if not is_number(dt) or not math.isfinite(dt) or dt <= 0:
        raise OptionError(f"dt is {dt!r}; expected a sampling interval in s, above 0")
    if plant.band[1] > 0.5 / dt:
        raise OptionError(
            f"the band of the plant extends to {plant.band[1]:g} Hz, but half the sampling rate is"
            f" {0.5 / dt:g} Hz; sample every {0.5 / plant.band[1]:.4g} s or faster, or make the"
            " plant for a narrower band"
        )
    return float(dt)


def _intervals(delay: float, dt: float, n_inputs: int, n_states: int) -> tuple[int, float]:
    """Return the whole intervals of a delay, and the remaining part from 0 to below 1."""
    if not is_number(delay) or not math.isfinite(delay) or delay < 0:
        raise OptionError(f"delay is {delay!r}; expected a time in s, 0 or above")
    count = float(delay) / dt
    near = round(count)
    whole, part = near, 0.0
    if abs(count - near) > DISCRETISATION.whole_distance:
        whole = math.floor(count)
        part = count - whole
    most = DISCRETISATION.most_states
    if n_states + (whole + 1) * n_inputs > most:
        raise OptionError(
            f"delay {delay:g} s is {count:g} intervals of {dt:g} s: with one state for each input"
            f" and interval the plant would have more than {most} states; expected a delay in s"
        )
    return whole, part


# -- zero-order hold ------------------------------------------------------------------------------
def _hold_input(plant: Plant, dt: float, part: float) -> _Matrices:
    """Return the matrices for a held input delayed by a part of an interval."""
    transition, forced, _ = interval_matrices(plant.A, plant.B, (1.0 - part) * dt)
    if not part:
        return transition, forced, plant.C, plant.D
    # From k dt the input of interval k - 1 acts for another part dt, then that of interval k.
    first, before, _ = interval_matrices(plant.A, plant.B, part * dt)
    states, inputs = plant.B.shape
    A = np.block([[transition @ first, transition @ before], [np.zeros((inputs, states + inputs))]])
    B = np.vstack([forced, np.eye(inputs)])
    # At the sample the earlier input still acts.
    return A, B, np.hstack([plant.C, plant.D]), np.zeros_like(plant.D)


# -- bilinear substitution ------------------------------------------------------------------------
def _tustin(plant: Plant, dt: float, prewarp: float | None) -> _Matrices:
    """Return the matrices of G(2 (z - 1) / (step (z + 1)))."""
    step = dt
    if prewarp is not None:
        if not is_number(prewarp) or not 0 < prewarp < 0.5 / dt:
            raise OptionError(
                f"prewarp is {prewarp!r}; expected a frequency in Hz above 0 and below half the"
                f" sampling rate, {0.5 / dt:g} Hz"
            )
        omega = 2 * np.pi * prewarp
        step = 2 * math.tan(omega * dt / 2) / omega
    poles = plant.poles
    singular = np.abs(poles * step / 2 - 1) < DISCRETISATION.singular_distance
    if singular.any():
        pole = poles[singular][0].real
        raise OptionError(
            f"the plant has a pole at s = {pole:g} rad/s, where the substitution of method 'tustin'"
            f" is singular (2 / dt{', prewarped' if prewarp is not None else ''}); choose another"
            " dt, or method 'zoh'"
        )
    converted = bilinear(StateSpace(plant.A, plant.B, plant.C, plant.D), step)
    return converted.A, converted.B, converted.C, converted.D


# -- delay ----------------------------------------------------------------------------------------
def _delay_input(A: RealArray, B: RealArray, C: RealArray, D: RealArray, whole: int) -> _Matrices:
    """Return the matrices with the input delayed by whole intervals; states x, u[k-1], ...."""
    if not whole:
        return A, B, C, D
    (n, m), held = B.shape, whole * B.shape[1]
    late_A = np.zeros((n + held, n + held))
    late_A[:n, :n] = A
    late_A[:n, n + held - m :] = B
    late_A[n + m :, n : n + held - m] = np.eye(held - m)
    late_B = np.zeros((n + held, m))
    late_B[n : n + m] = np.eye(m)
    late_C = np.zeros((len(C), n + held))
    late_C[:, :n], late_C[:, n + held - m :] = C, D
    return late_A, late_B, late_C, np.zeros_like(D)


# -- deviation ------------------------------------------------------------------------------------
def _deviations(plant: Plant, prompt: Plant, delay: float, whole: int) -> Mapping[str, object]:
    """Return the error of the sampled response as shares of the channels' peaks.

    `prompt` is without the whole intervals of the delay: their states would enlarge every solution.
    """
    assert prompt.dt is not None
    s = 2j * np.pi * _lines(plant)
    step = s * prompt.dt
    try:
        exact = plant.at(s) * np.exp(-s * delay)[:, None, None]
        found = prompt.at(np.exp(step)) * np.exp(-whole * step)[:, None, None]
    except DataError:  # an undamped pole in the band: no finite peak for comparison
        figures = {"deviation": math.nan, "deviation_without_hold": math.nan}
    else:
        hold = (-np.expm1(-step) / step)[:, None, None]
        figures = {
            "deviation": _largest_difference(found, hold * exact),
            "deviation_without_hold": _largest_difference(found, exact),
        }
    above = plant.modes[plant.modes > 0.5 / prompt.dt]
    return {**figures, "above_nyquist": [float(f) for f in above]}


def _lines(plant: Plant) -> RealArray:
    """Return nonzero lines over the band with each damped pole and its half-power points."""
    low, high = plant.band
    start = max(low, 1e-3 * high)
    poles = plant.poles[(plant.poles.imag > 0) & (plant.poles.real < 0)]
    peaks = np.concatenate([poles.imag, poles.imag + poles.real, poles.imag - poles.real]) / (
        2 * np.pi
    )
    half = DISCRETISATION.deviation_lines // 2
    even = np.linspace(start, high, half), np.geomspace(start, high, half)
    lines = np.concatenate([*even, peaks])
    return np.unique(lines[(lines >= start) & (lines <= high)])


def _largest_difference(found: ComplexArray, exact: ComplexArray) -> float:
    """Return the largest difference of a channel as a share of its peak."""
    off, peak = np.abs(found - exact).max(axis=0), np.abs(exact).max(axis=0)
    return float(np.max(off / np.where(peak > 0, peak, 1.0), initial=0.0))
