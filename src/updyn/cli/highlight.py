"""Colours of terminal output: styles for some words of the unchanged text."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from updyn.updating.judge.claim import PARTS

if TYPE_CHECKING:
    from rich.text import Text

    from updyn.updating.judge.badge import Badge

__all__ = ["STATUS_STYLES", "STYLES", "highlight"]

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
_PREFIX = "updyn."
#: Styles by name, for the theme of a console.
STYLES = {
    f"{_PREFIX}good": "bold green",
    f"{_PREFIX}warning": "bold yellow",
    f"{_PREFIX}bad": "bold red",
    f"{_PREFIX}faint": "dim",
    f"{_PREFIX}heading": "bold",
    f"{_PREFIX}doubt": "yellow",
}
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


def _list_patterns() -> list[str]:
    """Return the patterns of all words with a style; the name of a group is that of its style."""
    return [
        *_status_patterns(),
        rf"(?m)^(?P<heading>(?:{'|'.join(_HEADINGS)}) {{2,}}\S.*)$",
        *(rf"(?P<doubt>{doubt})" for doubt in _DOUBTS),
    ]


def highlight(text: str, badge: Badge | None = None) -> Text:
    """Return text with styles of verdict, status, headings of tables and doubtful results."""
    from rich.text import Text

    patterns = _list_patterns()
    if badge is not None:
        phrase = r"\s+".join(map(re.escape, badge.phrase.split()))
        patterns.append(rf"\)\.\s+(?P<{_BADGE_STYLES[badge.colour]}>{phrase})(?=\.)")
    styled = Text(text)
    for pattern in patterns:
        styled.highlight_regex(pattern, style_prefix=_PREFIX)
    return styled
