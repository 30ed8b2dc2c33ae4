"""`write_plan`: write a test plan as one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from updyn import __version__
from updyn.planning.criteria import CRITERIA
from updyn.planning.result import Plan
from updyn.report.formats import format_count, number, percentage, quantity_words, unknown_words
from updyn.report.page import assemble
from updyn.report.picture import picture
from updyn.report.plots import Figure, drop_missing, escape_labels, log_bars, rows_height
from updyn.report.section import PageContent, ReportSection
from updyn.report.templates import render_template, write_page

__all__ = ["write_plan"]

#: Number of colour steps in the picture.
_STEPS = 4
#: Standard deviations are clipped to this value and its inverse for colouring.
_LEAST = 1e-12
#: Quantities by which a group is coloured; the first one that is an unknown is used.
_QUANTITIES = ("stiffness", "mass", "viscous", "loss_factor", "mass_damping", "stiffness_damping")
_ABOUT = (
    "Sensors and forces, and the expected standard deviation of each part: its stiffness, or, if"
    " that is not an unknown, its mass, then its damping."
)


def write_plan(plan: Plan, path: str | PathLike[str], title: str = "") -> Path:
    """Write a test plan as one HTML page that needs no network and no other file.

    The page shows the layout on the geometry (if the model has one), the expected standard
    deviations, and the information gained from each sensor, force and part of the band.

    Parameters
    ----------
    plan : Plan
        Result of `updyn.plan`.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.
    title : str
        Title of the page.

    Returns
    -------
    Path
        The file.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> unknowns = updyn.parameters(model, stiffness="all")
    >>> layout = updyn.plan(model, unknowns, "all", 2, 1, (0.5, 12.0), robust=0)
    >>> updyn.write_plan(layout, "plan.html").name
    'plan.html'
    """
    return write_page(render(plan, title), path)


def render(plan: Plan, title: str = "") -> str:
    """Return the page as HTML."""
    title = title or "Test plan"
    return assemble(PageContent(further={"plan": plan}), _head(plan, title), title, __version__)


def _head(plan: Plan, title: str) -> str:
    low, high = plan.band
    layout = (
        f"{format_count(len(plan.responses), 'sensor')} and"
        f" {format_count(len(plan.references), 'force')}, {plan.criterion}"
    )
    about = (
        f"{layout}; {plan.quantity}, {format_count(len(plan.freq), 'line')} from {number(low)} to"
        f" {number(high)} Hz; noise {percentage(plan.noise['relative'])} of |H|, floor"
        f" {percentage(plan.noise['floor'])} of the rms"
    )
    worst = max(plan.std, key=lambda name: _relative_std(plan, name))
    verdict = (
        f"The least known of {format_count(len(plan.parameters), 'unknown')} is expected to be the"
        f" {unknown_words(worst)}, to ±{_format_std(plan, worst)} (one standard deviation)."
    )
    notes = []
    if plan.draws:
        notes.append(
            f"The layout is that of the largest mean over the start and {plan.draws} draws of it,"
            f" {percentage(plan.off)} off."
        )
    if plan.bands:
        others = [
            f"{number(band.low)} to {number(band.high)} Hz (standard deviations"
            f" {percentage(band.gain)} larger)"
            for band in plan.bands
            if (band.low, band.high) != plan.band
        ]
        notes.append(f"Other bands: {', '.join(others)}.")
    return render_template(
        "updyn.report/plan_head.html",
        title=title,
        about=about,
        verdict=verdict,
        notes=notes,
        key_figures=_key_figures(plan),
    )


def _key_figures(plan: Plan) -> list[tuple[str, str, str]]:
    """Return (name, value, hint) of each key figure."""
    out = [("Mean uncertainty", percentage(plan.radius), "geometric mean of the ellipsoid's axes")]
    if plan.further:
        gain = f"−{percentage(plan.further[0].gain)}"
        out.append(("One more sensor", gain, f"{plan.further[0].label}, on all uncertainties"))
    if plan.further_references:
        gain = f"−{percentage(plan.further_references[0].gain)}"
        which = f"{plan.further_references[0].label}, on all uncertainties"
        out.append(("One more force", gain, which))
    for name, gain_of in plan.doubled.items():
        out.append((f"Twice the {name}", f"−{percentage(gain_of)}", "on all uncertainties"))
    return out


def _relative_std(plan: Plan, name: str) -> float:
    """Return a standard deviation, divided by the start value for a factor."""
    p = plan.parameters[plan.parameters.names.index(name)]
    return plan.std[name] / p.start if p.is_factor else plan.std[name]


def _format_std(plan: Plan, name: str) -> str:
    """Return a standard deviation as text, in percent for a factor."""
    p = plan.parameters[plan.parameters.names.index(name)]
    return percentage(_relative_std(plan, name)) if p.is_factor else number(plan.std[name], 2)


# -- sections ------------------------------------------------------------------------------------
class PlanSection(ReportSection):
    """A section of the page of a plan."""

    def applies(self, content: PageContent) -> bool:
        """Whether the page describes a plan and not an update."""
        return content.update is None


class LayoutSection(PlanSection):
    """The sensors and forces on the geometry."""

    anchor = "layout"
    name = "Layout"
    heading = "Layout"
    place = 100
    template = "updyn.report/plan_layout.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the picture and the table of sensors and forces."""
        plan: Plan = content.further["plan"]
        rows = []
        for kind, chosen, gains in (
            ("sensor", plan.responses, plan.gain),
            ("force", plan.references, plan.reference_gain),
        ):
            for place, (label, gain) in enumerate(zip(chosen, gains, strict=True)):
                rows.append([label, kind, percentage(gain) if place else "first"])
        return {"picture": _draw_structure(plan), "rows": rows}


