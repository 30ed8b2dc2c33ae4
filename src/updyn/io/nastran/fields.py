"""Numbers as Nastran writes them: exponents with D or without a letter (``1.5-3``), in 8 or 16 characters."""

from __future__ import annotations

import math
import re

__all__ = ["real", "text_of"]

_PLAIN = 8  # characters up to which 0.001 is nicer than 1.-3
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EeDd]?([+-]\d+)|[EeDd](\d+))?")


def real(cell: str) -> float:
    """Read a number.

    Raises
    ------
    ValueError
        If the text is not a number.
    """
    found = _NUMBER.fullmatch(cell.strip())
    if found is None:
        raise ValueError(f"{cell!r} is not a number")
    number = float(f"{found[1]}e{found[2] or found[3] or 0}")
    if math.isinf(number):
        raise ValueError(f"{cell!r} is too large a number")
    return number


def text_of(value: float, width: int = 16) -> str:
    """Write a number with a decimal point in at most `width` characters, as many digits as fit.

    Raises
    ------
    ValueError
        If the number is not finite.
    """
    if value != value or value in (float("inf"), float("-inf")):
        raise ValueError(f"{value!r} has no text in a deck")
    significant = (
        len(repr(float(value)).split("e")[0].strip("-0.").replace(".", "").rstrip("0")) or 1
    )
    for digits in range(max(significant, 1), 0, -1):
        scientific = f"{value:.{digits - 1}e}"
        plain = _with_point(repr(float(scientific)))
        if len(plain) <= min(width, _PLAIN):
            return plain
        if len(short := _with_point(scientific)) <= width:
            return short
    raise ValueError(f"{value!r} does not fit {width} characters")


def _with_point(text: str) -> str:
    """Write a number as a deck has it: with a point, and an exponent without letter and zeros."""
    mantissa, _, exponent = text.partition("e")
    if "." not in mantissa:
        mantissa += "."
    return mantissa + (f"{int(exponent):+d}" if exponent else "")
