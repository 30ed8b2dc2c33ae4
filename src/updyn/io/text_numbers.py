"""Numbers in a text, checked against a grammar before they are converted.

A converter that stops at the first unknown character reads ``2.0D+05`` as 2 and ``1,5`` as 1, and
`float` and `int` of Python read ``1_5`` as 15. Exponents may have ``E`` or ``D``, as in Fortran.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError
from updyn.io.settings import FILE_TEXT

__all__ = [
    "check_last_line",
    "find_rounding",
    "parse_integer",
    "parse_real",
    "parse_reals",
    "parse_rows",
]

#: Integers of at most 15 digits, which doubles represent exactly.
_WHOLE = rb"[+-]?[0-9]{1,15}+"
_REAL = rb"[+-]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eEdD][+-]?[0-9]++)?"
_BLANKS = rb"[ \t]++"
_COMMA = rb"(?:[ \t]*+,[ \t]*+|[ \t]++)"
_ONE_REAL = re.compile(_REAL.decode())
_ONE_WHOLE = re.compile(r"[+-]?[0-9]{1,18}+")
_REALS = re.compile(rb"(?:\s*+" + _REAL + rb"(?=\s|\Z))*+\s*+")
_EXPONENT = bytes.maketrans(b"dD,", b"ee ")


def parse_rows(
    body: bytes,
    columns: str,
    expected: str,
    path: str | Path,
    first_line: int = 1,
    *,
    commas: bool = False,
    separator: bytes = b"",
    comment: bytes = b"",
) -> RealArray:
    """Return finite numbers, one row per line, shape (n, len(columns)); empty lines are ignored.

    `columns` has "i" for an integer or "r" for a real number of each row; `expected` names them for
    messages; `first_line` is the line of `body` in the file. The last line must end with a line
    break. `separator` and commas may also follow the last number.
    """
    check_last_line(body, path, first_line)
    end = _lines(columns, commas, separator, comment).match(body)
    assert end is not None  # an empty text matches, too
    if end.end() < len(body):
        raise _row_error(body, end.end(), expected, path, first_line)
    if comment:
        body = re.sub(rb"(?m)^[ \t]*" + re.escape(comment) + rb".*$", b"", body)
    if not body.strip():  # numpy reads a number from blanks
        return np.empty((0, len(columns)))
    if separator:
        body = body.replace(separator, b" ")
    table = np.fromstring(body.translate(_EXPONENT), sep=" ").reshape(-1, len(columns))
    wrong = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if wrong.size:
        at = _start_of_row(body, int(wrong[0]))
        raise _row_error(body, at, f"{expected}, of a size that a double holds", path, first_line)
    return table


def parse_real(text: str) -> float:
    """Return the number in a text, ignoring outer blanks; raise a ValueError for any other text."""
    # Infinities and numbers that exceed the range of a double are refused.
    found = text.strip()
    if _ONE_REAL.fullmatch(found) is None:
        raise ValueError(f"{found[: FILE_TEXT.quoted_characters]!r} is not a number")
    value = float(found.upper().replace("D", "E"))
    if value in (float("inf"), -float("inf")):
        raise ValueError(f"{found[: FILE_TEXT.quoted_characters]!r} is too large a number")
    return value


def parse_reals(body: bytes) -> RealArray | None:
    """Return the numbers separated by blanks and line breaks; None if a word is not a number."""
    if _REALS.fullmatch(body) is None:
        return None
    found = np.fromstring(body.translate(_EXPONENT), sep=" ")
    return found if np.isfinite(found).all() else None


def find_rounding(texts: Sequence[str], values: RealArray) -> RealArray:
    """Return the place value of the last digit of each number in its printed form."""
    # Numbers of one column have the same number of decimals, or the same number of significant
    # digits, and may lack trailing zeros.
    decimals, digits = 0, 1
    for text in texts:
        mantissa, _, exponent = text.strip().lower().replace("d", "e").partition("e")
        whole, _, part = mantissa.partition(".")
        decimals = max(decimals, len(part) - int(exponent or 0))
        digits = max(digits, len((whole + part).lstrip("+-0")))
    size = np.floor(
        np.log10(np.abs(values), where=values != 0.0, out=np.full(len(values), -np.inf))
    )
    return np.asarray(np.maximum(10.0**-decimals, 10.0 ** (size + 1.0 - digits)))


def parse_integer(text: str) -> int:
    """Return the integer in a text, ignoring outer blanks; ValueError for any other text."""
    # Numbers of more than 18 digits are refused, because they may exceed 64 bits.
    found = text.strip()
    if _ONE_WHOLE.fullmatch(found) is None:
        raise ValueError(f"{found[: FILE_TEXT.quoted_characters]!r} is not a whole number")
    return int(found)


def check_last_line(
    body: str | bytes,
    path: str | Path,
    first_line: int = 1,
    harmless: re.Pattern[bytes] | None = None,
) -> None:
    """Refuse a text whose last line does not end, unless that line matches `harmless`."""
    raw = body.encode("utf-8", "replace") if isinstance(body, str) else body
    if not raw or raw.endswith((b"\n", b"\r")):
        return
    last = raw[max(raw.rfind(b"\n"), raw.rfind(b"\r")) + 1 :]
    if harmless is None or harmless.fullmatch(last.strip()) is None:
        raise FormatError(
            f"the last line, {_format_text(last)}, does not end: the file may be truncated; if it"
            " is complete, add a line break",
            path,
            first_line + raw.count(b"\n"),
        )


def _lines(columns: str, commas: bool, separator: bytes, comment: bytes) -> re.Pattern[bytes]:
    """Return a pattern of all lines before the first invalid one."""
    margin = rb"[ \t]*+"
    between = _COMMA if commas else _BLANKS
    behind = rb"(?:[ \t]*+,)?" if commas else b""
    if separator:  # it may be a tab
        margin = rb" *+"
        between = margin + re.escape(separator) + margin
        behind = rb"(?: *+" + re.escape(separator) + rb")?"
    row = between.join(
        _repeat_pattern(letter, len(list(same)), between) for letter, same in groupby(columns)
    )
    kinds = [row + behind]
    if comment:
        kinds.append(re.escape(comment) + rb"[^\n]*+")
    return re.compile(rb"(?:" + margin + rb"(?:" + b"|".join(kinds) + rb")?[ \t]*+\r?\n)*+")


def _repeat_pattern(letter: str, count: int, between: bytes) -> bytes:
    number = _WHOLE if letter == "i" else _REAL
    if count == 1:
        return number
    return number + rb"(?:" + between + number + rb"){%d}+" % (count - 1)


def _start_of_row(body: bytes, number: int) -> int:
    """Return the start of row `number`, counted from 0 without empty lines."""
    rows = re.finditer(rb"(?m)^[ \t]*+[^\s].*$", body)
    return next(found.start() for at, found in enumerate(rows) if at == number)


def _row_error(
    body: bytes, at: int, expected: str, path: str | Path, first_line: int
) -> FormatError:
    line = body[at:].split(b"\n", 1)[0]
    number = first_line + body.count(b"\n", 0, at)
    return FormatError(f"found {_format_text(line)}; expected {expected}", path, number)


def _format_text(line: bytes) -> str:
    return repr(line.decode("ascii", "backslashreplace").strip()[: FILE_TEXT.quoted_characters])
