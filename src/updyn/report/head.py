"""The head of a page about an update: title, verdict and key figures; the table of several tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from urllib.parse import quote

from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import Figure
from updyn.report.residual import tile
from updyn.report.section import Content, Section
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["TESTS", "head", "joint_head"]


def head(result: UpdateResult, figures: Mapping[str, Mapping[str, float]], data: str = "") -> str:
    """Return title, verdict in two sentences, cause and remedy, key figures; `data` says what was measured."""
    said = verdict(result, figures)
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


#: Short word for the badge and kind of colour by status.
STATUS_WORDS = {
    "converged": ("Converged", "good"),
    "not-identifiable": ("Not all unknowns determined", "warn"),
    "max-iterations": ("Stopped at the iteration limit", "warn"),
    "stalled": ("Stalled", "warn"),
    "stopped": ("Stopped by the user", "warn"),
    "failed": ("Failed", "bad"),
}


@dataclass(frozen=True, slots=True)
class Verdict:
    """The head of the report.

    Attributes
    ----------
    badge, kind : str
        Short word, and ``"good"``, ``"warn"`` or ``"bad"``.
    status, agreement : str
        One sentence each: how the fit ended, and how well the model answers now.
    """

    badge: str
    kind: str
    status: str
    agreement: str


def verdict(result: UpdateResult, figures: Mapping[str, Mapping[str, float]]) -> Verdict:
    """Say in two sentences how the fit ended and how well the model answers.

    Parameters
    ----------
    result : UpdateResult
        The result.
    figures : mapping of str to mapping of str to float
        ``before``, ``after`` and ``validation``: each with ``frac_median`` and ``db_error_median``
        where known.
    """
    badge, kind = STATUS_WORDS.get(result.status, (result.status, "warn"))
    return Verdict(badge, kind, _status_sentence(result), _agreement_sentence(result, figures))


def _status_sentence(result: UpdateResult) -> str:
    ident, steps = result.identifiability, result.iterations
    n, rank = ident.n_parameters, ident.rank
    in_steps = f"after {w.counted(steps, 'iteration')}"
    what = "the one unknown" if n == 1 else f"all {n} unknowns"
    if rank >= n:
        determined = f"the data determine {what}"
    elif rank == 0:
        determined = f"the data determine none of the {n} unknowns"
    else:
        determined = f"the data determine only {rank} independent combinations of the {n} unknowns"
    texts = {
        "converged": f"The fit converged {in_steps}, and {determined}.",
        "not-identifiable": (
            f"The fit settled {in_steps}, but {determined}: some of the values below are arbitrary."
        ),
        "max-iterations": (
            f"The fit was still moving when it reached its limit {in_steps}; {determined}."
        ),
        "stalled": (
            f"The fit stalled {in_steps}: no step lowered the misfit further though it had not"
            f" converged; {determined}."
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


def _agreement_sentence(result: UpdateResult, figures: Mapping[str, Mapping[str, float]]) -> str:
    before, after = figures.get("before", {}), figures.get("after", {})
    if "frac_median" not in after:
        return "How well the updated model agrees with the measurement could not be computed."
    parts = [
        _went("median FRAC", before.get("frac_median"), after["frac_median"], w.figure_of_agreement)
    ]
    if "db_error_median" in after:
        parts.append(
            _went(
                "the median level difference",
                before.get("db_error_median"),
                after["db_error_median"],
                w.decibels,
            )
        )
    text = " and ".join(parts)
    held = figures.get("validation", {})
    if held.get("frac_median") is not None:
        what = w.held_out(result) or "the validation data"
        text += (
            f"; on what was held out ({what}) the median FRAC is"
            f" {w.figure_of_agreement(held['frac_median'])}"
        )
    return text[0].upper() + text[1:] + "."


def _went(what: str, before: float | None, after: float, say: Callable[[float], str]) -> str:
    if before is None:
        return f"{what} is {say(after)}"
    if say(before) == say(after):
        return f"{what} stays at {say(after)}"
    return f"{what} {'rises' if after > before else 'falls'} from {say(before)} to {say(after)}"
