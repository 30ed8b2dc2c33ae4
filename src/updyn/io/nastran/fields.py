"""Lines of bulk data and their fields (small, large and free), and numbers in Nastran's notation.

Exponents have D or no letter (``1.5-3``), in 8 or 16 characters.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from updyn.errors import FormatError

__all__ = ["NastranLine", "NastranRow", "format_field", "parse_nastran_real", "split_fields"]

_PLAIN = 8  # characters up to which 0.001 is preferred to 1.-3
_NUMBER = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EeDd]?([+-]\d+)|[EeDd](\d+))?")


def parse_nastran_real(cell: str) -> float:
    """Return the number in a field; raise a ValueError if it is not a number."""
    found = _NUMBER.fullmatch(cell.strip())
    if found is None:
        raise ValueError(f"{cell!r} is not a number")
    number = float(f"{found[1]}e{found[2] or found[3] or 0}")
    if math.isinf(number):
        raise ValueError(f"{cell!r} is too large a number")
    return number


def format_field(value: float, width: int = 16) -> str:
    """Format a finite number with a decimal point and as many digits as fit `width` characters."""
    if not math.isfinite(value):
        raise ValueError(f"{value!r} cannot be written to a deck")
    mantissa = repr(float(value)).split("e")[0]
    significant = len(mantissa.strip("-0.").replace(".", "").rstrip("0"))
    for digits in range(max(significant, 1), 0, -1):
        scientific = f"{value:.{digits - 1}e}"
        plain = _with_point(repr(float(scientific)))
        if len(plain) <= min(width, _PLAIN):
            return plain
        short = _with_point(scientific)
        if len(short) <= width:
            return short
    raise ValueError(f"{value!r} does not fit {width} characters")


def _with_point(text: str) -> str:
    """Return a number in deck notation: with a point, and an exponent without letter and zeros."""
    mantissa, _, exponent = text.partition("e")
    if "." not in mantissa:
        mantissa += "."
    if exponent:
        mantissa += f"{int(exponent):+d}"
    return mantissa


@dataclass(frozen=True, slots=True)
class NastranLine:
    """A line of a deck without comment; a line of a binary file has no number."""

    text: str
    path: Path
    number: int | None

    @property
    def place(self) -> str:
        """File and line, for messages."""
        return self.path.name if self.number is None else f"{self.path.name}:{self.number}"

    def error(self, message: str) -> FormatError:
        """Return an error at this line."""
        return FormatError(message, self.path, self.number)


@dataclass(frozen=True, slots=True)
class NastranRow:
    """A line of bulk data by its fields.

    `head` is field 1: the name of a card, a replicator, or the mark of a continuation. `fields` are
    8 small or 4 large ones. `tail` is field 10: the mark of the continuation of this line.
    """

    line: NastranLine
    head: str
    fields: tuple[str, ...]
    tail: str

    @property
    def continues(self) -> bool:
        """Whether the line continues another one."""
        return not self.head or self.head[0] in "+*"


def split_fields(line: NastranLine) -> NastranRow:
    """Return the fields of a line; raise a FormatError if it has too many fields or is too long."""
    if "," in line.text:
        cells, tail, n = _free_fields(line)
        head = line.text.split(",")[0].strip()
    else:
        cells, tail, n = _fixed_fields(line)
        head = line.text[:8].strip()
    return NastranRow(line, head, tuple(cells + [""] * (n - len(cells))), tail)


def _free_fields(line: NastranLine) -> tuple[list[str], str, int]:
    """Return the cells of a line with commas, its continuation mark, and the number of fields."""
    cells = [cell.strip() for cell in line.text.split(",")]
    is_large = cells[0].startswith("*") or cells[0].endswith("*")
    n = 4 if is_large else 8
    if len(cells) > n + 2:
        raise line.error(f"{len(cells)} fields; expected at most {n + 2} on a line")
    tail = ""
    if len(cells) == n + 2:
        tail = cells[n + 1]
    if tail and _is_number(tail) and tail[0] not in "+*":
        raise line.error(
            f"{tail!r} in field {n + 2}; expected at most {n} data fields on a line, then a"
            " continuation"
        )
    cells = cells[1 : n + 1]
    is_copy = line.text.lstrip().startswith("=")  # *1 is an increment there, not a mark
    if not tail and not is_copy and cells and _is_mark(cells[-1]):
        tail = cells.pop()  # the mark may follow the last field directly
    return cells, tail, n


def _fixed_fields(line: NastranLine) -> tuple[list[str], str, int]:
    """Return the cells of a line in columns, its continuation mark, and the number of fields."""
    text = line.text
    if len(text) > 80:
        raise line.error(f"{len(text)} characters; expected at most 80 before comments ($)")
    is_large = text[:1] == "*" or text[:8].rstrip().endswith("*")
    width = 16 if is_large else 8
    cells = [text[start : start + width].strip() for start in range(8, 72, width)]
    return cells, text[72:80].strip(), len(cells)


def _is_mark(cell: str) -> bool:
    return cell[:1] in ("+", "*") and not _is_number(cell)


def _is_number(cell: str) -> bool:
    try:
        parse_nastran_real(cell)
    except ValueError:
        return False
    return True
