"""A plant as MATLAB variables without structs, so ``load`` and ``ss`` are sufficient.

``dt`` is 0 for a continuous plant, as for ``ss``; ``comment`` contains the command that makes the
system. All variables: `updyn.control.files.items`. Version 5 is written; 5 to 7.3 are read.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from updyn.control.files.items import build_plant, flat_items, nested_items
from updyn.control.plant import Plant
from updyn.errors import FormatError
from updyn.io.atomic import atomic_path
from updyn.io.matlab import read_variables

__all__ = ["read_plant", "write_plant"]

#: Octave's ``ss`` accepts the same arguments, but has no units.
_LINE = (
    "load('{name}'); sys = ss(A,B,C,D,dt,'InputName',inputs,'OutputName',outputs); "
    "% MATLAB also: set(sys,'InputUnit',input_units,'OutputUnit',output_units)"
)


def write_plant(plant: Plant, path: str | Path) -> None:
    """Write a plant as a version 5 file; raises FormatError for a matrix above 2 GB."""
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    items = flat_items(plant)
    items["facts"] = json.dumps(json.loads(items["facts"]))  # ASCII, which every reader accepts
    items["comment"] = _LINE.format(name=Path(path).name.replace("'", "''"))
    variables = {
        name: np.array(v, dtype=object)[:, None] if isinstance(v, list) else v
        for name, v in items.items()
    }
    variables = {name: float(v) if isinstance(v, int) else v for name, v in variables.items()}
    try:
        with atomic_path(path) as temporary:
            savemat(temporary, variables, appendmat=False, do_compression=True, oned_as="column")
    except MatWriteError as error:
        raise FormatError(
            f"a .mat file of version 5 cannot store this ({error}); write .npz instead", path
        ) from error


def read_plant(path: str | Path) -> Plant:
    """Read a plant; raises FormatError for a damaged file or an invalid variable."""
    found: dict[str, object] = read_variables(path)
    found.pop("comment", None)
    return build_plant(nested_items(found, path), path)
