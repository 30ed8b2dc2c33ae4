"""Report section on the plant: Bode diagrams, errors, poles, conversions, weights."""

from __future__ import annotations

import math

import numpy as np

from updyn.arrays import ComplexArray
from updyn.control.conversions import ConversionError, conversion_state, find_route
from updyn.control.job.plant_result import PlantResult
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.report.settings import CONTROL_REPORT
from updyn.control.servo.verdict import judge_servo
from updyn.control.weight import UncertaintyWeight
from updyn.report.formats import format_count, number
from updyn.report.plots import (
    Figure,
    Panel,
    band_traces,
    curve,
    level_line,
    log_frequency,
    log_range,
    phases,
    stack_panels,
)
from updyn.report.section import Headline, PageContent, ReportSection

__all__ = [
    "PLANT",
    "bode_name",
    "channel_name",
    "channel_unit",
    "channels",
    "degree_axis",
    "judge_plant",
    "plant_figures",
    "share",
    "unit_ratio",
    "weight_name",
]

_ERROR_FLOOR = 1e-7
#: Error measures of a tolerance.
_ERRORS = {"relative": "error / |H|", "peak": "error / peak"}
#: Description of the conversions, and whether `updyn.plant` offers them.
_CONVERSIONS = {
    "modal": ("real modes, full modal damping matrix", "offered"),
    "complex": ("complex modes of the damped structure", "offered"),
    "rational": ("rational approximation of the response", "offered"),
    "biot": ("internal variables (Biot)", "offered"),
    "diagonal": ("modal damping ratios only", "refused"),
    "single-frequency": ("damping matrix at one frequency", "refused"),
}


def plant_figures(result: PlantResult) -> dict[str, Figure]:
    """Return every figure with content, by its place name in the page."""
    plant = result.plant
    if plant is None or result.freq is None:
        return {}
    out = {}
    for i, j in channels(result):
        out[bode_name(i, j)] = _bode_figure(result, plant, i, j)
    for (i, j), found in result.weights.items():
        out[weight_name(i, j)] = _weight_figure(found)
    return out


def channels(result: PlantResult) -> list[tuple[int, int]]:
    """Return the plotted channels: all, or those with the largest errors."""
    assert result.plant is not None
    everything = list(np.ndindex(len(result.plant.outputs), len(result.plant.inputs)))
    if len(everything) <= CONTROL_REPORT.plotted_channels:
        return everything
    errors = result.channel_errors(result.measure)
    return sorted(sorted(everything, key=lambda at: -errors[at])[: CONTROL_REPORT.plotted_channels])


def bode_name(output: int, input: int) -> str:
    """Return the place name of a channel's Bode diagram."""
    return f"plant-{output}-{input}"


def weight_name(output: int, input: int) -> str:
    """Return the place name of a channel's weight."""
    return f"weight-{output}-{input}"


def channel_name(plant: Plant, output: int, input: int) -> str:
    """Return the name of a channel, such as ``speed over torque``."""
    return f"{plant.outputs[output]} over {plant.inputs[input]}"


def channel_unit(plant: Plant, output: int, input: int) -> str:
    """Return the unit of a channel, such as ``(rad/s)/(N m)``."""
    return unit_ratio(plant.output_units[output], plant.input_units[input])


def unit_ratio(above: str, below: str) -> str:
    """Return the unit of a ratio, with products and ratios in parentheses."""
    parts = []
    for unit in (above.replace("s2", "s²"), below):
        parts.append(f"({unit})" if "/" in unit or " " in unit else unit)
    return "/".join(parts)


def _bode_figure(result: PlantResult, plant: Plant, i: int, j: int) -> Figure:
    freq, exact, answer = result.freq, result.exact, result.answer
    assert freq is not None
    assert exact is not None
    assert answer is not None
    H, G = exact[:, i, j], answer[:, i, j]
    unit = channel_unit(plant, i, j)
    model = "updated model" if result.updated else "model"
    degrees = phases(H, G)
    error = np.maximum(result.errors(result.measure)[:, i, j], _ERROR_FLOOR)
    size: list[dict[str, object]] = []
    if result.family is not None:
        low, high = result.family.spread(freq)
        size += band_traces(freq, low[:, i, j], high[:, i, j], f"family of {len(result.family)}")
    size += [
        curve(freq, np.abs(H), model, "@measured", unit=unit, width=4),
        curve(freq, np.abs(G), "plant", "@after", unit=unit),
    ]
    phase = [
        curve(freq, degrees[0], model, "@measured", unit="°", width=4, legend=False),
        curve(freq, degrees[1], "plant", "@after", unit="°", legend=False),
    ]
    off = [
        curve(freq, error, "error", "@third"),
        level_line(freq, plant.tolerance, "tolerance"),
    ]
    panels = [
        Panel(f"magnitude ({unit})", size, log_range(np.abs(np.concatenate([H, G]))), 1.5),
        Panel("phase (°)", phase, degree_axis(np.concatenate(degrees)), 0.9),
        Panel(_ERRORS[result.measure], off, log_range([*error, plant.tolerance], 5.0), 0.9),
    ]
    return stack_panels(panels, log_frequency(freq), 560)


