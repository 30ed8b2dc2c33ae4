"""Checks of numbers that users give: of draws, starts and evaluations, and probabilities."""

from __future__ import annotations

from typing import Any

import numpy as np

from updyn.errors import OptionError

__all__ = ["check_count", "check_level"]


def check_count(name: str, value: Any, what: str, least: int, most: int) -> int:
    """Return a whole number given by the user; raise OptionError if it is not in the range."""
    is_whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not is_whole or value < least:
        raise OptionError(
            f"{name} = {value!r}: expected a number of {what} from {least} up", key=(name,)
        )
    if value > most:
        raise OptionError(
            f"{name} = {value}: expected at most {most:,} {what}, as each takes time and memory",
            key=(name,),
        )
    return int(value)


def check_level(level: float, name: str = "level", example: float = 0.95) -> float:
    """Return a probability given by the user; raise OptionError if it is not between 0 and 1."""
    if not 0.0 < level < 1.0:
        raise OptionError(
            f"{name} = {level!r}: expected a share between 0 and 1, such as {example:g}",
            key=(name,),
        )
    return level
