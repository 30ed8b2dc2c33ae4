"""`write_location`: candidates of place and kind of a nonlinear element on one HTML page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from updyn import __version__
from updyn.candidates.location.result import HEADINGS, NonlinearityLocation
from updyn.report.formats import format_count, number, percentage
from updyn.report.page import assemble
from updyn.report.section import PageContent, ReportSection
from updyn.report.templates import render_template, write_page

__all__ = ["write_location"]


def write_location(
    location: NonlinearityLocation, path: str | PathLike[str], title: str = ""
) -> Path:
    """Write place and kind of a nonlinear element as one HTML page without other files.

    The page shows the candidates that were fitted, and the residual of each place.

    Parameters
    ----------
    location : NonlinearityLocation
        Result of `updyn.locate_nonlinearity`.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.
    title : str
        Title of the page.

    Returns
    -------
    Path
        The file.
    """
    return write_page(_render(location, title or "Location of a nonlinearity"), path)


def _render(location: NonlinearityLocation, title: str) -> str:
    head = render_template(
        "updyn.report/plan_head.html",
        title=title,
        about=f"{format_count(len(location), 'candidate')} at"
        f" {format_count(len(location.places), 'place')}",
        verdict=location.statement,
        notes=[],
        key_figures=_key_figures(location),
    )
    return assemble(PageContent(further={"location": location}), head, title, __version__)


def _key_figures(location: NonlinearityLocation) -> list[tuple[str, str, str]]:
    """Return (name, value, hint) of each key figure."""
    if not location.is_likely:
        return [("Linear model", number(location.linear_residual), "rms residual over the noise")]
    best = location.best
    return [
        ("Place", best.place, "of the first candidate"),
        ("Kind", best.kind, "of the first candidate"),
        (
            "Probability",
            percentage(location.probabilities[0]),
            "among the candidates, all equal before the test",
        ),
        ("Residual", number(best.residual), "rms in standard deviations of the noise"),
        ("Linear model", number(location.linear_residual), "rms residual over the noise"),
    ]


class _LocationSection(ReportSection):
    """A section of the page of a located nonlinearity."""

    template = "updyn.report/location_table.html"

    def applies(self, content: PageContent) -> bool:
        """Whether the page describes a location and not an update."""
        return content.update is None


class CandidatesSection(_LocationSection):
    """The table of the candidates."""

    anchor = "candidates"
    name = heading = "Candidates"
    place = 100

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table."""
        location: NonlinearityLocation = content.further["location"]
        text = (
            "Elements fitted to all levels by harmonic balance, the best first. Residual: rms in"
            " standard deviations of the noise. Log evidence: less that of the first candidate."
        )
        kinds = ("text", "text", "", "", "", "text")
        return {"text": text, "head": HEADINGS, "kinds": kinds, "rows": location.cells()}


class PlacesSection(_LocationSection):
    """The residual of each place."""

    anchor = "places"
    name = heading = "Places"
    place = 200

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the residuals by place in ascending order."""
        location: NonlinearityLocation = content.further["location"]
        rows = [[name, number(residual)] for name, residual in location.places.items()]
        text = (
            "Residual of an element of any kind at each place, in standard deviations of the noise:"
            " its force follows from the responses at each line and level by least squares."
        )
        head = ["place", "residual"]
        return {"text": text, "head": head, "kinds": ("text", ""), "rows": rows}


CANDIDATES = CandidatesSection()
PLACES = PlacesSection()
