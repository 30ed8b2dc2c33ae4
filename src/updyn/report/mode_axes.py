"""Modes on two frequency axes, those of the test above those of a model, with pairs joined."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.correlation.modes import ModeCorrelation
from updyn.report.formats import figure_of_agreement, number
from updyn.report.plots import MODEL_COLOURS, Figure
from updyn.report.settings import REPORT_LIST

__all__ = ["mode_axes"]

#: Heights of the axes of test and model, and the length of a tick towards the middle.
_TEST, _MODEL, _TICK = 1.0, 0.0, 0.18
#: Look of the lines between paired modes without shapes: name, colour, width in pixels.
_BY_ORDER = "paired by frequency", "@muted", 1.5


def mode_axes(found: ModeCorrelation, name: str) -> Figure:
    """Return ticks at the modes of the test and of a model, ``"start"`` or ``"updated"``."""
    test, model = found.measured.frequency, found.computed.frequency
    colour = MODEL_COLOURS[name]
    traces: list[dict[str, object]] = [
        *_join_pairs(found),
        *_draw_ticks(test, found.unpaired_measured, "test", _TEST, "@measured"),
        *_draw_ticks(model, found.unpaired_computed, f"{name} model", _MODEL, colour),
    ]
    both = np.concatenate([test, model])
    margin = 0.03 * float(np.ptp(both)) or 0.05 * float(both.max())
    return {
        "data": traces,
        "height": 190,
        "layout": {
            "xaxis": {
                "title": {"text": "frequency (Hz)", "standoff": 2},
                "range": [float(both.min()) - margin, float(both.max()) + margin],
                "showgrid": False,
                "zeroline": False,
            },
            "yaxis": {
                "tickvals": [_MODEL, _TEST],
                "ticktext": [name, "test"],
                "range": [-0.25, 1.25],
                "showgrid": False,
                "zeroline": False,
                "ticks": "",
            },
            "margin": {"l": 50, "r": 8, "t": 28, "b": 40},
            "showlegend": True,
        },
    }


def _draw_ticks(
    frequency: RealArray, alone: IndexArray, owner: str, height: float, colour: str
) -> Iterator[dict[str, object]]:
    """Yield the ticks of an axis: paired modes, and modes without a counterpart in another look."""
    end = height - _TICK if height == _TEST else height + _TICK
    paired = np.setdiff1d(np.arange(len(frequency)), alone)
    for which, text, dash in ((paired, "", "solid"), (alone, ", without a counterpart", "dot")):
        if not len(which):
            continue
        at = np.repeat(frequency[which], 3)
        hover = [f"{owner} {number(f, 5)} Hz{text}" for f in at]
        yield {
            "type": "scatter",
            "mode": "lines",
            "x": at.tolist(),
            "y": [height, end, None] * len(which),
            "name": f"{owner}{text}",
            "line": {"color": colour, "width": 3, "dash": dash},
            "text": hover,
            "hovertemplate": "%{text}<extra></extra>",
            "showlegend": bool(text),
        }


def _join_pairs(found: ModeCorrelation) -> Iterator[dict[str, object]]:
    """Yield the lines between paired modes, by class of their MAC."""
    left = np.ones(len(found.pairs.mac), dtype=np.bool_)
    high, fair = REPORT_LIST.high_mac, REPORT_LIST.fair_mac
    looks = (
        (high, f"MAC {high:g} or more", "@seq-7", 2.5),
        (fair, f"MAC {fair:g} or more", "@seq-4", 2.0),
        (-np.inf, f"MAC below {fair:g}", "@seq-2", 1.5),
    )
    for least, name, colour, width in looks:
        inside = left & (found.pairs.mac >= least)
        left &= ~inside
        if inside.any():
            yield _join(found, inside, name, colour, width)
    if left.any():  # MAC is nan
        yield _join(found, left, *_BY_ORDER)


def _join(
    found: ModeCorrelation, which: BoolArray, name: str, colour: str, width: float
) -> dict[str, object]:
    """Return the lines between some pairs, from the end of one tick to that of the other."""
    pairs = found.pairs
    test = found.measured.frequency[pairs.second[which]]
    model = found.computed.frequency[pairs.first[which]]
    x: list[float | None] = []
    texts: list[str] = []
    for above, below, mac in zip(test, model, pairs.mac[which], strict=True):
        shown = "" if np.isnan(mac) else f"; MAC {figure_of_agreement(mac)}"
        x += [float(above), float(below), None]
        texts += [f"test {number(above, 5)} Hz, model {number(below, 5)} Hz{shown}"] * 3
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": [_TEST - _TICK, _MODEL + _TICK, None] * len(test),
        "name": name,
        "line": {"color": colour, "width": width},
        "text": texts,
        "hovertemplate": "%{text}<extra></extra>",
    }
