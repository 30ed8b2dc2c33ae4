"""Figures of agreement: FRAC, CSAC, level differences and residuals, before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.data import ReportData
from updyn.report.plots import (
    PRINTED_CELLS,
    Figure,
    categories,
    colour_bar,
    existing,
    label,
    numbers,
    rows_height,
)
from updyn.report.section import Content, Section
from updyn.updating.result import UpdateResult

__all__ = [
    "AGREEMENT",
    "VALIDATION",
    "agreement_figures",
    "csac_lines",
    "frac_map",
    "level_difference",
]


def frac_map(data: ReportData, frac: NDArray[np.float64] | None) -> Figure | None:
    """Heat map of FRAC, responses down, references across, on the scale 0 to 1."""
    if frac is None:
        return None
    rows = [
        r + (" ◆" if held else "") for r, held in zip(data.responses, data.held_out, strict=True)
    ]
    hover = [
        [
            f"response {label(r)}{' (held out)' if held else ''}<br>reference {label(c)}<br>FRAC"
            f" {v:.4f}"
            for c, v in zip(data.references, line, strict=True)
        ]
        for r, held, line in zip(data.responses, data.held_out, frac, strict=True)
    ]
    height = max(rows_height(len(rows), extra=110), 190)
    trace = {
        "type": "heatmap",
        "z": numbers(frac),
        "x": list(range(len(data.references))),
        "y": list(range(len(rows))),
        "zmin": 0.0,
        "zmax": 1.0,
        "colorscale": "Cividis",
        "xgap": 1,
        "ygap": 1,
        "hovertext": hover,
        "hoverinfo": "text",
        "colorbar": colour_bar("FRAC", (0, 0.25, 0.5, 0.75, 1), height),
    }
    if frac.size == 1:
        trace["showscale"] = False
    if frac.size <= PRINTED_CELLS:
        trace["text"] = [[label(w.figure_of_agreement(v)) for v in line] for line in frac]
        trace["texttemplate"] = "%{text}"
    return {
        "data": [trace],
        "height": height,
        "layout": {
            "xaxis": categories(data.references, "reference"),
            "yaxis": {**categories(rows, "response"), "autorange": "reversed"},
        },
    }


def csac_lines(data: ReportData) -> Figure | None:
    """CSAC over frequency, before and after."""
    if data.csac_before is None and data.csac_after is None:
        return None
    traces: list[dict[str, Any]] = []
    x = numbers(data.freq)
    for name, csac, dash in (
        ("before", data.csac_before, "dot"),
        ("after", data.csac_after, "solid"),
    ):
        if csac is None:
            continue
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "name": name,
                "x": x,
                "y": numbers(csac),
                "line": {"color": f"@{name}", "dash": dash, "width": 1.6},
                "hovertemplate": f"%{{x:.5g}} Hz: CSAC {name} %{{y:.3f}}<extra></extra>",
            }
        )
    return {
        "data": traces,
        "height": 300,
        "layout": {
            "xaxis": {"title": {"text": "frequency (Hz)"}},
            "yaxis": {"title": {"text": "CSAC"}, "range": [-0.02, 1.04]},
            "showlegend": True,
        },
    }


def level_difference(
    measured: NDArray[np.complex128], computed: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """Return 20 log10 |computed / measured| in dB as a flat array, without values where either is zero."""
    a, b = np.abs(computed).ravel(), np.abs(measured).ravel()
    there = (a > 0) & (b > 0)
    return np.asarray(20.0 * np.log10(a[there] / b[there]))


def agreement_figures(result: UpdateResult, data: ReportData) -> dict[str, dict[str, float]]:
    """Return the figures of agreement of the result; where it has none, those of this page's own comparison."""
    held = result.correlation.get("validation") or {}
    out = {when: dict(result.correlation.get(when) or {}) for when in ("before", "after")}
    out["validation"] = dict(held.get("after") or {})
    fitted = ~np.array(data.held_out, dtype=np.bool_)
    for when, frac, values in (
        ("before", data.frac_before, data.before),
        ("after", data.frac_after, data.after),
    ):
        if not out[when] and frac is not None and values is not None and fitted.any():
            level = level_difference(
                data.measured[data.compared][:, fitted], values[data.compared][:, fitted]
            )
            out[when] = {"frac_median": float(np.median(frac[fitted]))}
            if level.size:
                out[when]["db_error_median"] = float(np.median(np.abs(level)))
    return out


