"""Text for the terminal: aligned columns, numbers with nouns, escaped control characters."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

__all__ = ["format_count", "percent", "printable", "text_table"]

#: Characters that a terminal would interpret, or that change the text direction.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def text_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)
) -> str:
    """Return rows as aligned columns, two blanks apart; columns not in `left` align right."""
    cells = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = []
    for row in cells:
        columns = enumerate(zip(row, widths, strict=True))
        padded = [c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in columns]
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def format_count(n: int, noun: str) -> str:
    """Return a number and a noun, such as ``"1 line"`` and ``"2 lines"``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def percent(share: float) -> str:
    """Return a share in percent with two digits, such as ``"4.2 %"`` and ``"130 %"``."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"


def printable(text: str) -> str:
    r"""Return text with escaped control characters, such as ``\x1b``, except line ends and tabs."""
    # All text for the terminal is escaped, as names come from files.
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)
