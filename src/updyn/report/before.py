"""`write_start`: compare a model with a test before any fit, as one self-contained HTML page."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from updyn import __version__
from updyn.remedy import Remedy
from updyn.report.agreement import compute_agreement
from updyn.report.data import ReportData
from updyn.report.evidence import show_start
from updyn.report.formats import extent, format_count, number, percentage, quantity_words
from updyn.report.head import key_figure, render_first_screen
from updyn.report.page import assemble
from updyn.report.plots import Figure
from updyn.report.section import PageContent, ReportSection
from updyn.report.start import Start
from updyn.report.templates import write_page
from updyn.report.verdict import Verdict, VerdictPart, count_all_modes
from updyn.updating.before_search import REMEDY
from updyn.updating.next_step import plan_test
from updyn.updating.problem.parameters import Parameter

__all__ = ["choose_first_step", "write_start"]

_IN_TERMINAL = "in a terminal, in the folder of the job"


def write_start(start: Start, path: str | PathLike[str]) -> Path:
    """Write a model and a test before any fit as one HTML page that needs no network.

    The page shows the sections of an update report that need no fit: the structure in three
    dimensions, all channels, maps of their agreement, modes, and the identifiability of the
    unknowns. It adds findings on faults in the data, and the matching of sensors and DOFs.

    Parameters
    ----------
    start : Start
        Model, test and unknowns.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.

    Returns
    -------
    Path
        The file.
    """
    return write_page(render(start), path)


def render(start: Start) -> str:
    """Return the page as HTML."""
    content = PageContent(further={"start": start})
    title = start.title or start.model.title or "Before the update"
    top, figures = _head(content, start, title)
    return assemble(content, top, title, __version__, figures=figures, folds=True)


def _head(content: PageContent, start: Start, title: str) -> tuple[str, dict[str, Figure]]:
    """Return the first screen as HTML, and its figures by name."""
    return render_first_screen(
        show_start(content),
        title=title,
        about=(
            f"Before any fit; {format_count(len(start.parameters), 'unknown')};"
            f" {extent(start.data)}"
        ),
        judgement=_judge_start(content, start),
        step=choose_first_step(start),
        others=[],
        key_figures=_key_figures(start, content.data) if content.has_frfs else [],
        more="",
        has_updated=False,
    )


def _judge_start(content: PageContent, start: Start) -> Verdict:
    """Return the verdict before any fit: identifiability, resemblance, and faults."""
    badge, kind = ("Not all unknowns can be determined", "warn")
    if start.identifiability.complete:
        badge, kind = ("All unknowns can be determined", "good")
    if start.findings:
        of_model = start.findings[0].concerns_model
        badge, kind = (f"Look at the {'model' if of_model else 'data'} first", "warn")
    if start.counterparts is not None and start.counterparts.few:
        badge, kind = ("Look at the model first", "bad")
    parts = (
        *_judge_resemblance(content, start),
        _judge_identifiability(start),
        *_find_model_error(start),
        _judge_data(start, has_frfs=content.has_frfs),
    )
    return Verdict(badge, kind, parts)


def choose_first_step(start: Start) -> Remedy:
    """Return the step before the fit: a repair, another test, or the fit."""
    if start.counterparts is not None and start.counterparts.few:
        return _check_again(start, start.counterparts.remedy or REMEDY)
    if start.findings:
        step = start.findings[0].step
        return step if step.lines else _check_again(start, str(step))
    if not start.identifiability.complete:
        step = plan_test(start.data)
        return replace(step, advice=start.identifiability.advice or step.advice)
    advice = start.identifiability.advice or "Fit the unknowns."
    return Remedy(advice, (f"updyn run {start.job}",), _IN_TERMINAL)


def _check_again(start: Start, advice: str) -> Remedy:
    """Return advice on data or model, and the command that checks the job after it."""
    return Remedy(advice, (f"updyn check {start.job}",), f"then {_IN_TERMINAL}")


def _judge_identifiability(start: Start) -> VerdictPart:
    rank, n = start.identifiability.rank, start.identifiability.n_parameters
    text = f"The data can determine all of {format_count(n, 'unknown')}."
    if rank < n:
        combinations = format_count(rank, "independent combination")
        text = f"The data can determine {combinations} of {format_count(n, 'unknown')}."
    return VerdictPart("Determined", rank >= n, text)


def _judge_resemblance(content: PageContent, start: Start) -> list[VerdictPart]:
    """Return whether model and test have modes in common; empty if that was not examined."""
    if start.counterparts is None:
        return []
    claim = start.counterparts.claim
    found = content.modes.correlations.get("start")
    why = claim.why
    if claim.holds:
        why += count_all_modes(start.counterparts, found, "model")
    return [VerdictPart("Resembles", claim.holds, why, claim.asked)]


def _find_model_error(start: Start) -> list[VerdictPart]:
    of_model = [found for found in start.findings if found.concerns_model]
    return [VerdictPart("Model sound", False, found.statement) for found in of_model[:1]]


def _judge_data(start: Start, *, has_frfs: bool) -> VerdictPart:
    if not has_frfs:
        return VerdictPart("Data sound", None, "Faults are detected in FRFs only.")
    of_data = [found for found in start.findings if not found.concerns_model]
    if of_data:
        return VerdictPart("Data sound", False, of_data[0].statement)
    if start.counterparts is not None and start.counterparts.few:
        return VerdictPart(
            "Data sound",
            None,
            "No fault was found; most faults show only against a model of the tested structure.",
        )
    return VerdictPart("Data sound", True, "No known fault was found before any fit.")


def _key_figures(start: Start, data: ReportData) -> list[tuple[str, str, str]]:
    """Return the figures of agreement of the start over the responses of the fit."""
    figures = start.figures or compute_agreement(data, data.before)
    names = ("frac_median", "correlation_min", "residual_median", "db_error_median")
    return [key_figure(name, figures[name]) for name in names if name in figures]


# -- sections ------------------------------------------------------------------------------------
class _StartSection(ReportSection):
    """A section shown only on a page before any fit."""

    of_start = True

    def applies(self, content: PageContent) -> bool:
        """Whether the page is about a model and a test before any fit."""
        return content.start is not None


class FindingsSection(_StartSection):
    """Suspected faults of data or model; omitted without findings."""

    anchor = "findings"
    name = heading = "Findings"
    place = 30
    template = "updyn.report/start_findings.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the findings, most likely first."""
        assert content.start is not None
        return {"findings": content.start.findings}


