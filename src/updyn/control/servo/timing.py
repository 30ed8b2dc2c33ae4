"""Time responses of a closed loop, as a servo reports them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.control.servo.judged import Judged
from updyn.control.servo.loops import Cascade
from updyn.control.servo.record import StepResponse, WindResponse
from updyn.control.servo.state_space import StateSpace
from updyn.control.servo.time_response import (
    at_rest,
    march,
    march_late,
    schedule,
    step_figures,
    step_series,
)
from updyn.control.servo.wind import Wind
from updyn.errors import DataError, OptionError
from updyn.group import is_number

__all__ = ["Timed", "timed"]

_Real = NDArray[np.float64]
_TWO_PI = 2.0 * np.pi

#: Positions in `Cascade.closed`.
_REFERENCE, _RATE, _VELOCITY, _DISTURBANCE = range(4)
_POSITION, _TORQUE, _POINTING = range(3)
#: Share of the variance of the error that the series of a wind may leave out at its upper end, and
#: its longest length.
_LEFT_OUT, _LONGEST = 1e-4, 2**16
#: With exact dead time: how much finer the intervals are, the most of them, and the fewest in the
#: dead time where those are not enough. How many samples are kept, about.
_FINER, _LONGEST_STEP, _COARSEST, _KEPT = 4.0, 60_000, 16, 5000


@dataclass(frozen=True, slots=True)
class Timed:
    """Responses over time, and what is to be said about them; as in `updyn.control.servo.record.Servo`."""

    step: StepResponse | None = None
    disturbance_step: StepResponse | None = None
    wind: WindResponse | None = None
    notes: tuple[str, ...] = ()


def timed(
    cascade: Cascade,
    judged: Judged,
    step: float | None,
    disturbance_step: float | None,
    wind: Wind | tuple[ArrayLike, ArrayLike] | None,
    duration: float | None,
) -> Timed:
    """Return the responses over time of a stable closed loop.

    Parameters
    ----------
    cascade : Cascade
        Controller and plant.
    judged : Judged
        Its outermost loop.
    step, disturbance_step : float or None
        Heights.
    wind : Wind or (time, disturbance), optional
        What acts.
    duration : float, optional
        Of the steps, in s.

    Raises
    ------
    OptionError
        If a number cannot be used.
    DataError
        If a series cannot be used.
    """
    for name, value in (
        ("step", step),
        ("disturbance_step", disturbance_step),
        ("duration", duration),
    ):
        if value is not None and (not is_number(value) or not np.isfinite(value) or value == 0):
            raise OptionError(
                f"servo: {name} is {value!r}; expected a number other than 0, or None"
            )
    if duration is not None and duration < 0:
        raise OptionError(f"servo: duration is {duration!r}; expected a time in s above 0")
    system = cascade.closed(judged.pade, pointing=True)
    jumps = bool(np.isnan(system.D[_POINTING, _DISTURBANCE]))
    system = replace(system, D=np.nan_to_num(system.D))  # of inputs that are 0 wherever it is read
    notes: list[str] = []
    reference = (
        _reference_step(cascade, system, step, duration, notes) if step is not None else None
    )
    if cascade.wiring.disturbance is None:
        return Timed(reference, notes=tuple(notes))
    if jumps:
        notes.append(
            "a step of the disturbance makes the velocity jump without bound (direct feed-through):"
            " left out"
        )
        return Timed(reference, notes=tuple(notes))
    disturbed = (
        _disturbance_step(cascade, system, disturbance_step, duration)
        if disturbance_step is not None
        else None
    )
    blown = None if wind is None else _wind(cascade, judged, system, wind)
    return Timed(reference, disturbed, blown, tuple(notes))


def _reference_step(
    cascade: Cascade, system: StateSpace, size: float, duration: float | None, notes: list[str]
) -> StepResponse | None:
    outer = cascade.has_position
    at = _REFERENCE if outer else _VELOCITY
    rate = _RATE if outer and cascade.controller.feed_forward else None
    if rate is not None and (system.D[_POSITION, rate] or system.D[_TORQUE, rate]):
        notes.append(
            "a step of the reference with feed-forward asks for a torque without bound: left out;"
            " give a low_pass"
        )
        return None
    wiring = cascade.wiring
    name = (wiring.position if outer else wiring.velocity) or wiring.velocity
    unit = _unit(cascade, name, not outer)
    time, outputs, slopes = _record(cascade, system, _POSITION, at, size, rate, duration)
    final = size * at_rest(system, _POSITION, at)
    figures = step_figures(time, outputs[:, _POSITION], slopes[:, _POSITION], final, True)
    time, value, torque = _thinned(time, outputs[:, _POSITION], outputs[:, _TORQUE])
    return StepResponse(
        "reference", float(size), name, unit, name, unit, time, value, torque, final, figures.rise_time,
        figures.overshoot, figures.settling_time, figures.peak, figures.peak_time,
    )  # fmt: skip


def _record(
    cascade: Cascade,
    system: StateSpace,
    output: int,
    at: int,
    size: float,
    rate: int | None,
    duration: float | None,
) -> tuple[_Real, _Real, _Real]:
    """Return time, outputs of `Cascade.closed` and derivatives after a step; the dead time exact where it can be."""
    parts = schedule(system, output, at, None if duration is None else float(duration))
    delay = cascade.controller.dead_time
    opened = cascade.opened() if delay else None
    long = sum(n * dt for n, dt in parts)
    wanted = int(np.ceil(_FINER * delay / min(dt for _, dt in parts)))
    late = min(wanted, int(_LONGEST_STEP * delay / long))
    if opened is None or late < min(wanted, _COARSEST):
        return step_series(system, at, size, rate, parts)
    w = np.zeros(system.B.shape[1])
    w[at] = size
    start = np.zeros(opened.n_states) if rate is None else opened.B[:, 1 + rate] * size
    n = int(np.ceil(long * late / delay - 1e-9)) + 1
    time, outputs, slopes = march_late(opened, w, start, delay, delay / late, n)
    order = [1, 0, 2]
    return time, outputs[:, order], slopes[:, order]


def _thinned(time: _Real, value: _Real, torque: _Real) -> tuple[_Real, _Real, _Real]:
    """Return a record of at most about `_KEPT` samples, the first ones and every so many of the others."""
    every = max(1, round(len(time) / _KEPT))
    keep = np.unique(
        np.concatenate([np.arange(min(len(time), _KEPT // 5)), np.arange(0, len(time), every)])
    )
    return time[keep], value[keep], torque[keep]


def _disturbance_step(
    cascade: Cascade, system: StateSpace, size: float, duration: float | None
) -> StepResponse:
    name, unit, output, output_unit = _disturbance_names(cascade)
    time, outputs, slopes = _record(cascade, system, _POINTING, _DISTURBANCE, size, None, duration)
    final = size * at_rest(system, _POINTING, _DISTURBANCE)
    figures = step_figures(time, outputs[:, _POINTING], slopes[:, _POINTING], final, False)
    time, value, torque = _thinned(time, outputs[:, _POINTING], outputs[:, _TORQUE])
    return StepResponse(
        "disturbance", float(size), name, unit, output, output_unit, time, value, torque, final, None, None,
        figures.settling_time, figures.peak, figures.peak_time,
    )  # fmt: skip


def _wind(
    cascade: Cascade, judged: Judged, system: StateSpace, wind: Wind | tuple[ArrayLike, ArrayLike]
) -> WindResponse:
    expected, facts = None, {}
    if isinstance(wind, Wind):
        expected, needed = _expected(cascade, judged, wind)
        time, torque = wind.series(max(needed, wind.duration / _LONGEST))
        facts = {
            "mean_speed": wind.mean_speed, "coefficient": wind.coefficient, "turbulence": wind.intensity,
            "roughness": wind.drag, "seed": wind.seed, "mean_torque": wind.mean_torque,
        }  # fmt: skip
    else:
        time, torque = _series(wind)
    rest = at_rest(system, _POINTING, _DISTURBANCE)
    if np.isnan(rest):
        rest, first = 0.0, 0.0
    else:
        first = torque[0]  # it has acted for ever before
    u = np.zeros((len(time), 4))
    u[:, _DISTURBANCE] = torque - first
    error = march(system, u, float(time[1] - time[0]))[1][:, _POINTING] + rest * first
    name, unit, output, output_unit = _disturbance_names(cascade)
    return WindResponse(
        name, unit, output, output_unit, time, torque, error, float(np.sqrt(np.mean(error**2))),
        float(np.abs(error).max()), float(error.mean()), expected, facts,
    )  # fmt: skip


def _expected(cascade: Cascade, judged: Judged, wind: Wind) -> tuple[float, float]:
    """Return the root mean square of the error by the spectrum, and the interval that a series needs, in s."""
    low = min(judged.w[0] / _TWO_PI, 1e-3 * wind.mean_speed / 1200.0)
    edges = np.unique(
        np.concatenate([np.geomspace(low, judged.w[-1] / _TWO_PI, 2000), judged.w / _TWO_PI])
    )
    middle = 0.5 * (edges[1:] + edges[:-1])
    ends, between = (np.abs(cascade.compliance(2j * np.pi * f)) ** 2 for f in (edges, middle))
    shares = wind.torque_variance(edges) * (ends[1:] + 4.0 * between + ends[:-1]) / 6.0
    below = float(wind.torque_variance(np.array([0.0, low]))[0] * ends[0])
    total = np.cumsum(shares) + below
    top = float(edges[1:][np.searchsorted(total, (1.0 - _LEFT_OUT) * total[-1])])
    return float(np.sqrt(total[-1])), 1.0 / (8.0 * top)


def _series(given: tuple[ArrayLike, ArrayLike]) -> tuple[_Real, _Real]:
    try:
        time, values = (np.array(part, dtype=np.float64) for part in given)
    except (TypeError, ValueError) as error:
        raise DataError(
            "wind: expected a Wind, or (time, disturbance) as two arrays of one length"
        ) from error
    if time.ndim != 1 or time.shape != values.shape or len(time) < 2:
        raise DataError(
            f"wind: times and values have shapes {time.shape} and {values.shape}; expected two"
            " arrays of one length"
        )
    if not np.isfinite(time).all() or not np.isfinite(values).all():
        raise DataError("wind: the series holds a number that is not finite")
    step = float(np.median(np.diff(time)))
    uneven = np.flatnonzero(np.abs(np.diff(time) - step) > 1e-6 * abs(step))
    if step <= 0 or len(uneven):
        where = int(uneven[0]) if len(uneven) else 0
        raise DataError(
            f"wind: times have to be equally spaced and increase; after {time[where]:g} s comes"
            f" {time[where + 1]:g} s, but most intervals are {step:g} s"
        )
    return time, values


def _unit(cascade: Cascade, name: str, velocity: bool) -> str:
    plant = cascade.plant
    port = plant.output_ports[plant.outputs.index(name)]
    return port.motion_unit("mobility" if velocity else "receptance")


def _disturbance_names(cascade: Cascade) -> tuple[str, str, str, str]:
    wiring, plant = cascade.wiring, cascade.plant
    assert wiring.disturbance is not None
    unit = plant.input_units[plant.inputs.index(wiring.disturbance)]
    velocity = not cascade.has_position and wiring.pointing == wiring.velocity
    return wiring.disturbance, unit, wiring.pointing, _unit(cascade, wiring.pointing, velocity)
