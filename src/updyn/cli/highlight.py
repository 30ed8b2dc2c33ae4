"""Colours of terminal output: styles for some words of the unchanged text."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rich.highlighter import RegexHighlighter
from rich.text import Text
from rich.theme import Theme

from updyn.updating.judge.claim import PARTS

if TYPE_CHECKING:
    from updyn.updating.judge.badge import Badge

__all__ = ["STATUS_STYLES", "THEME", "SummaryHighlighter"]

#: Style of the colour of a verdict.
_BADGE_STYLES = {"good": "good", "warn": "warning", "bad": "bad"}
#: Colour of each status of a result, and of a method that does not apply.
STATUS_STYLES = {
    "converged": "good",
    "not-credible": "bad",
    "not-identifiable": "warning",
    "max-iterations": "warning",
    "stalled": "warning",
    "stopped": "warning",
    "does not apply": "faint",
    "failed": "bad",
}
THEME = Theme(
    {
        "updyn.good": "bold green",
        "updyn.warning": "bold yellow",
        "updyn.bad": "bold red",
        "updyn.faint": "dim",
        "updyn.heading": "bold",
        "updyn.doubt": "yellow",
    }
)
#: First words of the header lines of tables.
_HEADINGS = ("unknown", "agreement", "method", r"test \(Hz\)", "sensor", "response", "group")
#: Warnings in rows and below tables.
_DOUBTS = (
    r"at its (?:lower|upper) bound",
    r"not determined by the data",
    r"undetermined combination \d+",
    r"answer \d+ fits as well",
)


def _status_patterns() -> list[str]:
    """Return patterns of a status in tables, and of the parts of a verdict."""
    patterns = []
    for status, style in STATUS_STYLES.items():
        patterns.append(rf"(?m)^\S+ +(?P<{style}>{status})(?=  )")
        patterns.append(rf"(?m)^\S+ (?P<{style}>{status})(?=: )")
    parts = rf"(?m)^  (?:{'|'.join(PARTS)})"
    patterns += [
        rf"{parts} +(?P<good>yes)(?=  )",
        rf"{parts} +(?P<bad>no)(?=  )",
        rf"{parts} +(?P<warning>not known)(?=  )",
        rf"{parts} +(?P<faint>not asked)(?=  )",
    ]
    part = rf"(?:(?m:^  )|, ?\n? *)(?:{'|'.join(PARTS)})\s+"
    patterns += [
        rf"{part}(?P<good>yes)(?=,|\n|$)",
        rf"{part}(?P<bad>no)(?=,|\n|$)",
        rf"{part}(?P<warning>not known)(?=,|\n|$)",
        rf"{part}(?P<faint>not asked)(?=,|\n|$)",
    ]
    return patterns


class SummaryHighlighter(RegexHighlighter):
    """Colours verdict, status, headings of tables and doubtful results."""

    base_style = "updyn."
    highlights = [  # noqa: RUF012
        *_status_patterns(),
        rf"(?m)^(?P<heading>(?:{'|'.join(_HEADINGS)}) {{2,}}\S.*)$",
        *(rf"(?P<doubt>{doubt})" for doubt in _DOUBTS),
    ]

    def __init__(self, badge: Badge | None = None) -> None:
        self._verdict = ""
        if badge is not None:
            phrase = r"\s+".join(map(re.escape, badge.phrase.split()))
            self._verdict = rf"\)\.\s+(?P<{_BADGE_STYLES[badge.colour]}>{phrase})(?=\.)"

    def highlight(self, text: Text) -> None:
        """Add the styles to a text."""
        super().highlight(text)
        if self._verdict:
            text.highlight_regex(self._verdict, style_prefix=self.base_style)
