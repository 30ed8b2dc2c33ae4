"""The figures of a servo: Bode and Nichols of its loops, the closed loop, and what it does over time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.control.plant import Plant
from updyn.control.report.plant_figures import degree_axis
from updyn.control.servo.record import Loop, Servo, StepResponse, WindResponse
from updyn.report.plots import (
    Figure,
    Panel,
    band_traces,
    curve,
    label,
    log_frequency,
    log_range,
    numbers,
    stacked,
    with_peaks,
)

__all__ = ["servo_figures"]

#: Members of a family that are drawn one by one at most, and lines of a curve, points of a series.
_MEMBERS, _LINES, _POINTS = 40, 3000, 4000
#: Range of dB that is shown of a loop function at most, about 0 dB.
_LOUD, _QUIET = 60.0, -80.0
#: Loops are drawn up to this multiple of the plant's band at most.
_REACH = 2.0
#: The circle about -1 that the Nichols plot shows: |1 + L| = 0.5, a sensitivity of 6 dB.
_MODULUS = 0.5

_Real = NDArray[np.float64]


def servo_figures(servo: Servo, plant: Plant) -> dict[str, Figure]:
    """Return every figure that has something to show, by the name of its place in the page."""
    torque_unit = plant.input_units[plant.inputs.index(servo.torque)]
    out: dict[str, Figure] = {}
    high = _REACH * float(servo.plant["band"][1])
    for loop in servo.loops:
        at = _drawn(loop, high)
        out[f"bode-{loop.name}"] = _bode(loop, at)
        out[f"nichols-{loop.name}"] = _nichols(loop, at)
    out["closed-loop"] = _closed(servo, plant, _drawn(servo.loops[-1], high))
    for name, step in (("step", servo.step), ("disturbance-step", servo.disturbance_step)):
        if step is not None:
            out[name] = _step(step, torque_unit)
    if servo.wind is not None:
        out["wind"] = _wind(servo.wind)
    return out


# -- loops -----------------------------------------------------------------------------------------------------
def _drawn(loop: Loop, high: float) -> NDArray[np.intp]:
    """Return which lines to draw: where the loop is neither loud nor quiet beyond interest, and every margin's line."""
    size = _db(loop.L)
    near = (size < _LOUD) & (size > _QUIET) & (loop.freq <= high)
    m = loop.margins
    marks = [
        m.crossover,
        m.gain_margin_at,
        m.gain_reduction_at,
        m.phase_margin_at,
        m.delay_margin_at,
    ]
    ends = [loop.freq[near].min(), loop.freq[near].max()] if near.any() else []
    ends += [f for f in (*marks, m.modulus_margin_at) if f is not None and math.isfinite(f)]
    if len(ends) < 2:
        return with_peaks(size, _LINES)
    inside = np.flatnonzero((loop.freq >= 0.95 * min(ends)) & (loop.freq <= 1.05 * max(ends)))
    return inside[with_peaks(size[inside], _LINES)]


def _bode(loop: Loop, at: NDArray[np.intp]) -> Figure:
    freq, L = loop.freq[at], loop.L[at]
    size: list[dict[str, Any]] = []
    phase: list[dict[str, Any]] = []
    turn = loop.phase[at]
    low_turn, high_turn = turn, turn
    if len(loop.family):
        members = loop.family[:, at]
        low, high = _spread(_db(members), _db(L))
        size += band_traces(freq, low, high, f"family of {len(members)}")
        turns = turn + np.degrees(np.angle(members * np.conj(L)))
        low_turn, high_turn = _spread(turns, turn)
        phase += band_traces(freq, low_turn, high_turn, f"family of {len(members)}", legend=False)
    size.append(curve(freq, _db(L), "L, nominal", "@after", unit="dB"))
    phase.append(curve(freq, turn, "phase", "@after", unit="°", legend=False))
    size += _marks(loop, "gain")
    phase += _marks(loop, "phase")
    panels = [
        Panel("|L| (dB)", size, _db_axis(_db(L)), 1.2, (0.0,)),
        Panel(
            "phase (°)",
            phase,
            degree_axis(np.concatenate([low_turn, high_turn])),
            1.0,
            _half_turns(turn),
        ),
    ]
    return stacked(panels, log_frequency(freq), 480)


