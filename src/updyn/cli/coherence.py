"""`COHERENCE`: coherence without FRFs in a MATLAB file, for ``updyn info``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from updyn.cli.reading import FileKind
from updyn.errors import InputError
from updyn.io.formats import find_format
from updyn.io.matlab import read_coherence
from updyn.io.testlab_mat import Functions

__all__ = ["COHERENCE"]


def _is_of_coherence(path: Path) -> bool:
    try:
        if find_format(path, "read_frf").name != "mat":
            return False
        read_coherence(path)
    except InputError:
        return False
    return True


def _describe(found: Functions) -> str:
    """Return lines, pairs and size of the coherence, as text."""
    values = np.stack([*found.values.values()])
    pairs = ", ".join("/".join(pair) for pair in found.values)
    return (
        f"Coherence without FRFs: {len(found.freq)} lines from {found.freq[0]:g} to"
        f" {found.freq[-1]:g} Hz\n"
        f"{len(found.values)} pairs of response and reference: {pairs}\n"
        f"median {np.median(values):.3f}, lowest {values.min():.3f}\n"
        "to use it, save its structs and those of the FRFs in one file"
    )


#: Coherence alone; recognised by its content, after all other kinds.
COHERENCE = FileKind("coherence", read_coherence, _describe, _is_of_coherence, is_tried=False)