class ExpectedUncertaintySection(PlanSection):
    """Expected standard deviations."""

    anchor = "expected"
    name = "Expected uncertainty"
    heading = "Expected uncertainty"
    place = 200
    template = "updyn.report/plan_expected.html"

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return bars by unknown, one figure for factors and one for other values."""
        plan: Plan = content.further["plan"]
        factors: dict[str, float] = {}
        others: dict[str, float] = {}
        for p in plan.parameters:
            (factors if p.is_factor else others)[p.name] = _relative_std(plan, p.name)
        return drop_missing(
            {
                "factors": log_bars(
                    {name: 100.0 * value for name, value in factors.items()},
                    "standard deviation (%)",
                ),
                "others": log_bars(others, "standard deviation"),
            }
        )

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the table of standard deviations."""
        plan: Plan = content.further["plan"]
        head = ["unknown", "start", "standard deviation"]
        if plan.std_range:
            head += ["least", "largest"]
        rows = []
        for p in plan.parameters:
            cells = [p.name, number(p.start), number(plan.std[p.name], 3)]
            if plan.std_range:
                cells += [number(value, 3) for value in plan.std_range[p.name]]
            rows.append(cells)
        return {"head": head, "rows": rows, "draws": plan.draws}


class WorthSection(PlanSection):
    """The information gained from each sensor, force and part of the band."""

    anchor = "worth"
    name = "Gain from more data"
    heading = "Gain from more data"
    place = 300
    template = "updyn.report/plan_worth.html"

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return bars of gains."""
        plan: Plan = content.further["plan"]
        parts = {f"{part.low:.4g} to {part.high:.4g} Hz": part.gain for part in plan.parts}
        sensors = _collect_gains(plan.responses, plan.gain, plan.further)
        forces = _collect_gains(plan.references, plan.reference_gain, plan.further_references)
        return drop_missing(
            {
                "sensors": _gain_bars(sensors, len(plan.responses) - 1),
                "forces": _gain_bars(forces, len(plan.references) - 1),
                "parts": _gain_bars(parts, len(parts)),
            }
        )

    def context(self, content: PageContent) -> dict[str, object]:
        """Return name, heading and caption of each figure."""
        filled = "Filled: chosen, each after those above it; hollow: the next ones."
        return {
            "bars": [
                ("sensors", "Sensors", filled),
                ("forces", "Forces", filled),
                ("parts", "Parts of the band", "What the lines of each part add to the others."),
            ]
        }


class RivalsSection(PlanSection):
    """Layouts by other criteria."""

    anchor = "criteria"
    name = "Other criteria"
    heading = "Other criteria"
    place = 400
    template = "updyn.report/plan_criteria.html"

    def applies(self, content: PageContent) -> bool:
        """Whether other criteria were requested."""
        return content.update is None and bool(content.further["plan"].rivals)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the table of layouts by criterion."""
        plan: Plan = content.further["plan"]
        rows = [_layout_row(plan.criterion, "1", plan.responses, plan.references)]
        for rival in plan.rivals:
            ratio = rival.note or number(rival.ratio, 3)
            rows.append(_layout_row(rival.criterion, ratio, rival.responses, rival.references))
        return {"rows": rows}


