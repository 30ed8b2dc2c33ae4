"""The first screen of the page of an update, and the table of tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from urllib.parse import quote

from updyn.report.evidence import Evidence, show_evidence
from updyn.report.formats import (
    chi_hint,
    decibels,
    extent,
    figure_of_agreement,
    format_count,
    noise_is_fitted,
    number,
    percentage,
    validation_words,
)
from updyn.report.plots import Figure
from updyn.report.residual import residual_tile
from updyn.report.section import Headline, PageContent, ReportSection, select_sections
from updyn.report.templates import render_template
from updyn.report.verdict import verdict
from updyn.updating.next_step import choose_next_step
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "TESTS",
    "agreement",
    "head",
    "joint_head",
    "key_figure",
    "page_title",
    "render_first_screen",
]

#: Figures of agreement in the table of tests.
_FIGURES = {
    "frac_median": "FRAC, median",
    "correlation_min": "FRF correlation, worst",
    "residual_median": "residual, median",
    "db_error_median": "level, median",
}
#: Outcomes of the residual test, worst first; the head shows the worst of all tests.
_SEVERITY = ("structure", "excess", "untested", "noise", "exact")


def _in_percent(value: float) -> str:
    return percentage(value / 100.0)


#: Key figures: name, title, formatter, ideal value, and 1 if larger is better, else -1.
_KEY_FIGURES: tuple[tuple[str, str, Callable[[float], str], str, float], ...] = (
    ("frac_median", "FRAC, median", figure_of_agreement, "1 is the same shape", 1.0),
    ("correlation_min", "FRF correlation, worst", figure_of_agreement, "1 is ideal", 1.0),
    ("residual_median", "Relative residual, median", percentage, "0 % is ideal", -1.0),
    ("db_error_median", "Level difference, median", decibels, "0 dB is ideal", -1.0),
    ("modes_paired", "Modes paired", lambda value: f"{value:.0f}", "all is ideal", 1.0),
    ("frequency_error_rms", "Frequency error, rms", _in_percent, "0 % is ideal", -1.0),
    ("mac_min", "MAC, worst mode", figure_of_agreement, "1 is the same shape", 1.0),
    ("loss_factor_error_rms", "Loss factor error, rms", _in_percent, "0 % is ideal", -1.0),
)

_Figures = Mapping[str, Mapping[str, float]]


def key_figure(name: str, value: float) -> tuple[str, str, str]:
    """Return title, value and ideal value of a figure of agreement of one model."""
    title, say, ideal = next(
        (title, say, ideal) for known, title, say, ideal, _ in _KEY_FIGURES if known == name
    )
    return title, say(value), ideal


def page_title(content: PageContent) -> str:
    """Return the title of the job, or else that of the model."""
    result = content.result
    return result.title or result.start.title or "Model update"


def head(
    content: PageContent,
    figures: _Figures,
    *,
    worst: UpdateResult | None = None,
    data: str = "",
) -> tuple[str, dict[str, Figure]]:
    """Return the first screen of a page as HTML, and its figures by name.

    `figures` are the figures of agreement ``before``, ``after`` and of the ``validation`` set, of
    the `worst` test if there are several; `data` describes the data of several tests.
    """
    assert content.update is not None
    result = content.result
    unknowns = format_count(len(result.parameters), "unknown")
    return render_first_screen(
        show_evidence(content),
        title=page_title(content),
        about=f"{unknowns}, method {result.method}; {data or extent(result.data)}",
        judgement=verdict(content),
        headlines=_collect_headlines(content),
        step=choose_next_step(content.update),
        others=result.steps[1:],
        key_figures=_key_figures(worst or result, figures),
        more="residual" if content.has_frfs else "",
        has_updated=True,
    )


def _collect_headlines(content: PageContent) -> list[tuple[str, Headline]]:
    """Return anchor and verdict of each section that has one."""
    found = [(section.anchor, section.headline(content)) for section in select_sections(content)]
    return [(anchor, headline) for anchor, headline in found if headline is not None]


def render_first_screen(evidence: Evidence, **context: object) -> tuple[str, dict[str, Figure]]:
    """Return the first screen of a page as HTML, and the figures of its evidence."""
    shown = {"headlines": [], **context}
    html = render_template(
        "updyn.report/head.html", figures=evidence.figures, panels=evidence.panels, **shown
    )
    return html, evidence.figures


def _key_figures(result: UpdateResult, figures: _Figures) -> list[tuple[str, str, str]]:
    """Return (name, value, hint) of each key figure."""
    before, after = figures.get("before", {}), figures.get("after", {})
    out = []
    for name, title, say, ideal, sign in _KEY_FIGURES:
        if name in after:
            out.append(_format_before_after(title, before.get(name), after[name], say, ideal, sign))
    held = figures.get("validation", {})
    if "residual_median" in held and "correlation_min" in held:
        value = percentage(held["residual_median"])
        lowest = (
            f"relative residual; worst correlation {figure_of_agreement(held['correlation_min'])}"
        )
        out.append((f"Held out: {validation_words(result) or 'validation set'}", value, lowest))
    elif "frequency_error_rms" in held:
        value = _in_percent(held["frequency_error_rms"])
        lowest = f"error of frequency, rms; worst MAC {figure_of_agreement(held['mac_min'])}"
        out.append((f"Held out: {validation_words(result) or 'validation set'}", value, lowest))
    elif "frac_median" in held:
        value = f"FRAC {figure_of_agreement(held['frac_median'])}"
        out.append(
            (f"Held out: {validation_words(result) or 'validation set'}", value, "median, after")
        )
    chi = result.noise.get("chi_square")
    fitted = noise_is_fitted(result.noise)  # then it is 1 by construction
    judged = result.adequacy is not None and result.adequacy.verdict not in result.message
    if isinstance(chi, int | float) and math.isfinite(chi) and not (fitted or judged):
        out.append(("Reduced chi-square", number(float(chi), 3), chi_hint(result.noise)))
    if result.adequacy is not None and judged:
        out.append(residual_tile(result.adequacy))
    return out


def _format_before_after(
    title: str,
    before: float | None,
    after: float,
    say: Callable[[float], str],
    ideal: str,
    sign: float,
) -> tuple[str, str, str]:
    """Return a figure before and after the update; `sign` is 1 if larger is better, else -1."""
    if before is None:
        return title, say(after), ideal
    first, last = say(before), say(after)
    hint = f"start → updated; {ideal}"
    if sign * after < sign * before and last != first:  # visible after rounding
        hint = f"worse than the start; {ideal}"
    return title, f"{first.removesuffix(' dB').removesuffix(' %')} → {last}", hint


# -- several tests -------------------------------------------------------------------------------
def joint_head(content: PageContent, result: JointResult) -> tuple[str, dict[str, Figure]]:
    """Return the head of the page of several tests, with the agreement of the worst test."""
    tests = list(result.results.values())
    worst = min(tests, key=lambda test: _agreement(test, "after").get("frac_median", 1.0))
    residuals = [test.adequacy for test in tests if test.adequacy is not None]
    most_severe = min(residuals, key=lambda found: _SEVERITY.index(found.outcome), default=None)
    return head(
        content,
        agreement(worst),
        worst=replace(worst, adequacy=most_severe),
        data=f"{len(tests)} tests; agreement is that of the worst of them",
    )


class TestsSection(ReportSection):
    """The tests fitted together, one row each."""

    anchor = "tests"
    name = "Tests"
    heading = "Tests"
    place = 5
    template = "updyn.report/tests.html"
    first_screen = True

    def applies(self, content: PageContent) -> bool:
        """Whether the page describes several tests."""
        return isinstance(content.update, JointResult)

    def context(self, content: PageContent) -> dict[str, object]:
        """Return one row per test: link, data, agreement before and after, residual."""
        return {
            "head": ["test", "data", *_FIGURES.values(), "residual test"],
            "kinds": ("text", "text", *[""] * len(_FIGURES), "text"),
            "tests": [
                {"cells": _test_cells(name, test), "link": f"{quote(name)}/report.html"}
                for name, test in content.tests.items()
            ],
        }


TESTS = TestsSection()


def _test_cells(name: str, test: UpdateResult) -> list[str]:
    before, after = _agreement(test, "before"), _agreement(test, "after")
    cells = [name, extent(test.data)]
    say = {name: formatter for name, _, formatter, _, _ in _KEY_FIGURES}
    for figure in _FIGURES:
        both = [say[figure](when[figure]) for when in (before, after) if figure in when]
        cells.append(" → ".join(both) or "–")
    cells.append("–" if test.adequacy is None else residual_tile(test.adequacy)[1])
    return cells


def agreement(result: UpdateResult) -> dict[str, dict[str, float]]:
    """Return the figures of agreement ``before``, ``after`` and of the ``validation`` set."""
    return {when: _agreement(result, when) for when in ("before", "after", "validation")}


def _agreement(result: UpdateResult, when: str) -> dict[str, float]:
    """Return the figures before or after the update, or those of the validation set after it."""
    found = result.correlation.get(when) or {}
    if when == "validation":
        found = found.get("after") or {}
    return dict(found)
