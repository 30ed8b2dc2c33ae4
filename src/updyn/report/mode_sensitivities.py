"""Map of the sensitivities of natural frequencies to the unknowns, before any fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import UpdynError
from updyn.report.formats import number
from updyn.report.of_unknowns import name_unknowns
from updyn.report.plots import DIVERGING, Figure, encode_numbers, names_font
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_LIST
from updyn.updating.modes import frequency_sensitivities

__all__ = ["sensitivity_map"]

#: Largest sensitivity of a frequency to a single stiffness or mass.
_LARGEST = 0.5


def sensitivity_map(content: PageContent) -> Figure | None:
    """Return a heat map of sensitivities, unknowns down and modes across; None without modes."""
    start, modes = content.start, content.modes.start
    if start is None or modes is None or not len(modes):
        return None
    try:
        values = frequency_sensitivities(
            content.start_modes, start.parameters, start.data, modes.frequency
        )
    except (UpdynError, np.linalg.LinAlgError):  # the section on modes states the reason
        return None
    largest = np.max(np.abs(values), axis=0, initial=0.0)
    shown = np.flatnonzero(largest > 0.0)
    shown = np.sort(
        shown[np.argsort(-largest[shown], kind="stable")][: REPORT_LIST.sensitive_unknowns]
    )
    if not len(shown):
        return None
    names = name_unknowns([tuple(start.parameters)[i] for i in shown])
    return _draw(values[:, shown].T, names, modes.frequency)


def _draw(values: RealArray, names: Sequence[str], frequency: RealArray) -> Figure:
    """Return the map of sensitivities, shape (n_unknowns, n_modes)."""
    every = -(-len(frequency) // REPORT_LIST.sensitivity_ticks)
    at = list(range(0, len(frequency), every))
    hover = [
        [
            f"{name}: {number(value, 2)} % at {number(f, 5)} Hz"
            for value, f in zip(row, frequency, strict=True)
        ]
        for name, row in zip(names, values, strict=True)
    ]
    trace: dict[str, object] = {
        "type": "heatmap",
        "z": encode_numbers(values),
        "x": list(range(len(frequency))),
        "y": list(range(len(names))),
        "zmin": -_LARGEST,
        "zmax": _LARGEST,
        "colorscale": DIVERGING,
        "xgap": 1,
        "ygap": 1,
        "hovertext": hover,
        "hoverinfo": "text",
        "showscale": False,
    }
    if every == 1:
        trace["text"] = [[_format_cell(value) for value in row] for row in values]
        trace["texttemplate"] = "%{text}"
    plain = {"showgrid": False, "zeroline": False}
    return {
        "data": [trace],
        "height": 52 + 24 * len(names),
        "layout": {
            "xaxis": {
                "title": {"text": "mode of the start model (Hz)", "standoff": 2},
                "tickvals": at,
                "ticktext": [number(frequency[i], 4) for i in at],
                "tickangle": 0,
                **plain,
            },
            "yaxis": {
                "tickvals": list(range(len(names))),
                "ticktext": list(names),
                "tickfont": names_font(names),
                "range": [len(names) - 0.5, -0.5],
                **plain,
            },
            "margin": {"l": 60, "r": 8, "t": 4, "b": 44},
        },
    }


def _format_cell(value: float) -> str:
    """Return a sensitivity with two decimals; blank if it rounds to 0."""
    text = f"{value:.2f}".replace("-", "−")
    return "" if float(f"{value:.2f}") == 0.0 else text
