"""Figures of FRFs: magnitude, phase and coherence; computed over measured FRFs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from updyn.correlation import Correlation
from updyn.errors import DataError, OptionError
from updyn.frf import FRF, reference_noun, unit
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
    phase_axis,
)
from updyn.report.plots import wrapped_phase
from updyn.settings import FIGURES
from updyn.style import DASHES, PAPER, STATES, category, state

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["frf", "overlay"]

#: Line styles of the models of an update; other computed curves use `DASHES`.
_DASHES = {"start": ":", "updated": "-"}
_FREQUENCY = "frequency (Hz)"


def frf(
    *frfs: FRF,
    labels: Sequence[str] | None = None,
    level: str = "log",
    log_frequency: bool = False,
    coherence: bool = True,
    ax: WhichAxes | None = None,
) -> Figure:
    """Draw magnitude, phase and coherence of every channel of one or several FRFs.

    Parameters
    ----------
    *frfs : FRF
        At least one FRF, all of one quantity. ``frf["3:Z", "1:Z"]`` is one channel of an FRF.
    labels : sequence of str, optional
        Names of the FRFs in the legend; by default their source, or their number.
    level : {"log", "dB", "linear"}
        Scale of the magnitude.
    log_frequency : bool
        Whether the frequency axis is logarithmic.
    coherence : bool
        Whether to draw the coherence, if known.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Axes for the magnitude, the phase and the coherence, in this order. With fewer axes, the
        latter are omitted. None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or an option cannot be used.
    DataError
        If there is no FRF, or quantities differ.
    """
    if not frfs:
        raise DataError("plots.frf: expected at least one FRF")
    names = _names(frfs, labels)
    for other in frfs[1:]:
        _check_quantity(other, frfs[0])
    panels = {"magnitude": 2.2, "phase": 1.0}
    if coherence and any(one.coherence is not None for one in frfs):
        panels["coherence"] = 0.8
    with canvas(ax, panels, (960, 300 + 110 * len(panels))) as made:
        number = 0
        for name, one in zip(names, frfs, strict=True):
            number = _channels(made, one, name, number, level)
        first = made.first
        level_axis(first, frfs[0].quantity, _units(frfs), level)
        if "phase" in made.axes:
            phase_axis(made.axes["phase"])
        if "coherence" in made.axes:
            made.axes["coherence"].set_ylabel("coherence (–)")
            made.axes["coherence"].set_ylim(-0.02, 1.05)
        _frequency_axis(made, log_frequency)
        legend_above(first, "response / force")
    return made.figure


def _channels(made: Canvas, one: FRF, name: str, number: int, level: str) -> int:
    """Draw the channels of an FRF, and return the number of the next curve."""
    size = level_values(one.values, level)
    for i, response in enumerate(one.responses.labels):
        for j, reference in enumerate(one.references.labels):
            colour, dash = category(number)
            look: dict[str, Any] = {
                "color": colour,
                "linestyle": dash,
                "label": f"{name}{response} / {reference}",
                **_single_line_marker(len(one.freq)),
            }
            number += 1
            made.first.plot(one.freq, size[:, i, j], **look)
            if "phase" in made.axes:
                made.axes["phase"].plot(*wrapped_phase(one.freq, one.values[:, i, j]), **look)
            if "coherence" in made.axes and one.coherence is not None:
                made.axes["coherence"].plot(one.freq, one.coherence[:, i, j], **look)
    return number


def _names(frfs: Sequence[FRF], labels: Sequence[str] | None) -> list[str]:
    """Return the prefix of the legend entries of each FRF."""
    if labels is not None:
        if isinstance(labels, str) or len(labels) != len(frfs):
            raise OptionError(f"labels: expected {len(frfs)}, one for each FRF, found {labels!r}")
        return [f"{label}: " for label in labels]
    if len(frfs) == 1:
        return [""]
    sources = [one.source for one in frfs]
    if all(sources) and len(set(sources)) == len(sources):
        return [f"{source}: " for source in sources]
    return [f"FRF {number}: " for number in range(1, len(frfs) + 1)]


def _units(frfs: Sequence[FRF]) -> str:
    """Return the units of the channels, without duplicates."""
    found: dict[str, None] = {}
    for one in frfs:
        for response in one.responses.labels:
            for reference in one.references.labels:
                found[unit(one.quantity, response, reference)] = None
    return ", ".join(found)


def _check_quantity(other: FRF, first: FRF) -> None:
    if other.quantity != first.quantity:
        raise DataError(
            f"plots: found {other.quantity} and {first.quantity}; convert one of them, for instance"
            f" frf.converted({first.quantity!r})"
        )


def _frequency_axis(made: Canvas, logarithmic: bool) -> None:
    axes = list(made.axes.values())
    axes[-1].set_xlabel(_FREQUENCY)
    if logarithmic:
        for one in axes:
            log_axis(one)


# -- computed over measured ------------------------------------------------------------------------
def overlay(
    measured: FRF | Correlation,
    *computed: FRF,
    labels: Sequence[str] | None = None,
    level: str = "log",
    log_frequency: bool = False,
    ax: WhichAxes | None = None,
) -> Figure:
    """Draw computed FRFs over a measured one, channel by channel.

    A single channel is drawn with magnitude and phase, several channels with their magnitude in one
    panel each.

    Parameters
    ----------
    measured : FRF or Correlation
        The measured FRF, or a correlation (`updyn.correlate`), which also contains the computed
        one.
    *computed : FRF
        FRFs at the DOFs of the measured one, and possibly more. Their lines may differ, such as
        finer ones. The quantity is converted.
    labels : sequence of str, optional
        Names of the computed FRFs; by default ``computed``, or ``start`` and ``updated`` for two.
        These two names have the colours of the report; others have different ones.
    level : {"log", "dB", "linear"}
        Scale of the magnitude.
    log_frequency : bool
        Whether the frequency axis is logarithmic.
    ax : matplotlib.axes.Axes or sequence of them, optional
        Axes for the magnitude and phase of a single channel, or one for each of several channels.
        None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or an option cannot be used.
    DataError
        If there is nothing to compare, or there are more than 16 channels.
    DofError
        If a DOF of the measured FRF is missing in a computed one.
    """
    if isinstance(measured, Correlation):
        computed, measured = (measured.computed, *computed), measured.measured
    if not computed:
        raise DataError(
            "plots.overlay: expected at least one computed FRF in addition to the measured one"
        )
    named = _name_frfs(computed, labels)
    fitted: dict[str, FRF] = {}
    for name, one in named.items():
        chosen = one.select(responses=measured.responses, references=measured.references)
        fitted[name] = chosen.converted(measured.quantity)
    pairs = [
        (i, j) for i in range(len(measured.responses)) for j in range(len(measured.references))
    ]
    if len(pairs) > FIGURES.overlay_channels:
        raise DataError(
            f"plots.overlay: {len(pairs)} channels, expected at most"
            f" {FIGURES.overlay_channels}; choose some,"
            f' for instance frf["{measured.responses[0]}", "{measured.references[0]}"]'
        )
    if len(pairs) == 1:
        return one_channel(measured, fitted, level, log_frequency, ax)
    titles = [f"{measured.responses[i]} / {measured.references[j]}" for i, j in pairs]
    columns = 2 if len(pairs) <= 8 else 3
    with grid_canvas(ax, titles, (1200 / columns, 260), columns) as made:
        looks = _computed_looks(fitted)
        for (i, j), title in zip(pairs, titles, strict=True):
            axes = made.axes[title]
            _levels(axes, measured, fitted, (i, j), level, looks)
            noun = reference_noun(measured.quantity)
            axes.set_title(f"response {title.replace(' / ', f', {noun} ')}")
            axes.set_xlabel(_FREQUENCY)
            if log_frequency:
                log_axis(axes)
        legend_outside(made)
    return made.figure


def _name_frfs(computed: Sequence[FRF], labels: Sequence[str] | None) -> dict[str, FRF]:
    if labels is None:
        defaults = {1: ["computed"], 2: ["start", "updated"]}
        numbered = [f"computed {number}" for number in range(1, len(computed) + 1)]
        labels = defaults.get(len(computed), numbered)
    if isinstance(labels, str) or len(set(labels)) != len(computed):
        raise OptionError(
            f"labels: expected {len(computed)} different ones, one for each computed FRF, found"
            f" {labels!r}"
        )
    return dict(zip(labels, computed, strict=True))


def one_channel(
    measured: FRF,
    fitted: Mapping[str, FRF],
    level: str,
    log_frequency: bool,
    ax: WhichAxes | None,
    *,
    looks: Mapping[str, Mapping[str, Any]] | None = None,
    agreement: str = "",
) -> Figure:
    """Draw magnitude and phase of a single channel; options as for `overlay`.

    `looks` are line properties of each computed curve, None to choose them by name; `agreement` is
    added to the title.
    """
    looks = _computed_looks(fitted) if looks is None else looks
    with canvas(ax, {"magnitude": 2.2, "phase": 1.0}, (960, 520)) as made:
        _levels(made.first, measured, fitted, (0, 0), level, looks)
        if "phase" in made.axes:
            axes = made.axes["phase"]
            x, y = wrapped_phase(measured.freq, measured.values[:, 0, 0])
            axes.plot(x, y, **_measured_look(len(measured.freq)))
            for name, one in fitted.items():
                look = {**looks[name], **_single_line_marker(len(one.freq))}
                axes.plot(*wrapped_phase(one.freq, one.values[:, 0, 0]), **look)
            phase_axis(axes)
        _frequency_axis(made, log_frequency)
        noun = reference_noun(measured.quantity)
        title = f"response {measured.responses[0]}, {noun} {measured.references[0]}"
        legend_above(made.first, f"{title}{agreement}")
    return made.figure


def _levels(
    axes: Axes,
    measured: FRF,
    fitted: Mapping[str, FRF],
    at: tuple[int, int],
    level: str,
    looks: Mapping[str, Mapping[str, Any]],
) -> None:
    """Draw the magnitudes of a channel."""
    i, j = at
    size = level_values(measured.values[:, i, j], level)
    axes.plot(measured.freq, size, label="measured", **_measured_look(len(measured.freq)))
    for name, one in fitted.items():
        size = level_values(one.values[:, i, j], level)
        look = {**looks[name], **_single_line_marker(len(one.freq))}
        axes.plot(one.freq, size, label=name, **look)
    unit_name = unit(measured.quantity, str(measured.responses[i]), str(measured.references[j]))
    level_axis(axes, measured.quantity, unit_name, level)


def _measured_look(n_lines: int) -> dict[str, Any]:
    """Return the line properties of measured data: points, or a wide line if there are many."""
    colour = PAPER[STATES["measured"]]
    if n_lines <= FIGURES.measured_points:
        return {"color": colour, "linestyle": "none", "marker": "o", "markersize": 3.6}
    return {"color": colour, "linewidth": 2.8}


def _single_line_marker(n_lines: int) -> dict[str, Any]:
    """Return a marker for a curve with a single line, which would otherwise be invisible."""
    return {"marker": "o", "markersize": 5.0} if n_lines == 1 else {}


def _computed_looks(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Return line properties of computed curves: start dotted, updated solid, others in turn."""
    looks: dict[str, dict[str, Any]] = {}
    others = 0
    for name in names:
        dash = _DASHES[name] if name in _DASHES else DASHES[others % len(DASHES)]
        looks[name] = {"color": PAPER[state(name, others)], "linestyle": dash}
        others += name not in STATES
    return looks