def degree_axis(values: object) -> dict[str, object]:
    """Return an axis in degrees around all values, with steps that divide a half turn."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    low, high = -180.0, 0.0
    if array.size:
        low, high = float(array.min()), float(array.max())
    step = next((s for s in (45, 90, 180, 360) if (high - low) / s <= 6), 720)
    return {"tick0": 0, "dtick": step, "range": [low - 0.15 * step, high + 0.15 * step]}


def _weight_figure(found: UncertaintyWeight) -> Figure:
    radius = np.asarray(found.radius)[:, 0, 0]
    cover = np.abs(np.asarray(found.at(found.freq))[:, 0, 0])
    traces = [
        curve(found.freq, radius, "family", "@measured", width=3),
        curve(found.freq, cover, "weight |W|", "@after"),
    ]
    axis = log_range(np.concatenate([radius, cover]), 6.0)
    return stack_panels(
        [Panel("relative to the nominal plant", traces, axis)], log_frequency(found.freq), 320
    )


class PlantSection(ReportSection):
    """The plant of a job."""

    anchor = "plant"
    name = "Plant"
    heading = "Plant"
    place = 2000
    template = "updyn.control.report/plant.html"

    def applies(self, content: PageContent) -> bool:
        """Return whether a page has the section: every page with a plant result."""
        return True

    def headline(self, content: PageContent) -> Headline | None:
        """Return the verdict on the plant; None if the section on the servo has one."""
        result: PlantResult = content.further["plant"]
        return judge_plant(result) if result.servo is None else None

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return Bode diagrams and weights."""
        return plant_figures(content.further["plant"])

    def context(self, content: PageContent) -> dict[str, object]:
        """Return key figures and table cells."""
        result: PlantResult = content.further["plant"]
        context: dict[str, object] = {
            "about": _introduction(result),
            "notes": [result.message, *result.notes],
            "plant": result.plant,
            "conversions": _conversions(result),
            "conversion_head": _conversion_head(result),
            "conversion_caption": _conversion_caption(result),
            "weights": [],
            "text_kinds": ("text", "text", "text", "text"),
            "error_kinds": ("", "", "", "note-cell"),
            "pole_kinds": ("", "", "text", "text"),
            "conversion_kinds": ("", "text", "", "", "", "text", "note-cell"),
            "weight_kinds": ("", "", "", "", "", "note-cell"),
        }
        if result.plant is not None:
            context |= _plant_context(result, result.plant)
        return context


PLANT = PlantSection()


def judge_plant(result: PlantResult) -> Headline:
    """Return the verdict on the servo, or on the plant if there is none."""
    if result.plant is None:
        return Headline("Tolerance not met: no plant is written", "bad")
    if result.servo is None:
        return Headline("Plant within its tolerance", "good" if result.updated else "warn")
    verdict = judge_servo(result.servo)
    return Headline(f"Servo {verdict.text}", verdict.kind)


def _plant_context(result: PlantResult, plant: Plant) -> dict[str, object]:
    poles = _poles(plant)
    diagrams = []
    for i, j in channels(result):
        diagrams.append((bode_name(i, j), channel_name(plant, i, j), channel_unit(plant, i, j)))
    return {
        "key_figures": _key_figures(result, plant),
        "ports": _ports(plant),
        "model": "updated model" if result.updated else "model",
        "diagrams": diagrams,
        "n_channels": len(plant.inputs) * len(plant.outputs),
        "errors": _channel_errors(result, plant),
        "zeros": _zeros(plant),
        "n_zeros": len(plant.zero_shift),
        "share_of": "its size at each line" if result.measure == "relative" else "its peak",
        "poles": [_pole_cells(plant, pole) for pole in poles[: CONTROL_REPORT.listed_poles]],
        "n_poles": len(poles),
        "weights": _weights(result, plant),
    }


def share(value: float) -> str:
    """Return a share in percent."""
    if not math.isfinite(value):
        return "–"
    if value >= 10.0:
        return f"{number(value, 3)} times"
    return f"{100.0 * value:.0f} %" if value >= 1.0 else f"{number(100.0 * value, 2)} %"