def _marks(loop: Loop, panel: str) -> list[dict[str, Any]]:
    """Return points where the margins are read: the gain margin in the upper panel, the phase margin in the lower."""
    m = loop.margins
    if (
        panel == "gain"
        and m.gain_margin is not None
        and m.gain_margin_at is not None
        and math.isfinite(m.gain_margin)
    ):
        assert m.gain_margin_db is not None
        return [
            _point(m.gain_margin_at, -m.gain_margin_db, f"gain margin {m.gain_margin_db:.3g} dB")
        ]
    if panel == "phase" and m.phase_margin is not None and m.phase_margin_at is not None:
        height = float(np.interp(np.log(m.phase_margin_at), np.log(loop.freq), loop.phase))
        return [_point(m.phase_margin_at, height, f"phase margin {m.phase_margin:.3g}°")]
    return []


def _point(x: float, y: float, name: str) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": label(name),
        "x": [x],
        "y": [y],
        "marker": {
            "color": "@before",
            "size": 9,
            "symbol": "circle-open",
            "line": {"width": 2, "color": "@before"},
        },
        "hovertemplate": f"%{{x:.5g}} Hz: {label(name)}<extra></extra>",
    }


def _nichols(loop: Loop, at: NDArray[np.intp]) -> Figure:
    L, turn = loop.L[at], loop.phase[at]
    shown = (_db(L) > _QUIET / 2) & (_db(L) < _LOUD)
    traces: list[dict[str, Any]] = []
    members = loop.family[:_MEMBERS, at]
    spread: list[_Real] = []
    for number, member in enumerate(members):
        turns = turn + np.degrees(np.angle(member * np.conj(L)))
        line = _along(turns, _db(member), loop.freq[at], "family", "@measured", 0.8)
        traces.append(line | {"showlegend": number == 0})
        spread.append(turns[(_db(member) > _QUIET / 2) & (_db(member) < _LOUD)])
    traces.append(_along(turn, _db(L), loop.freq[at], "L, nominal", "@after", 1.8))
    centres = _critical(turn[shown] if shown.any() else turn)
    circle = -1.0 + _MODULUS * np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
    for number, centre in enumerate(centres):
        around = centre + np.degrees(np.angle(-circle))
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"|1 + L| = {_MODULUS:g}",
                "showlegend": number == 0,
                "x": numbers(around),
                "y": numbers(_db(circle)),
                "line": {"color": "@before", "dash": "dash", "width": 1.5},
                "hoverinfo": "skip",
            }
        )
    traces.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": "−1",
            "x": list(centres),
            "y": [0.0] * len(centres),
            "marker": {
                "color": "@before",
                "symbol": "cross-thin-open",
                "size": 10,
                "line": {"width": 2},
            },
            "hovertemplate": "−1<extra></extra>",
        }
    )
    turns = np.concatenate(
        [turn[shown], *spread, np.asarray(centres) - 35.0, np.asarray(centres) + 35.0]
    )
    return {
        "data": traces,
        "height": 480,
        "layout": {
            "xaxis": {"title": {"text": "phase of L (°)"}, "zeroline": False, **degree_axis(turns)},
            "yaxis": {
                "title": {"text": "|L| (dB)"},
                "zeroline": True,
                **_db_axis(_db(L), _QUIET / 2),
            },
            "showlegend": True,
        },
    }


def _along(x: _Real, y: _Real, freq: _Real, name: str, colour: str, width: float) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": numbers(x),
        "y": numbers(y),
        "customdata": numbers(freq),
        "line": {"color": colour, "width": width},
        "hovertemplate": "%{customdata:.5g} Hz: %{y:.3g} dB, %{x:.4g}°<extra></extra>",
    }


def _critical(turn: _Real) -> list[float]:
    """Return the odd half turns in degrees that a curve passes; the nearest one where it passes none."""
    low, high = (float(turn.min()), float(turn.max())) if turn.size else (-180.0, -180.0)
    first, last = math.ceil((low - 180.0 - 30.0) / 360.0), math.floor((high - 180.0 + 30.0) / 360.0)
    found = [180.0 + 360.0 * k for k in range(first, last + 1)]
    return found or [180.0 + 360.0 * round((0.5 * (low + high) - 180.0) / 360.0)]


def _half_turns(turn: _Real) -> tuple[float, ...]:
    return tuple(_critical(turn))


