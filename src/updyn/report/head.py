"""The head of the page of an update: title, verdict and key figures; the table of tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import quote

from updyn.report.formats import (
    agreement_name,
    chi_hint,
    counted,
    decibels,
    extent,
    figure_of_agreement,
    held_out,
    number,
)
from updyn.report.residual import residual_tile
from updyn.report.section import Content, Section
from updyn.report.templates import render_template
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["TESTS", "Verdict", "head", "joint_head", "verdict"]

#: Short word for the badge and kind of colour by status.
STATUS_WORDS = {
    "converged": ("Converged", "good"),
    "not-credible": ("Not credible", "bad"),
    "not-identifiable": ("Not all unknowns determined", "warn"),
    "max-iterations": ("Stopped at the iteration limit", "warn"),
    "stalled": ("Stalled", "warn"),
    "stopped": ("Stopped by the user", "warn"),
    "failed": ("Failed", "bad"),
}
#: Figures of agreement in the table of tests.
_FIGURES = ("frac_median", "frac_min", "db_error_median")
#: Outcomes of the test of a residual, the worst first: the head shows the worst of all tests.
_GRAVITY = ("structure", "excess", "untested", "noise", "exact")

_Figures = Mapping[str, Mapping[str, float]]


def head(result: UpdateResult, figures: _Figures, data: str = "") -> str:
    """Return the head of a page as HTML: title, verdict, cause and remedy, key figures.

    Parameters
    ----------
    result : UpdateResult
        The result.
    figures : mapping of str to mapping of str to float
        Figures of agreement ``before``, ``after`` and of the ``validation`` set.
    data : str
        The measured data in words; by default their channels and lines.

    Returns
    -------
    str
    """
    said = verdict(result, figures)
    unknowns = counted(len(result.parameters), "unknown")
    return render_template(
        "updyn.report/head.html",
        title=result.title,
        about=f"{unknowns}, method {result.method}; {data or extent(result.frf)}",
        badge=said.badge,
        kind=said.kind,
        status=said.status,
        agreement=said.agreement,
        cause=_cause(result),
        remedy=f"What to do next: {result.remedy}" if result.remedy else "",
        key_figures=_key_figures(result, figures["before"], figures["after"]),
    )


def _cause(result: UpdateResult) -> str:
    """Return the message; where all is well, without its first sentence, which is the verdict."""
    if result.ok and not result.remedy:
        return result.message.partition(". ")[2]
    return result.message


def _key_figures(
    result: UpdateResult, before: Mapping[str, float], after: Mapping[str, float]
) -> list[tuple[str, str, str]]:
    """Return name, value and hint of each key figure."""
    out = []
    if "frac_median" in after:
        text = _from_to(before.get("frac_median"), after["frac_median"], figure_of_agreement)
        out.append(("Shape agreement, median FRAC", text, "1 is perfect, before → after"))
    if "db_error_median" in after:
        text = _from_to(before.get("db_error_median"), after["db_error_median"], decibels)
        out.append(("Level difference, median", text, "0 dB is perfect, before → after"))
    ident = result.identifiability
    hint = "independent combinations of the unknowns"
    if ident.complete:
        hint = "all unknowns"
    out.append(("Determined by the data", f"{ident.rank} of {ident.n_parameters}", hint))
    chi = result.noise.get("chi_square")
    if isinstance(chi, int | float) and math.isfinite(chi):
        out.append(("Reduced chi-square", number(float(chi), 3), chi_hint(result.noise)))
    if result.adequacy is not None:
        out.append(residual_tile(result.adequacy))
    return out


def _from_to(before: float | None, after: float, say: Callable[[float], str]) -> str:
    if before is None:
        return say(after)
    return f"{say(before).removesuffix(' dB')} → {say(after)}"


# -- several tests -------------------------------------------------------------------------------
def joint_head(result: JointResult) -> str:
    """Return the head of the page of several tests, with the agreement of the worst of them.

    Parameters
    ----------
    result : JointResult
        The result.

    Returns
    -------
    str
        HTML.
    """
    tests = list(result.results.values())
    worst = min(tests, key=lambda test: _agreement(test, "after").get("frac_median", 1.0))
    figures = {when: _agreement(worst, when) for when in ("before", "after", "validation")}
    residuals = [test.adequacy for test in tests if test.adequacy is not None]
    gravest = min(residuals, key=lambda found: _GRAVITY.index(found.outcome), default=None)
    return head(
        replace(worst, title=result.title, adequacy=gravest),
        figures,
        f"{len(tests)} tests; agreement is that of the worst of them",
    )


class Tests(Section):
    """The tests that were fitted together, one row each."""

    anchor = "tests"
    name = "Tests"
    heading = "Tests"
    place = 50
    template = "updyn.report/tests.html"

    def applies(self, content: Content) -> bool:
        """Whether the page is that of several tests."""
        return isinstance(content.update, JointResult)

    def context(self, content: Content) -> dict[str, Any]:
        """Return one row a test: link, data, agreement before and after, residual."""
        names = [agreement_name(name) for name in _FIGURES]
        return {
            "head": ["test", "data", *names, "residual"],
            "kinds": ("text", "text", *[""] * len(_FIGURES), "text"),
            "tests": [
                {"cells": _test_cells(name, test), "link": f"{quote(name)}/report.html"}
                for name, test in content.tests.items()
            ],
        }


TESTS = Tests()


def _test_cells(name: str, test: UpdateResult) -> list[str]:
    before, after = _agreement(test, "before"), _agreement(test, "after")
    cells = [name, extent(test.frf)]
    for figure in _FIGURES:
        cells.append(f"{number(before.get(figure))} → {number(after.get(figure))}")
    cells.append("–" if test.adequacy is None else residual_tile(test.adequacy)[1])
    return cells


def _agreement(result: UpdateResult, when: str) -> dict[str, float]:
    """Return figures of agreement before or after, or those after of the validation set."""
    found = result.correlation.get(when) or {}
    if when == "validation":
        found = found.get("after") or {}
    return dict(found)


# -- verdict -------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Verdict:
    """How a fit ended and how well the model agrees with the data, in words.

    Attributes
    ----------
    badge, kind : str
        Short word, and ``"good"``, ``"warn"`` or ``"bad"``.
    status, agreement : str
        One sentence each: how the fit ended, and how well the updated model agrees.
    """

    badge: str
    kind: str
    status: str
    agreement: str


def verdict(result: UpdateResult, figures: _Figures) -> Verdict:
    """Return in two sentences how the fit ended and how well the model agrees.

    Parameters
    ----------
    result : UpdateResult
        The result.
    figures : mapping of str to mapping of str to float
        ``before``, ``after`` and ``validation``: each with ``frac_median`` and ``db_error_median``
        where known.

    Returns
    -------
    Verdict
    """
    badge, kind = STATUS_WORDS.get(result.status, (result.status, "warn"))
    if _is_ambiguous(result):
        badge = "Several answers fit"
    return Verdict(badge, kind, _status_sentence(result), _agreement_sentence(result, figures))


def _is_ambiguous(result: UpdateResult) -> bool:
    """Return whether other answers are all that keeps the fit from being a good one."""
    determined = result.status == "not-identifiable" and result.identifiability.complete
    return determined and bool(result.alternatives)


def _status_sentence(result: UpdateResult) -> str:
    """Say how the fit ended and what the data determine."""
    ident, steps = result.identifiability, result.iterations
    n, rank = ident.n_parameters, ident.rank
    in_steps = f"after {counted(steps, 'iteration')}"
    if rank >= n == 1:
        determined = "the data determine the one unknown"
    elif rank >= n:
        determined = f"the data determine all {n} unknowns"
    elif rank == 0:
        determined = f"the data determine none of the {n} unknowns"
    else:
        determined = f"the data determine only {rank} independent combinations of the {n} unknowns"
    if _is_ambiguous(result):
        return (
            f"The fit settled {in_steps}, but {1 + len(result.alternatives)} answers fit the data"
            " equally well: the values below are those of one of them."
        )
    texts = {
        "converged": f"The fit converged {in_steps}, and {determined}.",
        "not-credible": f"The fit settled {in_steps}, but its answer is not to be believed.",
        "not-identifiable": (
            f"The fit settled {in_steps}, but {determined}: some of the values below are arbitrary."
        ),
        "max-iterations": (
            f"The fit was still moving when it reached its limit {in_steps}; {determined}."
        ),
        "stalled": (
            f"The fit did not settle {in_steps}: no step lowered the misfit further, or the search"
            f" found no answer that it could believe; {determined}."
        ),
        "stopped": (
            f"The fit was stopped by the user {in_steps}; the values are those of its best step."
        ),
        "failed": (
            f"The fit failed {in_steps}; the values below are not an update and must not be used as"
            " one."
        ),
    }
    return texts.get(
        result.status, f"The fit ended with status {result.status!r} {in_steps}; {determined}."
    )


def _agreement_sentence(result: UpdateResult, figures: _Figures) -> str:
    """Say how FRAC and level difference changed, and the FRAC of the validation set."""
    before, after = figures.get("before", {}), figures.get("after", {})
    if "frac_median" not in after:
        return "How well the updated model agrees with the measurement could not be computed."
    text = _change(
        "median FRAC", before.get("frac_median"), after["frac_median"], figure_of_agreement
    )
    if "db_error_median" in after:
        level = before.get("db_error_median"), after["db_error_median"]
        text += " and " + _change("the median level difference", *level, decibels)
    held = figures.get("validation", {}).get("frac_median")
    if held is not None:
        what = held_out(result) or "the validation set"
        text += f"; on the data held out ({what}) the median FRAC is {figure_of_agreement(held)}"
    return text[0].upper() + text[1:] + "."


def _change(what: str, before: float | None, after: float, say: Callable[[float], str]) -> str:
    if before is None:
        return f"{what} is {say(after)}"
    if say(before) == say(after):
        return f"{what} stays at {say(after)}"
    verb = "rises" if after > before else "falls"
    return f"{what} {verb} from {say(before)} to {say(after)}"
