"""Responses of the closed loop over time, by the matrix exponential: steps, wind, series."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from updyn.control.servo.loops import Cascade
from updyn.control.servo.record import RETURNS, StepResponse, WindResponse
from updyn.control.servo.stability import Judged
from updyn.control.servo.state_space import StateSpace, balanced
from updyn.control.servo.wind import Wind
from updyn.errors import DataError, OptionError
from updyn.group import is_number

__all__ = [
    "StepFigures",
    "Timed",
    "delayed_response",
    "final_value",
    "linear_response",
    "schedule",
    "step_figures",
    "step_series",
    "timed",
]

_Real = NDArray[np.float64]

#: Least number of intervals of a record, about.
_FEWEST = 1000
#: Largest number of intervals of a record.
_MOST = 20_000
#: Intervals in a radian of the fastest mode that contributes.
_PER_RADIAN = 12.0
#: Share of the response from which a mode contributes.
_SHOWS = 1e-3
#: Share of the response below which a mode has settled.
_SETTLED = 2e-3
#: Half width of the band in which a response has settled, as a share of its final value.
_BAND = 0.02
_TWO_PI = 2.0 * np.pi
#: Positions in `Cascade.closed`.
_REFERENCE, _RATE, _VELOCITY, _DISTURBANCE = range(4)
_POSITION, _TORQUE, _POINTING = range(3)
#: Share of the variance of the error that a series of the wind may lack above its last frequency.
_LEFT_OUT = 1e-4
#: Largest length of such a series.
_LONGEST = 2**16
#: With exact dead time: factor by which the intervals are finer.
_FINER = 4.0
#: With exact dead time: largest number of intervals.
_LONGEST_STEP = 60_000
#: With exact dead time: least number of intervals in it; otherwise it is approximated.
_COARSEST = 16
#: Number of samples that are kept, about.
_KEPT = 5000


def linear_response(
    system: StateSpace, u: _Real, dt: float, start: _Real | None = None
) -> tuple[_Real, _Real]:
    """Return states and outputs of a system under inputs that are linear between samples.

    Parameters
    ----------
    system : StateSpace
        n states, n_u inputs, n_y outputs.
    u : ndarray of float, shape (n_t, n_u)
        Inputs, equally spaced.
    dt : float
        Interval in s.
    start : ndarray of float, shape (n,), optional
        First state; 0 by default.

    Returns
    -------
    states : ndarray of float, shape (n_t, n)
    outputs : ndarray of float, shape (n_t, n_y)

    Notes
    -----
    First-order hold: exponential of the matrix augmented with the input and its slope (Van Loan
    1978, IEEE Trans. Autom. Control 23, p. 395), with the states balanced.
    """
    own, held, sloped = held_and_sloped(system.A, system.B, dt)
    own = np.ascontiguousarray(own.T)
    forced = u[:-1] @ held.T + np.diff(u, axis=0) @ sloped.T
    states = np.empty((len(u), system.n_states))
    states[0] = 0.0
    if start is not None:
        states[0] = start
    for k in range(len(u) - 1):
        states[k + 1] = states[k] @ own + forced[k]
    return states, states @ system.C.T + u @ system.D.T


def held_and_sloped(A: _Real, B: _Real, dt: float) -> tuple[_Real, _Real, _Real]:
    """Return the matrices of one interval: of states, a constant input and a ramp from 0 to 1.

    Parameters
    ----------
    A, B : ndarray of float, shapes (n, n), (n, n_u)
        Of the system.
    dt : float
        Interval in s.

    Returns
    -------
    own, held, sloped : ndarray of float, shapes (n, n), (n, n_u), (n, n_u)
    """
    n, m = B.shape
    if n == 0:
        return A, B, B
    even, scale = balanced(A)
    scaled = B / scale[:, None]
    # Powers of 2, so that nothing is rounded, of the inputs too.
    size = np.abs(scaled).max(axis=0)
    wanted = max(float(np.abs(even).max()), 1.0 / dt)
    unit = np.exp2(np.round(np.log2(np.where(size > 0, size, wanted) / wanted)))
    both = np.zeros((n + 2 * m, n + 2 * m))
    both[:n, :n] = even * dt
    both[:n, n : n + m] = scaled / unit * dt
    both[n : n + m, n + m :] = np.eye(m)
    whole = scipy.linalg.expm(both)[:n]
    back = scale[:, None]
    return (
        back * whole[:, :n] / scale,
        back * whole[:, n : n + m] * unit,
        back * whole[:, n + m :] * unit,
    )


def delayed_response(
    opened: StateSpace, w: _Real, start: _Real, delay: float, dt: float, n_t: int
) -> tuple[_Real, _Real, _Real]:
    """Return time, outputs and derivatives of a loop whose first output is fed back late.

    Parameters
    ----------
    opened : StateSpace
        With the late input first and what comes back first among the outputs.
    w : ndarray of float, shape (n_w,)
        The other inputs, constant from time 0 on.
    start : ndarray of float, shape (n,)
        States at time 0.
    delay, dt : float
        Dead time, and interval in s, a whole part of it.
    n_t : int
        Number of samples.

    Notes
    -----
    What is late is known from before (method of steps); between samples it is taken to be straight,
    its jumps at multiples of the dead time kept.
    """
    late = round(delay / dt)
    own, held, sloped = held_and_sloped(opened.A, opened.B, dt)
    constant = held[:, 1:] @ w
    first, pushed = held[:, 0], sloped[:, 0]
    c = opened.C[0]
    d = opened.D[0, 0]
    direct = float(opened.D[0, 1:] @ w)
    states = np.empty((n_t, len(own)))
    states[0] = x = start
    # The late input just before and just after each sample, 0 during the first dead time.
    before = np.zeros(n_t + late)
    after = np.zeros(n_t + late)
    after[late] = c @ x + direct
    for k in range(n_t - 1):
        begins = after[k]
        ends = before[k + 1]
        x = own @ x + first * begins + pushed * (ends - begins) + constant
        states[k + 1] = x
        returned = c @ x + direct
        before[k + 1 + late] = returned + d * ends
        after[k + 1 + late] = returned + d * after[k + 1]
    fed = after[:n_t]
    inputs = np.column_stack([fed, np.broadcast_to(w, (n_t, len(w)))])
    outputs = states @ opened.C.T + inputs @ opened.D.T
    slopes = (states @ opened.A.T + inputs @ opened.B.T) @ opened.C.T
    outputs[:, 0] = fed
    return np.asarray(np.arange(n_t) * dt, dtype=np.float64), outputs, slopes


def final_value(system: StateSpace, output: int, input: int) -> float:
    """Return the final value of an output under a constant input of 1; nan if it is unbounded.

    Parameters
    ----------
    system : StateSpace
        The closed loop; poles at 0 that do not show in this output are allowed.
    output, input : int
        Positions.
    """
    poles = np.abs(system.poles)
    moving = poles[poles > 1e-7 * poles.max(initial=0.0)]
    s = 1e-5 * float(moving.min()) if len(moving) else 1e-5
    even, scale = balanced(system.A)
    b, c = system.B[:, input] / scale, system.C[output] * scale
    far, near, nearer = (
        float(c @ np.linalg.solve(x * np.eye(len(even)) - even, b) + system.D[output, input])
        for x in (1e5 * s, s, 0.5 * s)
    )
    if abs(nearer) > 1.5 * abs(near) and abs(nearer) > 100.0 * abs(far):
        return np.nan
    return 2.0 * nearer - near


def schedule(
    system: StateSpace, output: int, input: int, duration: float | None = None
) -> list[tuple[int, float]]:
    """Return the numbers and lengths in s of the intervals that resolve a step response.

    Their length resolves the fastest mode that still contributes; they end when the slowest has
    settled.

    Parameters
    ----------
    system : StateSpace
        A stable closed loop.
    output, input : int
        Positions.
    duration : float, optional
        In s; by default until all has settled.
    """
    poles, share = _shares(system, output, input)
    rate = np.maximum(-poles.real, 1e-6 * np.abs(poles))
    largest = float(share.max(initial=0.0))
    shows = share > _SHOWS * largest
    if not shows.any():
        return [(_FEWEST, (duration or 1.0) / _FEWEST)]
    size, share, rate = np.abs(poles[shows]), share[shows], rate[shows]
    settled = np.log(np.maximum(share / (_SETTLED * largest), math.e)) / rate
    end = float(settled.max()) if duration is None else duration
    gone = np.log(share / (_SHOWS * largest)) / rate
    parts: list[tuple[int, float]] = []
    now, left = 0.0, _MOST
    for i in np.argsort(-size):
        until = end if i == np.argmin(size) else min(float(gone[i]), end)
        dt = min(1.0 / (_PER_RADIAN * float(size[i])), end / _FEWEST)
        n = min(int(np.ceil((until - now) / dt - 1e-9)), left)
        if n > 0:
            parts.append((n, dt))
            now, left = now + n * dt, left - n
    return parts


def _shares(system: StateSpace, output: int, input: int) -> tuple[NDArray[np.complex128], _Real]:
    """Return the poles in rad/s, and the share of each in a step response."""
    even, scale = balanced(system.A)
    poles, V = np.linalg.eig(even)
    b, c = system.B[:, input] / scale, system.C[output] * scale
    moving = np.abs(poles) > 1e-7 * np.abs(poles).max(initial=0.0)
    share = np.abs(c @ V * np.linalg.lstsq(V, b.astype(complex), rcond=None)[0])
    return poles, np.where(moving, share / np.where(moving, np.abs(poles), 1.0), 0.0)


def step_series(
    system: StateSpace, input: int, size: float, rate: int | None, parts: list[tuple[int, float]]
) -> tuple[_Real, _Real, _Real]:
    """Return time, outputs and their derivatives after a step of an input at time 0.

    Parameters
    ----------
    system : StateSpace
        The closed loop, at rest before.
    input : int
        Position of what steps.
    size : float
        Height.
    rate : int or None
        Position of the input that is the step's derivative: an impulse of the same size.
    parts : list of (int, float)
        Numbers of intervals and lengths in s.
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
    """Figures of a step response; as in `updyn.control.servo.record.StepResponse`.

    Attributes
    ----------
    rise_time, overshoot, settling_time : float or None
        In s, as a share, in s.
    peak, peak_time : float
        Value of largest size, and its time in s.
    """

    rise_time: float | None
    overshoot: float | None
    settling_time: float | None
    peak: float
    peak_time: float


