"""Bode diagrams of plants, and of loops with their margins, as matplotlib figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.control.family import PlantFamily
from updyn.control.lines import channel_zeros, dense_lines
from updyn.control.plant import Plant
from updyn.control.report.plant import channel_name, channel_unit
from updyn.control.servo.record import Loop, Servo
from updyn.control.settings import PLANT_PICTURES
from updyn.errors import DataError, OptionError
from updyn.frf import check_lines
from updyn.plots.canvas import (
    Canvas,
    WhichAxes,
    canvas,
    grid_canvas,
    legend_above,
    legend_outside,
    level_axis,
    level_values,
    log_axis,
)
from updyn.report.plots import phases
from updyn.style import PAPER, category

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["bode"]

_FREQUENCY = "frequency (Hz)"


def bode(
    found: Plant | PlantFamily | Servo | Loop,
    freq: ArrayLike | None = None,
    *,
    level: str | None = None,
    ax: WhichAxes | None = None,
) -> Figure:
    """Return the figure of `updyn.plots.plant`, with the same arguments and errors."""
    if isinstance(found, Servo | Loop):
        loop = found if isinstance(found, Loop) else found.loops[-1]
        if freq is not None:
            raise OptionError("plots.plant: a loop has its lines already; give freq to updyn.servo")
        return _loop(loop, level or "dB", ax)
    if not isinstance(found, Plant | PlantFamily):
        raise OptionError(
            "plots.plant: expected a Plant, a PlantFamily, a Servo or one of its loops, found"
            f" {type(found).__name__}"
        )
    nominal = found if isinstance(found, Plant) else found.nominal
    lines = _lines(nominal) if freq is None else check_lines(np.atleast_1d(np.asarray(freq)))
    values = nominal.response(lines).values
    spread = None if isinstance(found, Plant) else found.spread(lines)
    channels = list(np.ndindex(values.shape[1:]))
    most = PLANT_PICTURES.most_channels
    if len(channels) > most:
        raise DataError(
            f"plots.plant: {len(channels)} channels, expected at most {most}; choose one,"
            f" plant.channel({nominal.outputs[0]!r}, {nominal.inputs[0]!r})"
        )
    level = level or "log"
    if len(channels) == 1:
        with canvas(ax, {"magnitude": 1.8, "phase": 1.0}, (960, 540)) as figure:
            _magnitude(figure.first, nominal, lines, values, (0, 0), level, spread)
            if "phase" in figure.axes:
                _phase(figure.axes["phase"], lines, values[:, 0, 0])
            _frequency_axes(figure)
            legend_above(figure.first, channel_name(nominal, 0, 0))
        return figure.figure
    titles = [channel_name(nominal, i, j) for i, j in channels]
    columns = 2 if len(channels) <= 8 else 3
    with grid_canvas(ax, titles, (1200 / columns, 280), columns) as figure:
        for (i, j), title in zip(channels, titles, strict=True):
            axes = figure.axes[title]
            _magnitude(axes, nominal, lines, values, (i, j), level, spread)
            axes.set_title(title)
            log_axis(axes)
            axes.set_xlabel(_FREQUENCY)
        legend_outside(figure)
    return figure.figure


def _lines(plant: Plant) -> RealArray:
    """Return lines over the band that resolve every resonance and antiresonance."""
    low, high = max(plant.band[0], 1e-3 * plant.band[1]), plant.band[1]
    poles, zeros = plant.poles, []
    if plant.dt is None:
        shape = np.ndindex(len(plant.outputs), len(plant.inputs))
        zeros = [channel_zeros(plant, i, j) for i, j in shape]
    else:
        poles = np.log(poles[poles != 0]) / plant.dt
    return dense_lines([poles], zeros, low, high, per_decade=200)


def _magnitude(
    axes: Axes,
    plant: Plant,
    lines: RealArray,
    values: ComplexArray,
    at: tuple[int, int],
    level: str,
    spread: tuple[RealArray, RealArray] | None,
) -> None:
    """Draw the magnitude of a channel, with its largest error, and the family."""
    i, j = at
    if spread is not None:
        low, high = (level_values(part[:, i, j], level) for part in spread)
        axes.fill_between(lines, low, high, color=PAPER["after"], alpha=0.25, lw=0, label="family")
    size = np.abs(values[:, i, j])
    axes.plot(lines, level_values(size, level), color=PAPER["after"], label="plant")
    inside = (lines >= plant.band[0]) & (lines <= plant.band[1])
    if inside.any():
        share, of, words = _largest_error(plant, size[inside])
        if share > 0:
            axes.plot(
                lines[inside],
                level_values(share * of, level),
                color=PAPER["before"],
                linestyle="--",
                linewidth=1.1,
                label=f"its largest error, {100.0 * share:.2g} % of {words}",
            )
    name = {"receptance": "displacement", "mobility": "velocity", "accelerance": "acceleration"}
    level_axis(axes, name[plant.quantities[i]], channel_unit(plant, i, j), level)


def _largest_error(plant: Plant, size: RealArray) -> tuple[float, RealArray, str]:
    """Return the error with a tolerance, its denominator, and the denominator in words."""
    if plant.facts.get("error") == "relative":
        return plant.relative_error, size, "|H|"
    return plant.error, np.full_like(size, size.max()), "the peak"


def _phase(axes: Axes, lines: RealArray, values: ComplexArray) -> None:
    degrees = phases(values)[0]
    axes.plot(lines, degrees, color=PAPER["after"])
    _degree_axis(axes, degrees)


def _degree_axis(axes: Axes, degrees: RealArray) -> None:
    span = float(np.ptp(degrees))
    step = next((s for s in (45, 90, 180, 360) if span / s <= 6), 720)
    low = np.floor(float(degrees.min()) / step) * step
    high = max(np.ceil(float(degrees.max()) / step) * step, low + step)
    axes.set_yticks(np.arange(low, high + 0.5 * step, step))
    axes.set_ylim(low - 0.1 * step, high + 0.1 * step)
    axes.set_ylabel("phase (°)")


def _frequency_axes(figure: Canvas) -> None:
    axes = list(figure.axes.values())
    axes[-1].set_xlabel(_FREQUENCY)
    for one in axes:
        log_axis(one)


# -- loops -----------------------------------------------------------------------------------------
def _loop(loop: Loop, level: str, ax: WhichAxes | None) -> Figure:
    """Draw a loop function, its family and its margins."""
    with canvas(ax, {"magnitude": 1.6, "phase": 1.2}, (960, 600)) as figure:
        first, colour = figure.first, PAPER["after"]
        for number, member in enumerate(loop.family):
            look: dict[str, Any] = {"color": PAPER["faint"], "linewidth": 0.8}
            label = f"family of {len(loop.family)}" if number == 0 else None
            first.plot(loop.freq, level_values(member, level), label=label, **look)
        first.plot(loop.freq, level_values(loop.L, level), color=colour, label=f"{loop.name} loop")
        first.axhline(
            float(level_values([1.0], level)[0]), color=PAPER["muted"], linestyle=":", lw=1.0
        )
        level_axis(first, "loop gain", "–", level)
        if level == "dB":
            first.set_ylabel("loop gain (dB)")
        if "phase" in figure.axes:
            axes = figure.axes["phase"]
            for member in loop.family_phase:
                axes.plot(loop.freq, member, color=PAPER["faint"], linewidth=0.8)
            axes.plot(loop.freq, loop.phase, color=colour)
            axes.axhline(-180.0, color=PAPER["muted"], linestyle=":", linewidth=1.0)
            _degree_axis(axes, np.concatenate([loop.phase, loop.family_phase.ravel(), [-180.0]]))
        _margins(figure, loop, level)
        _frequency_axes(figure)
        state = "" if loop.margins.stable else "unstable: no margins"
        legend_above(first, state)
    return figure.figure


def _margins(figure: Canvas, loop: Loop, level: str) -> None:
    """Draw gain and phase margin at their frequencies."""
    found = loop.margins
    if not found.stable:
        return
    if found.gain_margin_at is not None and found.gain_margin is not None:
        at, gain = found.gain_margin_at, 1.0 / found.gain_margin
        ends = level_values([gain, 1.0], level)
        colour, _ = category(1)
        text = f"gain margin {found.gain_margin_db:.3g} dB at {at:.3g} Hz"
        figure.first.plot([at, at], ends, color=colour, linewidth=2.4, label=text)
    if "phase" in figure.axes and found.phase_margin_at is not None:
        at = found.phase_margin_at
        assert found.phase_margin is not None
        # The plotted phase continues beyond -180 degrees; the margin refers to the nearest turn.
        drawn = float(np.interp(np.log(at), np.log(loop.freq), loop.phase))
        colour, _ = category(2)
        text = f"phase margin {found.phase_margin:.3g}° at {at:.3g} Hz"
        base = 360.0 * round((drawn - found.phase_margin + 180.0) / 360.0) - 180.0
        turn = [base, base + found.phase_margin]
        figure.axes["phase"].plot([at, at], turn, color=colour, linewidth=2.4)
        figure.first.plot([], [], color=colour, linewidth=2.4, label=text)
