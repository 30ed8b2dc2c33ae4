"""Meshes as plain data, by meshio."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import FormatError, ModelError
from updyn.foreign import xdmf
from updyn.foreign.plain import Other

try:
    import meshio
except ImportError as error:
    raise ModelError('mesh files need meshio: pip install "updyn[mesh]"') from error

__all__ = ["load"]


def load(path: str) -> dict[str, Any]:
    """Load a mesh.

    Parameters
    ----------
    path : str
        The file.

    Returns
    -------
    dict
        ``points``, array; ``cells``, a list of [kind, number of dimensions, array of nodes];
        ``point_sets``, arrays by name; ``cell_sets``, by name a list of an array for each of the
        cells, None or `Other`; ``physical``, the tags of Gmsh for each of the cells; ``names``, by
        name of a physical group its tag and number of dimensions.

    Raises
    ------
    FormatError
        If it is damaged, or its numbers stand in another file that is not beside it.
    """
    if Path(path).suffix.lower() in xdmf.SUFFIXES:
        xdmf.check(path)
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            found = meshio.read(path)
    # meshio prints why, and ends the process on some bad files.
    except (meshio.ReadError, SystemExit) as error:
        reason = repr(error)
        for line in (*printed.getvalue().splitlines(), str(error)):
            if line.strip() not in ("", "1"):
                reason = line.strip()
                break
        raise FormatError(f"not a mesh that can be read ({reason})", path) from error
    sets = {}
    for name, members in found.cell_sets.items():
        sets[str(name)] = list(map(_members, members))
    return {
        "points": np.asarray(found.points),
        "cells": [[c.type, int(c.dim), np.asarray(c.data)] for c in found.cells],
        "point_sets": {str(name): np.asarray(m) for name, m in found.point_sets.items()},
        "cell_sets": sets,
        "physical": list(map(np.asarray, found.cell_data.get("gmsh:physical", []))),
        "names": {str(name): np.asarray(tag) for name, tag in found.field_data.items()},
    }


def _members(positions: Any) -> Any:
    """Return the members of a set in one block of cells."""
    if positions is None:
        return None
    try:
        return np.asarray(positions, dtype=np.int64)
    except (TypeError, ValueError):  # lists of other sets
        return Other("sets")
