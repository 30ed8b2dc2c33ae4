"""Report section on the servo: loops, margins, closed loop, time responses, drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from updyn.arrays import IndexArray, NumberArray, RealArray
from updyn.control.job.plant_result import PlantResult
from updyn.control.plant import Plant
from updyn.control.report.nonlinear import nonlinear_context, nonlinear_figures
from updyn.control.report.plant import degree_axis, judge_plant, unit_ratio
from updyn.control.report.settings import CONTROL_REPORT
from updyn.control.servo.drive import DriveFigures
from updyn.control.servo.margins import Margins, RobustMargin
from updyn.control.servo.record import Loop, SampledLoops, Servo, StepResponse, WindResponse
from updyn.control.servo.settings import SERVO_VERDICT
from updyn.control.servo.verdict import judge_servo, worst_member
from updyn.report.formats import number
from updyn.report.plots import (
    Figure,
    Panel,
    band_traces,
    curve,
    encode_numbers,
    escape_label,
    log_frequency,
    log_range,
    stack_panels,
    thin_indices,
)
from updyn.report.section import Headline, PageContent, ReportSection

__all__ = [
    "SERVO",
    "first_margins",
    "margin_table",
    "most_critical",
    "servo_figures",
]

#: Largest and smallest magnitude of a loop function that is drawn, in dB.
_LOUD = 60.0
_QUIET = -80.0
#: Ratio of the highest frequency of a plotted loop to the end of the plant's band.
_REACH = 2.0


def servo_figures(servo: Servo, plant: Plant) -> dict[str, Figure]:
    """Return the figures of a servo by their place name in the page."""
    torque_unit = plant.input_units[plant.inputs.index(servo.torque)]
    out: dict[str, Figure] = {}
    high = _REACH * float(servo.plant["band"][1])
    for loop in servo.loops:
        at = _plotted_lines(loop, high)
        out[f"bode-{loop.name}"] = _bode(loop, at)
        out[f"nichols-{loop.name}"] = _nichols(loop, at)
    out["closed-loop"] = _closed_loop_figure(servo, plant, _plotted_lines(servo.loops[-1], high))
    for name, step in (("step", servo.step), ("disturbance-step", servo.disturbance_step)):
        if step is not None:
            out[name] = _step_figure(step, torque_unit)
    if servo.wind is not None:
        out["wind"] = _wind_figure(servo.wind)
    return out


# -- loops ----------------------------------------------------------------------------------------
def _plotted_lines(loop: Loop, high: float) -> IndexArray:
    """Return the indices of the lines to plot: relevant gains, and the frequencies of margins."""
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
    ends = list(loop.freq[near][[0, -1]]) if near.any() else []
    ends += [f for f in (*marks, m.modulus_margin_at) if f is not None and math.isfinite(f)]
    if len(ends) < 2:
        return thin_indices(size, CONTROL_REPORT.loop_points)
    inside = np.flatnonzero((loop.freq >= 0.95 * min(ends)) & (loop.freq <= 1.05 * max(ends)))
    return inside[thin_indices(size[inside], CONTROL_REPORT.loop_points)]


def _bode(loop: Loop, at: IndexArray) -> Figure:
    freq, L = loop.freq[at], loop.L[at]
    size: list[dict[str, object]] = []
    phase: list[dict[str, object]] = []
    turn = loop.phase[at]
    low_turn, high_turn = turn, turn
    if len(loop.family):
        members = loop.family[:, at]
        low, high = _spread(_decibels(members), _decibels(L))
        size += band_traces(freq, low, high, f"family of {len(members)}")
        low_turn, high_turn = _spread(turn + np.degrees(np.angle(members * np.conj(L))), turn)
        phase += band_traces(freq, low_turn, high_turn, f"family of {len(members)}", legend=False)
    size.append(curve(freq, _decibels(L), "L, nominal", "@after", unit="dB"))
    phase.append(curve(freq, turn, "phase", "@after", unit="°", legend=False))
    size += _gain_margin_traces(loop)
    phase += _phase_margin_traces(loop)
    critical = _critical_phases(turn)
    turns = np.concatenate([low_turn, high_turn, critical])
    panels = [
        Panel("|L| (dB)", size, _db_axis(_decibels(L)), 1.2, (0.0,)),
        Panel("phase (°)", phase, degree_axis(turns), 1.0, tuple(critical)),
    ]
    return stack_panels(panels, log_frequency(freq), 480)


def _gain_margin_traces(loop: Loop) -> list[dict[str, object]]:
    """Return the gain margin as a line from the curve to 0 dB; nothing without a finite one."""
    m = loop.margins
    if m.gain_margin_at is None or m.gain_margin_db is None or not math.isfinite(m.gain_margin_db):
        return []
    name = f"gain margin {m.gain_margin_db:.3g} dB"
    return [_margin_line(m.gain_margin_at, (-m.gain_margin_db, 0.0), name)]


def _phase_margin_traces(loop: Loop) -> list[dict[str, object]]:
    """Return the phase margin as a line from the curve to an odd half turn; nothing without."""
    m = loop.margins
    if m.phase_margin is None or m.phase_margin_at is None or not math.isfinite(m.phase_margin):
        return []
    height = float(np.interp(np.log(m.phase_margin_at), np.log(loop.freq), loop.phase))
    name = f"phase margin {m.phase_margin:.3g}°"
    return [_margin_line(m.phase_margin_at, (height, height - m.phase_margin), name)]


def _margin_line(x: float, ends: tuple[float, float], name: str) -> dict[str, object]:
    """Return a vertical line with a circle at its first end, on the curve."""
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": escape_label(name),
        "x": [x, x],
        "y": list(ends),
        "line": {"color": "@before", "width": 2.5},
        "marker": {
            "color": "@before",
            "size": [9, 0],
            "symbol": "circle-open",
            "line": {"width": 2, "color": "@before"},
        },
        "hovertemplate": f"%{{x:.5g}} Hz: {escape_label(name)}<extra></extra>",
    }


def _nichols(loop: Loop, at: IndexArray) -> Figure:
    L, turn = loop.L[at], loop.phase[at]
    shown = (_decibels(L) > _QUIET / 2) & (_decibels(L) < _LOUD)
    traces: list[dict[str, object]] = []
    members = loop.family[: CONTROL_REPORT.plotted_members, at]
    spread: list[RealArray] = []
    for index, member in enumerate(members):
        turns = turn + np.degrees(np.angle(member * np.conj(L)))
        line = _curve_trace(turns, _decibels(member), loop.freq[at], "family", "@measured", 0.8)
        traces.append(line | {"showlegend": index == 0})
        spread.append(turns[(_decibels(member) > _QUIET / 2) & (_decibels(member) < _LOUD)])
    traces.append(_curve_trace(turn, _decibels(L), loop.freq[at], "L, nominal", "@after", 1.8))
    centres = _critical_phases(turn[shown] if shown.any() else turn)
    circle = -1.0 + SERVO_VERDICT.usual_modulus_margin * np.exp(
        1j * np.linspace(0.0, 2.0 * np.pi, 181)
    )
    for index, centre in enumerate(centres):
        around = centre + np.degrees(np.angle(-circle))
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": f"|1 + L| = {SERVO_VERDICT.usual_modulus_margin:g}",
                "showlegend": index == 0,
                "x": encode_numbers(around),
                "y": encode_numbers(_decibels(circle)),
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


def _curve_trace(
    x: RealArray, y: RealArray, freq: RealArray, name: str, colour: str, width: float
) -> dict[str, object]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": encode_numbers(x),
        "y": encode_numbers(y),
        "customdata": encode_numbers(freq),
        "line": {"color": colour, "width": width},
        "hovertemplate": "%{customdata:.5g} Hz: %{y:.3g} dB, %{x:.4g}°<extra></extra>",
    }


def _critical_phases(turn: RealArray) -> list[float]:
    """Return the odd half turns in degrees that a curve passes, or the nearest one."""
    low = high = -180.0
    if turn.size:
        low, high = float(turn.min()), float(turn.max())
    first = math.ceil((low - 180.0 - 30.0) / 360.0)
    last = math.floor((high - 180.0 + 30.0) / 360.0)
    found = [180.0 + 360.0 * k for k in range(first, last + 1)]
    return found or [180.0 + 360.0 * round((0.5 * (low + high) - 180.0) / 360.0)]


# -- closed loop ----------------------------------------------------------------------------------
def _closed_loop_figure(servo: Servo, plant: Plant, at: IndexArray) -> Figure:
    outer = servo.loops[-1]
    freq = outer.freq[at]  # also the lines of the reference
    named = outer.name
    S = outer.S[at]
    traces = [
        curve(freq, _decibels(servo.reference[at]), f"{named} over reference", "@after", unit="dB"),
        curve(freq, _decibels(S), "sensitivity S", "@third", unit="dB"),
    ]
    marks: tuple[float, ...] = ()
    if servo.bandwidth is not None:
        marks = (servo.bandwidth,)
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
    return stack_panels(panels, log_frequency(freq), 280 + 180 * (len(panels) - 1) + 60, marks)


def _compliance_unit(servo: Servo, plant: Plant) -> str:
    """Return the unit of position (of velocity, without a position loop) over disturbance."""
    assert servo.disturbance is not None
    read, quantity = servo.velocity, "mobility"
    if servo.position_loop is not None:
        read, quantity = servo.position or servo.velocity, "receptance"
    motion = plant.output_ports[plant.outputs.index(read)].motion_unit(quantity)
    return unit_ratio(motion, plant.input_units[plant.inputs.index(servo.disturbance)])


# -- time responses -------------------------------------------------------------------------------
def _step_figure(step: StepResponse, unit: str) -> Figure:
    value = _time_trace(step.time, step.value, step.output, step.output_unit, "@after")
    final = filter(math.isfinite, [step.final])
    panels = [
        Panel(
            f"{escape_label(step.output)} ({_unit(step.output_unit)})",
            [value],
            {},
            1.2,
            tuple(final),
        ),
        Panel(
            f"command ({unit})",
            [_time_trace(step.time, step.torque, "command", unit, "@third")],
            {},
            0.8,
        ),
    ]
    return stack_panels(
        panels, {"title": {"text": "time (s)"}, "range": [0.0, float(step.time[-1])]}, 400
    )


def _wind_figure(wind: WindResponse) -> Figure:
    time = wind.time
    push = _time_trace(time, wind.disturbance, wind.input, wind.input_unit, "@fourth")
    error = _time_trace(time, wind.error, wind.output, wind.output_unit, "@after")
    panels = [
        Panel(f"{escape_label(wind.input)} ({_unit(wind.input_unit)})", [push], {}, 0.8),
        Panel(f"{escape_label(wind.output)}, error ({_unit(wind.output_unit)})", [error], {}, 1.2),
    ]
    return stack_panels(
        panels, {"title": {"text": "time (s)"}, "range": [float(time[0]), float(time[-1])]}, 400
    )


def _time_trace(
    time: RealArray, value: RealArray, name: str, unit: str, colour: str
) -> dict[str, object]:
    shown = f"%{{x:.5g}} s: {escape_label(name)} %{{y:.4g}} {_unit(unit)}".rstrip()
    at = thin_indices(value, CONTROL_REPORT.series_points)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape_label(name),
        "x": encode_numbers(time[at]),
        "y": encode_numbers(value[at]),
        "line": {"color": colour, "width": 1.6},
        "hovertemplate": f"{shown}<extra></extra>",
    }


# -- helpers --------------------------------------------------------------------------------------
def _unit(unit: str) -> str:
    return unit.replace("s2", "s²")


def _decibels(values: NumberArray) -> RealArray:
    size = np.abs(values)
    return np.asarray(20.0 * np.log10(np.maximum(size, 1e-30)))


def _spread(members: RealArray, nominal: RealArray) -> tuple[RealArray, RealArray]:
    everything = np.vstack([members, nominal[None]])
    return everything.min(axis=0), everything.max(axis=0)


def _db_axis(values: RealArray, lowest: float = _QUIET) -> dict[str, object]:
    finite = values[np.isfinite(values)]
    low = max(float(finite.min(initial=-12.0)), lowest)
    high = min(float(finite.max(initial=6.0)), _LOUD)
    if not finite.size:
        low, high = max(-20.0, lowest), 20.0
    step = next((s for s in (3, 6, 10, 20) if (high - low) / s <= 8), 40)
    return {"dtick": step, "tick0": 0, "range": [low - 0.3 * step, high + 0.3 * step]}


class ServoSection(ReportSection):
    """Servo on the plant of a job, and the figures of its drive."""

    anchor = "servo"
    name = "Servo"
    heading = "Servo"
    place = 2100
    template = "updyn.control.report/servo.html"

    def applies(self, content: PageContent) -> bool:
        """Return whether the plant result has a servo or a drive."""
        result: PlantResult = content.further["plant"]
        return result.servo is not None or result.drive is not None

    def headline(self, content: PageContent) -> Headline | None:
        """Return the verdict on the servo; None without one."""
        result: PlantResult = content.further["plant"]
        return None if result.servo is None else judge_plant(result)

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return loops, time responses, and simulations with backlash or friction."""
        result: PlantResult = content.further["plant"]
        if result.servo is None:
            return {}
        assert result.plant is not None
        return nonlinear_figures(result.nonlinear) | servo_figures(result.servo, result.plant)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return texts, key figures and table cells."""
        result: PlantResult = content.further["plant"]
        context: dict[str, object] = {"servo": result.servo, "drive": result.drive}
        if result.servo is not None:
            context |= _servo_context(result.servo)
            nonlinear = enumerate(result.nonlinear)
            context["nonlinear"] = [nonlinear_context(number, found) for number, found in nonlinear]
            context["cycle_kinds"] = ("", "", "text", "", "note-cell")
        if result.drive is not None:
            context["drive_figures"] = _drive_cells(result.drive)
            context["drive_kinds"] = ("", "", "text")
        return context


SERVO = ServoSection()


def _servo_context(servo: Servo) -> dict[str, object]:
    return {
        "verdict": judge_servo(servo),
        "notes": [_to_sentence(note) for note in servo.notes],
        "key_figures": _key_figures(servo),
        "controller": _controller(servo),
        "margins": margin_table(servo.all_loops),
        "robust": [_robust(margin) for margin in servo.robust],
        "sampled": None if servo.sampled is None else _sampled_context(servo.sampled),
        "has_family": bool(servo.velocity_loop.members),
        "unstable": _unstable(servo),
        "loops": [_loop(loop) for loop in servo.loops],
        "crossing_kinds": ("", "text", "", ""),
        "robust_kinds": ("text", "", "", "note-cell"),
        "over_time": _over_time(servo),
    }


# -- the loop -------------------------------------------------------------------------------------
def _loop(loop: Loop) -> dict[str, object]:
    """Return name, size of the family and crossings of a loop."""
    crossings = _crossings(loop)
    return {
        "name": loop.name,
        "n_members": len(loop.members),
        "crossings": crossings[: CONTROL_REPORT.listed_items],
        "n_crossings": len(crossings),
    }


def _key_figures(servo: Servo) -> list[tuple[str, str, str]]:
    """Return name, value and hint of the key figures."""
    outer = servo.loops[-1]
    tiles = [("Bandwidth", _hz(servo.bandwidth), f"closed {outer.name} loop, −3 dB")]
    for loop in servo.loops[::-1]:
        crossover = _hz(loop.margins.crossover)
        tiles.append((f"{loop.name.capitalize()} crossover", crossover, "|L| falls through 1"))
    if servo.step is not None:
        settles = _with_unit(servo.step.settling_time, 3, "s")
        tiles.append(("Step settles in", settles, "to 2 %"))
    if servo.wind is not None:
        rms = f"{number(servo.wind.rms, 3)} {servo.wind.output_unit}"
        tiles.append(("Error in wind", rms, f"rms of {servo.wind.output}"))
    return tiles


def _controller(servo: Servo) -> list[tuple[str, str]]:
    """Return the settings of the controller, name and value."""
    c = servo.controller
    reads = servo.velocity
    if servo.position:
        reads += f", {servo.position}"
    kp = f"{number(c.kp, 5)} (unit of {servo.torque} per unit of velocity)"
    rows = [
        ("loop", f"{servo.torque} → {reads}"),
        ("gain of the velocity loop, kp", kp),
        ("integral time, ti", _with_unit(c.ti, 5, "s")),
        ("gain of the position loop, kv", _with_unit(c.kv, 5, "1/s")),
    ]
    if c.ratio != 1.0:
        rows.append(("gear ratio, velocity over position", number(c.ratio, 5)))
    for n in c.notches:
        width = f"width {number(n.width, 4)} Hz, depth {number(n.depth, 3)}"
        rows.append(("notch", f"{number(n.frequency, 5)} Hz, {width}"))
    if c.low_pass is not None:
        order = "first order"
        if c.low_pass_damping is not None:
            order = f"damping ratio {number(c.low_pass_damping, 3)}"
        rows.append(("low-pass", f"{number(c.low_pass, 5)} Hz, {order}"))
    if c.feed_forward:
        rows.append(("velocity feed-forward", f"{number(100 * c.feed_forward, 3)} %"))
    rows.append(("dead time", _with_unit(1e3 * c.dead_time or None, 4, "ms")))
    inertia = servo.plant.get("inertia")
    if inertia is not None:
        rows.append(("rigid-body inertia of the plant", number(float(inertia), 5)))
    return rows


def _with_unit(value: float | None, digits: int, unit: str) -> str:
    return "none" if value is None else f"{number(value, digits)} {unit}"


# -- margins --------------------------------------------------------------------------------------
def margin_table(loops: Sequence[Loop]) -> tuple[list[str], list[tuple[str, list[list[str]]]]]:
    """Return the head of a table of margins, and its rows by the name of their loop."""
    has_family = any(loop.members for loop in loops)
    head = ["", "nominal", "at"]
    if has_family:
        head += [f"worst of {len(loops[0].members)}", "plant"]
    groups = []
    for loop in loops:
        rows = []
        for title, name, text in _FIGURES:
            cells = [text(getattr(loop.margins, name)), _hz(_at(loop.margins, name))]
            if has_family:
                cells += _worst_cells(loop, name, text)
            if set(cells) != {"–"}:
                rows.append([title, *cells])
        if loop.modulus_range is not None:
            span = " to ".join(number(value, 3) for value in loop.modulus_range)
            rows.append(["modulus margin, with the error of the plant", span, "–"])
        if loop.bandwidth is not None:
            rows.append(["closed-loop bandwidth", _hz(loop.bandwidth), "–"])
        padded = [row + ["–"] * (len(head) - len(row)) for row in rows]
        groups.append((_LOOP_NAMES[loop.name], padded))
    return head, groups


def first_margins(servo: Servo) -> tuple[list[str], list[tuple[str, list[list[str]]]]]:
    """Return head and rows, as `margin_table`, of crossover and margins of the first screen."""
    count = len(servo.velocity_loop.members)
    head = ["", "nominal", *([f"worst of {count} plants"] if count else [])]
    groups = []
    for loop in servo.loops:
        rows = []
        for title, name, text in _FIGURES:
            if name in _FIRST:
                cells = [text(getattr(loop.margins, name)), *_worst_cells(loop, name, text)[:1]]
                rows.append([title, *cells[: len(head) - 1]])
        if loop.margins.crossover is not None:
            rows.append(["crossover", _hz(loop.margins.crossover), *[""] * (len(head) - 2)])
        groups.append((_LOOP_NAMES[loop.name], rows))
    return head, groups


def most_critical(servo: Servo) -> Loop:
    """Return the first unstable loop, or that with the smallest modulus margin of all plants."""

    def margin(loop: Loop) -> float:
        nominal = loop.margins.modulus_margin
        if nominal is None or loop.unstable_members:
            return -1.0
        worst = worst_member(loop, "modulus_margin")
        return nominal if worst is None else min(nominal, worst[0])

    return min(servo.loops, key=margin)


def _robust(margin: RobustMargin) -> list[str]:
    value = "∞" if math.isinf(margin.margin) else number(margin.margin, 3)
    return [margin.of, value, _hz(margin.at), _to_sentence(margin.meaning)]


def _sampled_context(sampled: SampledLoops) -> dict[str, object]:
    late = "without delay"
    if sampled.delay:
        late = f"torque delayed by {sampled.delay} interval{'s' if sampled.delay > 1 else ''}"
    notes = [_to_sentence(note) for note in sampled.notes]
    if not sampled.stable:
        notes.insert(0, "The sampled loop is UNSTABLE.")
    return {
        "caption": (
            f"Margins of the sampled loops: every {number(1e3 * sampled.dt, 4)} ms, with the hold,"
            f" {late}"
        ),
        "margins": margin_table(sampled.loops),
        "notes": notes,
    }


def _worst_cells(loop: Loop, name: str, text: Callable[[float | None], str]) -> list[str]:
    """Return the worst value of a margin over the family, and its plant."""
    worst = worst_member(loop, name)
    if worst is None or text(worst[0]) in ("–", "∞"):
        return ["–" if worst is None else text(worst[0]), "–"]
    return [text(worst[0]), str(worst[1])]


def _unstable(servo: Servo) -> str:
    """Return a note on the unstable members of the family; empty without any."""
    bad = []
    some = False
    for loop in servo.loops:
        unstable = loop.unstable_members
        if unstable:
            bad.append(f"{loop.name} loop: plants {_list_members(unstable)}")
            some |= len(unstable) < len(loop.members)
    if not bad:
        return ""
    rest = " The worst values are those of the stable ones." if some else ""
    return f"Unstable: {'; '.join(bad)}.{rest}"


def _to_sentence(text: str) -> str:
    sentence = text[:1].upper() + text[1:]
    return sentence.removesuffix(".") + "."


def _list_members(members: tuple[int, ...]) -> str:
    listed = ", ".join(map(str, members[: CONTROL_REPORT.listed_items]))
    return f"{listed}, ..." if len(members) > CONTROL_REPORT.listed_items else listed


def _at(margins: Margins, name: str) -> float | None:
    return margins.crossover if name == "crossover" else getattr(margins, f"{name}_at", None)


def _hz(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{number(value, 4)} Hz"


def _degrees(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{number(value, 3)}°"


def _db(value: float | None) -> str:
    if value is None or math.isnan(value) or value <= 0:
        return "–"
    return "∞" if math.isinf(value) else f"{number(20.0 * math.log10(value), 3)} dB"


def _ms(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{number(1e3 * value, 3)} ms"


def _modulus(value: float | None) -> str:
    return number(value, 3)


#: Margins on the first screen.
_FIRST = ("phase_margin", "gain_margin", "modulus_margin")
#: Names of the loops in tables.
_LOOP_NAMES = {
    "velocity": "velocity loop",
    "position": "position loop",
    "torque": "both loops, broken at the torque",
}
#: Rows of the table of margins: title, attribute of `Margins`, text of a value.
_FIGURES = (
    ("crossover", "crossover", _hz),
    ("phase margin", "phase_margin", _degrees),
    ("gain margin", "gain_margin", _db),
    ("gain reduction", "gain_reduction", _db),
    ("delay margin", "delay_margin", _ms),
    ("modulus margin", "modulus_margin", _modulus),
)


def _crossings(loop: Loop) -> list[list[str]]:
    """Return the cells of all crossings of a loop, ascending."""
    m = loop.margins
    rows = []
    gains = zip(m.gain_crossings, m.phase_margins, m.delay_margins, strict=True)
    for frequency, phase, delay in gains:
        cells = [_hz(float(frequency)), "|L| = 1", _degrees(float(phase))]
        rows.append((float(frequency), [*cells, f"delay {_ms(float(delay))}"]))
    for frequency, gain in zip(m.phase_crossings, m.gain_margins, strict=True):
        cells = [_hz(float(frequency)), "phase −180°", _db(float(gain)), ""]
        rows.append((float(frequency), cells))
    rows.sort(key=lambda row: row[0])
    return [cells for _, cells in rows]


# -- time responses -------------------------------------------------------------------------------
def _over_time(servo: Servo) -> list[tuple[str, str, str]]:
    """Return figure, heading and caption of each time response."""
    out = []
    if servo.step is not None:
        out.append(("step", "Step of the reference", _step(servo.step)))
    if servo.disturbance_step is not None:
        caption = _step(servo.disturbance_step)
        out.append(("disturbance-step", "Step of the disturbance", caption))
    if servo.wind is not None:
        out.append(("wind", "Wind", _wind(servo.wind)))
    return out


def _step(step: StepResponse) -> str:
    size = f"{number(step.size, 4)} {step.input_unit}"
    if step.of == "disturbance":
        peak = f"{number(step.peak, 4)} {step.output_unit}"
        return (
            f"{size} at {step.input}: {step.output} deviates by at most {peak} after"
            f" {number(step.peak_time, 3)} s, and settles at {number(step.final, 4)}"
            f" {step.output_unit}."
        )
    parts = []
    if step.returns:
        parts.append(
            f"returns to zero (final value {number(step.final, 2)} {step.output_unit}, peak"
            f" {number(step.peak, 4)} {step.output_unit} after {number(step.peak_time, 3)} s)"
        )
    if step.rise_time is not None:
        parts.append(f"rises from 10 to 90 % in {number(step.rise_time, 3)} s")
    if step.overshoot is not None:
        parts.append(f"overshoots by {number(100 * step.overshoot, 3)} %")
    of = " of the peak" if step.returns else ""
    if step.settling_time is None:
        parts.append(f"is not within 2 %{of} when the record ends")
    else:
        parts.append(f"stays within 2 %{of} after {number(step.settling_time, 3)} s")
    return f"A step of {size} {', '.join(parts)}."


def _wind(wind: WindResponse) -> str:
    unit = wind.output_unit
    text = (
        f"{wind.output}: error {number(wind.rms, 3)} {unit} rms, at most"
        f" {number(wind.peak, 3)} {unit}, mean {number(wind.mean, 3)} {unit}."
    )
    if wind.rms_expected is not None:
        expected = f"{number(wind.rms_expected, 3)} {unit} rms"
        text += f" From the spectrum, without the mean: {expected}."
    return text


# -- the drive ------------------------------------------------------------------------------------
def _drive_cells(drive: DriveFigures) -> list[tuple[str, str, str]]:
    """Return name, value and unit of each figure of the drive."""
    mass, stiff = _units(drive.motor)
    load_mass, load_stiff = _units(drive.load)
    ratio = "–"
    if drive.ratio is not None:
        ratio = f"{number(drive.ratio, 6)} ({drive.ratio_from})"
    rows = [
        ("gear ratio", ratio, ""),
        ("inertia at the motor", number(drive.inertia, 5), f"{mass}, all in rigid-body motion"),
        ("the motor's own", number(drive.motor_inertia, 5), mass),
        ("the rest, at the motor", number(drive.rest_inertia, 5), mass),
        ("the rest, at the load", number(drive.load_inertia, 5), load_mass),
        ("inertia ratio", number(drive.inertia_ratio, 4), "rest over motor, at the motor"),
        ("stiffness at the motor", number(drive.stiffness_at_motor, 5), f"{stiff}, load held"),
        ("stiffness at the load", number(drive.stiffness_at_load, 5), f"{load_stiff}, motor held"),
    ]
    if drive.first_resonance is not None:
        rows.append(("first resonance", number(drive.first_resonance, 5), "Hz"))
    return rows


def _units(dof: str) -> tuple[str, str]:
    return ("kg m²", "N m/rad") if "R" in dof else ("kg", "N/m")
