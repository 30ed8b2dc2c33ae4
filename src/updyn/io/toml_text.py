"""TOML texts, read so that all which is wrong with one is one kind of error.

`tomllib` follows nested brackets until the interpreter's stack ends, hands on whole numbers of any
size, of which no double and no 64 bits hold some, and takes the first half of a number at the end
of a file that is cut short for a number.
"""

from __future__ import annotations

import re
import tomllib
from typing import Any

__all__ = ["parse_toml"]

_DEEPEST = 50
_LARGEST = 2**63 - 1
#: A last line of which a cut may have left a part of a number: all else has an end of its own.
_CUT = re.compile(r"^[^\n#]*=[^\n\"'#\]}]*[0-9_.]\Z", re.MULTILINE)
_LONG = re.compile(r"(?<![\w.\"'])[+-]?[0-9][0-9_]{18,}")


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML text.

    Parameters
    ----------
    text : str
        The document.

    Returns
    -------
    dict
        As `tomllib` reads it.

    Raises
    ------
    tomllib.TOMLDecodeError
        If the text is not TOML, its tables and arrays are nested more than 50 deep, a whole number
        does not fit 64 bits, or the last line is a number without a line break.
    """
    cut = _CUT.search(text)
    if cut is not None:
        raise tomllib.TOMLDecodeError(
            f"the last line, {cut[0].strip()[:60]!r}, does not end: the file may be cut short; if"
            f" it is whole, add a line break{_place(text, cut.start())}"
        )
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise _too_deep() from error
    except ValueError as error:  # a whole number of more digits than Python converts
        raise _too_large(text) from error
    _check(document, text)
    return document


def _check(document: dict[str, Any], text: str) -> None:
    """Walk through all values, level by level."""
    level: list[Any] = [document]
    for _ in range(_DEEPEST):
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                below += value.values()
            elif isinstance(value, list):
                below += value
            elif isinstance(value, int) and abs(value) > _LARGEST:
                raise _too_large(text)
        if not below:
            return
        level = below
    raise _too_deep()


def _too_deep() -> tomllib.TOMLDecodeError:
    return tomllib.TOMLDecodeError(f"tables or arrays are nested more than {_DEEPEST} deep")


def _too_large(text: str) -> tomllib.TOMLDecodeError:
    found = _LONG.search(text)
    place = "" if found is None else _place(text, found.start())
    return tomllib.TOMLDecodeError(f"a whole number does not fit 64 bits{place}")


def _place(text: str, at: int) -> str:
    """Return a place as `tomllib` says it."""
    line, column = text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)
    return f" (at line {line}, column {column})"
