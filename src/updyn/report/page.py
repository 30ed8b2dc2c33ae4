"""`write_report`: an update as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from updyn.control.job.plant_result import Planted
from updyn.control.report.plant_parts import plant_parts
from updyn.report import markup as m
from updyn.report.content import Content, agreement_figures, asset
from updyn.report.data import gather
from updyn.report.figures import all_figures, overlay
from updyn.report.plots import Figure
from updyn.report.sections import SECTIONS, head
from updyn.report.sections_tests import COMMON, joint_head, tests
from updyn.report.structure import structure_of
from updyn.report.uncertain import band_figure, intervals_figure
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["POLICY", "page_text", "write_report"]

#: What the page may load: nothing but itself.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:;"
    " font-src data:; base-uri 'none'; form-action 'none'"
)


_NO_SCRIPT = (
    "The figures of this page are drawn by its own scripts, which are switched off here; all tables"
    " can be read without them."
)


def write_report(
    result: UpdateResult | JointResult,
    path: str | PathLike[str],
    uncertainty: Draws | Profiles | None = None,
    plant: Planted | None = None,
) -> Path:
    """Write an update as one HTML page that needs nothing else: no network, no other file.

    The page shows the verdict, measured FRFs over those of the model before and after, the
    agreement channel by channel, a picture of the structure where the model has a geometry, the
    unknowns with their uncertainty, what the data determine, the way of the fit, the validation,
    the residual, and how the result was made. The models' FRFs are computed for it at the lines of
    the data.

    Parameters
    ----------
    result : UpdateResult or JointResult
        What `updyn.update` gave, whatever its status. For several tests the page shows what they
        have in common, and links to the page of each, ``NAME/report.html`` beside it, which is
        written from its own result.
    path : str or path-like
        Where to write; an existing file is replaced only once the new page is complete.
    uncertainty : Draws or Profiles, optional
        From `updyn.sample`, `updyn.bootstrap` or `updyn.profile`, to be shown in a section of its
        own.
    plant : Planted, optional
        What ``[plant]`` of a job gave, to be shown in sections of its own.

    Returns
    -------
    Path
        Where the page is.

    Notes
    -----
    A page takes 1.6 MB and, for each channel and line drawn, 32 bytes (38 with coherence); beyond
    `updyn.report.figures.DRAWING_BUDGET` lines are thinned, which the page says.
    """
    if isinstance(result, UpdateResult):
        return m.write_page(render(result, uncertainty, plant), path)
    return m.write_page(render_joint(result, uncertainty, plant), path)


def render(
    result: UpdateResult, uncertainty: Draws | Profiles | None = None, plant: Planted | None = None
) -> str:
    """Return the page as text."""
    data = gather(result)
    scores = agreement_figures(result, data)
    figures = all_figures(result, data)
    frfs, thinned = overlay(result, data)
    figures |= _uncertain(result, uncertainty)
    content = Content(result, data, figures, thinned, uncertainty)
    sections = [(anchor, name, section(content)) for anchor, name, section in SECTIONS]
    there, figures = _with_plant(
        [(anchor, name, text) for anchor, name, text in sections if text], figures, plant
    )
    return page_text(
        head(result, scores), there, result.title, result.versions.get("updyn", ""), figures, frfs
    )


def _with_plant(
    sections: list[tuple[str, str, str]], figures: dict[str, Figure], plant: Planted | None
) -> tuple[list[tuple[str, str, str]], dict[str, Figure]]:
    """Return sections and figures with those of the plant, before how the result was made."""
    if plant is None:
        return sections, figures
    more, drawn = plant_parts(plant)
    at = next(
        (i for i, (anchor, _, _) in enumerate(sections) if anchor == "provenance"), len(sections)
    )
    return [*sections[:at], *more, *sections[at:]], {**figures, **drawn}


def _uncertain(
    result: UpdateResult | JointResult, found: Draws | Profiles | None
) -> dict[str, Figure]:
    """Return the figures of the uncertainty."""
    if found is None:
        return {}
    intervals = intervals_figure(result, found)
    out = {} if intervals is None else {"uncertainty-intervals": intervals}
    band = band_figure(result, found) if isinstance(result, UpdateResult) else None
    return out if band is None else out | {"uncertainty-band": band[0] | {"channel": band[1]}}


def render_joint(
    result: JointResult, uncertainty: Draws | Profiles | None = None, plant: Planted | None = None
) -> str:
    """Return the page of what several tests have in common."""
    first = replace(result.first, title=result.title)
    data = gather(first)
    figures = all_figures(first, data)
    figures |= _uncertain(result, uncertainty)
    content = Content(first, data, figures, "", uncertainty)
    made = [
        (anchor, name, section(content)) for anchor, name, section in SECTIONS if anchor in COMMON
    ]
    common = [(anchor, name, text) for anchor, name, text in made if text]
    shown = {
        name: figure
        for name, figure in figures.items()
        if any(f'"{name}"' in text for _, _, text in common)
    }
    picture = structure_of(list(result.results.values()))
    sections = [
        ("tests", "Tests", tests(result)),
        *([("structure", "Structure", picture)] if picture else []),
        *common,
    ]
    sections, shown = _with_plant(sections, shown, plant)
    return page_text(
        joint_head(result), sections, first.title, first.versions.get("updyn", ""), shown
    )


def page_text(
    top: str,
    sections: Sequence[tuple[str, str, str]],
    title: str,
    version: str,
    figures: Mapping[str, Figure],
    frfs: Any = None,
) -> str:
    """Return a page as text.

    Parameters
    ----------
    top : str
        Its head, HTML.
    sections : sequence of (str, str, str)
        Anchor, name in the list of contents and HTML of each.
    title, version : str
        What the browser shows, and the version of updyn that made it.
    figures : mapping of str to Figure
        By the name of their place in the page.
    frfs : object
        What the FRF overlay draws; None where there is none.
    """
    contents = "".join(
        f'<li><a href="#{anchor}">{m.esc(name)}</a></li>' for anchor, name, _ in sections
    )
    body = "".join(text for _, _, text in sections)
    version = m.esc(version)
    drawn = "" if frfs is None else m.embedded_json("updyn-frf", frfs)
    scripts = asset("report.js") + ("updynReport.start();" if frfs is None else asset("overlay.js"))
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="updyn {version}">
<title>{m.esc(title or "Model update")} – updyn report</title>
<link rel="icon" href="data:,">
<style>{asset("report.css")}{asset("structure.css")}</style>
<script>{asset("watch.js")}</script>
</head>
<body>
{top}
<nav aria-label="Contents"><ul>{contents}</ul></nav>
<main>
<noscript>{m.note(_NO_SCRIPT)}</noscript>
{body}
</main>
<footer>Written by updyn {version}. This page holds all its data and loads nothing from elsewhere.</footer>
{m.embedded_json("updyn-figures", figures)}
{drawn}
<script>{asset("plotly-cartesian.min.js")}</script>
<script>{scripts}</script>
</body>
</html>
"""
