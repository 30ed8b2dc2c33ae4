"""The worst and the median channel: measured FRF and model curves on a fine grid."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypedDict

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.frf import reference_noun
from updyn.report.data import ReportData
from updyn.report.formats import figure_of_agreement, percentage, unit
from updyn.report.plots import (
    MODEL_COLOURS,
    Figure,
    Panel,
    curve,
    drop_missing,
    encode_numbers,
    linear_frequency,
    log_range,
    stack_panels,
    thin_indices,
    wrapped_phase,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_COMPUTATION, REPORT_SIZE
from updyn.settings import FIGURES

__all__ = [
    "CHANNELS",
    "channel_curves",
    "format_channel",
    "is_mostly_noise",
    "small_curves",
    "worst_and_median",
]


class ChannelsSection(ReportSection):
    """FRFs of the channel with the worst agreement and of the median channel."""

    anchor = "channels"
    name = "FRFs"
    heading = "FRFs: worst and median channel"
    place = 55
    template = "updyn.report/channels.html"
    needs_frfs = True
    of_start = True

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return magnitude and phase of both channels."""
        data = content.data
        made = {}
        for name, at in worst_and_median(data).items():
            made[f"{name}-channel"] = channel_curves(data, *at)
        return drop_missing(made)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return figure name, title and caption of each channel."""
        data = content.data
        shown = []
        for name, at in worst_and_median(data).items():
            shown.append(
                (f"{name}-channel", _format_title(data, name, *at), _format_caption(data, *at))
            )
        return {"channels": shown}


CHANNELS = ChannelsSection()

#: Text of ticks of small figures in pixels.
_SMALL_TEXT = 11


def worst_and_median(data: ReportData) -> dict[str, tuple[int, int]]:
    """Return the positions (response, reference) of the ``worst`` and the ``median`` channel.

    Channels are ranked by the relative residual of the updated (otherwise the start) model, which
    depends on level, sign and phase. Channels with mostly noise, which the model cannot fit, come
    last. Channels measured as zero are omitted. The key of a single
    channel is ``"only"``; the result is empty if no model could be computed.
    """
    residual = data.residual_after
    if residual is None:
        residual = data.residual_before
    if residual is None:
        return {}
    at = np.argwhere(np.isfinite(residual))
    if not len(at):
        return {}
    noisy = np.array([is_mostly_noise(data, *place) for place in at.tolist()])
    ordered = at[np.lexsort((-residual[tuple(at.T)], noisy))].tolist()
    worst, median = tuple(ordered[0]), tuple(ordered[len(ordered) // 2])
    if len(ordered) == 1:
        return {"only": worst}
    if len(ordered) == 2:
        return {"worst": worst, "other": median}
    return {"worst": worst, "median": median}


def is_mostly_noise(data: ReportData, i: int, j: int) -> bool:
    """Return whether noise alone causes most of the residual, and of the measured level."""
    if data.noise is None or data.residual_after is None:
        return False
    noise, residual = float(data.noise[i, j]), float(data.residual_after[i, j])
    share = REPORT_COMPUTATION.noise_share
    return noise > share and noise > share * residual


def format_channel(data: ReportData, i: int, j: int) -> str:
    """Return the labels of response and reference of a channel, and whether it was held out."""
    return f"{data.responses[i]} / {data.references[j]}{_say_held_out(data, i)}"


def _format_title(data: ReportData, name: str, i: int, j: int) -> str:
    reference = f"{reference_noun(data.quantity)} {data.references[j]}"
    where = f"response {data.responses[i]}, {reference}{_say_held_out(data, i)}"
    return f"{name.capitalize()} channel: {where}"


def _say_held_out(data: ReportData, i: int) -> str:
    return ", held out" if data.held_out[i] else ""


def _format_caption(data: ReportData, i: int, j: int) -> str:
    """Return the figures of agreement of a channel, before and after the update."""
    figures = (
        ("Relative residual", data.residual_before, data.residual_after, percentage),
        (
            "FRF correlation",
            data.correlation_before,
            data.correlation_after,
            figure_of_agreement,
        ),
        ("FRAC", data.frac_before, data.frac_after, figure_of_agreement),
    )
    texts = []
    for name, before, after, say in figures:
        shown = [say(float(values[i, j])) for values in (before, after) if values is not None]
        texts.append(f"{name} {' → '.join(shown)}")
    return "; ".join(texts) + "."


def channel_curves(data: ReportData, i: int, j: int) -> Figure | None:
    """Return magnitude and phase over frequency of channel (i, j); None without lines."""
    if not data.freq.size:
        return None
    unit_of = unit(data.quantity, data.responses[i], data.references[j])
    measured = data.measured[:, i, j]
    level = [_measured_trace(data.freq, np.abs(measured), f"%{{y:.4g}} {unit_of}")]
    phase = [
        _measured_trace(*wrapped_phase(data.freq, measured), "%{y:.0f}°") | {"showlegend": False}
    ]
    drawn = [np.abs(measured)]
    for name, x, H, look in _model_curves(data, i, j, REPORT_SIZE.curve_lines):
        level.append(curve(x, np.abs(H), name, unit=unit_of, **look))
        phase.append(curve(*wrapped_phase(x, H), name, unit="°", legend=False, **look))
        drawn.append(np.abs(H))
    degrees = {"range": [-190, 190], "tickvals": [-180, -90, 0, 90, 180]}
    panels = [
        Panel(f"{data.quantity} ({unit_of})", level, log_range(np.concatenate(drawn)), 2.2),
        Panel("phase (°)", phase, degrees),
    ]
    return stack_panels(panels, linear_frequency(data.freq), height=430)


def small_curves(data: ReportData, i: int, j: int) -> Figure | None:
    """Return the magnitude of channel (i, j) as a small figure; None without lines."""
    if not data.freq.size:
        return None
    unit_of = unit(data.quantity, data.responses[i], data.references[j])
    most = REPORT_SIZE.small_curve_lines
    at = thin_indices(_level(data.measured[:, i, j]), most)
    measured = np.abs(data.measured[at, i, j])
    traces = [_measured_trace(data.freq[at], measured, f"%{{y:.4g}} {unit_of}")]
    drawn = [measured]
    for name, x, H, look in _model_curves(data, i, j, most):
        traces.append(curve(x, np.abs(H), name, unit=unit_of, legend=False, **look))
        drawn.append(np.abs(H))
    panel = Panel(unit_of, traces, log_range(np.concatenate(drawn)))
    figure = stack_panels([panel], linear_frequency(data.freq), height=168)
    figure["layout"] |= {"showlegend": False, "margin": {"l": 40, "r": 8, "t": 6, "b": 40}}
    for axis in ("xaxis", "yaxis"):
        figure["layout"][axis]["title"]["standoff"] = 2
        figure["layout"][axis]["tickfont"] = {"size": _SMALL_TEXT}
    return figure


def _model_curves(
    data: ReportData, i: int, j: int, most: int
) -> Iterator[tuple[str, RealArray, ComplexArray, _Look]]:
    """Yield name, lines, FRF and look of the curve of each model, with at most `most` lines."""
    for name, values, dash in (
        ("start", data.before_curve, "dot"),
        ("updated", data.after_curve, "solid"),
    ):
        if values is None:
            continue
        at = thin_indices(_level(values[:, i, j]), most)
        look = _Look(colour=MODEL_COLOURS[name], dash=dash, width=1.5)
        yield name, data.grid[at], values[at, i, j], look


class _Look(TypedDict):
    """Colour, dash and width in pixels of a curve."""

    colour: str
    dash: str
    width: float


def _measured_trace(x: RealArray, y: RealArray, value_format: str) -> dict[str, object]:
    """Return the trace of measured values: points, or a wide line if there are many."""
    style: dict[str, object] = {"mode": "markers", "marker": {"color": "@measured", "size": 6}}
    if x.size > FIGURES.measured_points:
        style = {"mode": "lines", "line": {"color": "@measured", "width": 4}}
    return {
        "type": "scatter",
        "name": "measured",
        "legendgroup": "measured",
        "x": encode_numbers(x),
        "y": encode_numbers(y),
        "hovertemplate": f"%{{x:.5g}} Hz: measured {value_format}<extra></extra>",
    } | style


def _level(H: ComplexArray) -> RealArray:
    """Return the logarithm of the magnitude, by which lines are thinned."""
    return np.log(np.maximum(np.abs(H), np.finfo(np.float64).tiny))
