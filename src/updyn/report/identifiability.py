"""The section of the report on identifiability."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from updyn.arrays import BoolArray, RealArray
from updyn.report.formats import estimate, number, quantity_words
from updyn.report.of_unknowns import ParameterSection, name_unknowns
from updyn.report.plots import (
    DIVERGING,
    Figure,
    colour_bar,
    drop_missing,
    encode_numbers,
    escape_labels,
    log_range,
    names_font,
    rows_height,
)
from updyn.report.section import PageContent
from updyn.report.start import Start
from updyn.settings import FIGURES
from updyn.updating.judge.alternatives import find_differences
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import UpdateResult

__all__ = [
    "IDENTIFIABILITY",
    "combinations_map",
    "correlation_map",
    "correlations",
    "singular_values",
]


class IdentifiabilitySection(ParameterSection):
    """The unknowns, and combinations of unknowns, that the data determine."""

    anchor = "identifiability"
    name = "Identifiability"
    heading = "Identifiability"
    place = 600
    template = "updyn.report/identifiability.html"
    of_start = True

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return singular values, undetermined combinations as a matrix, and correlations."""
        found: UpdateResult | Start = content.start or content.result
        return drop_missing(
            {
                "singular-values": singular_values(found.identifiability),
                "combinations": combinations_map(found.identifiability),
                "correlation": correlation_map(found.parameters, found.covariance),
            }
        )

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the identifiability of the unknowns."""
        if content.start is not None:  # the head of the page shows the advice
            return {"ident": content.start.identifiability, "advice": "", "answers": None}
        result = content.result
        advice = result.identifiability.advice
        return {
            "ident": result.identifiability,
            "advice": "" if advice in result.remedy else advice,
            "answers": _tabulate_answers(result),
        }


def _tabulate_answers(result: UpdateResult) -> dict[str, object] | None:
    """Return the table of solutions that fit equally well; None if there is only one."""
    others = result.alternatives
    if not others:
        return None
    rows = []
    for name, values in find_differences(result.values, result.std, others):
        group, _, quantity = name.rpartition(".")
        shown = [estimate(value, result.std[name]) for value in values]
        rows.append([group, quantity_words(quantity), *shown])
    odds = [f"{number(other.odds, 2)} to 1" for other in others]
    sensors = [other.sensor or "none" for other in others]
    apart = [
        f"{number(100.0 * other.difference, 2)} %" if other.sensor else "–" for other in others
    ]
    return {
        "count": 1 + len(others),
        "head": ["group", "quantity", "this result", *_name_answers(len(others))],
        "kinds": ("", "word", *[""] * (1 + len(others))),
        "rows": rows,
        "about": [
            ["odds of this result over it", "", "–", *odds],
            ["sensor that distinguishes it from this result", "", "–", *sensors],
            ["typical difference of the FRFs there", "", "–", *apart],
        ],
    }


def _name_answers(n_others: int) -> list[str]:
    return [f"answer {i + 2}" for i in range(n_others)]


IDENTIFIABILITY = IdentifiabilitySection()


def singular_values(ident: Identifiability) -> Figure | None:
    """Return the singular values of the scaled Jacobian, determined and undetermined separately."""
    # Zeros are drawn at the lower end of the logarithmic axis.
    values = np.array(ident.singular_values, dtype=np.float64)
    values = values[np.isfinite(values)]
    if values.size < 2:
        return None
    foot = 1e-16
    if (values > 0).any():
        foot = max(float(values[values > 0].min()) / 10.0, 1e-18)
    determined = np.arange(values.size) < ident.rank
    name = "undetermined: lost in the noise, or exactly"
    traces = []
    if determined.any():
        traces.append(_singular_trace("determined", values, determined, foot, "@after", "circle"))
    if not determined.all():
        traces.append(_singular_trace(name, values, ~determined, foot, "@before", "x"))
    axis: dict[str, object] = {
        "title": {"text": "combination number, best determined first"},
        "range": [0.4, values.size + 0.6],
        "zeroline": False,
    }
    if values.size <= 20:
        axis |= {"tickmode": "linear", "tick0": 1, "dtick": 1}
    return {
        "data": traces,
        "height": 320,
        "layout": {
            "xaxis": axis,
            "yaxis": {
                "title": {"text": "singular value"},
                **log_range(np.maximum(values, foot), decades=18.0),
            },
            "showlegend": True,
        },
    }


def _singular_trace(
    name: str,
    values: RealArray,
    where: BoolArray,
    foot: float,
    colour: str,
    symbol: str,
) -> dict[str, object]:
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "x": (np.flatnonzero(where) + 1).tolist(),
        "y": encode_numbers(np.maximum(values[where], foot)),
        "text": [f"{v:.3g}" for v in values[where]],
        "marker": {"color": colour, "symbol": symbol, "size": 9},
        "hovertemplate": "number %{x}: %{text}<extra></extra>",
    }


def correlations(covariance: RealArray) -> RealArray:
    """Return the correlation matrix of a covariance; NaN for a variance that is 0 or not finite."""
    variance = np.diag(covariance)
    known = np.isfinite(variance) & (variance > 0)
    out = np.full(covariance.shape, np.nan)
    at = np.ix_(known, known)
    std = np.sqrt(variance[known])
    out[at] = covariance[at] / std[:, None] / std[None, :]
    return np.where(np.isfinite(out), np.clip(out, -1.0, 1.0), np.nan)


def correlation_map(parameters: ParameterSet, covariance: RealArray) -> Figure | None:
    """Return the correlation map of the unknowns, blank where undetermined; None if unknown."""
    names = name_unknowns(tuple(parameters))
    if len(names) < 2 or covariance.shape != (len(names), len(names)):
        return None
    matrix = correlations(np.asarray(covariance, dtype=np.float64))
    if not np.isfinite(matrix).any():
        return None
    return _signed_map(matrix, names, names, "correlation", _format_coefficient)


def combinations_map(ident: Identifiability) -> Figure | None:
    """Return the undetermined combinations as a matrix, unknowns down; None without any."""
    directions = ident.null_directions
    if not directions:
        return None
    involved = list(dict.fromkeys(name for weights in directions for name in weights))
    matrix = np.array([[weights.get(name, np.nan) for weights in directions] for name in involved])
    rows = [f"{group}: {quantity_words(quantity)}" for group, _, quantity in map(_split, involved)]
    columns = [f"combination {number}" for number in range(1, len(directions) + 1)]
    return _signed_map(matrix, escape_labels(rows), columns, "weight", _format_weight)


def _split(name: str) -> tuple[str, str, str]:
    return name.rpartition(".")


def _signed_map(
    matrix: RealArray,
    rows: Sequence[str],
    columns: Sequence[str],
    what: str,
    say: Callable[[float], str],
) -> Figure:
    """Return a heat map from -1 to 1; values are printed if there are few cells."""
    height = max(rows_height(len(rows), extra=220), 320)
    trace = {
        "type": "heatmap",
        "z": encode_numbers(matrix),
        "x": list(columns),
        "y": list(rows),
        "zmin": -1.0,
        "zmax": 1.0,
        "colorscale": DIVERGING,
        "xgap": 1,
        "ygap": 1,
        "hovertemplate": "%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        "colorbar": colour_bar(what, (-1, -0.5, 0, 0.5, 1), height - 100),
    }
    if matrix.size <= FIGURES.printed_cells:
        trace["text"] = [list(map(say, row)) for row in matrix]
        trace["texttemplate"] = "%{text}"
    axis: dict[str, object] = {
        "type": "category",
        "showgrid": False,
        "zeroline": False,
    }
    across = axis | {"autotickangles": [0, -50, -90], "tickfont": names_font(columns)}
    if len(columns) <= 40:
        across["dtick"] = 1
    down = axis | {"autorange": "reversed", "dtick": 1, "tickfont": names_font(rows)}
    return {"data": [trace], "height": height, "layout": {"xaxis": across, "yaxis": down}}


def _format_weight(value: float) -> str:
    """Return a weight as text; blank if not finite."""
    return number(value, 2) if np.isfinite(value) else ""


def _format_coefficient(value: float) -> str:
    """Return a correlation coefficient as text; blank if not finite."""
    if not np.isfinite(value):
        return ""
    return f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")
