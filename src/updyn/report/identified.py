"""`write_modes_page`: modes of a measurement and their stabilisation diagram as one HTML page."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from updyn import __version__
from updyn.frf import FRF, QUANTITIES
from updyn.modal import ModeSet
from updyn.modal.unexplained import peaks_without_modes
from updyn.report.formats import counted, extent, number, percentage, unit
from updyn.report.page import assemble
from updyn.report.plots import Figure, log_range, numbers
from updyn.report.section import Content, Section
from updyn.report.templates import asset, render_template, write_page

__all__ = ["Identified", "write_modes_page"]

#: Poles of the diagram in the bottom share of the figure, the level of the FRFs above.
_DIAGRAM = 0.68
#: Most points of the curve of the level.
_POINTS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Identified:
    """Modes, and the measurement that they are of."""

    modes: ModeSet
    frf: FRF


def write_modes_page(modes: ModeSet, frf: FRF, path: str | PathLike[str], title: str = "") -> Path:
    """Write modes and their stabilisation diagram as one HTML page.

    Parameters
    ----------
    modes : ModeSet
        From `updyn.identify_modes`.
    frf : FRF
        The measurement.
    path : str or path-like
        The file; an existing one is replaced only once the new page is complete.
    title : str
        Of the page.

    Returns
    -------
    Path
        The file.
    """
    return write_page(render(modes, frf, title), path)


def render(modes: ModeSet, frf: FRF, title: str = "") -> str:
    """Return the page as text."""
    title = title or "Modes"
    head = render_template(
        "updyn.report/identified_head.html", title=title, about=extent(frf), verdict=_verdict(modes)
    )
    return assemble(
        Content(further={"identified": Identified(modes, frf)}), head, title, __version__
    )


def _verdict(modes: ModeSet) -> str:
    """Return in words how many modes there are, and which is the least sure."""
    count = counted(len(modes), "mode")
    if not np.isfinite(modes.quality).any():
        return f"{count}."
    least = int(np.nanargmin(modes.quality))
    missing = ""
    if len(modes.unexplained):
        missing = f" {peaks_without_modes(modes.unexplained)}."
    return (
        f"{count}; the least sure is the one at {number(float(modes.frequency[least]))} Hz, which"
        f" explains {100.0 * float(modes.quality[least]):.2f} % of what the others leave there."
        f"{missing}"
    )


class DiagramSection(Section):
    """The stabilisation diagram, in which modes are picked."""

    anchor = "diagram"
    name = "Stabilisation diagram"
    heading = "Stabilisation diagram"
    place = 100
    template = "updyn.report/identified_diagram.html"

    def applies(self, content: Content) -> bool:
        """Whether the modes have a diagram."""
        found: Identified = content.further["identified"]
        return found.modes.diagram is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the diagram over frequency, the level of the FRFs above it."""
        return {"diagram": _diagram(content.further["identified"])}

    def script(self) -> str:
        """Return the script that picks modes at a click."""
        return asset("picks.js")


class ModesSection(Section):
    """The table of the modes."""

    anchor = "modes"
    name = "Modes"
    heading = "Modes"
    place = 200
    template = "updyn.report/identified_modes.html"

    def applies(self, content: Content) -> bool:
        """Whether there are modes, which is always so."""
        return True

    def context(self, content: Content) -> dict[str, Any]:
        """Return the rows."""
        modes: ModeSet = content.further["identified"].modes
        shape = _shape_errors(modes)
        rows = []
        for k in range(len(modes)):
            rows.append(
                [
                    str(k + 1),
                    f"{modes.frequency[k]:.6g}",
                    number(float(modes.std_frequency[k]), 2),
                    percentage(float(modes.damping[k])),
                    percentage(float(modes.std_damping[k])),
                    _known(float(shape[k])),
                    f"{modes.phase_collinearity[k]:.3f}",
                    f"{modes.quality[k]:.4f}",
                ]
            )
        return {"rows": rows}


