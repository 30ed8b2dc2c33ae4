"""Stability of a closed loop: by eigenvalues, or by the Nyquist criterion with dead time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.servo import grid
from updyn.control.servo.grid import Loop, resolve
from updyn.control.servo.loops import Cascade
from updyn.control.servo.margins import Margins
from updyn.control.servo.settings import LOOP_LINES, LOOP_STABILITY
from updyn.errors import ModelError, SolverError

__all__ = [
    "JudgedLoop",
    "count_drifting",
    "count_growing",
    "find_margins",
    "judge",
    "judge_loops",
    "judge_torque",
    "nyquist_count",
]


_TWO_PI = 2.0 * np.pi


def count_drifting(poles: ComplexArray, scale: float) -> int:
    """Return the number of closed-loop poles at 0; `scale` is the crossover in rad/s."""
    return int((np.abs(poles) < LOOP_STABILITY.zero_pole_share * scale).sum())


def count_growing(poles: ComplexArray, scale: float) -> int:
    """Return the number of unstable closed-loop poles, without those at 0; `scale` as above."""
    moving = poles[np.abs(poles) >= LOOP_STABILITY.zero_pole_share * scale]
    return int((moving.real > LOOP_STABILITY.growth_share * np.abs(moving)).sum())


def nyquist_count(loop: Loop, w: RealArray, open_poles: ComplexArray, drifting: int) -> int:
    """Return the number of unstable closed-loop poles with dead time.

    `w` in rad/s begins below every closed-loop pole that is not at 0; `open_poles` are without the
    dead time, including cancelled ones.
    """
    # Mikhailov's criterion: with p the poles of the open loop, chi(s) = prod(s - p) (1 + L(s)) has
    # no poles, so the phase of chi(j w) grows by (n - m - 2 Z) pi / 2 from w = 0 to infinity,
    # where Z of its zeros lie to the right and m (`drifting`) at 0. Dead time keeps the order n if
    # |L| < 1 above the last line.
    lines, values = resolve(lambda s: 1.0 + loop(s), w)
    if abs(values[-1] - 1.0) >= 1.0:
        raise SolverError(
            f"the loop gain is still {abs(values[-1] - 1.0):.3g} at {lines[-1] / (2 * np.pi):.4g}"
            " Hz: stability with dead time cannot be determined; give the controller a low_pass"
        )
    # Rounding moves poles away from 0: a double pole appears as a pair around it, whose phases have
    # the same sum.
    pole_phase = np.angle(1j * lines[:, None] - open_poles).sum(axis=1)
    total = np.unwrap(pole_phase + np.angle(values))
    n = len(open_poles)
    start = total[0] - drifting * np.pi / 2.0
    before = start - np.pi * np.round(start / np.pi)  # phase change below the first line
    after = n * np.pi / 2.0 - pole_phase[-1] - float(np.angle(values[-1]))
    turned = total[-1] - total[0] + before + after
    found = float(0.5 * (n - drifting) - turned / np.pi)
    if abs(found - round(found)) > 0.2:
        raise SolverError(
            f"stability with dead time: the phase of the loop function gives {found:.3f} unstable"
            " poles, which is not a whole number; the lines start too high"
        )
    return round(found)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLoop:
    """A loop L(s) with its margins and the stability of its closed loop.

    `w` are lines in rad/s that resolve L, `values` L at these. `poles` of the closed loop, in
    rad/s, are with dead time those of a Pade approximation of order `pade`; `agrees` tells whether
    it has as many unstable poles as the exact loop.
    """

    loop: Loop
    w: RealArray
    values: ComplexArray
    margins: Margins
    poles: ComplexArray
    pade: int
    agrees: bool


def judge_loops(cascade: Cascade) -> tuple[JudgedLoop, JudgedLoop | None]:
    """Return margins and stability of the velocity loop and the position loop of a cascade."""
    _check_moves(cascade)
    zeros = cascade.zeros
    inner = judge(cascade, cascade.velocity, cascade.velocity, cascade.velocity_poles, zeros, False)
    if not cascade.has_position:
        return inner, None
    features = np.concatenate([zeros, inner.poles])
    return inner, judge(cascade, cascade.position, cascade.torque, cascade.poles, features, True)


def judge_torque(cascade: Cascade, outer: JudgedLoop) -> JudgedLoop:
    """Return margins and stability of both loops closed, broken at the torque."""
    # A change of gain or delay in drive and motor acts on both loops at this place.
    features = np.concatenate([cascade.zeros, outer.poles])
    return judge(cascade, cascade.torque, cascade.torque, cascade.poles, features, True)


def _check_moves(cascade: Cascade) -> None:
    wiring = cascade.wiring
    size = np.abs(cascade.motion(1j * np.array([0.9, 11.3, 257.1, 4021.7])))[:, :, 0].max(axis=0)
    for name, largest in ((wiring.velocity, size[0]), (wiring.position, size[1])):
        if name is not None and not largest:
            raise ModelError(f"torque {wiring.torque!r} does not move {name!r}: the loop gain is 0")


def judge(
    cascade: Cascade,
    loop: Loop,
    whole: Loop,
    open_poles: ComplexArray,
    features: ComplexArray,
    position: bool,
) -> JudgedLoop:
    """Return margins and stability of one loop L(s).

    `whole` is an L(s) of the same closed loop with the poles `open_poles` (without the dead time).
    Lines are dense around `features`, poles and zeros in rad/s.
    """
    controller = cascade.controller
    free = cascade.closed_loop(0, position=position).poles
    features = np.concatenate([features, open_poles, free, [-(controller.kv or 0.0)]])
    pade = 0
    if controller.dead_time:
        w, values = _lines(whole, whole, features, controller.dead_time)
        gains = grid.crossings_of_gain(whole, w, values)
        last = gains[-1] if len(gains) else w[len(w) // 2]
        pade = int(np.clip(4 + np.ceil(2.0 * last * controller.dead_time), 5, 12))
    poles = cascade.closed_loop(pade, position=position).poles
    w, values = _lines(loop, whole, features, controller.dead_time, poles)
    w, values = grid.add_extremes(loop, w, values)
    gains = grid.crossings_of_gain(loop, w, values)
    phases = grid.crossings_of_phase(loop, w, values)
    scale = float(gains[0]) if len(gains) else float(_sizes(features).min())
    drifting = count_drifting(poles, scale)
    growing = count_growing(poles, scale)
    exact = growing
    if pade:
        exact = nyquist_count(whole, w, open_poles, drifting)
    margins = find_margins(loop, w, values, gains, phases, exact, drifting, controller.dead_time)
    return JudgedLoop(loop, w, values, margins, poles, pade, exact == growing)


def _sizes(features: ComplexArray) -> RealArray:
    """Return the moduli of poles and zeros other than 0, in rad/s; 1 without any."""
    size = np.abs(features)
    size = size[size > LOOP_LINES.zero_share * size.max(initial=0.0)]
    return size if len(size) else np.ones(1)


def _lines(
    loop: Loop,
    whole: Loop,
    features: ComplexArray,
    delay: float,
    beside: ComplexArray | None = None,
) -> tuple[RealArray, ComplexArray]:
    """Return lines that are dense around poles and zeros, and the loop function at them."""
    size = _sizes(features)
    low = LOOP_LINES.first_line_ratio * float(size.min())
    high = LOOP_LINES.last_line_ratio * float(size.max())
    for _ in range(20):
        ends = np.array([1j, 2j]) * high
        size = np.maximum(np.abs(loop(ends)), np.abs(whole(ends)))
        no_longer_decreases = size[1] > 0.9 * size[0]
        if size[0] <= LOOP_LINES.vanished_gain or no_longer_decreases:
            break
        high *= 2.0
    dense = features if beside is None else np.concatenate([features, beside])
    if delay:  # do not resolve the phase of a gain that has vanished
        w = grid.frequencies(dense, low, high)
        gain = np.maximum(np.abs(loop(1j * w)), np.abs(whole(1j * w)))
        large = np.flatnonzero(~(gain <= LOOP_LINES.vanished_gain))
        if len(large):
            high = min(high, LOOP_LINES.delay_line_ratio * float(w[large[-1]]))
    return grid.resolve(loop, grid.frequencies(dense, low, high, delay))


def find_margins(
    loop: Loop,
    w: RealArray,
    values: ComplexArray,
    gains: RealArray,
    phases: RealArray,
    growing: int,
    drifting: int,
    delay: float,
) -> Margins:
    """Return the margins of a loop from its crossings and stability.

    `gains` and `phases` are the frequencies in rad/s at which |L| is 1 and at which L is real and
    negative; `growing` and `drifting` count the closed-loop poles that are unstable and at 0. With
    a `delay` in s, the modulus margin is also searched above the last line.
    """
    at_phase = 1.0 / np.abs(_at(loop, phases))
    angle = np.angle(-_at(loop, gains))  # phase margin, -pi to pi
    delays = np.mod(angle, _TWO_PI) / gains
    shared = {
        "stable": growing == 0,
        "unstable_poles": growing,
        "drifting": drifting,
        "judged_by": "Nyquist count" if delay else "eigenvalues",
        "phase_crossings": phases / _TWO_PI,
        "gain_margins": at_phase,
        "gain_crossings": gains / _TWO_PI,
        "phase_margins": np.degrees(angle),
        "delay_margins": delays,
        "crossover": _first_crossover(loop, gains),
    }
    if growing:
        none = dict.fromkeys(
            ("gain_margin", "gain_reduction", "phase_margin", "delay_margin", "modulus_margin")
        )
        return Margins(**shared, **none)  # type: ignore[arg-type]
    up = at_phase > 1.0
    modulus, modulus_at = _modulus(loop, w, values, delay)
    if modulus > 1.0 and abs(values[-1]) <= LOOP_LINES.vanished_gain:
        # L vanishes at high frequencies, so 1 + L tends to 1.
        modulus, modulus_at = 1.0, np.inf
    gain, gain_at = _find_least(at_phase[up], at_phase[up], phases[up], np.inf)
    reduction, reduction_at = _find_least(-at_phase[~up], at_phase[~up], phases[~up], 0.0)
    phase, phase_at = _find_least(np.abs(angle), np.degrees(angle), gains, np.inf)
    late, late_at = _find_least(delays, delays, gains, np.inf)
    return Margins(
        **shared,  # type: ignore[arg-type]
        gain_margin=gain,
        gain_reduction=reduction,
        phase_margin=phase,
        delay_margin=late,
        modulus_margin=modulus,
        gain_margin_at=gain_at,
        gain_reduction_at=reduction_at,
        phase_margin_at=phase_at,
        delay_margin_at=late_at,
        modulus_margin_at=modulus_at / _TWO_PI if np.isfinite(modulus_at) else None,
    )


def _at(loop: Loop, w: RealArray) -> ComplexArray:
    """Return L at lines in rad/s, which may be empty."""
    if not len(w):
        return np.zeros(0, dtype=np.complex128)
    return loop(1j * w)


def _find_least(
    size: RealArray, values: RealArray, w: RealArray, otherwise: float
) -> tuple[float, float | None]:
    """Return the value of least size and its frequency in Hz; `otherwise` and None if empty."""
    if not len(size):
        return otherwise, None
    at = int(np.argmin(size))
    return float(values[at]), float(w[at] / _TWO_PI)


def _modulus(loop: Loop, w: RealArray, values: ComplexArray, delay: float) -> tuple[float, float]:
    """Return the smallest |1 + L| and its frequency in rad/s."""

    def distance(x: RealArray) -> RealArray:
        return np.asarray(np.abs(1.0 + loop(1j * x)))

    best = grid.find_minimum(distance, w, np.abs(1.0 + values))
    end = float(w[-1])
    for _ in range(10):
        if not delay or end * delay > 1e4 or 1.0 - abs(loop(np.array([1j * end]))[0]) >= best[0]:
            break
        more = np.linspace(0.8 * end, 2.0 * end, 9 + int(end * delay / 0.15))
        best = min(best, grid.find_minimum(distance, more, distance(more)))
        end *= 2.0
    return best


def _first_crossover(loop: Loop, gains: RealArray) -> float | None:
    """Return the first crossing with falling gain, in Hz."""
    if not len(gains):
        return None
    falls = np.abs(loop(1j * gains * (1.0 + 1e-7))) < np.abs(loop(1j * gains * (1.0 - 1e-7)))
    return float(gains[np.argmax(falls)] / _TWO_PI) if falls.any() else None