def step_figures(
    time: _Real, value: _Real, slope: _Real, final: float, reference: bool
) -> StepFigures:
    """Return the figures of a step response, between the samples by cubic polynomials.

    Parameters
    ----------
    time, value, slope : ndarray of float, shape (n,)
        In s; the output; its derivative.
    final : float
        Final value; nan without one.
    reference : bool
        Whether it is a step of the reference, which has a rise time and an overshoot.
    """
    curve = CubicHermiteSpline(time, value, slope, extrapolate=False)
    places = np.concatenate([time[[0, -1]], _within(curve.derivative().roots(), time)])
    heights = curve(places)
    top = int(np.argmax(np.abs(heights)))
    peak, peak_time = float(heights[top]), float(places[top])
    rise = overshoot = None
    rises = reference and abs(final) > RETURNS * abs(peak)  # not of a final value of nan either
    if rises:
        begins = _first(curve, time, 0.1 * final)
        ends = _first(curve, time, 0.9 * final)
        if begins is not None and ends is not None:
            rise = ends - begins
        overshoot = max(0.0, float((heights / final).max()) - 1.0)
    settles = None
    if np.isfinite(final):
        width = _BAND * abs(final if rises else peak)
        if width and abs(value[-1] - final) <= width:
            below = _within(curve.solve(final - width), time)
            above = _within(curve.solve(final + width), time)
            settles = float(np.concatenate([below, above, time[:1]]).max())
    return StepFigures(rise, overshoot, settles, peak, peak_time)