# -- closed loop -----------------------------------------------------------------------------------------------
def _closed(servo: Servo, plant: Plant, at: NDArray[np.intp]) -> Figure:
    outer = servo.loops[-1]
    freq = outer.freq[at]  # those of the loop and of the reference are the same
    named = "position" if servo.position_loop is not None else "velocity"
    S = outer.S[at]
    traces = [
        curve(freq, _db(servo.reference[at]), f"{named} over reference", "@after", unit="dB"),
        curve(freq, _db(S), "sensitivity S", "@third", unit="dB"),
    ]
    marks = () if servo.bandwidth is None else (servo.bandwidth,)
    both = np.concatenate([_db(servo.reference[at]), _db(S)])
    panels = [Panel("closed loop (dB)", traces, _db_axis(both, -60.0), 1.0, (0.0,))]
    if servo.compliance is not None and servo.disturbance is not None:
        unit = _compliance_unit(servo, plant)
        name = f"compliance to {servo.disturbance}"
        compliance = curve(freq, np.abs(servo.compliance[at]), name, "@fourth", unit=unit)
        panels.append(
            Panel(
                f"compliance ({unit})",
                [compliance],
                log_range(np.abs(servo.compliance[at]), 6.0),
                0.8,
            )
        )
    return stacked(panels, log_frequency(freq), 280 + 180 * (len(panels) - 1) + 60, marks)


def _compliance_unit(servo: Servo, plant: Plant) -> str:
    """Return the unit of position (of velocity, without a position loop) over disturbance."""
    assert servo.disturbance is not None
    read = (
        servo.velocity if servo.position_loop is None or servo.position is None else servo.position
    )
    quantity = "mobility" if servo.position_loop is None else "receptance"
    top = plant.output_ports[plant.outputs.index(read)].motion_unit(quantity)
    below = plant.input_units[plant.inputs.index(servo.disturbance)]
    top, below = (f"({u})" if "/" in u or " " in u else u for u in (top, below))
    return f"{top}/{below}"


# -- over time -------------------------------------------------------------------------------------------------
def _step(step: StepResponse, unit: str) -> Figure:
    value = _timed(step.time, step.value, step.output, step.output_unit, "@after")
    final = [] if not math.isfinite(step.final) else [step.final]
    panels = [
        Panel(f"{label(step.output)} ({_unit(step.output_unit)})", [value], {}, 1.2, tuple(final)),
        Panel(
            f"command ({unit})",
            [_timed(step.time, step.torque, "command", unit, "@third")],
            {},
            0.8,
        ),
    ]
    return stacked(
        panels, {"title": {"text": "time (s)"}, "range": [0.0, float(step.time[-1])]}, 400
    )


def _wind(wind: WindResponse) -> Figure:
    time = wind.time
    push = _timed(time, wind.disturbance, wind.input, wind.input_unit, "@fourth")
    error = _timed(time, wind.error, wind.output, wind.output_unit, "@after")
    panels = [
        Panel(f"{label(wind.input)} ({_unit(wind.input_unit)})", [push], {}, 0.8),
        Panel(f"{label(wind.output)}, error ({_unit(wind.output_unit)})", [error], {}, 1.2),
    ]
    return stacked(
        panels, {"title": {"text": "time (s)"}, "range": [float(time[0]), float(time[-1])]}, 400
    )


def _timed(time: _Real, value: _Real, name: str, unit: str, colour: str) -> dict[str, Any]:
    shown = f"%{{x:.5g}} s: {label(name)} %{{y:.4g}} {_unit(unit)}".rstrip()
    at = with_peaks(value, _POINTS)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": label(name),
        "x": numbers(time[at]),
        "y": numbers(value[at]),
        "line": {"color": colour, "width": 1.6},
        "hovertemplate": f"{shown}<extra></extra>",
    }


# -- what they share -------------------------------------------------------------------------------------------
def _unit(unit: str) -> str:
    return unit.replace("s2", "s²")


def _db(values: NDArray[Any]) -> _Real:
    size = np.abs(values)
    return np.asarray(20.0 * np.log10(np.maximum(size, 1e-30)))


def _spread(members: _Real, nominal: _Real) -> tuple[_Real, _Real]:
    everything = np.vstack([members, nominal[None]])
    return everything.min(axis=0), everything.max(axis=0)


def _db_axis(values: _Real, lowest: float = _QUIET) -> dict[str, Any]:
    seen = values[np.isfinite(values)]
    low, high = (float(seen.min()), float(seen.max())) if seen.size else (-20.0, 20.0)
    low, high = max(min(low, -12.0), lowest), min(max(high, 6.0), _LOUD)
    step = next((s for s in (3, 6, 10, 20) if (high - low) / s <= 8), 40)
    return {"dtick": step, "tick0": 0, "range": [low - 0.3 * step, high + 0.3 * step]}
