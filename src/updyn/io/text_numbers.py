"""Numbers in a text, checked against a grammar before they are converted.

A converter that stops at the first character which it does not know reads ``2.0D+05`` as 2 and
``1,5`` as 1, and `float` and `int` of Python read ``1_5`` as 15. Here every character has to be
part of a number as programs write them, else the text is refused. Exponents may have ``E`` or
``D``, as Fortran writes them.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError

__all__ = ["check_last_line", "number_rows", "real_of", "reals", "rounding_of", "whole_of"]

#: Whole numbers of at most 15 digits: they are exact as doubles.
_WHOLE = rb"[+-]?[0-9]{1,15}+"
_REAL = rb"[+-]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)(?:[eEdD][+-]?[0-9]++)?"
_BLANKS = rb"[ \t]++"
_COMMA = rb"(?:[ \t]*+,[ \t]*+|[ \t]++)"
_ONE_REAL = re.compile(_REAL.decode())
_ONE_WHOLE = re.compile(r"[+-]?[0-9]{1,18}+")
_REALS = re.compile(rb"(?:\s*+" + _REAL + rb"(?=\s|\Z))*+\s*+")
_SHOWN = 60  # characters of a line in a message
_EXPONENT = bytes.maketrans(b"dD,", b"ee ")


def number_rows(
    body: bytes,
    columns: str,
    expected: str,
    path: str | Path,
    first_line: int = 1,
    *,
    commas: bool = False,
    separator: bytes = b"",
    comment: bytes = b"",
) -> NDArray[np.float64]:
    """Read rows of numbers, one a line; empty lines are passed over.

    Parameters
    ----------
    body : bytes
        The lines. The last one has to end with a line break.
    columns : str
        A letter for each number of a row: "i" for a whole one, "r" for a real one.
    expected : str
        What the columns are, for messages: ``"row, column, entry"``.
    path : path
        The file, for messages.
    first_line : int
        Line of the file on which `body` begins.
    commas : bool
        Whether numbers may stand between commas, too, and a comma after the last.
    separator : bytes
        What stands between two numbers instead of blanks, once, and perhaps after the last.
    comment : bytes
        What lines of comment start with, if there are any.

    Returns
    -------
    ndarray of float, shape (n, len(columns))
        The numbers; all are finite.

    Raises
    ------
    FormatError
        If a line is anything else, does not end, or a number is too large; the message says which.
    """
    check_last_line(body, path, first_line)
    end = _lines(columns, commas, separator, comment).match(body)
    assert end is not None  # no line at all matches, too
    if end.end() < len(body):
        raise _refused(body, end.end(), expected, path, first_line)
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
        raise _refused(body, at, f"{expected}, of a size that a double holds", path, first_line)
    return table


def real_of(text: str) -> float:
    """Return the number that a text is; blanks around it do not matter.

    Raises
    ------
    ValueError
        If the text is anything else: no infinity, no number that a double cannot hold.
    """
    found = text.strip()
    if _ONE_REAL.fullmatch(found) is None:
        raise ValueError(f"{found[:_SHOWN]!r} is not a number")
    value = float(found.upper().replace("D", "E"))
    if value in (float("inf"), -float("inf")):
        raise ValueError(f"{found[:_SHOWN]!r} is too large a number")
    return value


def reals(body: bytes) -> NDArray[np.float64] | None:
    """Return the numbers that stand between blanks and line breaks; None if a word is none."""
    if _REALS.fullmatch(body) is None:
        return None
    found = np.fromstring(body.translate(_EXPONENT), sep=" ")
    return found if np.isfinite(found).all() else None


def rounding_of(texts: Sequence[str], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the place value of the last digit of each number, as a program has printed it.

    Numbers of one column have the same number of decimals, or the same number of significant
    digits, and may lack zeros at their end.

    Parameters
    ----------
    texts : sequence of str
        The numbers as they are printed.
    values : ndarray of float, shape (len(texts),)
        The same numbers.

    Returns
    -------
    ndarray of float, shape (len(texts),)
    """
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


def whole_of(text: str) -> int:
    """Return the whole number that a text is; blanks around it do not matter.

    Raises
    ------
    ValueError
        If the text is anything else, or has more than 18 digits: it might not fit 64 bits.
    """
    found = text.strip()
    if _ONE_WHOLE.fullmatch(found) is None:
        raise ValueError(f"{found[:_SHOWN]!r} is not a whole number")
    return int(found)


def check_last_line(
    body: str | bytes,
    path: str | Path,
    first_line: int = 1,
    harmless: re.Pattern[bytes] | None = None,
) -> None:
    """Refuse a text whose last line does not end: it may be cut short, even within a number.

    Parameters
    ----------
    body : str or bytes
        The text.
    path : path
        The file, for the message.
    first_line : int
        Line of the file on which `body` begins.
    harmless : re.Pattern, optional
        Last lines that are whole, or mean nothing, as they are.

    Raises
    ------
    FormatError
        If the last character is no line break.
    """
    raw = body.encode("utf-8", "replace") if isinstance(body, str) else body
    if not raw or raw.endswith((b"\n", b"\r")):
        return
    last = raw[max(raw.rfind(b"\n"), raw.rfind(b"\r")) + 1 :]
    if harmless is None or harmless.fullmatch(last.strip()) is None:
        raise FormatError(
            f"the last line, {_shown(last)}, does not end: the file may be cut short; if it is"
            " whole, add a line break",
            path,
            first_line + raw.count(b"\n"),
        )


def _lines(columns: str, commas: bool, separator: bytes, comment: bytes) -> re.Pattern[bytes]:
    """Return a pattern of all lines up to the first that is not as described."""
    margin = rb"[ \t]*+"
    between = _COMMA if commas else _BLANKS
    behind = rb"(?:[ \t]*+,)?" if commas else b""
    if separator:  # which may be a tab
        margin = rb" *+"
        between = margin + re.escape(separator) + margin
        behind = rb"(?: *+" + re.escape(separator) + rb")?"
    row = between.join(
        _repeated(letter, len(list(same)), between) for letter, same in groupby(columns)
    )
    kinds = [row + behind]
    if comment:
        kinds.append(re.escape(comment) + rb"[^\n]*+")
    return re.compile(rb"(?:" + margin + rb"(?:" + b"|".join(kinds) + rb")?[ \t]*+\r?\n)*+")


def _repeated(letter: str, count: int, between: bytes) -> bytes:
    """Return a pattern of so many numbers of one kind."""
    number = _WHOLE if letter == "i" else _REAL
    if count == 1:
        return number
    return number + rb"(?:" + between + number + rb"){%d}+" % (count - 1)


def _start_of_row(body: bytes, number: int) -> int:
    """Return where the row of that number begins, counted from 0 and without empty lines."""
    rows = re.finditer(rb"(?m)^[ \t]*+[^\s].*$", body)
    return next(found.start() for at, found in enumerate(rows) if at == number)


def _refused(body: bytes, at: int, expected: str, path: str | Path, first_line: int) -> FormatError:
    line = body[at:].split(b"\n", 1)[0]
    number = first_line + body.count(b"\n", 0, at)
    return FormatError(f"found {_shown(line)}; expected {expected}", path, number)


def _shown(line: bytes) -> str:
    return repr(line.decode("ascii", "backslashreplace").strip()[:_SHOWN])
