"""The head of the report and the section on the agreement by channel."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.agreement import csac_lines, frac_map, level_difference
from updyn.report.data import ReportData
from updyn.report.plots import Figure, existing
from updyn.report.section import Content, Section
from updyn.report.sections_residual import tile
from updyn.updating.result import UpdateResult

__all__ = ["AGREEMENT", "agreement_figures", "head"]


def head(result: UpdateResult, figures: Mapping[str, Mapping[str, float]], data: str = "") -> str:
    """Return title, verdict in two sentences, cause and remedy, key figures; `data` says what was measured."""
    said = w.verdict(result, figures)
    about = (
        f"{w.counted(len(result.parameters), 'unknown')}, method {result.method};"
        f" {data or w.extent(result.frf)}"
    )
    remedy = f"What to do next: {result.remedy}" if result.remedy else ""
    # The first sentence of a fit that is well repeats the verdict.
    cause = result.message if result.remedy or not result.ok else result.message.partition(". ")[2]
    return (
        f"<header><h1>{m.esc(result.title or 'Model update')}</h1>{m.paragraph(about, 'byline')}"
        '<section id="verdict" aria-label="Verdict"><p><span class="badge'
        f' {said.kind}">{m.esc(said.badge)}</span></p>'
        f'<p class="lead">{m.esc(said.status)} {m.esc(said.agreement)}</p>'
        f"{m.note(cause, remedy)}{_tiles(result, figures)}</section></header>"
    )


def _tiles(result: UpdateResult, figures: Mapping[str, Mapping[str, float]]) -> str:
    before, after = figures["before"], figures["after"]
    ident = result.identifiability
    tiles = []
    if "frac_median" in after:
        text = _from_to(before.get("frac_median"), after["frac_median"], w.figure_of_agreement)
        tiles.append(("Shape agreement, median FRAC", text, "1 is perfect, before → after"))
    if "db_error_median" in after:
        text = _from_to(before.get("db_error_median"), after["db_error_median"], w.decibels)
        tiles.append(("Level difference, median", text, "0 dB is perfect, before → after"))
    tiles.append(
        (
            "Determined by the data",
            f"{ident.rank} of {ident.n_parameters}",
            "all unknowns" if ident.complete else "independent combinations of the unknowns",
        )
    )
    chi = result.noise.get("chi_square")
    if isinstance(chi, int | float) and math.isfinite(chi):
        tiles.append(("Reduced chi-square", w.number(float(chi), 3), w.chi_hint(result.noise)))
    if result.adequacy is not None:
        tiles.append(tile(result.adequacy))
    cells = "".join(
        f"<div><dt>{m.esc(name)}</dt><dd>{m.esc(value)}<small>{m.esc(hint)}</small></dd></div>"
        for name, value, hint in tiles
    )
    return f'<dl class="tiles">{cells}</dl>'


def _from_to(before: float | None, after: float, say: Callable[[float], str]) -> str:
    return (say(before).removesuffix(" dB") + " → " if before is not None else "") + say(after)


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