def _shape_errors(modes: ModeSet) -> np.ndarray[Any, Any]:
    """Return the rms of the standard deviations of each shape as a share of the shape's."""
    if modes.std_shapes is None:
        return np.full(len(modes), np.nan)
    return np.asarray(
        np.linalg.norm(modes.std_shapes, axis=0) / np.linalg.norm(modes.real_shapes, axis=0)
    )


def _known(share: float) -> str:
    return "not known" if np.isnan(share) else percentage(share)


def _diagram(found: Identified) -> Figure:
    modes, frf, diagram = found.modes, found.frf, found.modes.diagram
    assert diagram is not None
    order, stable = diagram.order, diagram.stable
    top = float(order.max(initial=1)) + 3.0
    said = "%{x:.6g} Hz, order %{y}<br>damping %{customdata:.3g} %<extra></extra>"
    traces = []
    for chosen, name, marker in (
        (~stable, "new in this order", {"color": "@faint", "size": 4}),
        (stable, "stays from the order before", {"color": "@after", "size": 6}),
    ):
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": name,
                "x": numbers(diagram.frequency[chosen]),
                "y": numbers(order[chosen]),
                "customdata": numbers(100.0 * diagram.damping[chosen]),
                "marker": marker,
                "hovertemplate": said,
            }
        )
    traces.append(
        {
            "type": "scatter",
            "mode": "markers",
            "name": "mode",
            "x": numbers(modes.frequency, packed=False),
            "y": [top] * len(modes),
            "customdata": numbers(100.0 * modes.damping, packed=False),
            "marker": {"color": "@before", "size": 11, "symbol": "triangle-down"},
            "hovertemplate": "mode at %{x:.6g} Hz<br>damping %{customdata:.3g} %<extra></extra>",
        }
    )
    if len(modes.unexplained):
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "peak without a mode",
                "x": numbers(modes.unexplained, packed=False),
                "y": [top] * len(modes.unexplained),
                "marker": {"color": "@warn", "size": 10, "symbol": "x"},
                "hovertemplate": "peak at %{x:.6g} Hz without a mode<extra></extra>",
            }
        )
    freq, level = _level(frf)
    traces.append(
        {
            "type": "scatter",
            "mode": "lines",
            "name": "level of all FRFs",
            "x": numbers(freq),
            "y": numbers(level),
            "yaxis": "y2",
            "line": {"color": "@measured", "width": 1.4},
            "hovertemplate": "%{x:.6g} Hz: %{y:.3g}<extra></extra>",
        }
    )
    layout = {
        "xaxis": {
            "title": {"text": "frequency (Hz)"},
            "anchor": "y",
            "range": [float(frf.freq[0]), float(frf.freq[-1])],
        },
        "yaxis": {"title": {"text": "order"}, "domain": [0.0, _DIAGRAM], "range": [0.0, top + 2.0]},
        "yaxis2": {
            "title": {"text": f"accelerance,<br>rms ({_unit(frf)})"},
            **log_range(level),
            "domain": [_DIAGRAM + 0.04, 1.0],
        },
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"},
        "hovermode": "closest",
    }
    return {"data": traces, "height": 560, "layout": layout}


def _unit(frf: FRF) -> str:
    """Return the unit of the accelerances, where they have one in common."""
    of = {unit("accelerance", i, j) for i in frf.responses.labels for j in frf.references.labels}
    return of.pop() if len(of) == 1 else "several units"


def _level(frf: FRF) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return lines and the rms of the accelerances; of many lines the highest of each few."""
    moving = frf.freq > 0
    freq = frf.freq[moving]
    power = 2 - QUANTITIES[frf.quantity]
    level = np.sqrt(np.mean(np.abs(frf.values[moving]) ** 2, axis=(1, 2)))
    level = level * np.abs(frf.s[moving]) ** power
    few = -(-len(freq) // _POINTS)
    if few < 2:
        return freq, level
    starts = range(0, len(freq), few)
    highest = np.array([start + int(np.argmax(level[start : start + few])) for start in starts])
    return freq[highest], level[highest]


DIAGRAM = DiagramSection()
MODES = ModesSection()
