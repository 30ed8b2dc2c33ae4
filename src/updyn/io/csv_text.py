"""Comments, units and numbers of text tables of FRFs and time records."""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import FormatError
from updyn.io.settings import FILE_TEXT
from updyn.io.text_numbers import parse_real
from updyn.units import find_unit

__all__ = [
    "EXCITATION",
    "UNITS",
    "Comments",
    "check_comments",
    "comment",
    "plain_numbers",
    "read_averages",
    "read_decay",
    "read_excitation",
    "single_comment",
    "split_axis",
]

#: Values of comments with their line, by name.
Comments = dict[str, list[tuple[int, str]]]

#: A comment that states a value: name, value.
_COMMENT = re.compile(r"#+\s*([^\W\d_][^:=]{0,30}?)\s*[:=][ \t]?(.*)")
#: Names of comments that state the unit of all values.
UNITS = ("unit", "units")
#: Comments on the excitation.
EXCITATION = ("base", "force", "level", "sweep", "excitation", "spectrum")
#: Names of comments that would change the meaning of the numbers and are not supported.
_MEANINGS = {
    *UNITS,
    *(f"{what} {unit}" for what in ("time", "x", "y", "abscissa", "ordinate") for unit in UNITS),
    *(f"{what} {unit}" for what in ("freq", "frequency", "phase", "value") for unit in UNITS),
    *("scale", "scaling", "scale factor", "factor", "multiplier", "offset", "gain"),
    *("db", "db reference", "reference level"),
}

#: A name and the unit of an axis: "freq_kHz", "freq (Hz)", "t/ms", "time [ms]".
_AXIS = re.compile(r"(\w+?)\s*(?:[/_ ]\s*(\S.*)|\[([^\[\]]*)\]|\(([^()]*)\))")

#: A decimal comma that cannot separate thousands: not followed by three digits, or preceded by
#: digits that cannot start a grouped number.
_DECIMAL_COMMA = re.compile(r"(?<![\d,])(?:0\d*|\d{4,}),\d|,(?:\d{1,2}|\d{4,})(?!\d)")


def comment(line: str) -> tuple[str, str] | None:
    """Return name and value in a comment line, or None."""
    found = _COMMENT.fullmatch(line.strip())
    if found is None:
        return None
    return " ".join(found[1].replace("_", " ").split()).casefold(), found[2]


def check_comments(
    comments: Iterable[tuple[int, str]], known: Collection[str], remedy: str, path: str | Path
) -> None:
    """Refuse comments that change the meaning of the numbers, except those that are read.

    `known` are names of comments that the reader supports; their misspellings are refused too.
    """
    for number, line in comments:
        shown = f"comment {line.strip()[:60]!r}"
        for name in _names(line, known):
            if name in _MEANINGS:
                raise FormatError(
                    f"{shown}: {name!r} would change the numbers and is not supported; {remedy}, or"
                    " delete the line",
                    path,
                    number,
                )
            least = FILE_TEXT.misspelt_similarity
            close = difflib.get_close_matches(name, known, n=1, cutoff=least)
            if close:
                raise FormatError(
                    f"{shown}: unknown name {name!r}; did you mean {close[0]!r}?", path, number
                )


def _names(line: str, known: Collection[str]) -> list[str]:
    """Return the names to which a comment assigns values; empty if the first one is known."""
    stated = comment(line)
    if stated is not None and stated[0] in known:
        return []
    parts = [comment("#" + part) for part in re.split("[,;]", line.strip().lstrip("#"))]
    return [part[0] for part in parts if part is not None]


def split_axis(cell: str, names: Collection[str], kind: str) -> tuple[str, str] | None:
    """Return name and unit of an axis in a header cell such as ``"t/ms"`` or ``"Time (s)"``."""
    found = _AXIS.fullmatch(cell)
    if found is None or found[1].casefold() not in names:
        return None
    unit = found[2] or found[3] or found[4] or ""
    return (found[1], unit.strip()) if find_unit(unit, kind) else None


def plain_numbers(rows: str, separator: str) -> str:
    """Return rows with decimal points, ASCII minus signs and no quotes around cells.

    Decimal commas are converted if the separator is another character, no number has a point, and
    at least one comma cannot separate thousands.
    """
    rows = rows.replace("\u2212", "-")
    if '"' in rows:
        rows = re.sub(
            r'"([^"\n]*)"', lambda cell: cell[0] if separator in cell[1] else cell[1], rows
        )
    if separator != "," and "." not in rows and _DECIMAL_COMMA.search(rows):
        rows = rows.replace(",", ".")
    return rows


def single_comment(head: Comments, name: str, path: str | Path) -> str | None:
    """Return the value of a comment that may be stated once; None without it."""
    found = {value.strip(): None for _, value in head.get(name, [])}
    if len(found) > 1:
        raise FormatError(f"{name} is stated twice: {' and '.join(sorted(found))}", path)
    return next(iter(found), None)


def read_averages(head: Comments, path: str | Path) -> int | None:
    """Return the number of averages that a comment states; None without it."""
    stated = single_comment(head, "averages", path)
    if stated is None:
        return None
    if not re.fullmatch(r"[0-9]+", stated):
        raise FormatError(f"averages: {stated!r}; expected a whole number of at least 1", path)
    return int(stated)


def read_excitation(head: Comments, path: str | Path) -> dict[str, Any]:
    """Return base, force and level with its kind that comments state, as items."""
    stated = {name: single_comment(head, name, path) for name in EXCITATION}
    items: dict[str, Any] = {name: text for name, text in stated.items() if text is not None}
    if "base" in items:
        items["base"] = items["base"].split()
    if "level" in items:
        try:
            levels = np.array([parse_real(cell) for cell in items["level"].split()])
        except ValueError as error:
            raise FormatError(
                f"level: {items['level']!r}; expected a number in N, or one for each line", path
            ) from error
        items["level"] = levels if len(levels) > 1 else levels[0]
    if "spectrum" in items:
        rows = [row.split() for row in items["spectrum"].split(";")]
        try:
            items["spectrum"] = np.array([[parse_real(cell) for cell in row] for row in rows])
        except ValueError as error:
            raise FormatError(
                "spectrum: expected pairs of a frequency in Hz and a density in N^2/Hz, such as"
                f" '5 0.02; 100 0.02', found {items['spectrum'][:40]!r}",
                path,
            ) from error
    return items


def read_decay(head: Comments, path: str | Path) -> float:
    """Return the decay rate in 1/s that a comment states, by default 0."""
    stated = single_comment(head, "decay", path)
    if stated is None:
        return 0.0
    try:
        return parse_real(stated)
    except ValueError as error:
        raise FormatError(f"decay: {stated!r}; expected a number in 1/s", path) from error
