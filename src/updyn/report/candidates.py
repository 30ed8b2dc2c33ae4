"""`write_candidates`: compare candidate models on one self-contained HTML page."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from updyn import __version__
from updyn.candidates.result import HEADINGS, ModelComparison
from updyn.report.formats import format_count, number, percentage
from updyn.report.page import assemble
from updyn.report.section import PageContent, ReportSection
from updyn.report.templates import render_template, write_page

__all__ = ["write_candidates"]


def write_candidates(comparison: ModelComparison, path: str | PathLike[str]) -> Path:
    """Write a comparison of candidate models as one HTML page without other files.

    The page shows the table of the candidates, and the predictive score of each band.

    Parameters
    ----------
    comparison : ModelComparison
        Result of `updyn.compare_models`.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.

    Returns
    -------
    Path
        The file.
    """
    return write_page(render(comparison), path)


def render(comparison: ModelComparison) -> str:
    """Return the page as HTML."""
    title = comparison.title or "Comparison of models"
    low, high = comparison.bands[0][0], comparison.bands[-1][1]
    head = render_template(
        "updyn.report/plan_head.html",
        title=title,
        about=f"{format_count(len(comparison), 'candidate')}; {number(low)} to {number(high)} Hz",
        verdict=comparison.statement,
        notes=[
            f"{row.name} {row.status}: {row.message}" for row in comparison if not row.is_fitted
        ],
        key_figures=_key_figures(comparison),
    )
    content = PageContent(further={"candidates": comparison})
    return assemble(content, head, title, __version__)


def _key_figures(comparison: ModelComparison) -> list[tuple[str, str, str]]:
    """Return (name, value, hint) of each key figure."""
    first = comparison[0]
    if not first.is_fitted:
        return []
    probability = comparison.probabilities[first.name]
    return [
        ("First", first.name, f"by {comparison.criterion}"),
        ("Probability", percentage(probability), "by the evidence, all equal before the test"),
        ("Residual", number(first.residual), "rms in standard deviations of the noise"),
    ]


class _CandidatesSection(ReportSection):
    """A section of the page of candidate models."""

    def applies(self, content: PageContent) -> bool:
        """Whether the page describes a comparison and not an update."""
        return content.update is None


class TableSection(_CandidatesSection):
    """The table of the candidates."""

    anchor = "candidates"
    name = heading = "Candidates"
    place = 100
    template = "updyn.report/candidates_table.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table."""
        comparison: ModelComparison = content.further["candidates"]
        rows = [
            {"cells": cells, "kind": "" if row.is_fitted else "open"}
            for row, cells in zip(comparison, comparison.cells(), strict=True)
        ]
        return {"head": HEADINGS, "rows": rows}


class BandsSection(_CandidatesSection):
    """The predictive score of each candidate by band."""

    anchor = "bands"
    name = heading = "Bands held out"
    place = 200
    template = "updyn.report/candidates_bands.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the differences of scores by band."""
        comparison: ModelComparison = content.further["candidates"]
        first, *others = [row for row in comparison if row.is_fitted] or [comparison[0]]
        rows = []
        for k, (low, high) in enumerate(comparison.bands):
            differences = [row.band_scores[k] - first.band_scores[k] for row in others]
            band = f"{number(low)} to {number(high)} Hz"
            rows.append([band, number(first.band_scores[k]), *map(number, differences)])
        head = ["band", first.name, *(f"{row.name} less {first.name}" for row in others)]
        return {"head": head, "rows": rows}


TABLE = TableSection()
BANDS = BandsSection()