def _first(curve: CubicHermiteSpline, time: _Real, height: float) -> float | None:
    places = _within(curve.solve(height), time)
    return float(places.min()) if len(places) else None


def _within(places: _Real, time: _Real) -> _Real:
    """Return places that are numbers (a constant piece has nan) within the record."""
    good = np.isfinite(places)
    return np.asarray(places[good & (np.where(good, places, 0.0) >= time[0])])


@dataclass(frozen=True, slots=True)
class Timed:
    """Responses over time and notes on them; as in `updyn.control.servo.record.Servo`."""

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
        The disturbance.
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
        if value is not None and (not is_number(value) or not math.isfinite(value) or value == 0):
            raise OptionError(
                f"servo: {name} is {value!r}; expected a number other than 0, or None"
            )
    if duration is not None and duration < 0:
        raise OptionError(f"servo: duration is {duration!r}; expected a time in s above 0")
    system = cascade.closed(judged.pade, pointing=True)
    jumps = bool(np.isnan(system.D[_POINTING, _DISTURBANCE]))
    system = replace(system, D=np.nan_to_num(system.D))  # of inputs that are 0 wherever it is read
    notes: list[str] = []
    reference = None
    if step is not None:
        reference = _reference_step(cascade, system, step, duration, notes)
    if cascade.wiring.disturbance is None:
        return Timed(reference, notes=tuple(notes))
    if jumps:
        notes.append(
            "a step of the disturbance makes the velocity jump without bound (direct feed-through):"
            " left out"
        )
        return Timed(reference, notes=tuple(notes))
    disturbed = gusts = None
    if disturbance_step is not None:
        names, places = _disturbance_names(cascade), (_POINTING, _DISTURBANCE)
        disturbed = _step(
            cascade, system, "disturbance", names, places, disturbance_step, None, duration
        )
    if wind is not None:
        gusts = _wind(cascade, judged, system, wind)
    return Timed(reference, disturbed, gusts, tuple(notes))


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
            "a step of the reference with feed-forward asks for a torque without bound: left out;"
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
    """Return the response to a step.

    `names` are input, its unit, output, its unit; `places` are those of output and input in
    `Cascade.closed`.
    """
    row, at = places
    time, outputs, slopes = _record(cascade, system, row, at, size, rate, duration)
    final = size * final_value(system, row, at)
    is_reference = of == "reference"
    figures = step_figures(time, outputs[:, row], slopes[:, row], final, is_reference)
    time, value, torque = _thinned(time, outputs[:, row], outputs[:, _TORQUE])
    return StepResponse(of, float(size), *names, time, value, torque, final, **asdict(figures))


