"""The closed loop over time, exact by the matrix exponential: steps, and a disturbance given as a series."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from updyn.control.servo.state_space import StateSpace, balanced

__all__ = [
    "StepFigures",
    "at_rest",
    "march",
    "march_late",
    "schedule",
    "step_figures",
    "step_series",
]

_Real = NDArray[np.float64]

#: About the fewest and most intervals of a record, and intervals in a radian of the fastest motion
#: that shows.
_FEWEST, _MOST, _PER_RADIAN = 1000, 20_000, 12.0
#: A mode shows if its share of the response exceeds the first; a record lasts until shares are
#: below the second.
_SHOWS, _SETTLED = 1e-3, 2e-3
_BAND = 0.02


def march(
    system: StateSpace, u: _Real, dt: float, start: _Real | None = None
) -> tuple[_Real, _Real]:
    """Return the states and outputs of a system under inputs that are straight between samples, exact at the samples.

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
    states[0] = 0.0 if start is None else start
    for k in range(len(u) - 1):
        states[k + 1] = states[k] @ own + forced[k]
    return states, states @ system.C.T + u @ system.D.T


def held_and_sloped(A: _Real, B: _Real, dt: float) -> tuple[_Real, _Real, _Real]:
    """Return what states, a constant input and an input that grows from 0 to 1 become in an interval.

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
    both[:n, :n], both[:n, n : n + m], both[n : n + m, n + m :] = (
        even * dt,
        scaled / unit * dt,
        np.eye(m),
    )
    whole = scipy.linalg.expm(both)[:n]
    back = scale[:, None]
    return (
        back * whole[:, :n] / scale,
        back * whole[:, n : n + m] * unit,
        back * whole[:, n + m :] * unit,
    )


def march_late(
    opened: StateSpace, w: _Real, start: _Real, delay: float, dt: float, n_t: int
) -> tuple[_Real, _Real, _Real]:
    """Return time, outputs and their derivatives of a loop whose first output comes back late as its first input.

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
    c, d, direct = opened.C[0], opened.D[0, 0], float(opened.D[0, 1:] @ w)
    states = np.empty((n_t, len(own)))
    states[0] = x = start
    before, after = np.zeros(n_t), np.zeros(n_t)  # what comes back, on both sides of each sample
    after[0] = c @ x + direct
    for k in range(n_t - 1):
        begins = after[k - late] if k >= late else 0.0
        ends = before[k + 1 - late] if k + 1 >= late else 0.0
        x = own @ x + first * begins + pushed * (ends - begins) + constant
        states[k + 1] = x
        returned = c @ x + direct
        before[k + 1] = returned + d * ends
        after[k + 1] = returned + d * (after[k + 1 - late] if k + 1 >= late else 0.0)
    fed = np.concatenate([np.zeros(min(late, n_t)), after[: max(n_t - late, 0)]])
    inputs = np.column_stack([fed, np.broadcast_to(w, (n_t, len(w)))])
    outputs = states @ opened.C.T + inputs @ opened.D.T
    slopes = (states @ opened.A.T + inputs @ opened.B.T) @ opened.C.T
    outputs[:, 0] = fed
    return np.asarray(np.arange(n_t) * dt, dtype=np.float64), outputs, slopes


def at_rest(system: StateSpace, output: int, input: int) -> float:
    """Return where an output goes under a constant input of 1; nan if it goes on for ever.

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
    return (
        np.nan
        if abs(nearer) > 1.5 * abs(near) and abs(nearer) > 100.0 * abs(far)
        else 2.0 * nearer - near
    )


def schedule(
    system: StateSpace, output: int, input: int, duration: float | None = None
) -> list[tuple[int, float]]:
    """Return in which intervals the answer to a step has to be recorded: numbers of them and lengths in s, in order.

    They are as fine as the fastest mode asks for that still shows, and last until the slowest has
    settled.

    Parameters
    ----------
    system : StateSpace
        A stable closed loop.
    output, input : int
        Positions.
    duration : float, optional
        In s, where it is not to be found.
    """
    poles, share = _shares(system, output, input)
    rate = np.maximum(-poles.real, 1e-6 * np.abs(poles))
    largest = float(share.max(initial=0.0))
    shows = share > _SHOWS * largest
    if not shows.any():
        return [(_FEWEST, (duration or 1.0) / _FEWEST)]
    size, share, rate = np.abs(poles[shows]), share[shows], rate[shows]
    settled = np.log(np.maximum(share / (_SETTLED * largest), np.e)) / rate
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
    """Return the poles, in rad/s, and how much each has of the answer of an output to a step of an input."""
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
    start = np.zeros(system.n_states) if rate is None else system.B[:, rate] * size
    time, states = np.zeros(1), start[None]
    for n, dt in parts:
        more = march(system, np.broadcast_to(u, (n + 1, len(u))), dt, states[-1])[0]
        time = np.concatenate([time, time[-1] + dt * np.arange(1, n + 1)])
        states = np.concatenate([states, more[1:]])
    outputs = states @ system.C.T + system.D @ u
    return time, outputs, (states @ system.A.T + system.B @ u) @ system.C.T


@dataclass(frozen=True, slots=True)
class StepFigures:
    """What is read off a step response; as in `updyn.control.servo.record.StepResponse`.

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
    """Read figures off a step response, between the samples by cubic polynomials.

    Parameters
    ----------
    time, value, slope : ndarray of float, shape (n,)
        In s; the output; its derivative.
    final : float
        Where it goes to; nan where nowhere.
    reference : bool
        Whether the reference stepped, so that rise and overshoot are meant.
    """
    curve = CubicHermiteSpline(time, value, slope, extrapolate=False)
    places = np.concatenate([time[[0, -1]], _within(curve.derivative().roots(), time)])
    heights = curve(places)
    top = int(np.argmax(np.abs(heights)))
    peak, peak_time = float(heights[top]), float(places[top])
    rise = overshoot = None
    if reference and np.isfinite(final) and final:
        first = [_first(curve, time, share * final) for share in (0.1, 0.9)]
        rise = None if None in first else first[1] - first[0]  # type: ignore[operator]
        overshoot = max(0.0, float((heights / final).max()) - 1.0)
    settles = None
    if np.isfinite(final):
        width = _BAND * abs(final if reference else peak)
        if width and abs(value[-1] - final) <= width:
            last = [_within(curve.solve(final + side * width), time) for side in (-1.0, 1.0)]
            settles = float(np.concatenate([*last, time[:1]]).max())
    return StepFigures(rise, overshoot, settles, peak, peak_time)


def _first(curve: CubicHermiteSpline, time: _Real, height: float) -> float | None:
    places = _within(curve.solve(height), time)
    return float(places.min()) if len(places) else None


def _within(places: _Real, time: _Real) -> _Real:
    """Return places that are numbers (a constant piece has nan) within the record."""
    good = np.isfinite(places)
    return np.asarray(places[good & (np.where(good, places, 0.0) >= time[0])])
