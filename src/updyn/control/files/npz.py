"""A plant as a NumPy ``.npz`` archive of the items of `updyn.control.files.items`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from updyn.control.files.items import build_plant, flat_items, nested_items
from updyn.control.plant import Plant
from updyn.io.atomic import atomic_path
from updyn.io.npz import read_arrays

__all__ = ["read_plant", "write_plant"]


def write_plant(plant: Plant, path: str | Path) -> None:
    """Write a plant as an archive."""
    # With an open file: for a name without the suffix, numpy appends it.
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            **{name: np.asarray(value) for name, value in flat_items(plant).items()},
        )


def read_plant(path: str | Path) -> Plant:
    """Read a plant; raises FormatError for a damaged archive, pickles or an invalid array."""
    found: dict[str, object] = {}
    for name, array in read_arrays(path).items():
        found[name] = array.ravel().tolist() if array.dtype.kind == "U" else array
    return build_plant(nested_items(found, path), path)
