"""Records, header, units and DOF names of the binary files of Ansys Mechanical APDL.

A record is a word (4 bytes) with the number n of words in the data, a word of flags, n words, and
the number again (Ansys Programmer's Reference, "Format of Binary Data Files"). ansys-mapdl-reader
returns only upper triangles, and crashes the process for a damaged file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from updyn.arrays import NumberArray
from updyn.dofs import DofSet
from updyn.errors import FormatError, in_all
from updyn.io.consistent_units import UNITS, UnitSystem, find_units
from updyn.io.items import locate_errors

__all__ = ["DOF_NAMES", "BinaryFile", "dofs_of_nodes"]

_WORD = 4
_LOW = 0xFFFFFFFF
_HEADER = 100  # words
#: Bits of the last byte of the flags: integer, and short or single; compressed by zlib or by
#: omitting zeros.
_TYPE = 0xC0
_COMPRESSED = 0x3F
_TYPES = {0x80: "<i4", 0xC0: "<i2", 0x00: "<f8", 0x40: "<f4"}

#: DOF reference numbers of Ansys (fdemat.inc, fdfull.inc); the first six are the directions of a
#: `Dof`, in its order.
DOF_NAMES: Mapping[int, str] = {
    1: "UX",
    2: "UY",
    3: "UZ",
    4: "ROTX",
    5: "ROTY",
    6: "ROTZ",
    7: "AX",
    8: "AY",
    9: "AZ",
    10: "VX",
    11: "VY",
    12: "VZ",
    19: "PRES",
    20: "TEMP",
    21: "VOLT",
    22: "MAG",
    23: "ENKE",
    24: "ENDS",
    25: "EMF",
    26: "CURR",
}

_FILES = {2: ".emat", 4: ".full", 8: ".sub", 9: ".mode", 12: ".rst"}
#: Units that /UNITS writes into the header (Programmer's Reference, standard header, item 5), as
#: far as supported.
_UNITS = {1: "m", 4: "in", 5: "m", 6: "mm"}
_UNIT_NAMES = {1: "SI", 2: "CGS", 3: "BFT", 4: "BIN", 5: "MKS", 6: "MPA", 7: "uMKS"}


class BinaryFile:
    """A binary file of Ansys, read by records; `kind` is 2 for ``.emat``, 4 for ``.full``."""

    def __init__(self, path: str | Path, kind: int) -> None:
        self.path = Path(path)
        size = self.path.stat().st_size // _WORD
        self._words = np.empty(0, dtype="<i4")
        if size:
            self._words = np.memmap(self.path, dtype="<i4", mode="r", shape=(size,))
        if size and self._words[:1].view(">i4")[0] == _HEADER:
            raise FormatError(
                "not a supported binary file of Ansys: expected little-endian byte order", path
            )
        if size < _HEADER + 3 or self._words[0] != _HEADER:
            raise FormatError("not a binary file of Ansys: no complete header", path)
        kind_found = int(self._words[2])
        self._unit = int(self._words[6])
        if kind_found != kind:
            found = _FILES.get(kind_found, f"type {kind_found}")
            raise FormatError(
                f"is a {found} file of Ansys by its header, expected {_FILES[kind]}", path
            )

    def record(self, at: int, what: str, kinds: str = "iuf") -> tuple[NumberArray, int]:
        """Return the values of a record at a word, and the position of the next record in words.

        `kinds` are the allowed NumPy kinds.
        """
        after = self.after(at, what)
        flags = int(self._words[at + 1]) >> 24 & 0xFF
        if flags & _COMPRESSED:
            raise FormatError(
                f"{what}: the record at word {at} is compressed; solve with /FCOMP,...,0", self.path
            )
        words = self._words[at + 2 : after - 1]
        dtype = _TYPES[flags & _TYPE]
        if words.nbytes % np.dtype(dtype).itemsize or np.dtype(dtype).kind not in kinds:
            raise FormatError(
                f"{what}: the record at word {at} holds {words.nbytes} bytes of {dtype}", self.path
            )
        return np.array(words).view(dtype), after

    def after(self, at: int, what: str, count: int = 1) -> int:
        """Return the position after `count` complete records, in words; refuse incomplete ones."""
        for _ in range(count):
            length = self._word(at, what)
            end = at + 2 + length
            if length < 0 or self._word(end, what) != length:
                raise FormatError(
                    f"{what}: no complete record at word {at} of {len(self._words)}: damaged",
                    self.path,
                )
            at = end + 1
        return at

    def _word(self, at: int, what: str) -> int:
        if not 0 <= at < len(self._words):
            raise FormatError(
                f"{what}: extends to word {at} of {len(self._words)}: truncated or damaged",
                self.path,
            )
        return int(self._words[at])

    def header(self, items: Mapping[str, int | tuple[int, int]]) -> dict[str, int]:
        """Return items of the header record that follows the standard header.

        `items` has the position of each item, counted from 0, or of the low and the high half of a
        long one.
        """
        values, _ = self.record(_HEADER + 3, "header", "i")
        last = int(max(np.max(at) for at in items.values()))
        if len(values) <= last:
            raise FormatError(
                f"header: {len(values)} numbers, expected {last + 1}: a release before 14.5?",
                self.path,
            )
        found = {}
        for name, at in items.items():
            if isinstance(at, int):
                found[name] = int(values[at])
            else:
                low, high = at
                found[name] = (int(values[high]) << 32) + (int(values[low]) & _LOW)
        return found

    def units(self, unit: str | None) -> UnitSystem:
        """Return the units of the numbers: `unit`, else the units of the header, else SI."""
        stated = _UNITS.get(self._unit)
        name = _UNIT_NAMES.get(self._unit)
        if name is not None and stated is None:
            raise FormatError(
                f"the header states units {name}, which are not converted; solve in one of"
                f" {', '.join(UNITS)}",
                self.path,
            )
        if unit is None:
            return find_units(stated or "m")
        if stated is not None and find_units(unit).name != stated:
            raise FormatError(
                f"unit {unit!r} contradicts the header, which states {name}"
                f" ({UNITS[stated].description})",
                self.path,
            )
        return find_units(unit)


def dofs_of_nodes(nodes: NumberArray, numbers: NumberArray, path: str | Path) -> DofSet:
    """Return the DOFs of nodes and DOF reference numbers (1 to 6: UX UY UZ ROTX ROTY ROTZ)."""
    other = np.flatnonzero((numbers < 1) | (numbers > 6))
    if other.size:
        at = int(other[0])
        name = DOF_NAMES.get(int(numbers[at]), f"number {numbers[at]}")
        raise FormatError(
            f"node {nodes[at]} has the degree of freedom {name}{in_all(other.size)}; expected"
            " only displacements and rotations (UX UY UZ ROTX ROTY ROTZ): a structure without"
            " fields, fluid and multipliers",
            path,
        )
    with locate_errors(path, "degrees of freedom"):
        return DofSet.from_arrays(nodes, numbers - 1)