def _introduction(result: PlantResult) -> str:
    plant = result.plant
    low, high = result.band
    band = f"{number(low, 4)} to {number(high, 4)} Hz"
    if plant is None:
        return f"No plant holds the tolerance of {share(result.tolerance)} from {band}."
    of = "the original model, which is NOT updated"
    if result.updated:
        of = "the updated model"
    return (
        f"A real state-space model of {of}: {format_count(len(plant.inputs), 'input')},"
        f" {format_count(len(plant.outputs), 'output')}, {format_count(plant.n_states, 'state')}."
        f" From {band} its error is at most {_error_of(result, plant)}."
    )


def _error_of(result: PlantResult, plant: Plant) -> str:
    """Return the largest error in the measure of the tolerance as text."""
    if result.measure == "peak":
        return f"{share(plant.error)} of a channel's peak"
    return f"{share(plant.relative_error)} of a channel's magnitude at each line"


def _key_figures(result: PlantResult, plant: Plant) -> list[tuple[str, str, str]]:
    """Return name, value and hint of the key figures."""
    rigid = "no rigid-body motion"
    if plant.rigid:
        rigid = f"{plant.rigid} of rigid-body motion"
    modes = f"{len(plant.modes) - plant.rigid} flexible modes, {rigid}"
    tiles = [
        *_error_tiles(result, plant),
        ("Order", str(plant.n_states), modes),
        ("Route", plant.route, _CONVERSIONS.get(plant.route, ("", ""))[0]),
    ]
    if result.sampled is not None and result.sampled.dt is not None:
        states = format_count(result.sampled.n_states, "state")
        if result.sampled.delay:
            states += f", input late by {result.sampled.delay} intervals"
        tiles.append(("Sampled", f"{number(1e3 * result.sampled.dt, 4)} ms", states))
    if result.family is not None:
        size = str(len(result.family))
        tiles.append(("Family", size, "plants from the uncertainty of the update"))
    return tiles


def _error_tiles(result: PlantResult, plant: Plant) -> list[tuple[str, str, str]]:
    asked = f"at most; tolerance {share(plant.tolerance)}"
    tile = ("Error", share(plant.relative_error), f"of |H| at each line, {asked}")
    if result.measure == "peak":
        tile = ("Error", share(plant.error), f"of the peak of a channel, {asked}")
    peaks = ("Error of peaks", share(plant.peak_error), "of the height of a resonance, at most")
    return [tile, peaks, *_zero_tiles(plant)]


def _zero_tiles(plant: Plant) -> list[tuple[str, str, str]]:
    """Return the tile of the antiresonances, with the number of those missing in the plant."""
    known = [abs(zero.shift) for zero in plant.zero_shift if math.isfinite(zero.shift)]
    lacking = len(plant.zero_shift) - len(known)
    missing = f"{format_count(lacking, 'antiresonance')} not in the plant"
    if not known:
        return [("Zeros moved by", "–", missing)] if lacking else []
    hint = f"at most, of {format_count(len(known), 'antiresonance')}"
    if lacking:
        hint += f"; {missing}"
    return [("Zeros moved by", f"{number(max(known), 2)} %", hint)]


def _zeros(plant: Plant) -> list[list[str]]:
    """Return the antiresonances by decreasing shift."""
    rows = []
    order = sorted(plant.zero_shift, key=lambda z: -abs(z.shift) if math.isfinite(z.shift) else -99)
    for zero in order[: CONTROL_REPORT.listed_poles]:
        shift = "not in the plant"
        if math.isfinite(zero.shift):
            shift = f"{number(zero.shift, 2)} %"
        depths = [f"{number(depth, 3)} dB" for depth in (zero.depth, zero.plant_depth)]
        channel = f"{zero.output} over {zero.input}"
        rows.append([channel, f"{number(zero.frequency, 5)} Hz", shift, *depths])
    return rows


def _ports(plant: Plant) -> list[list[str]]:
    """Return name, kind, unit and weights of each port."""
    rows = []
    for port in plant.input_ports:
        rows.append([port.name, "input", port.force_unit, _port_weights(port)])
    for port, quantity in zip(plant.output_ports, plant.quantities, strict=True):
        unit = port.motion_unit(quantity).replace("s2", "s²")
        rows.append([port.name, f"output, {quantity}", unit, _port_weights(port)])
    return rows


def _port_weights(port: Port) -> str:
    terms = []
    for dof, weight in port.weights.items():
        terms.append(dof if weight == 1.0 else f"{number(weight, 4)} · {dof}")
    return " + ".join(terms).replace("+ −", "− ")


