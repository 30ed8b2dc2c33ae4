"""Acceptance by a standard, as a page of its own and as a section of the report."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from updyn import __version__
from updyn.acceptance.result import Acceptance
from updyn.report.section import PageContent, ReportSection
from updyn.report.templates import render_template, write_page
from updyn.viewer.page import POLICY

__all__ = ["REQUIREMENTS", "write_acceptance"]

_TEMPLATE = "updyn.report/acceptance.html"
#: What each limit bounds.
_LIMITS = {
    "frequency": "difference of frequency, at most",
    "mac": "MAC of a pair, at least",
    "frequency_major": "difference of frequency of major modes, at most",
    "mac_major": "MAC of major modes, at least",
    "frequency_fundamental": "difference of frequency of fundamental modes, at most",
    "mac_fundamental": "MAC of fundamental modes, at least",
    "mac_off": "MAC with another mode, at most",
    "cross": "cross-orthogonality of a pair, at least",
    "cross_off": "cross-orthogonality with another mode, at most",
    "effective_mass": "effective mass of a major mode, above this share of the total mass",
    "mass_met": "effective mass of the paired modes together, at least this share",
}


def write_acceptance(acceptance: Acceptance, path: str | PathLike[str]) -> Path:
    """Write an acceptance as one HTML page that needs no network and no other file.

    The page has the outcome, the limits with their origin, and all requirements with value, limit,
    outcome and probability.

    Parameters
    ----------
    acceptance : Acceptance
        Result of `updyn.accept`.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.

    Returns
    -------
    Path
        The file.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build()
    >>> modes, sensors = updyn.modes(model, 3), ["2:X", "5:X", "7:X", "10:X", "12:X"]
    >>> measured = updyn.ModeSet(modes.frequency, modes.at(sensors), sensors)
    >>> updyn.write_acceptance(updyn.accept(model, measured), "acceptance.html").name
    'acceptance.html'
    """
    return write_page(render(acceptance), path)


def render(acceptance: Acceptance) -> str:
    """Return the page as HTML."""
    return render_template(
        "updyn.report/acceptance_page.html",
        policy=POLICY,
        version=__version__,
        title=acceptance.title or "Acceptance of a model",
        standard=acceptance.limits.name,
        body=render_template(_TEMPLATE, **_context(acceptance)),
    )


def _context(acceptance: Acceptance) -> dict[str, object]:
    head, rows = acceptance.rows()
    limits, least = acceptance.limits, acceptance.least_probability
    decided = "Decided by the values as measured."
    if least is not None:
        decided = f"Decided by the probability: at least {least:g} to pass, or to fail."
    low, high = acceptance.probability
    return {
        "statement": acceptance.statement,
        "notes": acceptance.notes,
        "limits_head": ["limit", "value", "from"],
        "limits": [
            [_LIMITS[name], f"{value:g}", _origin(acceptance, name)]
            for name, value in limits.stated.items()
        ],
        "source": limits.source,
        "head": head,
        "rows": rows,
        "kinds": ["", "", "text", "", "", "word", "", "", "note-cell"],
        "decided": decided,
        "bounds": "" if np.isnan(low) else f"{low:.3f} to {high:.3f}",
    }


def _origin(acceptance: Acceptance, name: str) -> str:
    """Return the origin of a limit."""
    changed = name in acceptance.limits.changed
    return "stated by the user" if changed else acceptance.limits.name


class RequirementsSection(ReportSection):
    """Acceptance by a standard."""

    anchor = "acceptance"
    name = "Acceptance"
    heading = "Acceptance"
    place = 45
    template = _TEMPLATE
    first_screen = True

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update."""
        return content.update is not None

    def context(self, content: PageContent) -> dict[str, object]:
        """Return outcome, limits and requirements."""
        return _context(content.further["accept"])


REQUIREMENTS = RequirementsSection()
