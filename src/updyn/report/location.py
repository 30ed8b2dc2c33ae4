"""`write_location`: candidates of place and kind of a nonlinear element on one HTML page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from updyn import __version__
from updyn.candidates.location.result import (
    FOUND_HEADINGS,
    HEADINGS,
    LocatedNonlinearities,
    NonlinearityLocation,
)
from updyn.report.formats import format_count, number, percentage
from updyn.report.page import assemble
from updyn.report.section import PageContent, ReportSection
from updyn.report.templates import render_template, write_page

__all__ = ["write_location"]


def write_location(
    location: NonlinearityLocation | LocatedNonlinearities,
    path: str | PathLike[str],
    title: str = "",
) -> Path:
    """Write places and kinds of nonlinear elements as one HTML page without other files.

    The page shows the elements that were found, the candidates that were fitted, and the residual
    of each place.

    Parameters
    ----------
    location : NonlinearityLocation or LocatedNonlinearities
        Result of `updyn.locate_nonlinearity` or `updyn.locate_nonlinearities`.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.
    title : str
        Title of the page.

    Returns
    -------
    Path
        The file.
    """
    page = title or "Location of a nonlinearity"
    if isinstance(location, LocatedNonlinearities):
        return write_page(_render_several(location, page), path)
    return write_page(_render(location, page), path)


def _render_several(found: LocatedNonlinearities, title: str) -> str:
    head = render_template(
        "updyn.report/plan_head.html",
        title=title,
        about=format_count(len(found), "element"),
        verdict=found.statement,
        notes=[],
        key_figures=[
            ("Elements", str(len(found)), "found one after the other"),
            ("Residual", number(found.residual), "rms in standard deviations of the noise"),
            ("Linear model", number(found.linear_residual), "rms residual over the noise"),
        ],
    )
    return assemble(PageContent(further={"located": found}), head, title, __version__)


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


class ElementsSection(_LocationSection):
    """The table of the elements that were found."""

    anchor = "elements"
    name = heading = "Elements"
    place = 50

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table."""
        found: LocatedNonlinearities = content.further["located"]
        text = (
            "Elements fitted together to all levels. Log odds: of the model over that without the"
            " element, with all other unknowns fitted again."
        )
        kinds = ("text", "text", "", "text")
        return {"text": text, "head": FOUND_HEADINGS, "kinds": kinds, "rows": found.cells()}


class SearchesSection(_LocationSection):
    """The candidates of all searches."""

    anchor = "searches"
    name = heading = "Searches"
    place = 60

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the candidates of each search, with the residuals of their places."""
        found: LocatedNonlinearities = content.further["located"]
        searches = [(one.name, one.search) for one in found]
        if found.further is not None:
            searches.append(("one more", found.further))
        rows = []
        for name, search in searches:
            for row, cells in zip(search, search.cells(), strict=False):
                rows.append([name, *cells[:2], number(search.places[row.place]), *cells[3:]])
        text = (
            "Candidates of the search in which each element was found, and of that for one more,"
            " the best first, with the other elements that were known then. Place: residual of an"
            " element of any kind there."
        )
        head = ("element", "place", "kind", "place", "residual", "log evidence", "parameters")
        kinds = ("text", "text", "text", "", "", "", "text")
        return {"text": text, "head": head, "kinds": kinds, "rows": rows}


class CandidatesSection(_LocationSection):
    """The table of the candidates."""

    anchor = "candidates"
    name = heading = "Candidates"
    place = 100

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table."""
        location: NonlinearityLocation = content.further["location"]
        text = (
            "Elements fitted to all levels, the best first. Residual: rms in standard deviations of"
            " the noise. Log evidence: less that of the first candidate."
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


ELEMENTS = ElementsSection()
SEARCHES = SearchesSection()
CANDIDATES = CandidatesSection()
PLACES = PlacesSection()
