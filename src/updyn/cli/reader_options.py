"""Options of readers on the command line: ``KEY=VALUE``, as a job file writes them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from typing import Any

from updyn.errors import InputError

__all__ = ["parse_reader_options"]


def parse_reader_options(texts: Iterable[str] | None, flag: str) -> dict[str, Any]:
    """Return the options of ``KEY=VALUE`` texts.

    A value is TOML, such as ``2``, ``true``, ``["PROD 16"]`` or ``{freq = "f"}``; other text is
    taken as it is.
    """
    found: dict[str, Any] = {}
    for text in texts or ():
        key, separator, value = (part.strip() for part in text.partition("="))
        if not separator or not key.isidentifier():
            raise InputError(f"{flag} {text!r}: expected KEY=VALUE, such as spc=2")
        if key in found:
            raise InputError(f"{flag} {text!r}: {key} is given twice")
        found[key] = _parse_value(value)
    return found


def _parse_value(text: str) -> object:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
