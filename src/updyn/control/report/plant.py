"""The report section on the plant: Bode diagrams, errors, poles, conversions, weights."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from updyn.control.job.plant_result import PlantResult
from updyn.control.plant import Plant
from updyn.control.weight import UncertaintyWeight
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import (
    Figure,
    Panel,
    band_traces,
    curve,
    level_line,
    log_frequency,
    log_range,
    phases,
    stacked,
)
from updyn.report.section import Content, Section

__all__ = [
    "PLANT",
    "bode_name",
    "channels",
    "degree_axis",
    "plant_figures",
    "plant_tiles",
    "share",
    "unit_of",
    "weight_name",
]

#: Channels that are drawn at most; those with the largest errors are.
_DRAWN = 6
_ERROR_FLOOR = 1e-7


def plant_figures(result: PlantResult) -> dict[str, Figure]:
    """Return every figure that has something to show, by the name of its place in the page."""
    plant = result.plant
    if plant is None or result.freq is None:
        return {}
    out = {bode_name(i, j): _bode(result, plant, i, j) for i, j in channels(result)}
    return out | {weight_name(i, j): _weight(found) for (i, j), found in result.weights.items()}


def channels(result: PlantResult) -> list[tuple[int, int]]:
    """Return the channels that are drawn: all, or those with the largest errors."""
    assert result.plant is not None
    everything = list(np.ndindex(len(result.plant.outputs), len(result.plant.inputs)))
    if len(everything) <= _DRAWN:
        return everything
    errors = result.channel_errors()
    return sorted(sorted(everything, key=lambda at: -errors[at])[:_DRAWN])


def bode_name(output: int, input: int) -> str:
    """Return the name of the place of a channel's Bode diagram."""
    return f"plant-{output}-{input}"


def weight_name(output: int, input: int) -> str:
    """Return the name of the place of a channel's weight."""
    return f"weight-{output}-{input}"


def unit_of(plant: Plant, output: int, input: int) -> str:
    """Return the unit of a channel, as ``(rad/s)/(N m)``."""
    top, below = plant.output_units[output].replace("s2", "s²"), plant.input_units[input]
    top, below = (f"({u})" if "/" in u or " " in u else u for u in (top, below))
    return f"{top}/{below}"


def _bode(result: PlantResult, plant: Plant, i: int, j: int) -> Figure:
    freq, exact, answer = result.freq, result.exact, result.answer
    assert freq is not None
    assert exact is not None
    assert answer is not None
    H, G = exact[:, i, j], answer[:, i, j]
    unit = unit_of(plant, i, j)
    model = "updated model" if result.updated else "model"
    degrees = phases(H, G)
    level = float(np.abs(H).max()) or 1.0
    error = np.maximum(np.abs(G - H) / level, _ERROR_FLOOR)
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
        Panel("error / peak", off, log_range([*error, plant.tolerance], 5.0), 0.9),
    ]
    return stacked(panels, log_frequency(freq), 560)


