"""The report section on the servo: loops, margins, closed loop, time responses, drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.control.job.plant_result import PlantResult
from updyn.control.plant import Plant
from updyn.control.report.nonlinear import nonlinear_figures, nonlinear_part
from updyn.control.report.plant import degree_axis
from updyn.control.servo.drive import DriveFigures
from updyn.control.servo.margins import Margins
from updyn.control.servo.record import Loop, Servo, StepResponse, WindResponse
from updyn.report import formats as w
from updyn.report import markup as m
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
from updyn.report.section import Content, Section

__all__ = [
    "SERVO",
    "servo_figures",
]

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
            out[name] = _step_figure(step, torque_unit)
    if servo.wind is not None:
        out["wind"] = _wind_figure(servo.wind)
    return out


# -- loops ----------------------------------------------------------------------------------------
def _drawn(loop: Loop, high: float) -> NDArray[np.intp]:
    """Return the lines to draw: gains of interest, and the line of every margin."""
    size = _decibels(loop.L)
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
        low, high = _spread(_decibels(members), _decibels(L))
        size += band_traces(freq, low, high, f"family of {len(members)}")
        turns = turn + np.degrees(np.angle(members * np.conj(L)))
        low_turn, high_turn = _spread(turns, turn)
        phase += band_traces(freq, low_turn, high_turn, f"family of {len(members)}", legend=False)
    size.append(curve(freq, _decibels(L), "L, nominal", "@after", unit="dB"))
    phase.append(curve(freq, turn, "phase", "@after", unit="°", legend=False))
    size += _marks(loop, "gain")
    phase += _marks(loop, "phase")
    panels = [
        Panel("|L| (dB)", size, _db_axis(_decibels(L)), 1.2, (0.0,)),
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
    """Return the points of the gain margin (upper panel) and of the phase margin (lower)."""
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
    shown = (_decibels(L) > _QUIET / 2) & (_decibels(L) < _LOUD)
    traces: list[dict[str, Any]] = []
    members = loop.family[:_MEMBERS, at]
    spread: list[_Real] = []
    for number, member in enumerate(members):
        turns = turn + np.degrees(np.angle(member * np.conj(L)))
        line = _along(turns, _decibels(member), loop.freq[at], "family", "@measured", 0.8)
        traces.append(line | {"showlegend": number == 0})
        spread.append(turns[(_decibels(member) > _QUIET / 2) & (_decibels(member) < _LOUD)])
    traces.append(_along(turn, _decibels(L), loop.freq[at], "L, nominal", "@after", 1.8))
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
                "y": numbers(_decibels(circle)),
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
                **_db_axis(_decibels(L), _QUIET / 2),
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
    """Return the odd half turns in degrees that a curve passes, or the nearest one."""
    low, high = (float(turn.min()), float(turn.max())) if turn.size else (-180.0, -180.0)
    first, last = math.ceil((low - 180.0 - 30.0) / 360.0), math.floor((high - 180.0 + 30.0) / 360.0)
    found = [180.0 + 360.0 * k for k in range(first, last + 1)]
    return found or [180.0 + 360.0 * round((0.5 * (low + high) - 180.0) / 360.0)]


def _half_turns(turn: _Real) -> tuple[float, ...]:
    return tuple(_critical(turn))


# -- closed loop ----------------------------------------------------------------------------------
def _closed(servo: Servo, plant: Plant, at: NDArray[np.intp]) -> Figure:
    outer = servo.loops[-1]
    freq = outer.freq[at]  # those of the loop and of the reference are the same
    named = "position" if servo.position_loop is not None else "velocity"
    S = outer.S[at]
    traces = [
        curve(freq, _decibels(servo.reference[at]), f"{named} over reference", "@after", unit="dB"),
        curve(freq, _decibels(S), "sensitivity S", "@third", unit="dB"),
    ]
    marks = () if servo.bandwidth is None else (servo.bandwidth,)
    both = np.concatenate([_decibels(servo.reference[at]), _decibels(S)])
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


# -- over time ------------------------------------------------------------------------------------
def _step_figure(step: StepResponse, unit: str) -> Figure:
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


def _wind_figure(wind: WindResponse) -> Figure:
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


# -- what they share ------------------------------------------------------------------------------
def _unit(unit: str) -> str:
    return unit.replace("s2", "s²")


def _decibels(values: NDArray[Any]) -> _Real:
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


#: Crossings that are listed for each loop at most.
_CROSSINGS = 12


class ServoSection(Section):
    """The servo on the plant of a job, and the figures of its drive."""

    anchor = "servo"
    name = "Servo"
    heading = "Servo"
    place = 2100

    def applies(self, content: Content) -> bool:
        """Whether there is a servo or a drive: any page shows it."""
        result: PlantResult = content.further["plant"]
        return result.servo is not None or result.drive is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return loops, responses over time, and simulations with backlash or friction."""
        result: PlantResult = content.further["plant"]
        if result.servo is None:
            return {}
        assert result.plant is not None
        return nonlinear_figures(result.nonlinear) | servo_figures(result.servo, result.plant)

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words, tables and places of figures."""
        return _body(content.further["plant"], figures)


SERVO = ServoSection()


def _body(result: PlantResult, figures: Mapping[str, Figure]) -> str:
    parts = []
    if result.servo is not None:
        parts += _servo(result.servo, figures)
        parts += [
            nonlinear_part(number, found, figures) for number, found in enumerate(result.nonlinear)
        ]
    if result.drive is not None:
        parts.append(_drive(result.drive))
    return "".join(parts)


# -- the loop -------------------------------------------------------------------------------------
def _servo(servo: Servo, figures: Mapping[str, Figure]) -> list[str]:
    parts = [
        m.paragraph(_verdict(servo), "lead"),
        m.note(*map(_sentence, servo.notes)),
        _tiles(servo),
        _controller(servo),
    ]
    parts.append(_margins(servo))
    for loop in servo.loops:
        parts.append(_loop(loop, figures))
    parts.append("<h3>Closed loop</h3>")
    bandwidth = (
        ""
        if servo.bandwidth is None
        else f" Vertical: the bandwidth, {w.number(servo.bandwidth, 4)} Hz (−3 dB)."
    )
    caption = f"From the reference, and the sensitivity of the outer loop.{bandwidth}"
    parts.append(_place(figures, "closed-loop", "Closed loop and sensitivity", caption))
    over_time = [
        ("step", "Step of the reference", None if servo.step is None else _step(servo.step)),
        (
            "disturbance-step",
            "Step of the disturbance",
            None if servo.disturbance_step is None else _step(servo.disturbance_step),
        ),
        ("wind", "Wind", None if servo.wind is None else _wind(servo.wind)),
    ]
    places = [
        f"<div><h3>{m.esc(heading)}</h3>{_place(figures, name, heading, said)}</div>"
        for name, heading, said in over_time
        if said is not None
    ]
    if places:
        parts.append(f"<div class='pair wide'>{''.join(places)}</div>")
    return parts


def _loop(loop: Loop, figures: Mapping[str, Figure]) -> str:
    """Return the part on one loop: Bode diagram, Nichols plot and crossings."""
    name = loop.name
    other = "the velocity loop closed" if name == "position" else "the position loop open"
    caption = f"L of the {name} loop, broken at the {name}, {other}"
    if loop.members:
        caption += f"; the band holds the {len(loop.members)} plants of the family"
    caption += ". Circles: where the margins are read; dotted: 0 dB and −180°."
    nichols = "The same in the Nichols plane. Inside the dashed line the sensitivity is above 6 dB."
    places = (
        _place(figures, f"bode-{name}", f"Bode diagram of the {name} loop", caption),
        _place(figures, f"nichols-{name}", f"Nichols plot of the {name} loop", nichols),
    )
    pair = "".join(f"<div>{place}</div>" for place in places)
    heading = f"<h3>{m.esc(name.capitalize())} loop</h3>"
    return f"{heading}<div class='pair wide'>{pair}</div>{_crossings(loop)}"


def _place(figures: Mapping[str, Figure], name: str, alternative: str, caption: str) -> str:
    if name not in figures:
        return ""
    return m.figure(name, alternative, caption, height=figures[name]["height"])


def _verdict(servo: Servo) -> str:
    if not all(loop.margins.stable for loop in servo.loops):
        return "The loop is UNSTABLE on the nominal plant; its crossings are no margins."
    bad = sorted({i for loop in servo.loops for i in loop.unstable_members})
    count = len(servo.loops[0].members)
    if bad:
        return (
            f"The loop is stable on the nominal plant, and UNSTABLE on {len(bad)} of {count} plants"
            " of the family."
        )
    return "The loop is stable" + (f", on all {count} plants of the family too." if count else ".")


def _tiles(servo: Servo) -> str:
    smallest = (
        "smallest of all loops and plants"
        if servo.velocity_loop.members
        else "smallest of the loops"
    )
    outer, inner = servo.loops[-1].margins, servo.velocity_loop.margins
    tiles = [("Bandwidth", _hz(servo.bandwidth), f"closed {servo.loops[-1].name} loop, −3 dB")]
    if servo.position_loop is not None:
        tiles.append(("Position crossover", _hz(outer.crossover), "|L| falls through 1"))
    tiles.append(("Velocity crossover", _hz(inner.crossover), "|L| falls through 1"))
    tiles.append(("Phase margin", _degrees(_worst_of(servo, "phase_margin")), smallest))
    gain = _worst_of(servo, "gain_margin")
    tiles.append(("Gain margin", _db(gain), smallest))
    modulus = _worst_of(servo, "modulus_margin")
    tiles.append(("Modulus margin", w.number(modulus, 3), "smallest |1 + L|; above 0.5 is usual"))
    if servo.wind is not None:
        unit = servo.wind.output_unit
        tiles.append(
            (
                "Error in wind",
                f"{w.number(servo.wind.rms, 3)} {unit}",
                f"rms of {servo.wind.output}",
            )
        )
    made = "".join(
        f"<div><dt>{m.esc(name)}</dt><dd>{m.esc(value)}<small>{m.esc(hint)}</small></dd></div>"
        for name, value, hint in tiles
    )
    return f'<dl class="tiles">{made}</dl>'


def _worst_of(servo: Servo, name: str) -> float | None:
    found = [getattr(each, name) for loop in servo.loops for each in (loop.margins, *loop.members)]
    if any(not each.stable for loop in servo.loops for each in (loop.margins, *loop.members)):
        return None
    known = [v for v in found if v is not None]
    return min(known, key=abs) if known else None


def _controller(servo: Servo) -> str:
    c = servo.controller
    rows = [
        (
            "gain of the velocity loop, kp",
            f"{w.number(c.kp, 5)} (unit of {servo.torque} per unit of velocity)",
        ),
        ("integral time, ti", "none" if c.ti is None else f"{w.number(c.ti, 5)} s"),
        ("gain of the position loop, kv", "none" if c.kv is None else f"{w.number(c.kv, 5)} 1/s"),
    ]
    rows += [
        (
            "notch",
            (
                f"{w.number(n.frequency, 5)} Hz, width {w.number(n.width, 4)} Hz, depth"
                f" {w.number(n.depth, 3)}"
            ),
        )
        for n in c.notches
    ]
    if c.low_pass is not None:
        order = (
            "first order"
            if c.low_pass_damping is None
            else f"damping ratio {w.number(c.low_pass_damping, 3)}"
        )
        rows.append(("low-pass", f"{w.number(c.low_pass, 5)} Hz, {order}"))
    if c.feed_forward:
        rows.append(("velocity feed-forward", f"{w.number(100 * c.feed_forward, 3)} %"))
    rows.append(("dead time", f"{w.number(1e3 * c.dead_time, 4)} ms" if c.dead_time else "none"))
    reads = f"{servo.torque} → {servo.velocity}" + (f", {servo.position}" if servo.position else "")
    inertia = servo.plant.get("inertia")
    rows = [("loop", reads), *rows]
    if inertia is not None:
        rows.append(("rigid-body inertia of the plant", w.number(float(inertia), 5)))
    return m.details("Controller", m.definition_table(rows))


# -- margins --------------------------------------------------------------------------------------
def _margins(servo: Servo) -> str:
    head, kinds = ["figure"], [""]
    for loop in servo.loops:
        head += [f"{loop.name} loop", "at"] + (["worst of family", "plant"] if loop.members else [])
        kinds += ["", ""] + (["", ""] if loop.members else [])
    rows = []
    for title, name, say in _FIGURES:
        cells = [title]
        for loop in servo.loops:
            cells += [say(getattr(loop.margins, name)), _hz(_at(loop.margins, name))]
            if loop.members:
                spread = loop.worst[name]
                high = name == "gain_reduction"
                value = spread.largest if high else spread.smallest
                which = spread.largest_member if high else spread.smallest_member
                none = which is None or say(value) in ("–", "∞")
                cells += [say(value), "–" if none else str(which)]
        if any(cell != "–" for cell in cells[1:]):
            rows.append(m.row(cells, kinds))
    closed = ["closed-loop bandwidth"]
    for loop in servo.loops:
        closed += [_hz(loop.bandwidth), "–"] + (["–", "–"] if loop.members else [])
    rows.append(m.row(closed, kinds))
    caption = "Margins; a dash: there is none, as the loop is unstable or nothing bounds it"
    caption += ". Plants of the family are counted from 0" if servo.loops[0].members else ""
    bad = [
        f"{loop.name} loop: plants {_listed(loop.unstable_members)}"
        for loop in servo.loops
        if loop.unstable_members
    ]
    some = any(0 < len(loop.unstable_members) < len(loop.members) for loop in servo.loops)
    rest = " The worst are of the stable ones." if some else ""
    more = m.note(f"Unstable: {'; '.join(bad)}.{rest}") if bad else ""
    return m.table(head, rows, caption=caption, kinds=kinds) + more


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _listed(members: tuple[int, ...]) -> str:
    return ", ".join(str(i) for i in members[:12]) + (", ..." if len(members) > 12 else "")


def _at(margins: Margins, name: str) -> float | None:
    return margins.crossover if name == "crossover" else getattr(margins, f"{name}_at", None)


def _hz(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{w.number(value, 4)} Hz"


def _degrees(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{w.number(value, 3)}°"


def _db(value: float | None) -> str:
    if value is None or math.isnan(value) or value <= 0:
        return "–"
    return "∞" if math.isinf(value) else f"{w.number(20.0 * math.log10(value), 3)} dB"


def _ms(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{w.number(1e3 * value, 3)} ms"


_FIGURES = (
    ("crossover", "crossover", _hz),
    ("phase margin", "phase_margin", _degrees),
    ("gain margin", "gain_margin", _db),
    ("gain reduction", "gain_reduction", _db),
    ("delay margin", "delay_margin", _ms),
    ("modulus margin", "modulus_margin", lambda v: w.number(v, 3)),
)


def _crossings(loop: Loop) -> str:
    found = loop.margins
    rows = [
        (
            float(f),
            m.row(
                [_hz(float(f)), "|L| = 1", _degrees(float(p)), f"delay {_ms(float(d))}"],
                ("", "text", "", ""),
            ),
        )
        for f, p, d in zip(
            found.gain_crossings, found.phase_margins, found.delay_margins, strict=True
        )
    ] + [
        (float(f), m.row([_hz(float(f)), "phase −180°", _db(float(g)), ""], ("", "text", "", "")))
        for f, g in zip(found.phase_crossings, found.gain_margins, strict=True)
    ]
    if not rows:
        return ""
    shown = [text for _, text in sorted(rows, key=lambda r: r[0])[:_CROSSINGS]]
    more = f"; the first {_CROSSINGS} of {len(rows)}" if len(rows) > _CROSSINGS else ""
    table = m.table(["at", "crossing", "margin", ""], shown, kinds=("", "text", "", ""))
    return m.details(f"All crossings of the {loop.name} loop{more}", table)


# -- over time ------------------------------------------------------------------------------------
def _step(step: StepResponse) -> str:
    if step.of == "disturbance":
        text = (
            f"{w.number(step.size, 4)} {step.input_unit} at {step.input}: {step.output} deviates by"
            " at most "
        )
        text += f"{w.number(step.peak, 4)} {step.output_unit} after {w.number(step.peak_time, 3)} s"
        return f"{text}, and comes to {w.number(step.final, 4)} {step.output_unit}."
    said = (
        []
        if step.rise_time is None
        else [f"rises from 10 to 90 % in {w.number(step.rise_time, 3)} s"]
    )
    if step.overshoot is not None:
        said.append(f"overshoots by {w.number(100 * step.overshoot, 3)} %")
    if step.settling_time is None:
        said.append("is not within 2 % when the record ends")
    else:
        said.append(f"stays within 2 % after {w.number(step.settling_time, 3)} s")
    return f"A step of {w.number(step.size, 4)} {step.input_unit} {', '.join(said)}."


def _wind(wind: WindResponse) -> str:
    text = f"{wind.output} is off by {w.number(wind.rms, 3)} {wind.output_unit} rms, at most by "
    text += (
        f"{w.number(wind.peak, 3)} {wind.output_unit}; in the mean by {w.number(wind.mean, 3)}"
        f" {wind.output_unit}."
    )
    if wind.rms_expected is not None:
        text += (
            f" From the spectrum, mean left out: {w.number(wind.rms_expected, 3)}"
            f" {wind.output_unit} rms."
        )
    return text


# -- the drive ------------------------------------------------------------------------------------
def _drive(drive: DriveFigures) -> str:
    mass, stiff = ("kg m²", "N m/rad") if "R" in drive.motor else ("kg", "N/m")
    load_mass, load_stiff = ("kg m²", "N m/rad") if "R" in drive.load else ("kg", "N/m")
    rows = [
        ("gear ratio", _ratio(drive), ""),
        ("inertia at the motor", w.number(drive.inertia, 5), f"{mass}, all in rigid-body motion"),
        ("the motor's own", w.number(drive.motor_inertia, 5), mass),
        ("the rest, at the motor", w.number(drive.rest_inertia, 5), mass),
        ("the rest, at the load", w.number(drive.load_inertia, 5), load_mass),
        ("inertia ratio", w.number(drive.inertia_ratio, 4), "rest over motor, at the motor"),
        ("stiffness at the motor", w.number(drive.stiffness_at_motor, 5), f"{stiff}, load held"),
        (
            "stiffness at the load",
            w.number(drive.stiffness_at_load, 5),
            f"{load_stiff}, motor held",
        ),
    ]
    if drive.first_resonance is not None:
        rows.append(("first resonance", w.number(drive.first_resonance, 5), "Hz"))
    kinds = ("", "", "text")
    parts = [
        f"<h3>The drive from {m.esc(drive.motor)} to {m.esc(drive.load)}</h3>",
        m.note(*drive.notes),
        m.table(["figure", "value", ""], [m.row(row, kinds) for row in rows], kinds=kinds),
    ]
    if drive.pairs:
        pairs = [
            m.row(
                [
                    w.number(v, 5)
                    for v in (
                        p.antiresonance,
                        p.antiresonance_damping,
                        p.resonance,
                        p.resonance_damping,
                    )
                ]
            )
            for p in drive.pairs
        ]
        head = ["antiresonance (Hz)", "damping ratio", "resonance (Hz)", "damping ratio"]
        caption = (
            "Torque to motor speed: antiresonances are the frequencies with the rotor locked,"
            " resonances with it free"
        )
        parts.append(m.table(head, pairs, caption=caption))
    if drive.bandwidth is not None:
        parts.append(m.paragraph(drive.bandwidth.rule))
    return "".join(parts)


def _ratio(drive: DriveFigures) -> str:
    return "–" if drive.ratio is None else f"{w.number(drive.ratio, 6)} ({drive.ratio_from})"