class StartUnknownsSection(_StartSection):
    """The unknowns with their expected standard deviations."""

    anchor = "unknowns"
    name = heading = "Unknowns"
    place = 70
    template = "updyn.report/start_unknowns.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the rows of the table: start, bounds, expected standard deviation."""
        start = content.start
        assert start is not None
        std = np.sqrt(np.diag(start.covariance))
        rows = [_parameter_row(p, float(s)) for p, s in zip(start.parameters, std, strict=True)]
        return {
            "rows": rows,
            "head": ["group", "quantity", "start", "bounds", "expected std. dev."],
        }


class MatchingSection(_StartSection):
    """The matching of sensors and forces to DOFs of the model."""

    anchor = "matching"
    name = heading = "Sensors and DOFs"
    place = 350
    template = "updyn.report/start_matching.html"

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the matching table as text."""
        assert content.start is not None
        return {"text": content.start.matching}


FINDINGS = FindingsSection()
EXPECTED = StartUnknownsSection()
MATCHING = MatchingSection()


def _parameter_row(p: Parameter, std: float) -> tuple[list[str], str]:
    """Return the cells of an unknown and the CSS class of its row.

    The standard deviation, in the optimiser's coordinates, is in percent if they are logarithms.
    """
    known = bool(np.isfinite(std))
    shown = "not determined"
    if known:
        unit = p.scale if p.of_element else 1.0
        shown = f"±{percentage(std)}" if p.is_log else f"±{number(std * unit, 2)}"
    bounds = f"{number(p.lower, 3)} to {number(p.upper, 3)}"
    cells = [p.group, quantity_words(p.quantity), number(p.start), bounds, shown]
    return cells, "" if known else "open"
