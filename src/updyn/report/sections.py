"""The sections of the report from the verdict to the agreement by channel, and the order of all sections."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from string import Template

from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.content import Content, asset
from updyn.report.sections_held import held
from updyn.report.sections_record import noise, provenance, validation
from updyn.report.sections_residual import model_error, tile
from updyn.report.sections_uncertainty import uncertainty
from updyn.report.sections_unknowns import convergence, identifiability, parameters
from updyn.report.structure import structure
from updyn.updating.result import UpdateResult

__all__ = ["SECTIONS", "agreement", "head", "overlay"]


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


def overlay(c: Content) -> str:
    """Return the FRF overlay with its channel picker."""
    responses = "".join(
        f'<option value="{i}"'
        f' data-label="{m.esc(r)}">{m.esc(r)}{" (held out)" if held else ""}</option>'
        for i, (r, held) in enumerate(zip(c.data.responses, c.data.held_out, strict=True))
    )
    references = "".join(
        f'<option value="{j}" data-label="{m.esc(r)}">{m.esc(r)}</option>'
        for j, r in enumerate(c.data.references)
    )
    return Template(asset("overlay.html")).substitute(
        responses=responses,
        references=references,
        height=640 if c.data.coherence is not None else 560,
        bands=_bands(c),
        notes=m.note(c.note, *c.data.notes),
    )


def _bands(c: Content) -> str:
    said = ""
    if len(c.result.lines):
        low, high = w.number(float(c.result.lines.min())), w.number(float(c.result.lines.max()))
        said = (
            f"{m.swatch('fit')}band used in the fit, {low} to {high} Hz, {len(c.result.lines)}"
            " lines"
        )
    if c.result.validation_band is not None:
        low, high = (w.number(v) for v in c.result.validation_band)
        said += f" {m.swatch('held')}band held out, {low} to {high} Hz"
    return said


def agreement(c: Content) -> str:
    """Return FRAC before and after, CSAC over frequency."""
    parts = [
        "<section id='agreement'><h2>Agreement channel by channel</h2>",
        m.paragraph(
            "FRAC (frequency response assurance criterion) compares the shape of a measured and a"
            " computed FRF over frequency: 1 where they are proportional, 0 where they have nothing"
            " in common. It does not see a wrong level; the level difference in dB does."
        ),
    ]
    span = c.data.freq[c.data.compared]
    over = (
        f"Over {len(span)} lines from {w.number(float(span[0]))} to {w.number(float(span[-1]))} Hz"
        if len(span)
        else ""
    )
    held = " ◆ marks responses held out of the fit." if any(c.data.held_out) else ""
    maps = []
    for when in ("before", "after"):
        if f"frac-{when}" in c.figures:
            caption = f"{over}. Choose a cell to see its FRF above.{held}"
            plot = m.figure(
                f"frac-{when}",
                f"FRAC of every channel {when} the update",
                caption,
                height=c.figures[f"frac-{when}"]["height"],
            )
            maps.append(f"<div><h3>FRAC {when}</h3>{plot}</div>")
    parts.append(
        f'<div class="pair">{"".join(maps)}</div>'
        if maps
        else m.paragraph("There is no FRAC to show.", "muted")
    )
    parts.append(_agreement_table(c.result))
    if "csac" in c.figures:
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
                height=c.figures["csac"]["height"],
            )
        )
    elif len(c.data.responses) * len(c.data.references) == 1:
        parts.append(
            m.paragraph(
                "CSAC compares shapes over several channels; with one channel it is always 1.",
                "muted",
            )
        )
    return "".join(parts) + "</section>"


def _agreement_table(result: UpdateResult) -> str:
    before, after = (dict(result.correlation.get(k) or {}) for k in ("before", "after"))
    names = list(dict.fromkeys([*before, *after]))
    rows = [
        m.row([w.agreement_name(n), w.number(before.get(n)), w.number(after.get(n))]) for n in names
    ]
    return (
        m.table(["figure", "before", "after"], rows, caption="Figures of the fit") if rows else ""
    )


#: Sections after the head, in order: anchor, name in the list of contents, function.
SECTIONS: tuple[tuple[str, str, Callable[[Content], str]], ...] = (
    ("frfs", "FRFs", overlay),
    ("agreement", "Agreement", agreement),
    ("structure", "Structure", structure),
    ("unknowns", "Unknowns", parameters),
    ("uncertainty", "Uncertainty", uncertainty),
    ("identifiability", "What is determined", identifiability),
    ("held", "What was held", held),
    ("convergence", "Convergence", convergence),
    ("validation", "Validation", validation),
    ("model-error", "Model error", model_error),
    ("noise", "Noise and residual", noise),
    ("provenance", "How it was made", provenance),
)
