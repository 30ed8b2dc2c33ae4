"""TOML texts, with a single kind of error for all faults.

`tomllib` follows nested brackets until the stack of the interpreter overflows, accepts integers of
any size, and reads the remaining half of a number at the end of a truncated file.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from updyn.io.settings import DECK

__all__ = ["format_mapping", "format_toml", "parse_toml"]

_LARGEST = 2**63 - 1
#: A last line that may end with a truncated number; all other values have an end mark.
_CUT = re.compile(r"^[^\n#]*=[^\n\"'#\]}]*[0-9_.]\Z", re.MULTILINE)
_LONG = re.compile(r"(?<![\w.\"'])[+-]?[0-9][0-9_]{18,}")


def parse_toml(text: str) -> dict[str, object]:
    """Parse a TOML text; raise a `tomllib.TOMLDecodeError` for all faults."""
    # Faults include nesting more than 50 deep, integers above 64 bits, and a number as the last
    # line without a line break.
    cut = _CUT.search(text)
    if cut is not None:
        raise tomllib.TOMLDecodeError(
            f"the last line, {cut[0].strip()[:60]!r}, does not end: the file may be truncated; if"
            f" it is complete, add a line break{_place(text, cut.start())}"
        )
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise _depth_error() from error
    except ValueError as error:  # an integer of more digits than Python converts
        raise _size_error(text) from error
    _check(document, text)
    return document


def format_toml(value: object) -> str:
    """Return a value as TOML; keys must be bare."""
    if isinstance(value, dict):
        items = (f"{key} = {format_toml(item)}" for key, item in value.items())
        return "{ " + ", ".join(items) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(format_toml, value)) + "]"
    # Strings and booleans of JSON are valid TOML, except that TOML escapes one more character.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def format_mapping(mapping: Mapping[str, Any]) -> str:
    """Return a mapping of `updyn.io.channels` as TOML, with one channel per line."""
    if "channels" not in mapping:
        return format_toml(dict(mapping))
    items = [f"{key} = {format_toml(v)}" for key, v in mapping.items() if key != "channels"]
    rows = [f"  {format_toml(channel)}," for channel in mapping["channels"]]
    return "\n".join([f"{{ {', '.join([*items, 'channels = ['])}", *rows, "] }"])


def _check(document: dict[str, object], text: str) -> None:
    """Check all values, level by level."""
    level: list[object] = [document]
    for _ in range(DECK.toml_depth):
        below: list[object] = []
        for value in level:
            if isinstance(value, dict):
                below += value.values()
            elif isinstance(value, list):
                below += value
            elif isinstance(value, int) and abs(value) > _LARGEST:
                raise _size_error(text)
        if not below:
            return
        level = below
    raise _depth_error()


def _depth_error() -> tomllib.TOMLDecodeError:
    return tomllib.TOMLDecodeError(f"tables or arrays are nested more than {DECK.toml_depth} deep")


def _size_error(text: str) -> tomllib.TOMLDecodeError:
    found = _LONG.search(text)
    place = "" if found is None else _place(text, found.start())
    return tomllib.TOMLDecodeError(f"a whole number does not fit 64 bits{place}")


def _place(text: str, at: int) -> str:
    line, column = text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)
    return f" (at line {line}, column {column})"
