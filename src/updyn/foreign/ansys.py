"""Elements and nodes of Ansys files (``.cdb``, ``.rst``) as plain data, by ansys-mapdl-reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from updyn.errors import OptionError

try:
    from ansys.mapdl import reader
except (ImportError, OSError) as error:
    raise OptionError(
        ".cdb and .rst files are read by ansys-mapdl-reader, which cannot be loaded"
        f" ({error}): pip install 'updyn[ansys]'"
    ) from error

__all__ = ["load"]


def load(path: str) -> dict[str, object]:
    """Load elements, their attributes and nodes, components and node positions.

    ``rows`` has attributes and nodes of all elements, one after the other, with the counts in
    ``lengths``; ``routines`` has pairs of element type and routine.
    """
    if Path(path).suffix.lower() == ".rst":
        mesh = reader.read_binary(path).mesh
    else:
        mesh = reader.Archive(path, parse_vtk=False)
    rows = [np.asarray(row, dtype=np.int64) for row in mesh.elem or ()]
    angles = None
    if mesh.node_angles is not None:
        angles = np.asarray(mesh.node_angles, dtype=np.float64)
    components = {}
    for name, part in mesh.element_components.items():
        components[str(name)] = np.asarray(part, dtype=np.int64)
    return {
        "elements": np.asarray(mesh.enum, dtype=np.int64),
        "rows": np.concatenate([np.empty(0, dtype=np.int64), *rows]),
        "lengths": np.array(list(map(len, rows)), dtype=np.int64),
        "routines": np.asarray(mesh.ekey)[:, :2],
        "components": components,
        "nodes": np.asarray(mesh.nnum, dtype=np.int64),
        "xyz": np.asarray(mesh.nodes, dtype=np.float64),
        "angles": angles,
    }
