"""Universal files (UFF, UNV): FRFs, time records, modes, shapes, geometry and units."""

from updyn.io.uff.frf import read_frf, read_geometry
from updyn.io.uff.modes import read_modes
from updyn.io.uff.records import read_records
from updyn.io.uff.shapes import write_modes, write_shapes
from updyn.io.uff.writing import write_frf

__all__ = [
    "read_frf",
    "read_geometry",
    "read_modes",
    "read_records",
    "write_frf",
    "write_modes",
    "write_shapes",
]