def _layout_row(
    name: str, ratio: str, responses: Sequence[str], references: Sequence[str]
) -> list[str]:
    source = CRITERIA[name].source
    return [name, ratio, ", ".join(responses), ", ".join(references), source]


LAYOUT = LayoutSection()
EXPECTED = ExpectedUncertaintySection()
WORTH = WorthSection()
RIVALS = RivalsSection()


# -- picture -------------------------------------------------------------------------------------
def _draw_structure(plan: Plan) -> str:
    """Return the picture of the structure, groups coloured by their expected standard deviation."""
    known: dict[str, tuple[str, float]] = {}
    for quantity in _QUANTITIES:
        for p in plan.parameters:
            for drive in p.acts_on:
                if drive.quantity == quantity:
                    known.setdefault(drive.group, (p.name, _relative_std(plan, p.name)))
    if not known:
        return ""
    logs = {
        group: math.log(min(max(std, _LEAST), 1.0 / _LEAST)) for group, (_, std) in known.items()
    }
    low, high = min(logs.values()), max(max(logs.values()), min(logs.values()) + math.log(2.0))
    parts = {}
    for group, (name, _) in known.items():
        step = 1 + round((_STEPS - 1) * (logs[group] - low) / (high - low))
        quantity = quantity_words(name.rpartition(".")[2])
        parts[group] = (f"s-{step}", f"{group}: {quantity} ±{_format_std(plan, name)}")
    scale = []
    for step in range(1, _STEPS + 1):
        std = math.exp(low + (high - low) * (step - 1) / (_STEPS - 1))
        scale.append((f"s-{step}", f"±{percentage(std)}"))
    ordered = sorted(parts, key=lambda group: -logs[group])
    return picture(
        plan.model,
        plan.responses,
        plan.references,
        parts,
        about=_ABOUT,
        scale=[*scale, ("s-none", "no unknown")],
        legend=[parts[group] for group in ordered],
    )


# -- figures -------------------------------------------------------------------------------------
def _collect_gains(
    chosen: Sequence[str], gains: Sequence[float], further: Sequence[Any]
) -> dict[str, float]:
    """Return gains by label: the chosen DOFs without the first, then the next candidates."""
    out = dict(zip(chosen[1:], gains[1:], strict=True))
    return out | {worth.label: worth.gain for worth in further}


def _gain_bars(gains: Mapping[str, float], chosen: int) -> Figure | None:
    """Return one horizontal bar per gain; candidates that are not chosen are hollow."""
    if not gains:
        return None
    values = 100.0 * np.array(list(gains.values()))
    rows = list(range(len(gains)))
    hollow = [place >= chosen for place in rows]
    trace = {
        "type": "bar",
        "orientation": "h",
        "x": values.tolist(),
        "y": rows,
        "text": [number(value, 2) for value in values],
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {
            "color": ["rgba(0,0,0,0)" if empty else "@after" for empty in hollow],
            "line": {"color": "@after", "width": 1.5},
        },
        "hoverinfo": "skip",
    }
    layout = {
        "xaxis": {
            "title": {"text": "all standard deviations fall by (%)"},
            "range": [0.0, 1.18 * max(float(values.max()), 1e-9)],
        },
        "yaxis": {
            "tickvals": rows,
            "ticktext": escape_labels(gains),
            "range": [len(gains) - 0.4, -0.6],
            "zeroline": False,
            "showgrid": False,
        },
        "showlegend": False,
        "bargap": 0.35,
    }
    return {"data": [trace], "height": rows_height(len(gains), extra=95), "layout": layout}
