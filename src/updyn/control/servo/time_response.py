"""Time responses of the closed loop by the matrix exponential: steps, wind, series."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
import scipy  # loads scipy.interpolate on use
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.control.servo.loops import Cascade
from updyn.control.servo.record import StepResponse, WindResponse
from updyn.control.servo.settings import STEP_RESPONSE, WIND_SERIES
from updyn.control.servo.stability import JudgedLoop
from updyn.control.servo.state_space import StateSpace, balance, interval_matrices
from updyn.control.servo.wind import LENGTH, Wind
from updyn.errors import DataError, OptionError
from updyn.group import is_number

__all__ = [
    "StepFigures",
    "TimeResponses",
    "delayed_response",
    "final_value",
    "linear_response",
    "schedule_intervals",
    "simulate_step",
    "step_figures",
    "time_responses",
]


_TWO_PI = 2.0 * np.pi
#: Indices of inputs and outputs in `Cascade.closed_loop`.
_REFERENCE, _RATE, _VELOCITY, _DISTURBANCE = range(4)
_POSITION, _TORQUE, _POINTING = range(3)


def linear_response(
    system: StateSpace, u: RealArray, dt: float, start: RealArray | None = None
) -> tuple[RealArray, RealArray]:
    """Return states and outputs for inputs `u`, (n_t, n_u), linear between samples `dt` s apart."""
    # First-order hold: exponential of the matrix augmented with the input and its slope (Van Loan
    # 1978, IEEE Trans. Autom. Control 23, p. 395).
    transition, held, sloped = interval_matrices(system.A, system.B, dt)
    transition = np.ascontiguousarray(transition.T)
    forced = u[:-1] @ held.T + np.diff(u, axis=0) @ sloped.T
    states = np.empty((len(u), system.n_states))
    states[0] = 0.0
    if start is not None:
        states[0] = start
    for k in range(len(u) - 1):
        states[k + 1] = states[k] @ transition + forced[k]
    return states, states @ system.C.T + u @ system.D.T


def delayed_response(
    opened: StateSpace, w: RealArray, start: RealArray, delay: float, dt: float, n_t: int
) -> tuple[RealArray, RealArray, RealArray]:
    """Return time, outputs and their derivatives of a loop whose first output is fed back delayed.

    `opened` has the delayed input and the output to feed back first; `w` are the other inputs,
    constant from time 0 on. `dt` divides `delay`.
    """
    # Method of steps: earlier steps give the delayed input, which is linear between samples, with
    # its jumps at multiples of the dead time.
    late = round(delay / dt)
    transition, held, sloped = interval_matrices(opened.A, opened.B, dt)
    constant = held[:, 1:] @ w
    first, pushed = held[:, 0], sloped[:, 0]
    c = opened.C[0]
    d = opened.D[0, 0]
    direct = float(opened.D[0, 1:] @ w)
    states = np.empty((n_t, len(transition)))
    states[0] = x = start
    # The delayed input just before and just after each sample, 0 during the first dead time.
    before = np.zeros(n_t + late)
    after = np.zeros(n_t + late)
    after[late] = c @ x + direct
    for k in range(n_t - 1):
        begins = after[k]
        ends = before[k + 1]
        x = transition @ x + first * begins + pushed * (ends - begins) + constant
        states[k + 1] = x
        fed_back = c @ x + direct
        before[k + 1 + late] = fed_back + d * ends
        after[k + 1 + late] = fed_back + d * after[k + 1]
    fed = after[:n_t]
    inputs = np.column_stack([fed, np.broadcast_to(w, (n_t, len(w)))])
    outputs = states @ opened.C.T + inputs @ opened.D.T
    slopes = (states @ opened.A.T + inputs @ opened.B.T) @ opened.C.T
    outputs[:, 0] = fed
    return np.asarray(np.arange(n_t) * dt, dtype=np.float64), outputs, slopes


def final_value(system: StateSpace, output: int, input: int) -> float:
    """Return the final value of an output under a constant input of 1; nan if it is unbounded."""
    poles = np.abs(system.poles)
    moving = poles[poles > 1e-7 * poles.max(initial=0.0)]
    s = 1e-5 * float(moving.min()) if len(moving) else 1e-5
    even, scale = balance(system.A)
    b, c = system.B[:, input] / scale, system.C[output] * scale
    far, near, nearer = (
        float(c @ np.linalg.solve(x * np.eye(len(even)) - even, b) + system.D[output, input])
        for x in (1e5 * s, s, 0.5 * s)
    )
    if abs(nearer) > 1.5 * abs(near) and abs(nearer) > 100.0 * abs(far):
        return np.nan
    return 2.0 * nearer - near


def schedule_intervals(
    system: StateSpace, output: int, input: int, duration: float | None = None
) -> list[tuple[int, float]]:
    """Return numbers and lengths in s of intervals that resolve a step response."""
    poles, share = _pole_shares(system, output, input)
    rate = np.maximum(-poles.real, 1e-6 * np.abs(poles))
    largest = float(share.max(initial=0.0))
    least = STEP_RESPONSE.least_intervals
    shows = share > STEP_RESPONSE.contributing_share * largest
    if not shows.any():
        return [(least, (duration or 1.0) / least)]
    size, share, rate = np.abs(poles[shows]), share[shows], rate[shows]
    settled = np.log(np.maximum(share / (STEP_RESPONSE.settled_share * largest), math.e)) / rate
    end = float(settled.max()) if duration is None else duration
    gone = np.log(share / (STEP_RESPONSE.contributing_share * largest)) / rate
    parts: list[tuple[int, float]] = []
    now, n_left = 0.0, STEP_RESPONSE.most_intervals
    for i in np.argsort(-size):
        until = end if i == np.argmin(size) else min(float(gone[i]), end)
        dt = min(1.0 / (STEP_RESPONSE.intervals_per_radian * float(size[i])), end / least)
        n = min(int(np.ceil((until - now) / dt - 1e-9)), n_left)
        if n > 0:
            parts.append((n, dt))
            now, n_left = now + n * dt, n_left - n
    return parts


def _pole_shares(system: StateSpace, output: int, input: int) -> tuple[ComplexArray, RealArray]:
    """Return the poles in rad/s and the share of each in a step response."""
    even, scale = balance(system.A)
    poles, V = np.linalg.eig(even)
    b, c = system.B[:, input] / scale, system.C[output] * scale
    moving = np.abs(poles) > 1e-7 * np.abs(poles).max(initial=0.0)
    share = np.abs(c @ V * np.linalg.lstsq(V, b.astype(complex), rcond=None)[0])
    return poles, np.where(moving, share / np.where(moving, np.abs(poles), 1.0), 0.0)


def simulate_step(
    system: StateSpace, input: int, size: float, rate: int | None, parts: list[tuple[int, float]]
) -> tuple[RealArray, RealArray, RealArray]:
    """Return time, outputs and their derivatives after a step of an input at time 0.

    `rate` is the index of the input that is the derivative of the step: an impulse of the same
    size. `parts` are numbers of intervals and their lengths in s.
    """
    u = np.zeros(system.B.shape[1])
    u[input] = size
    start = np.zeros(system.n_states)
    if rate is not None:
        start = system.B[:, rate] * size
    time, states = np.zeros(1), start[None]
    for n, dt in parts:
        more = linear_response(system, np.broadcast_to(u, (n + 1, len(u))), dt, states[-1])[0]
        time = np.concatenate([time, time[-1] + dt * np.arange(1, n + 1)])
        states = np.concatenate([states, more[1:]])
    outputs = states @ system.C.T + system.D @ u
    return time, outputs, (states @ system.A.T + system.B @ u) @ system.C.T


@dataclass(frozen=True, slots=True)
class StepFigures:
    """Figures of a step response, as in `updyn.control.servo.record.StepResponse`."""

    rise_time: float | None
    overshoot: float | None
    settling_time: float | None
    peak: float
    peak_time: float


def step_figures(
    time: RealArray, value: RealArray, slope: RealArray, final: float, reference: bool
) -> StepFigures:
    """Return the figures of a step response, with cubic interpolation between samples."""
    curve = scipy.interpolate.CubicHermiteSpline(time, value, slope, extrapolate=False)
    places = np.concatenate([time[[0, -1]], _within_record(curve.derivative().roots(), time)])
    heights = curve(places)
    top = int(np.argmax(np.abs(heights)))
    peak, peak_time = float(heights[top]), float(places[top])
    rise = overshoot = None
    # False for a final value of nan
    rises = reference and abs(final) > STEP_RESPONSE.returning_share * abs(peak)
    if rises:
        begins = _first_crossing(curve, time, 0.1 * final)
        ends = _first_crossing(curve, time, 0.9 * final)
        if begins is not None and ends is not None:
            rise = ends - begins
        overshoot = max(0.0, float((heights / final).max()) - 1.0)
    settles = None
    if np.isfinite(final):
        width = STEP_RESPONSE.settling_band * abs(final if rises else peak)
        if width and abs(value[-1] - final) <= width:
            below = _within_record(curve.solve(final - width), time)
            above = _within_record(curve.solve(final + width), time)
            settles = float(np.concatenate([below, above, time[:1]]).max())
    return StepFigures(rise, overshoot, settles, peak, peak_time)


def _first_crossing(
    curve: scipy.interpolate.CubicHermiteSpline, time: RealArray, height: float
) -> float | None:
    places = _within_record(curve.solve(height), time)
    return float(places.min()) if len(places) else None


def _within_record(places: RealArray, time: RealArray) -> RealArray:
    """Return the places within the record, without the nan of constant pieces."""
    good = np.isfinite(places)
    return np.asarray(places[good & (np.where(good, places, 0.0) >= time[0])])


@dataclass(frozen=True, slots=True)
class TimeResponses:
    """Time responses and notes on them, as in `updyn.control.servo.record.Servo`."""

    step: StepResponse | None = None
    disturbance_step: StepResponse | None = None
    wind: WindResponse | None = None
    notes: tuple[str, ...] = ()


def time_responses(
    cascade: Cascade,
    judged: JudgedLoop,
    step: float | None,
    disturbance_step: float | None,
    wind: Wind | tuple[ArrayLike, ArrayLike] | None,
    duration: float | None,
) -> TimeResponses:
    """Return the time responses of a stable closed loop; `judged` is its outermost loop."""
    for name, value in (
        ("step", step),
        ("disturbance_step", disturbance_step),
        ("duration", duration),
    ):
        if value is not None and (not is_number(value) or not math.isfinite(value) or value == 0):
            raise OptionError(
                f"servo: {name} is {value!r}; expected a number other than 0, or None"
            )
    if duration is not None and duration < 0:
        raise OptionError(f"servo: duration is {duration!r}; expected a time in s above 0")
    system = cascade.closed_loop(judged.pade, pointing=True)
    jumps = bool(np.isnan(system.D[_POINTING, _DISTURBANCE]))
    system = replace(system, D=np.nan_to_num(system.D))  # nan only for inputs that are 0 here
    notes: list[str] = []
    reference = None
    if step is not None:
        reference = _reference_step(cascade, system, step, duration, notes)
    if cascade.wiring.disturbance is None:
        return TimeResponses(reference, notes=tuple(notes))
    if jumps:
        notes.append(
            "a step of the disturbance makes the velocity jump without bound (direct feed-through):"
            " not computed"
        )
        return TimeResponses(reference, notes=tuple(notes))
    disturbed = gusts = None
    if disturbance_step is not None:
        names, places = _disturbance_names(cascade), (_POINTING, _DISTURBANCE)
        disturbed = _step(
            cascade, system, "disturbance", names, places, disturbance_step, None, duration
        )
    if wind is not None:
        gusts = _simulate_wind(cascade, judged, system, wind)
    return TimeResponses(reference, disturbed, gusts, tuple(notes))


def _reference_step(
    cascade: Cascade, system: StateSpace, size: float, duration: float | None, notes: list[str]
) -> StepResponse | None:
    outer = cascade.has_position
    at, rate = _VELOCITY, None
    if outer:
        at = _REFERENCE
        if cascade.controller.feed_forward:
            rate = _RATE
    if rate is not None and (system.D[_POSITION, rate] or system.D[_TORQUE, rate]):
        notes.append(
            "a step of the reference with feed-forward needs an unbounded torque: not computed;"
            " give a low_pass"
        )
        return None
    name = cascade.wiring.velocity
    if outer:
        name = cascade.wiring.position or name
    unit = _unit(cascade, name, not outer)
    names = (name, unit, name, unit)
    return _step(cascade, system, "reference", names, (_POSITION, at), size, rate, duration)


def _step(
    cascade: Cascade,
    system: StateSpace,
    of: str,
    names: tuple[str, str, str, str],
    places: tuple[int, int],
    size: float,
    rate: int | None,
    duration: float | None,
) -> StepResponse:
    """Return the response to a step; `names` are those and the units of input and output."""
    row, at = places
    time, outputs, slopes = _simulate_step_record(cascade, system, row, at, size, rate, duration)
    final = size * final_value(system, row, at)
    is_reference = of == "reference"
    figures = step_figures(time, outputs[:, row], slopes[:, row], final, is_reference)
    time, value, torque = _thin_record(time, outputs[:, row], outputs[:, _TORQUE])
    return StepResponse(of, float(size), *names, time, value, torque, final, **asdict(figures))


def _simulate_step_record(
    cascade: Cascade,
    system: StateSpace,
    output: int,
    at: int,
    size: float,
    rate: int | None,
    duration: float | None,
) -> tuple[RealArray, RealArray, RealArray]:
    """Return time, outputs of `Cascade.closed_loop` and their derivatives after a step."""
    parts = schedule_intervals(system, output, at, duration)
    delay = cascade.controller.dead_time
    opened = None
    if delay:
        opened = cascade.open_at_delay()
    long = sum(n * dt for n, dt in parts)
    wanted = int(np.ceil(STEP_RESPONSE.delay_refinement * delay / min(dt for _, dt in parts)))
    late = min(wanted, int(STEP_RESPONSE.most_delay_intervals * delay / long))
    if opened is None or late < min(wanted, STEP_RESPONSE.least_intervals_per_delay):
        return simulate_step(system, at, size, rate, parts)
    w = np.zeros(system.B.shape[1])
    w[at] = size
    start = np.zeros(opened.n_states)
    if rate is not None:
        start = opened.B[:, 1 + rate] * size
    n = int(np.ceil(long * late / delay - 1e-9)) + 1
    time, outputs, slopes = delayed_response(opened, w, start, delay, delay / late, n)
    order = [1, 0, 2]
    return time, outputs[:, order], slopes[:, order]


def _thin_record(
    time: RealArray, value: RealArray, torque: RealArray
) -> tuple[RealArray, RealArray, RealArray]:
    """Return a record thinned to about the number of stored samples, with all of the first ones."""
    stored = STEP_RESPONSE.stored_samples
    every = max(1, round(len(time) / stored))
    keep = np.unique(
        np.concatenate([np.arange(min(len(time), stored // 5)), np.arange(0, len(time), every)])
    )
    return time[keep], value[keep], torque[keep]


def _simulate_wind(
    cascade: Cascade,
    judged: JudgedLoop,
    system: StateSpace,
    wind: Wind | tuple[ArrayLike, ArrayLike],
) -> WindResponse:
    expected, facts = None, {}
    if isinstance(wind, Wind):
        expected, needed = _expected_rms(cascade, judged, wind)
        time, torque = wind.series(max(needed, wind.duration / WIND_SERIES.most_default_samples))
        facts = {
            "mean_speed": wind.mean_speed,
            "coefficient": wind.coefficient,
            "turbulence": wind.intensity,
            "roughness": wind.drag,
            "seed": wind.seed,
            "mean_torque": wind.mean_torque,
        }
    else:
        time, torque = _read_series(wind)
    rest = final_value(system, _POINTING, _DISTURBANCE)
    if np.isnan(rest):
        rest, first = 0.0, 0.0
    else:
        first = torque[0]  # constant before the record
    u = np.zeros((len(time), 4))
    u[:, _DISTURBANCE] = torque - first
    error = linear_response(system, u, float(time[1] - time[0]))[1][:, _POINTING] + rest * first
    names = _disturbance_names(cascade)
    rms = float(np.sqrt(np.mean(error**2)))
    peak, mean = float(np.abs(error).max()), float(error.mean())
    return WindResponse(*names, time, torque, error, rms, peak, mean, expected, facts)


def _expected_rms(cascade: Cascade, judged: JudgedLoop, wind: Wind) -> tuple[float, float]:
    """Return the rms error by the spectrum, and the sampling interval of a time series in s."""
    low = min(judged.w[0] / _TWO_PI, 1e-3 * wind.mean_speed / LENGTH)
    spread = np.geomspace(low, judged.w[-1] / _TWO_PI, WIND_SERIES.spectrum_lines)
    edges = np.union1d(spread, judged.w / _TWO_PI)
    middle = 0.5 * (edges[1:] + edges[:-1])
    ends = np.abs(cascade.compliance(2j * np.pi * edges)) ** 2
    between = np.abs(cascade.compliance(2j * np.pi * middle)) ** 2
    shares = wind.torque_variance(edges) * (ends[1:] + 4.0 * between + ends[:-1]) / 6.0
    below = float(wind.torque_variance(np.array([0.0, low]))[0] * ends[0])
    total = np.cumsum(shares) + below
    resolved = (1.0 - WIND_SERIES.missing_variance) * total[-1]
    top = float(edges[1:][np.searchsorted(total, resolved)])
    return float(np.sqrt(total[-1])), 1.0 / (8.0 * top)


def _read_series(given: tuple[ArrayLike, ArrayLike]) -> tuple[RealArray, RealArray]:
    try:
        time, values = given
        time = np.array(time, dtype=np.float64)
        values = np.array(values, dtype=np.float64)
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
            f"wind: times must be equally spaced and increasing; {time[where]:g} s is followed by"
            f" {time[where + 1]:g} s, but most intervals are {step:g} s"
        )
    return time, values


def _unit(cascade: Cascade, name: str, velocity: bool) -> str:
    plant = cascade.plant
    port = plant.output_ports[plant.outputs.index(name)]
    return port.motion_unit("mobility" if velocity else "receptance")


def _disturbance_names(cascade: Cascade) -> tuple[str, str, str, str]:
    """Return the disturbance input, its unit, the pointing output, its unit."""
    wiring, plant = cascade.wiring, cascade.plant
    assert wiring.disturbance is not None
    unit = plant.input_units[plant.inputs.index(wiring.disturbance)]
    velocity = not cascade.has_position and wiring.pointing == wiring.velocity
    return wiring.disturbance, unit, wiring.pointing, _unit(cascade, wiring.pointing, velocity)