def _channel_errors(result: PlantResult, plant: Plant) -> list[list[str]]:
    """Return the channels with their errors, in decreasing order, and where |H| is smallest."""
    errors = result.channel_errors(result.measure)
    both = result.channel_errors("relative"), result.channel_errors("peak")
    order = sorted(np.ndindex(*errors.shape), key=lambda at: -errors[at])
    rows = []
    for i, j in order[: CONTROL_REPORT.listed_channels]:
        peak, relative = (share(float(e[i, j])) for e in both[::-1])
        rows.append([channel_name(plant, i, j), peak, relative, _error_place(result, plant, i, j)])
    return rows


def _error_place(result: PlantResult, plant: Plant, i: int, j: int) -> str:
    """Return where the relative error of a channel is largest: frequency, size, antiresonance."""
    assert result.freq is not None
    assert result.exact is not None
    at = int(np.argmax(result.errors("relative")[:, i, j]))
    f, size = float(result.freq[at]), np.abs(result.exact[:, i, j])
    place = f"{number(f, 4)} Hz"
    if size.max() > 0:
        place += f", where |H| is {share(float(size[at] / size.max()))} of the peak"
    names = plant.outputs[i], plant.inputs[j]
    near = CONTROL_REPORT.antiresonance_distance * f
    for zero in plant.zero_shift:
        if (zero.output, zero.input) == names and abs(zero.frequency - f) <= near:
            return f"{place}, at the antiresonance of {number(zero.frequency, 4)} Hz"
    return place


def _poles(plant: Plant) -> ComplexArray:
    """Return the poles by frequency, one of each pair, without those at 0."""
    poles = plant.poles[np.argsort(np.abs(plant.poles), kind="stable")]
    poles = poles[poles.imag >= 0]
    at_zero = int((np.abs(poles) <= 1e-9 * np.abs(poles).max(initial=1e-300)).sum())
    return np.asarray(poles[at_zero:])


def _pole_cells(plant: Plant, pole: complex) -> list[str]:
    frequency = abs(pole) / (2.0 * np.pi)
    kind = "mode" if pole.imag > 0 else "real pole"
    low, high = plant.band
    outside = "" if low <= frequency <= high else "outside the band"
    return [number(frequency, 5), number(-pole.real / abs(pole), 3), kind, outside]


def _conversion_head(result: PlantResult) -> list[str]:
    """Return the head of the table of conversions, with a column for notes if there are any."""
    head = ["conversion", "", "relative error", "error / peak", "height of resonances", ""]
    if any(found.note for found in result.conversions):
        head.append("note")
    return head


def _conversion_caption(result: PlantResult) -> str:
    text = (
        "Conversions of the structural damping to poles, with all modes, each compared with the"
        " model; marked: not within the tolerance."
    )
    if result.plant is not None:
        text += " Last row: the plant"
        if "fitted" in result.plant.facts:
            text += ", its outputs fitted after the conversion"
        text += "; the tolerance applies to its errors."
    return text


def _conversions(result: PlantResult) -> list[tuple[list[str], bool]]:
    """Return the cells of each conversion and whether it holds the tolerance; the plant is last."""
    plant = result.plant
    rows = []
    for found in result.conversions:
        words, state = _CONVERSIONS.get(found.name, (found.name, ""))
        state = conversion_state(found.name, plant) or state
        rows.append(_conversion_row(result, found, (found.name, words, state, found.note)))
    if plant is not None and rows:
        words = f"{find_route(plant)}; {format_count(plant.n_states, 'state')}"
        rows.append(_conversion_row(result, plant, ("the plant", words, "", "")))
    return rows


def _conversion_row(
    result: PlantResult, found: ConversionError | Plant, texts: tuple[str, str, str, str]
) -> tuple[list[str], bool]:
    """Return the cells of a row and whether it holds the tolerance."""
    name, words, state, note = texts
    errors = [share(e) for e in (found.relative_error, found.error, found.peak_error)]
    holds = found.relative_error <= result.tolerance
    if result.measure == "peak":
        holds = max(found.error, found.peak_error) <= result.tolerance
    cells = [name, words, *errors, state, note]
    return cells[: len(_conversion_head(result))], holds


def _weights(result: PlantResult, plant: Plant) -> list[tuple[str, list[str]]]:
    """Return the figure name of each weight and the cells of its row."""
    rows = []
    for (i, j), found in result.weights.items():
        ((weight,),) = found.weights
        cells = [
            channel_name(plant, i, j),
            share(weight.peak),
            f"{number(weight.peak_at, 4)} Hz",
            str(weight.order),
            f"{number(weight.largest, 3)}, mean {number(weight.mean, 3)}",
            weight.note,
        ]
        rows.append((weight_name(i, j), cells))
    return rows
