"""The section on modes of test, start and updated model: MAC, COMAC, cross-orthogonality."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.correlation import Subspace
from updyn.correlation.modes import ModeCorrelation
from updyn.dynamics.modes import Modes
from updyn.geometry import Geometry
from updyn.modal import ModeSet
from updyn.report.formats import (
    figure_of_agreement,
    format_count,
    format_padded,
    number,
    percentage,
)
from updyn.report.picture import VIEWS, camera
from updyn.report.plots import (
    MODEL_COLOURS,
    SEQUENTIAL,
    Figure,
    colour_bar,
    drop_missing,
    encode_numbers,
    escape_label,
    escape_labels,
    names_font,
    rows_height,
)
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_LIST, REPORT_SIZE
from updyn.settings import FIGURES
from updyn.updating.judge.modal_table import ModalTable, ModeEntry

__all__ = ["MODES", "comac_bars", "comac_maps", "modal_rows", "mode_map"]

#: Largest number of tick labels along the vertical axis of modes.
_MARKS = 30
#: The same along the horizontal axis, which is 130 px wide in print.
_MARKS_ACROSS = 10
#: Smallest and largest height in pixels of a MAC map.
_HEIGHTS = 240, 560
#: Height in pixels of a COMAC map, and the largest number of geometry lines drawn in it.
_MAP_HEIGHT = 380


def mode_map(
    values: ArrayLike,
    rows: Modes | ModeSet,
    columns: Modes | ModeSet,
    names: tuple[str, str],
    criterion: str,
    subspaces: Sequence[Subspace] = (),
) -> Figure:
    """Return a heat map of the modulus of a criterion, modes against modes, from 0 to 1.

    The first mode is at the top and on the left. `names` are the owners of the modes of rows and
    columns. `subspaces` are groups of close modes, framed and labelled with their subspace MAC.
    """
    size = np.abs(np.asarray(values))
    hover = []
    for at, row in zip(rows.frequency, size, strict=True):
        first = f"{escape_label(names[0])} {number(at, 5)} Hz<br>{escape_label(names[1])}"
        cells = zip(columns.frequency, row, strict=True)
        hover.append([f"{first} {number(f, 5)} Hz<br>{criterion} {v:.3f}" for f, v in cells])
    for one in subspaces:
        for i, j in product(one.computed.tolist(), one.measured.tolist()):
            hover[i][j] += f" of single shapes<br>subspace MAC {one.mac:.3f}"
    height = int(np.clip(rows_height(len(rows), extra=110), *_HEIGHTS))
    trace: dict[str, object] = {
        "type": "heatmap",
        "z": encode_numbers(size),
        "x": list(range(len(columns))),
        "y": list(range(len(rows))),
        "zmin": 0.0,
        "zmax": 1.0,
        "colorscale": SEQUENTIAL,
        "xgap": 1,
        "ygap": 1,
        "hovertext": hover,
        "hoverinfo": "text",
        "colorbar": colour_bar(criterion, (0, 0.25, 0.5, 0.75, 1), height),
    }
    if size.size <= FIGURES.printed_cells:
        trace["text"] = [[f"{v:.2f}" for v in row] for row in size]
        trace["texttemplate"] = "%{text}"
    return {
        "data": [trace],
        "height": height,
        "layout": {
            "xaxis": _mode_axis(columns.frequency, f"{names[1]} (Hz)", _MARKS_ACROSS),
            "yaxis": {
                **_mode_axis(rows.frequency, f"{names[0]} (Hz)", _MARKS),
                "autorange": "reversed",
            },
            **_frame_subspaces(subspaces),
        },
    }


def _frame_subspaces(subspaces: Sequence[Subspace]) -> dict[str, object]:
    """Return frames around close modes, labelled with their subspace MAC."""
    frames, texts = [], []
    for one in subspaces:
        for top, bottom, left, right in one.blocks:
            corners = {"x0": left - 0.5, "x1": right + 0.5, "y0": top - 0.5, "y1": bottom + 0.5}
            frames.append({"type": "rect", "line": {"color": "@before", "width": 2}} | corners)
            texts.append(
                {
                    "text": f"{one.mac:.2f}",
                    "x": 0.5 * (left + right),
                    "y": 0.5 * (top + bottom),
                    "showarrow": False,
                    "font": {"size": 11, "color": "@before"},
                    "bgcolor": "@ground",
                    "bordercolor": "@before",
                    "borderpad": 1,
                }
            )
    return {"shapes": frames, "annotations": texts} if frames else {}


def _mode_axis(frequency: RealArray, title: str, most: int) -> dict[str, object]:
    """Return an axis with one place per mode, up to `most` labelled with the frequency in Hz."""
    every = -(-len(frequency) // most)
    at = list(range(0, len(frequency), every))
    return {
        "title": {"text": escape_label(title)},
        "tickvals": at,
        "ticktext": [format_padded(frequency[i], 4) for i in at],
        "showgrid": False,
        "zeroline": False,
    }


def comac_bars(table: ModalTable) -> Figure | None:
    """Return COMAC by sensor before and after the update; None without paired modes."""
    # If sensors are many, only those with the lowest COMAC in the last model are shown.
    found = {}
    for name, correlation in table.correlations.items():
        values = correlation.comac()
        if np.isfinite(values).any():
            found[name] = (values, len(correlation.pairs.mac))
            sensors = correlation.dofs.labels
    if not found:
        return None
    last, _ = next(reversed(found.values()))
    shown = np.sort(np.argsort(last, kind="stable")[: REPORT_LIST.comac_sensors])
    traces, names = [], escape_labels(sensors[i] for i in shown)
    symbols = {"start": "diamond-open", "updated": "circle"}
    for name, (values, n) in found.items():
        colour, symbol = MODEL_COLOURS[name], symbols[name]
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": f"{name} ({format_count(n, 'pair')})",
                "x": encode_numbers(values[shown]),
                "y": list(range(len(names))),
                "text": names,
                "marker": {"color": colour, "symbol": symbol, "size": 9},
                "hovertemplate": f"%{{text}}: COMAC {name} %{{x:.3f}}<extra></extra>",
            }
        )
    return {
        "data": traces,
        "height": rows_height(len(names), extra=130),
        "layout": {
            "xaxis": {"title": {"text": "COMAC"}, "range": [-0.02, 1.03], "zeroline": False},
            "yaxis": {
                "title": {"text": "sensor"},
                "tickvals": list(range(len(names))),
                "ticktext": names,
                "range": [len(names) - 0.4, -0.6],
                "zeroline": False,
                "tickfont": names_font(names),
            },
            "showlegend": True,
        },
    }


def comac_maps(table: ModalTable, geometry: Geometry | None) -> dict[str, Figure]:
    """Return the figures ``"comac-map-start"`` and ``"comac-map-updated"`` by name."""
    # A node with several sensors shows their lowest COMAC. Sensors outside the geometry are
    # omitted.
    made: dict[str, Figure] = {}
    if geometry is None or not len(geometry.nodes):
        return made
    flat = geometry.xyz @ camera(*VIEWS["front"])[:2].T
    ends = geometry.line_ends
    if len(ends) > REPORT_SIZE.map_lines:
        ends = ends[np.linspace(0, len(ends) - 1, REPORT_SIZE.map_lines).round().astype(np.intp)]
    gap = np.full((len(ends), 1, 2), np.nan)
    lines = np.concatenate([flat[ends], gap], axis=1).reshape(-1, 2)
    place = {int(node): at for at, node in enumerate(geometry.nodes)}
    for name, correlation in table.correlations.items():
        found: dict[int, dict[str, float]] = {}
        for dof, value in zip(correlation.dofs, correlation.comac().tolist(), strict=True):
            if dof.node in place and np.isfinite(value):
                found.setdefault(dof.node, {})[dof.direction] = value
        if found:
            at = flat[[place[node] for node in found]]
            made[f"comac-map-{name}"] = _comac_map(lines, at, found)
    return made


def _comac_map(lines: RealArray, at: RealArray, found: Mapping[int, Mapping[str, float]]) -> Figure:
    """Return a picture of the lines, coloured by COMAC at the sensor positions."""
    nodes, hover = list(map(str, found)), []
    for node, values in found.items():
        hover.append(f"{node}: " + ", ".join(f"{way} {v:.3f}" for way, v in values.items()))
    lowest = np.array([min(values.values()) for values in found.values()])
    order = np.argsort(-lowest, kind="stable")  # draw the lowest values on top
    structure = {
        "type": "scatter",
        "mode": "lines",
        "x": encode_numbers(lines[:, 0]),
        "y": encode_numbers(lines[:, 1]),
        "line": {"color": "@muted", "width": 1},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    sensors = {
        "type": "scatter",
        "mode": "markers+text" if len(found) <= REPORT_LIST.labelled_nodes else "markers",
        "x": encode_numbers(at[order, 0]),
        "y": encode_numbers(at[order, 1]),
        "text": [nodes[i] for i in order],
        "textposition": "top right",
        "cliponaxis": False,
        "hovertext": [hover[i] for i in order],
        "hovertemplate": "COMAC %{hovertext}<extra></extra>",
        "showlegend": False,
        "marker": {
            "size": 13,
            "color": encode_numbers(lowest[order]),
            "cmin": 0.0,
            "cmax": 1.0,
            "colorscale": SEQUENTIAL,
            "line": {"color": "@text", "width": 1},
            "colorbar": colour_bar("COMAC", (0, 0.25, 0.5, 0.75, 1), _MAP_HEIGHT),
        },
    }
    hidden = {"visible": False}
    return {
        "data": [structure, sensors],
        "height": _MAP_HEIGHT,
        "layout": {"xaxis": hidden, "yaxis": {**hidden, "scaleanchor": "x"}},
    }


def modal_rows(table: ModalTable, *, fitted: bool = True) -> list[tuple[list[str], str]]:
    """Return the cells and the CSS class of each table row; `fitted` with an updated model."""
    shown = []
    for count, row in enumerate(table.rows, 1):
        computed = [row.start, row.updated] if fitted else [row.start]
        cells = [str(count), _format_entry(row.test, "frequency", 5)]
        for entry in computed:
            cells += [
                _format_entry(entry, "frequency", 5),
                _format_change(entry),
                _format_mac(entry),
            ]
        cells += [_format_entry(entry, "loss_factor", 3) for entry in (row.test, *computed)]
        alone = row.test is None or computed[-1] is None
        shown.append((cells, "open" if alone else ""))
    return shown


def _format_entry(entry: ModeEntry | None, name: str, digits: int) -> str:
    return format_padded(getattr(entry, name, None), digits)


def _format_change(entry: ModeEntry | None) -> str:
    if entry is None or entry.change is None or np.isnan(entry.change):
        return "–"
    shown = f"{round(entry.change, 2) + 0.0:+.2f} %"  # + 0.0: no negative zero
    return shown.replace("-", "−")


def _format_mac(entry: ModeEntry | None) -> str:
    if entry is None or entry.mac is None or np.isnan(entry.mac):
        return "–"
    return f"{entry.mac:.3f}{'*' if entry.in_subspace else ''}"


def _format_verdict(table: ModalTable) -> str:
    """Return a summary of the agreement between the modes of the model and of the test."""
    found = table.correlations.get("updated") or table.correlations["start"]
    which = "updated" if "updated" in table.correlations else "start"
    n, pairs = len(found.measured), found.pairs
    text = f"{len(pairs.mac)} of {n} modes of the test have a mode of the {which} model."
    if len(pairs.mac):
        text += _describe_pairs(found)
    alone = len(found.unpaired_computed)
    if alone:
        are = "is" if alone == 1 else "are"
        modes = format_count(alone, "mode")
        text += f" {modes} of the model in this band {are} not found in the test."
    return text


def _describe_pairs(found: ModeCorrelation) -> str:
    """Return sentences on MAC and frequency differences of the paired modes."""
    figures = found.figures()
    mac, least = (figure_of_agreement(figures[f"mac_{name}"]) for name in ("median", "min"))
    change, most = (percentage(figures[f"frequency_change_{n}"] / 100.0) for n in ("median", "max"))
    if not len(found.dofs):
        text = f" Their frequencies differ by {change} in the median and {most} at most."
    elif len(found.pairs.mac) == 1:
        text = f" The MAC of the pair is {mac}; its frequencies differ by {change}."
    else:
        text = (
            f" Of these pairs the MAC is {mac} in the median and {least} at least; frequencies"
            f" differ by {change} in the median and {most} at most."
        )
    if close := int(found.in_subspace.sum()):
        are = "pair has close modes" if close == 1 else "pairs have close modes"
        text += f" {close} {are}, whose MAC (*) is that of their subspaces."
    return text


class ModesSection(ReportSection):
    """Natural frequencies, damping and shapes of the modes: test, start and updated."""

    anchor = "modes"
    name = "Modes"
    heading = "Modes of test and model"
    place = 40
    template = "updyn.report/modes.html"
    of_start = True

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return MAC before and after, AutoMAC, COMAC as bars and maps, and cross-orthogonality."""
        table = content.modes
        made: dict[str, Figure | None] = {"comac": comac_bars(table)}
        for name, found in table.correlations.items():
            if len(found.computed) and len(found.dofs):
                whose = (f"{name} model", "test")
                made[f"mac-{name}"] = mode_map(
                    found.mac, found.computed, found.measured, whose, "MAC", found.subspaces
                )
                made["auto-mac"] = mode_map(
                    found.auto_mac, found.measured, found.measured, ("test", "test"), "AutoMAC"
                )
        if table.cross_orthogonality is not None:
            assert table.updated is not None
            assert table.test is not None
            values, whose = table.cross_orthogonality, ("updated model", "test")
            made["cross-orthogonality"] = mode_map(
                values, table.updated, table.test, whose, "modulus"
            )
        return drop_missing(made) | comac_maps(table, content.start_model.geometry)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the table rows and the remarks on them."""
        table = content.modes
        rows = modal_rows(table, fitted=content.start is None)
        return {
            "known": table.known,
            "verdict": _format_verdict(table) if table.known else "",
            "notes": (*_list_counterparts(content), *table.notes),
            "rows": rows,
            "shown": REPORT_LIST.unfolded_rows,
            "most_sensors": REPORT_LIST.comac_sensors,
            "n_sensors": len(table.test.dofs) if table.test is not None else 0,
            "reduction": _reduction_error(table),
            "alike": _find_least_separated(table),
            "subspaces": table.subspace_notes,
            "framed": any(one.subspaces for one in table.correlations.values()),
        }


def _list_counterparts(content: PageContent) -> list[str]:
    """Return a note on the modes paired before the search; empty if the result has no count."""
    if content.update is None or content.result.counterparts is None:
        return []
    return [f"Before the search: {content.result.counterparts.statement}"]


def _reduction_error(table: ModalTable) -> float | None:
    """Return the largest off-diagonal entry of the updated model's orthogonality matrix."""
    orthogonality = table.own_orthogonality
    if orthogonality is None or len(orthogonality) < 2:
        return None
    size = np.abs(orthogonality)
    np.fill_diagonal(size, 0.0)
    return float(size.max())


def _find_least_separated(table: ModalTable) -> str:
    """Return the two test modes that the sensors separate worst; empty if all are separated."""
    if not table.known or table.test is None or len(table.test) < 2:
        return ""
    auto = np.nan_to_num(next(iter(table.correlations.values())).auto_mac)
    np.fill_diagonal(auto, 0.0)
    i, j = sorted(np.unravel_index(int(np.argmax(auto)), auto.shape))
    if auto[i, j] < 0.25:
        return ""
    at = table.test.frequency
    return f"{number(at[i], 4)} and {number(at[j], 4)} Hz (AutoMAC {auto[i, j]:.2f})"


MODES = ModesSection()
