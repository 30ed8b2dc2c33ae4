"""The page of several tests: what they have in common, and where the page of each is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from urllib.parse import quote

from updyn.report import markup as m
from updyn.report import words as w
from updyn.report.plots import Figure
from updyn.report.section import Content, Section
from updyn.report.sections import head
from updyn.report.sections_residual import tile
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["TESTS", "joint_head"]

_FIGURES = ("frac_median", "frac_min", "db_error_median")
#: Outcomes of the residual's tests, the worst first: the head shows that of all tests.
_GRAVITY = ("structure", "excess", "untested", "noise", "exact")


def joint_head(result: JointResult) -> str:
    """Return title and verdict, with the agreement of the test that agrees worst."""
    worst = min(
        result.results.values(), key=lambda one: _figures(one, "after").get("frac_median", 1.0)
    )
    figures = {when: _figures(worst, when) for when in ("before", "after", "validation")}
    count = len(result.results)
    left = [one.adequacy for one in result.results.values() if one.adequacy is not None]
    least = min(left, key=lambda found: _GRAVITY.index(found.outcome), default=None)
    return head(
        replace(worst, title=result.title, adequacy=least),
        figures,
        f"{count} tests; agreement is that of the worst of them",
    )


class Tests(Section):
    """The tests that were fitted together, one row each."""

    anchor = "tests"
    name = "Tests"
    heading = "Tests"
    place = 50

    def applies(self, content: Content) -> bool:
        """Whether the page is that of several tests."""
        return isinstance(content.update, JointResult)

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return one row a test: link, data, agreement before and after."""
        kinds = ("text", "text", *[""] * len(_FIGURES), "text")
        rows = []
        for name, one in content.tests.items():
            before, after = _figures(one, "before"), _figures(one, "after")
            agreed = [f"{w.number(before.get(k))} → {w.number(after.get(k))}" for k in _FIGURES]
            left = "–" if one.adequacy is None else tile(one.adequacy)[1]
            rows.append(
                m.row(
                    [name, w.extent(one.frf), *agreed, left],
                    kinds,
                    link=f"{quote(name)}/report.html",
                )
            )
        names = ["test", "data", *(w.agreement_name(k) for k in _FIGURES), "what is left"]
        return m.paragraph(
            "One set of unknowns was fitted to all tests together; each has a page of its own."
        ) + m.table(names, rows, caption="Agreement before → after", kinds=kinds)


TESTS = Tests()


def _figures(result: UpdateResult, when: str) -> dict[str, float]:
    """Return figures of agreement before or after, or those after on what was held out."""
    found = result.correlation.get(when) or {}
    return dict((found.get("after") or {}) if when == "validation" else found)
