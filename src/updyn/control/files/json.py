"""A plant as JSON: numbers with all digits, one line per row of a matrix."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from updyn.control.files.items import build_plant, plant_items
from updyn.control.plant import Plant
from updyn.errors import FormatError
from updyn.io.atomic import atomic_path
from updyn.io.items import refuse_repeated_names
from updyn.store.values import from_text, to_text

__all__ = ["read_plant", "write_plant"]


def write_plant(plant: Plant, path: str | Path) -> None:
    """Write a plant with the names of `updyn.control.files.items`."""
    rows = []
    for name, value in plant_items(plant).items():
        rows.append(f"  {json.dumps(name)}: {_laid_out(value)}")
    text = "{\n" + ",\n".join(rows) + "\n}\n"
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def read_plant(path: str | Path) -> Plant:
    """Read a plant; raises FormatError with the line for invalid JSON, or for an invalid item."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
        items = json.loads(text, object_pairs_hook=refuse_repeated_names)
    except json.JSONDecodeError as error:
        message = f"not JSON: {error.msg} (column {error.colno}); truncated or damaged?"
        raise FormatError(message, path, error.lineno) from error
    except (RecursionError, ValueError) as error:
        raise FormatError(f"not JSON as updyn writes it: {error}", path) from error
    if not isinstance(items, dict):
        raise FormatError(f"found a {type(items).__name__}; expected the items of a plant", path)
    found = {}
    for name, value in items.items():
        found[name] = from_text(json.dumps(value), name, path)
    return build_plant(found, path)


def _laid_out(value: object) -> str:
    if isinstance(value, np.ndarray) and value.ndim == 1:
        value = value.tolist()
    rows = value.tolist() if isinstance(value, np.ndarray) else value
    if isinstance(rows, list) and rows and all(isinstance(r, list | dict) for r in rows):
        return "[\n" + ",\n".join(f"    {to_text(row, 'a plant')}" for row in rows) + "\n  ]"
    return to_text(rows, "facts of a plant")
