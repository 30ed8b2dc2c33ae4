"""Text for the terminal: aligned columns, numbers with nouns, escaped control characters."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

__all__ = [
    "FACTORS",
    "display_width",
    "fit_columns",
    "format_change",
    "format_count",
    "format_multiple",
    "percent",
    "percent_of",
    "printable",
    "text_table",
]

#: Ratio from which texts give a multiple instead of percent.
FACTORS = 10.0
#: [%] Smaller changes are written as none.
_NO_CHANGE = 5e-4
#: Characters that a terminal would interpret, or that change the text direction.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def text_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)
) -> str:
    """Return rows as aligned columns, two blanks apart; columns not in `left` align right."""
    cells = [list(header), *(list(row) for row in rows)]
    widths = [max(display_width(row[i]) for row in cells) for i in range(len(header))]
    lines = []
    for row in cells:
        padded = []
        for i, (cell, width) in enumerate(zip(row, widths, strict=True)):
            blanks = " " * (width - display_width(cell))
            padded.append(cell + blanks if i in left else blanks + cell)
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)


def fit_columns(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    width: int | None,
    dropped: Sequence[str],
    left: Collection[str] = (),
) -> str:
    """Return rows as `text_table` does, without the columns that do not fit into a width.

    Columns are dropped in the order of `dropped`, their headings, until the table fits; None is an
    unlimited width. The first column and those in `left` align left.
    """
    names = list(header)
    for name in ("", *dropped):
        names = [heading for heading in names if heading != name or not name]
        at = [i for i, heading in enumerate(header) if heading in names]
        aligned = {k for k, i in enumerate(at) if i == 0 or header[i] in left}
        found = text_table([header[i] for i in at], [[row[i] for i in at] for row in rows], aligned)
        if width is None or max(map(display_width, found.splitlines())) <= width:
            break
    return found


def display_width(text: str) -> int:
    """Return the number of columns of a line of text on a terminal."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


def format_count(n: int, noun: str) -> str:
    """Return a number and a noun, such as ``"1 line"`` and ``"2 lines"``."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def percent(share: float) -> str:
    """Return a share in percent with two digits, such as ``"4.2 %"`` and ``"130 %"``."""
    value = 100.0 * share
    return f"{value:.0f} %" if value >= 10.0 else f"{value:.2g} %"


def percent_of(share: float, whole: str) -> str:
    """Return a share of a whole: in percent, or as a multiple if it is large."""
    if share >= FACTORS:
        return f"{format_multiple(share)} times {whole}"
    return f"{percent(share)} of {whole}"


def format_multiple(factor: float) -> str:
    """Return a factor with two digits, three above ten; no power of ten below a million."""
    if factor < FACTORS:
        return f"{factor:.2g}"
    return f"{factor:.3g}" if factor < 1e3 or factor >= 1e6 else f"{factor:.0f}"


def format_change(factor: float, digits: int = 3) -> str:
    """Return the change by a factor in percent, with its sign; a large factor as a factor."""
    if factor >= FACTORS:
        return f"×{format_multiple(factor)}"
    change = 100.0 * (factor - 1.0)
    if abs(change) < _NO_CHANGE:
        return "0 %"
    text = f"{change:+.{digits}g}"
    if "e" in text:
        text = f"{change:+.0f}"
    return f"{text} %".replace("-", "−")


def printable(text: str) -> str:
    r"""Return text with escaped control characters, such as ``\x1b``, except line ends and tabs."""
    # All text for the terminal is escaped, as names come from files.
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)
