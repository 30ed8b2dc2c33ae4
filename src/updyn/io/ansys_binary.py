"""What the binary files of Ansys Mechanical APDL have in common: records, header, units, names of DOFs.

Read through ansys-mapdl-reader (extra ``updyn[ansys]``). It trusts what a file says about itself, so that lengths are
checked here before it is asked. A record is a word (4 bytes) with the number n of words that follow, a word of flags,
n words, and the number again (Ansys Programmer's Reference, "Format of Binary Data Files").
"""

from __future__ import annotations

import importlib
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.errors import FormatError, OptionError
from updyn.io.consistent_units import UNITS, System, system
from updyn.io.guard import library, placed

__all__ = ["DOF_NAMES", "BinaryFile", "labels_of", "mapdl_reader"]

_WORD = 4
_HEADER = 100  # words
_PACKAGE = "ansys.mapdl.reader"

#: DOF reference numbers of Ansys (fdemat.inc, fdfull.inc); the first six are the directions of a `Dof`, in its order.
DOF_NAMES: Mapping[int, str] = {
    **dict(enumerate(("UX", "UY", "UZ", "ROTX", "ROTY", "ROTZ", "AX", "AY", "AZ", "VX", "VY", "VZ"), 1)),
    **dict(enumerate(("PRES", "TEMP", "VOLT", "MAG", "ENKE", "ENDS", "EMF", "CURR"), 19)),
}

_FILES = {2: ".emat", 4: ".full", 8: ".sub", 9: ".mode", 12: ".rst"}
#: What /UNITS writes into the header (Programmer's Reference, standard header, item 5), as far as it is one of ours.
_UNITS = {1: "m", 4: "in", 5: "m", 6: "mm"}
_UNIT_NAMES = {1: "SI", 2: "CGS", 3: "BFT", 4: "BIN", 5: "MKS", 6: "MPA", 7: "uMKS"}


def mapdl_reader(module: str = "") -> Any:
    """Import ansys-mapdl-reader, or one of its modules.

    Parameters
    ----------
    module : str
        Name of the module within the package; empty: the package.

    Raises
    ------
    OptionError
        If it is not installed or cannot be loaded; the message says what to install.
    """
    try:
        return importlib.import_module(f"{_PACKAGE}.{module}" if module else _PACKAGE)
    except (ImportError, OSError) as error:
        raise OptionError(
            f"files of Ansys are read through ansys-mapdl-reader, which cannot be loaded ({error}): "
            "pip install 'updyn[ansys]'"
        ) from error


class BinaryFile:
    """A binary file of Ansys, record by record.

    Parameters
    ----------
    path : path
        The file.
    kind : int
        Number of the file type that it has to be: 2 ``.emat``, 4 ``.full``.

    Raises
    ------
    FormatError
        If it is not a file of that type, is of the other byte order, or is cut short in its header.
    OptionError
        If ansys-mapdl-reader is missing.
    """

    def __init__(self, path: str | Path, kind: int) -> None:
        self.path = Path(path)
        self._words = self.path.stat().st_size // _WORD
        with self.path.open("rb") as file:
            start = file.read((_HEADER + 3) * _WORD)
        if len(start) < (_HEADER + 3) * _WORD or struct.unpack("<i", start[:4])[0] != _HEADER:
            swapped = len(start) >= 4 and struct.unpack(">i", start[:4])[0] == _HEADER
            why = "it is big-endian, of a machine that is not read" if swapped else "no complete header of Ansys"
            raise FormatError(f"not a binary file of Ansys: {why}", path)
        header = struct.unpack(f"<{_HEADER}i", start[8 : 8 + _HEADER * _WORD])
        if header[0] != kind:
            found = _FILES.get(header[0], f"type {header[0]}")
            raise FormatError(f"is a {found} file of Ansys by its header, expected {_FILES[kind]}", path)
        self._unit = header[4]
        self._record = mapdl_reader("common").AnsysBinary()
        self._record.filename = str(self.path)

    def record(self, at: int, what: str, kinds: str = "iuf") -> tuple[NDArray[Any], int]:
        """Read one record.

        Parameters
        ----------
        at : int
            Where it starts, in words.
        what : str
            What is expected there, for the message.
        kinds : str
            NumPy kinds of numbers that it may hold.

        Returns
        -------
        values : ndarray
            What it holds.
        after : int
            Where the next one starts, in words.

        Raises
        ------
        FormatError
            If there is no whole record, or it holds numbers of another kind.
        """
        after = self.after(at, what)
        with library(self.path, "binary file of Ansys"):
            values = np.asarray(self._record.read_record(at))
        if values.dtype.kind not in kinds:
            raise FormatError(f"{what}: the record at word {at} holds {values.dtype}", self.path)
        return values, after

    def after(self, at: int, what: str, count: int = 1) -> int:
        """Check that whole records stand at a word, and return where the next one starts.

        Parameters
        ----------
        at : int
            Where the first one starts, in words.
        what : str
            What is expected there, for the message.
        count : int
            How many.

        Raises
        ------
        FormatError
            If there are not as many whole records.
        """
        with self.path.open("rb") as file:
            for _ in range(count):
                length = self._word(file, at, what)
                end = at + 2 + length
                if length < 0 or self._word(file, end, what) != length:
                    raise FormatError(f"{what}: no whole record at word {at} of {self._words}: damaged", self.path)
                at = end + 1
        return at

    def _word(self, file: BinaryIO, at: int, what: str) -> int:
        if not 0 <= at < self._words:
            raise FormatError(f"{what}: reaches to word {at} of {self._words}: cut short or damaged", self.path)
        file.seek(at * _WORD)
        return int(struct.unpack("<i", file.read(_WORD))[0])

    def units(self, unit: str | None) -> System:
        """Return the units of the numbers: as stated, else as the header says, else SI.

        Parameters
        ----------
        unit : str or None
            What was stated.

        Raises
        ------
        OptionError
            If there is no such unit.
        FormatError
            If the header says another one, or one that has to be converted by hand.
        """
        said = _UNITS.get(self._unit)
        name = _UNIT_NAMES.get(self._unit)
        if name is not None and said is None:
            raise FormatError(
                f"the header says units {name}, which are not converted; solve in one of {', '.join(UNITS)}", self.path
            )
        if unit is None:
            return system(said or "m")
        if said is not None and system(unit).name != said:
            raise FormatError(
                f"unit {unit!r} contradicts the header, which says {name} ({UNITS[said].described})", self.path
            )
        return system(unit)


def labels_of(nodes: NDArray[Any], numbers: NDArray[Any], path: str | Path) -> DofSet:
    """Return DOFs from nodes and Ansys's DOF reference numbers.

    Parameters
    ----------
    nodes : ndarray of int, shape (n,)
        Node numbers.
    numbers : ndarray of int, shape (n,)
        DOF reference numbers, 1 to 6 for UX UY UZ ROTX ROTY ROTZ.
    path : path
        The file, for messages.

    Raises
    ------
    FormatError
        If one is not a displacement or a rotation, or stands twice.
    """
    other = np.flatnonzero((numbers < 1) | (numbers > 6))
    if other.size:
        at = int(other[0])
        name = DOF_NAMES.get(int(numbers[at]), f"number {numbers[at]}")
        more = f" ({other.size} such)" if other.size > 1 else ""
        raise FormatError(
            f"node {nodes[at]} has the degree of freedom {name}{more}; expected displacements and rotations only "
            "(UX UY UZ ROTX ROTY ROTZ): a structure without fields, fluid and multipliers",
            path,
        )
    with placed(path, "degrees of freedom"):
        return DofSet.from_arrays(nodes, numbers - 1)
