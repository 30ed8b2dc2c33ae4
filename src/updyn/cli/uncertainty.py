"""`UNCERTAINTY`: files of `updyn.write_uncertainty`, for ``updyn info``."""

from __future__ import annotations

from pathlib import Path

from updyn.cli.reading import FileKind
from updyn.errors import InputError
from updyn.store.netcdf import read_dataset
from updyn.store.uncertainty import read_uncertainty

__all__ = ["UNCERTAINTY"]


def _is_of_uncertainty(path: Path) -> bool:
    """Return whether a file was written by `updyn.write_uncertainty`."""
    try:
        read_dataset(path, "uncertainty", "draws or profiles")
    except InputError:
        return False
    return True


#: Draws and profiles; a separate module, because it imports `updyn.uncertainty`.
UNCERTAINTY = FileKind(
    "draws or profiles",
    read_uncertainty,
    lambda found: found.summary(),
    _is_of_uncertainty,
    is_tried=False,
)