def degree_axis(values: object) -> dict[str, object]:
    """Return an axis of degrees in steps that divide a half turn, around all values."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    low, high = (float(array.min()), float(array.max())) if array.size else (-180.0, 0.0)
    step = next((s for s in (45, 90, 180, 360) if (high - low) / s <= 6), 720)
    return {"tick0": 0, "dtick": step, "range": [low - 0.15 * step, high + 0.15 * step]}


def _weight(found: UncertaintyWeight) -> Figure:
    radius = np.asarray(found.radius)[:, 0, 0]
    cover = np.abs(np.asarray(found.at(found.freq))[:, 0, 0])
    traces = [
        curve(found.freq, radius, "family", "@measured", width=3),
        curve(found.freq, cover, "weight |W|", "@after"),
    ]
    axis = log_range(np.concatenate([radius, cover]), 6.0)
    return stacked(
        [Panel("relative to the nominal plant", traces, axis)], log_frequency(found.freq), 320
    )


#: Poles that are listed at most, and channels in the table of errors.
_LISTED, _CHANNELS = 60, 40
_CONVERSIONS = {
    "modal": ("real modes, full modal damping matrix", "offered"),
    "complex": ("complex modes of the damped structure", "offered"),
    "biot": ("internal variables (Biot)", "offered"),
    "diagonal": ("modal damping ratios alone", "refused"),
    "single-frequency": ("damping matrix at one frequency", "refused"),
}


class PlantSection(Section):
    """The plant of a job."""

    anchor = "plant"
    name = "Plant"
    heading = "Plant"
    place = 2000

    def applies(self, content: Content) -> bool:
        """Whether there is one: any page shows it."""
        return True

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return Bode diagrams and weights."""
        return plant_figures(content.further["plant"])

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words, Bode diagrams, and tables of errors, poles and conversions."""
        return _body(content.further["plant"], figures)


PLANT = PlantSection()


def _body(result: PlantResult, figures: Mapping[str, Figure]) -> str:
    parts = [
        m.paragraph(_about(result), "lead"),
        m.note(*_notes(result)),
    ]
    plant = result.plant
    if plant is not None:
        parts.append(plant_tiles(result, plant))
        parts.append(_ports(plant))
        parts += _diagrams(result, plant, figures)
        parts.append(_channel_table(result, plant))
        parts.append(_pole_table(plant))
    parts.append(_conversions(result))
    parts.append(_weights(result, figures))
    return "".join(parts)


def share(value: float) -> str:
    """Return a share as percent."""
    if not math.isfinite(value):
        return "–"
    if value >= 10.0:
        return f"{w.number(value, 3)} times"
    return f"{100.0 * value:.0f} %" if value >= 1.0 else f"{w.number(100.0 * value, 2)} %"


def _about(result: PlantResult) -> str:
    plant, (low, high) = result.plant, result.band
    band = f"{w.number(low, 4)} to {w.number(high, 4)} Hz"
    if plant is None:
        return f"No plant holds the tolerance of {share(result.tolerance)} from {band}."
    of = "the updated model" if result.updated else "the model as it stands, which is NOT updated"
    return (
        f"A real state-space model of {of}: {w.counted(len(plant.inputs), 'input')},"
        f" {w.counted(len(plant.outputs), 'output')}, {w.counted(plant.n_states, 'state')}. From"
        f" {band} it is off by at most {share(plant.error)} of a channel's peak."
    )


def _notes(result: PlantResult) -> list[str]:
    return [result.message, *result.notes]


def plant_tiles(result: PlantResult, plant: Plant) -> str:
    """Return the figures that a reader looks for first."""
    motions = f"{len(plant.modes) - plant.rigid} flexible modes"
    motions += f", {plant.rigid} of rigid-body motion" if plant.rigid else ", no rigid-body motion"
    tiles = [
        ("Error", share(plant.error), f"of the peak, at most; asked {share(plant.tolerance)}"),
        ("Error of peaks", share(plant.peak_error), "of the height of a resonance, at most"),
        ("Order", str(plant.n_states), motions),
        ("Route", plant.route, _CONVERSIONS.get(plant.route, ("", ""))[0]),
    ]
    if result.sampled is not None and result.sampled.dt is not None:
        late = f", input late by {result.sampled.delay} intervals" if result.sampled.delay else ""
        states = w.counted(result.sampled.n_states, "state")
        tiles.append(("Sampled", f"{w.number(1e3 * result.sampled.dt, 4)} ms", f"{states}{late}"))
    if result.family is not None:
        tiles.append(
            ("Family", str(len(result.family)), "plants from the uncertainty of the update")
        )
    made = "".join(
        f"<div><dt>{m.esc(name)}</dt><dd>{m.esc(value)}<small>{m.esc(hint)}</small></dd></div>"
        for name, value, hint in tiles
    )
    return f'<dl class="tiles">{made}</dl>'


def _ports(plant: Plant) -> str:
    def weights(port: object) -> str:
        found = getattr(port, "weights", {})
        return " + ".join(
            f"{w.number(v, 4)} · {k}" if v != 1.0 else k for k, v in found.items()
        ).replace("+ −", "− ")

    kinds = ("text", "text", "text", "text")
    rows = [
        m.row([p.name, "input", p.force_unit, weights(p)], kinds) for p in plant.input_ports
    ] + [
        m.row([p.name, f"output, {q}", unit.replace("s2", "s²"), weights(p)], kinds)
        for p, q, unit in zip(plant.output_ports, plant.quantities, plant.output_units, strict=True)
    ]
    return m.table(["port", "is", "unit", "DOFs"], rows, kinds=kinds)


def _diagrams(result: PlantResult, plant: Plant, figures: Mapping[str, Figure]) -> list[str]:
    drawn = channels(result)
    total = len(plant.inputs) * len(plant.outputs)
    more = (
        f" The {len(drawn)} of {total} channels with the largest errors are drawn."
        if len(drawn) < total
        else ""
    )
    model = "updated model with its" if result.updated else "model with its"
    caption = (
        f"Grey: the {model} structural damping, one factorisation a line; blue: the plant, from its"
        f" matrices. Below: their difference as a share of the channel's peak.{more}"
    )
    places = []
    for i, j in drawn:
        name = bode_name(i, j)
        heading = f"{plant.outputs[i]} over {plant.inputs[j]}"
        place = m.figure(
            name,
            f"Bode diagram of {heading} in {unit_of(plant, i, j)}",
            "",
            height=figures[name]["height"],
        )
        places.append(f"<div><h3>{m.esc(heading)}</h3>{place}</div>")
    return [m.paragraph(caption), f'<div class="pair wide">{"".join(places)}</div>']


def _channel_table(result: PlantResult, plant: Plant) -> str:
    errors = result.channel_errors()
    if errors.size == 1:
        return ""
    order = sorted(np.ndindex(*errors.shape), key=lambda at: -errors[at])[:_CHANNELS]
    rows = [
        m.row([f"{plant.outputs[i]} over {plant.inputs[j]}", share(float(errors[i, j]))])
        for i, j in order
    ]
    rest = f"; the {_CHANNELS} largest of {errors.size}" if errors.size > _CHANNELS else ""
    return m.table(
        ["channel", "error / peak"],
        rows,
        caption=f"Largest error of each channel in the band{rest}",
    )


def _pole_table(plant: Plant) -> str:
    poles = plant.poles[np.argsort(np.abs(plant.poles), kind="stable")]
    poles = poles[poles.imag >= 0]
    at_zero = int((np.abs(poles) <= 1e-9 * np.abs(poles).max(initial=1e-300)).sum())
    rest = poles[at_zero:]
    rows = []
    for p in rest[:_LISTED]:
        f, z = abs(p) / (2.0 * np.pi), -p.real / abs(p)
        what = "mode" if p.imag > 0 else "real pole"
        inside = "" if plant.band[0] <= f <= plant.band[1] else "outside the band"
        rows.append(m.row([w.number(f, 5), w.number(z, 3), what, inside], ("", "", "text", "text")))
    said = (
        f"Poles of the plant; {w.counted(plant.rigid, 'rigid-body mode')} with a pole at 0"
        if plant.rigid
        else "Poles of the plant"
    )
    said += f". The first {_LISTED} of {len(rest)}" if len(rest) > _LISTED else ""
    kinds = ("", "", "text", "text")
    return m.table(["frequency (Hz)", "damping ratio", "", ""], rows, caption=said, kinds=kinds)


def _conversions(result: PlantResult) -> str:
    if not result.conversions:
        return ""
    noted = any(found.note for found in result.conversions)
    kinds = ("", "text", "", "", "text", *(["note-cell"] if noted else []))
    rows = []
    for found in result.conversions:
        words, kind = _CONVERSIONS.get(found.name, (found.name, ""))
        used = result.plant is not None and found.name == result.plant.route
        state = "used" if used else kind
        good = max(found.error, found.peak_error) <= result.tolerance
        cells = [found.name, words, share(found.error), share(found.peak_error), state]
        cells += [found.note] if noted else []
        rows.append(m.row(cells, kinds, "" if good else "open"))
    caption = (
        "Structural damping turned into poles in several ways, all modes kept, each against the"
        " model itself; marked: not within the tolerance."
    )
    head = [
        "conversion",
        "",
        "error / peak",
        "height of resonances",
        "",
        *(["note"] if noted else []),
    ]
    return f"<h3>Conversions of the damping</h3>{m.table(head, rows, caption=caption, kinds=kinds)}"


def _weights(result: PlantResult, figures: Mapping[str, Figure]) -> str:
    if not result.weights or result.plant is None:
        return ""
    plant, places, rows = result.plant, [], []
    kinds = ("", "", "", "", "", "note-cell")
    for (i, j), found in result.weights.items():
        name, heading = weight_name(i, j), f"{plant.outputs[i]} over {plant.inputs[j]}"
        place = m.figure(
            name, f"Uncertainty of {heading} and its weight", "", height=figures[name]["height"]
        )
        places.append(f"<div><h3>{m.esc(heading)}</h3>{place}</div>")
        ((weight,),) = found.weights
        over = f"{w.number(weight.largest, 3)}, mean {w.number(weight.mean, 3)}"
        farthest = [share(weight.peak), f"{w.number(weight.peak_at, 4)} Hz"]
        rows.append(m.row([heading, *farthest, str(weight.order), over, weight.note], kinds))
    said = (
        "How far the plants of the family are from the nominal one, relative to it, and a stable"
        " minimum-phase weight of low order that covers them, for a robust design. Zeros, poles and"
        " gains are in control.json."
    )
    head = ["channel", "farthest", "at", "order of the weight", "weight over radius", "note"]
    drawn = m.details(
        "Radius and weight over frequency", f'<div class="pair wide">{"".join(places)}</div>'
    )
    return (
        "<h3>Uncertainty for a robust"
        f" design</h3>{m.paragraph(said)}{m.table(head, rows, kinds=kinds)}{drawn}"
    )