def _record(
    cascade: Cascade,
    system: StateSpace,
    output: int,
    at: int,
    size: float,
    rate: int | None,
    duration: float | None,
) -> tuple[_Real, _Real, _Real]:
    """Return time, outputs of `Cascade.closed` and their derivatives after a step."""
    parts = schedule(system, output, at, duration)
    delay = cascade.controller.dead_time
    opened = None
    if delay:
        opened = cascade.opened()
    long = sum(n * dt for n, dt in parts)
    wanted = int(np.ceil(_FINER * delay / min(dt for _, dt in parts)))
    late = min(wanted, int(_LONGEST_STEP * delay / long))
    if opened is None or late < min(wanted, _COARSEST):
        return step_series(system, at, size, rate, parts)
    w = np.zeros(system.B.shape[1])
    w[at] = size
    start = np.zeros(opened.n_states)
    if rate is not None:
        start = opened.B[:, 1 + rate] * size
    n = int(np.ceil(long * late / delay - 1e-9)) + 1
    time, outputs, slopes = delayed_response(opened, w, start, delay, delay / late, n)
    order = [1, 0, 2]
    return time, outputs[:, order], slopes[:, order]


def _thinned(time: _Real, value: _Real, torque: _Real) -> tuple[_Real, _Real, _Real]:
    """Return a record thinned to about `_KEPT` samples, the first ones kept."""
    every = max(1, round(len(time) / _KEPT))
    keep = np.unique(
        np.concatenate([np.arange(min(len(time), _KEPT // 5)), np.arange(0, len(time), every)])
    )
    return time[keep], value[keep], torque[keep]


def _wind(
    cascade: Cascade, judged: Judged, system: StateSpace, wind: Wind | tuple[ArrayLike, ArrayLike]
) -> WindResponse:
    expected, facts = None, {}
    if isinstance(wind, Wind):
        expected, needed = _expected(cascade, judged, wind)
        time, torque = wind.series(max(needed, wind.duration / _LONGEST))
        facts = {
            "mean_speed": wind.mean_speed,
            "coefficient": wind.coefficient,
            "turbulence": wind.intensity,
            "roughness": wind.drag,
            "seed": wind.seed,
            "mean_torque": wind.mean_torque,
        }
    else:
        time, torque = _series(wind)
    rest = final_value(system, _POINTING, _DISTURBANCE)
    if np.isnan(rest):
        rest, first = 0.0, 0.0
    else:
        first = torque[0]  # it acts since minus infinity
    u = np.zeros((len(time), 4))
    u[:, _DISTURBANCE] = torque - first
    error = linear_response(system, u, float(time[1] - time[0]))[1][:, _POINTING] + rest * first
    names = _disturbance_names(cascade)
    rms = float(np.sqrt(np.mean(error**2)))
    peak, mean = float(np.abs(error).max()), float(error.mean())
    return WindResponse(*names, time, torque, error, rms, peak, mean, expected, facts)


def _expected(cascade: Cascade, judged: Judged, wind: Wind) -> tuple[float, float]:
    """Return the rms error by the spectrum, and the interval of a time series in s."""
    low = min(judged.w[0] / _TWO_PI, 1e-3 * wind.mean_speed / 1200.0)
    edges = np.unique(
        np.concatenate([np.geomspace(low, judged.w[-1] / _TWO_PI, 2000), judged.w / _TWO_PI])
    )
    middle = 0.5 * (edges[1:] + edges[:-1])
    ends = np.abs(cascade.compliance(2j * np.pi * edges)) ** 2
    between = np.abs(cascade.compliance(2j * np.pi * middle)) ** 2
    shares = wind.torque_variance(edges) * (ends[1:] + 4.0 * between + ends[:-1]) / 6.0
    below = float(wind.torque_variance(np.array([0.0, low]))[0] * ends[0])
    total = np.cumsum(shares) + below
    top = float(edges[1:][np.searchsorted(total, (1.0 - _LEFT_OUT) * total[-1])])
    return float(np.sqrt(total[-1])), 1.0 / (8.0 * top)


def _series(given: tuple[ArrayLike, ArrayLike]) -> tuple[_Real, _Real]:
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
            f"wind: times have to be equally spaced and increase; after {time[where]:g} s comes"
            f" {time[where + 1]:g} s, but most intervals are {step:g} s"
        )
    return time, values


def _unit(cascade: Cascade, name: str, velocity: bool) -> str:
    plant = cascade.plant
    port = plant.output_ports[plant.outputs.index(name)]
    return port.motion_unit("mobility" if velocity else "receptance")


def _disturbance_names(cascade: Cascade) -> tuple[str, str, str, str]:
    """Return input, its unit, pointing, its unit."""
    wiring, plant = cascade.wiring, cascade.plant
    assert wiring.disturbance is not None
    unit = plant.input_units[plant.inputs.index(wiring.disturbance)]
    velocity = not cascade.has_position and wiring.pointing == wiring.velocity
    return wiring.disturbance, unit, wiring.pointing, _unit(cascade, wiring.pointing, velocity)