class Agreement(Section):
    """FRAC before and after, CSAC over frequency."""

    anchor = "agreement"
    name = "Agreement"
    heading = "Agreement channel by channel"
    place = 200

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return the maps of FRAC, and CSAC over frequency."""
        data = content.data
        return existing(
            {
                "frac-before": frac_map(data, data.frac_before),
                "frac-after": frac_map(data, data.frac_after),
                "csac": csac_lines(data),
            }
        )

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words, maps, the table of figures, and CSAC."""
        parts = [
            m.paragraph(
                "FRAC (frequency response assurance criterion) compares the shape of a measured and a"
                " computed FRF over frequency: 1 where they are proportional, 0 where they have nothing"
                " in common. It does not see a wrong level; the level difference in dB does."
            ),
        ]
        span = content.data.freq[content.data.compared]
        over = (
            f"Over {len(span)} lines from {w.number(float(span[0]))} to {w.number(float(span[-1]))} Hz"
            if len(span)
            else ""
        )
        held = " ◆ marks responses held out of the fit." if any(content.data.held_out) else ""
        maps = []
        for when in ("before", "after"):
            if f"frac-{when}" in figures:
                caption = f"{over}. Choose a cell to see its FRF above.{held}"
                plot = m.figure(
                    f"frac-{when}",
                    f"FRAC of every channel {when} the update",
                    caption,
                    height=figures[f"frac-{when}"]["height"],
                )
                maps.append(f"<div><h3>FRAC {when}</h3>{plot}</div>")
        parts.append(
            f'<div class="pair">{"".join(maps)}</div>'
            if maps
            else m.paragraph("There is no FRAC to show.", "muted")
        )
        parts.append(_agreement_table(content.result))
        if "csac" in figures:
            caption = (
                "CSAC (cross signature assurance criterion) compares, line by line, the deflection over"
                " all channels: dips show the frequencies at which the model moves in a different"
                " shape."
            )
            parts.append("<h3>CSAC over frequency</h3>")
            parts.append(
                m.figure(
                    "csac",
                    "CSAC over frequency before and after",
                    caption,
                    height=figures["csac"]["height"],
                )
            )
        elif len(content.data.responses) * len(content.data.references) == 1:
            parts.append(
                m.paragraph(
                    "CSAC compares shapes over several channels; with one channel it is always 1.",
                    "muted",
                )
            )
        return "".join(parts)


AGREEMENT = Agreement()


def _agreement_table(result: UpdateResult) -> str:
    before, after = (dict(result.correlation.get(k) or {}) for k in ("before", "after"))
    names = list(dict.fromkeys([*before, *after]))
    rows = [
        m.row([w.agreement_name(n), w.number(before.get(n)), w.number(after.get(n))]) for n in names
    ]
    return (
        m.table(["figure", "before", "after"], rows, caption="Figures of the fit") if rows else ""
    )


class Validation(Section):
    """Agreement with the data held out of the fit."""

    anchor = "validation"
    name = "Validation"
    heading = "Validation on what was held out"
    place = 900

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return what was held out, and how well it is predicted."""
        parts = []
        what = w.held_out(content.result)
        if not what:
            text = (
                "Nothing was held out of the fit, so these data cannot say how well the updated model"
                " predicts what it has not seen. Hold out a response or a band to find out."
            )
            return m.paragraph(text)
        parts.append(m.paragraph(f"Held out of the fit, and used only to judge it: {what}."))
        scores = content.result.correlation.get("validation") or {}
        before, after = (dict(scores.get(k) or {}) for k in ("before", "after"))
        names = list(dict.fromkeys([*before, *after]))
        if names:
            rows = [
                m.row([w.agreement_name(n), w.number(before.get(n)), w.number(after.get(n))])
                for n in names
            ]
            parts.append(
                m.table(
                    ["figure", "before", "after"], rows, caption="Figures over the data held out"
                )
            )
        else:
            parts.append(m.paragraph("There are no figures for it.", "muted"))
        rows = [
            m.row(
                [
                    f"{response} / {reference}",
                    _cell(content.data.frac_before, i, j),
                    _cell(content.data.frac_after, i, j),
                ]
            )
            for i, (response, held) in enumerate(
                zip(content.data.responses, content.data.held_out, strict=True)
            )
            if held
            for j, reference in enumerate(content.data.references)
        ]
        if rows:
            shown = m.table(["response / reference", "FRAC before", "FRAC after"], rows)
            parts.append(
                shown if len(rows) <= 20 else m.details(f"All {len(rows)} channels held out", shown)
            )
        return "".join(parts)


VALIDATION = Validation()


def _cell(frac: NDArray[Any] | None, i: int, j: int) -> str:
    return "–" if frac is None else w.figure_of_agreement(float(frac[i, j]))
