"""Meshes as plain data, by meshio."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from updyn.errors import FormatError, ModelError
from updyn.foreign import xdmf
from updyn.foreign.hdf5 import HDF5Content
from updyn.foreign.plain import Other

try:
    import meshio
except ImportError as error:
    raise ModelError('mesh files need meshio: pip install "updyn[mesh]"') from error

__all__ = ["load"]


def load(path: str) -> dict[str, object]:
    """Load points, cells, sets and physical groups of a mesh.

    ``cells`` is a list of [kind, number of dimensions, nodes]; ``cell_sets`` and ``physical`` (tags
    of Gmsh) have an entry for each of the cells; ``names`` is tag and number of dimensions by
    group.
    """
    if Path(path).suffix.lower() in xdmf.SUFFIXES:
        xdmf.check(path)
    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            HDF5Content(path, False).group(file)  # refuses links, which meshio would follow
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            found = meshio.read(path)
    # meshio prints the reason, ends the process for some bad files, and does not check HDF5 groups.
    except (meshio.ReadError, SystemExit, KeyError) as error:
        reason = repr(error)
        for line in (*printed.getvalue().splitlines(), str(error)):
            if line.strip() not in ("", "1"):
                reason = line.strip()
                break
        raise FormatError(f"not a readable mesh ({reason})", path) from error
    sets: dict[str, list[object]] = {}
    for name, members in found.cell_sets.items():
        sets[str(name)] = list(map(_members, members))
    sets |= _families(getattr(found, "cell_tags", {}), found.cell_data.get("cell_tags", []))
    point_sets = {str(name): np.asarray(m) for name, m in found.point_sets.items()}
    if "point_tags" in found.point_data:
        tags = [found.point_data["point_tags"]]
        for name, (members,) in _families(getattr(found, "point_tags", {}), tags).items():
            point_sets[name] = members
    return {
        "points": np.asarray(found.points),
        "cells": [[c.type, int(c.dim), np.asarray(c.data)] for c in found.cells],
        "point_sets": point_sets,
        "cell_sets": sets,
        "physical": list(map(np.asarray, found.cell_data.get("gmsh:physical", []))),
        "names": {str(name): np.asarray(tag) for name, tag in found.field_data.items()},
    }


def _families(names: Mapping[Any, Sequence[str]], tags: Sequence[Any]) -> dict[str, list[Any]]:
    """Return the members of the groups of a MED file in each block, identified by families."""
    groups: dict[str, list[int]] = {}
    for family, members in names.items():
        for name in members:
            groups.setdefault(str(name), []).append(int(family))
    return {
        name: [np.flatnonzero(np.isin(block, families)) for block in tags]
        for name, families in groups.items()
    }


def _members(positions: object) -> object:
    """Return the members of a set in one block of cells."""
    if positions is None:
        return None
    try:
        return np.asarray(positions, dtype=np.int64)
    except (TypeError, ValueError):  # lists of other sets
        return Other("sets")
