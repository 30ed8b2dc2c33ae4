"""True values of unknowns from a file: of a simulated structure, whose truth is known."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from updyn.errors import FormatError, suggest
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["read_truth"]


def read_truth(path: str | Path, parameters: ParameterSet) -> dict[str, float]:
    """Read true values of unknowns.

    Parameters
    ----------
    path : path
        TOML or JSON (told by its suffix): names with values, such as ``"part 1.stiffness" = 0.8``,
        or a table for each group, ``["part 1"]`` with ``stiffness = 0.8``.
    parameters : ParameterSet
        The unknowns.

    Returns
    -------
    dict of str to float
        By unknown, in the order of the file. Not every unknown has to be there.

    Raises
    ------
    FormatError
        If the file is not there or cannot be read, names something that is no unknown, or holds no
        number for it.
    """
    path = Path(path)
    found: dict[str, float] = {}
    for name, value in _named(_content(path), ""):
        if name not in parameters.names:
            raise FormatError(
                f"{name!r} is no unknown of the job; {suggest(name, parameters.names)}", path
            )
        number = (
            isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        )
        if not number:
            raise FormatError(f"{name!r}: expected a finite number, found {value!r}", path)
        if name in found:
            raise FormatError(f"{name!r} stands twice", path)
        found[name] = float(value)
    if not found:
        raise FormatError(
            'holds no true value; expected lines such as "part 1.stiffness" = 0.8', path
        )
    return found


def _content(path: Path) -> Mapping[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise FormatError(f"the true values cannot be read: {why}", path) from error
    try:
        content = json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        kind = "JSON" if path.suffix.lower() == ".json" else "TOML"
        raise FormatError(f"not {kind}: {error}", path) from error
    if not isinstance(content, dict):
        raise FormatError(f"expected names with values, found a {type(content).__name__}", path)
    return content


def _named(table: Mapping[str, Any], before: str) -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        name = f"{before}.{key}" if before else key
        if isinstance(value, dict):
            yield from _named(value, name)
        else:
            yield name, value
