"""Element matrices of an Ansys ``.emat`` file, one element after another (fdemat.inc).

Each record is taken by its own length, so that full, triangular and diagonal matrices (MASS21,
LUMPM) come out right, and pointers by both halves, as in files above 8 GB.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError
from updyn.io.ansys_binary import BinaryFile

__all__ = ["Element", "ElementFile"]

_KIND = 2
_MATRICES = ("stiffness", "mass", "damping", "stress stiffness")
_HEADER: dict[str, int | tuple[int, int]] = {
    "nume": 1,
    "numdof": 2,
    "lenbac": 4,
    "numCE": 26,
    "ptrDOF": 30,
    "ptrBAC": 31,
    "ptrElm": (32, 20),
    "ptrIDX": (37, 25),
}
_SAMPLE = 200  # elements that tell how triangles are packed


@dataclass(frozen=True, slots=True)
class Element:
    """One element.

    Parameters
    ----------
    number : int
        Element number.
    nodes : ndarray of int, shape (n,)
        Node number of each row.
    dofs : ndarray of int, shape (n,)
        DOF reference number of each row.
    matrices : dict of str to ndarray of float, shape (n, n)
        Those that it has, of "stiffness", "mass", "damping", "stress stiffness", in units of the
        deck.
    """

    number: int
    nodes: NDArray[np.int64]
    dofs: NDArray[np.int64]
    matrices: dict[str, NDArray[np.float64]]


class ElementFile:
    """An ``.emat`` file.

    Parameters
    ----------
    path : path
        The file.

    Attributes
    ----------
    binary : BinaryFile
        Its records.
    elements : ndarray of int, shape (n,)
        Element numbers, in the order of the file.

    Raises
    ------
    FormatError
        If the file is damaged, or holds what the elements alone do not say (internal constraint
        equations).
    """

    def __init__(self, path: str | Path) -> None:
        self.binary = BinaryFile(path, _KIND)
        header = self.binary.header(_HEADER)
        if header["numCE"]:
            raise FormatError(
                f"holds {header['numCE']} internal constraint equations (contact, joints), which no"
                " element shows",
                path,
            )
        self._used = self._table(header["ptrDOF"], "degrees of freedom per node", header["numdof"])
        self._nodes = self._table(header["ptrBAC"], "nodal equivalence table", header["lenbac"])
        self.elements = self._table(header["ptrElm"], "element equivalence table", header["nume"])
        if not len(self.elements):
            raise FormatError("holds no element", path)
        index = self._table(header["ptrIDX"], "element index table", 2 * header["nume"])
        low, high = np.split(index, 2)
        self._at = (high << 32) + (low & 0xFFFFFFFF)
        self._by_rows = True
        self._by_rows = self._packed_by_rows()

    def _table(self, at: int, what: str, length: int) -> NDArray[np.int64]:
        values, _ = self.binary.record(at, what, "i")
        if len(values) != length:
            raise FormatError(
                f"{what}: found {len(values)} numbers, the header says {length}", self.binary.path
            )
        return values.astype(np.int64)

    def __iter__(self) -> Iterator[Element]:
        for i in range(len(self.elements)):
            yield self._read(i)

    def _read(self, i: int) -> Element:
        where = f"element {self.elements[i]}"
        header, at = self.binary.record(int(self._at[i]), where, "i")
        if len(header) < 10:
            raise FormatError(
                f"{where}: its header has {len(header)} numbers, expected 10", self.binary.path
            )
        size = abs(int(header[9]))
        index, at = self.binary.record(at, f"{where}: DOF index table", "i")
        if len(index) != size:
            raise FormatError(
                f"{where}: {size} rows and {len(index)} degrees of freedom; a substructure"
                " (MATRIX50) is not read",
                self.binary.path,
            )
        node, dof = np.divmod(index.astype(np.int64) - 1, len(self._used))
        if size and (node.min() < 0 or node.max() >= len(self._nodes)):
            raise FormatError(
                f"{where}: DOF index {index[np.argmax((node < 0) | (node >= len(self._nodes)))]} is"
                f" not one of {len(self._nodes)} nodes with {len(self._used)} degrees of freedom"
                " each",
                self.binary.path,
            )
        matrices = {}
        for key, what in zip(header[:4], _MATRICES, strict=True):
            if key:
                values, at = self.binary.record(at, f"{where}: {what}", "f")
                matrices[what] = self._square(values.astype(np.float64), size, f"{where}: {what}")
        return Element(int(self.elements[i]), self._nodes[node], self._used[dof], matrices)

    def _square(self, values: NDArray[np.float64], size: int, where: str) -> NDArray[np.float64]:
        """Return a matrix from a record: its length says whether it is full, a triangle or a diagonal."""
        if not np.isfinite(values).all():
            raise FormatError(f"{where} holds numbers that are not finite", self.binary.path)
        if len(values) == size * size:
            full = values.reshape(size, size)
            if size and np.abs(full - full.T).max() > 1e-10 * np.abs(full).max():
                raise FormatError(
                    f"{where} is unsymmetric; expected a symmetric structure", self.binary.path
                )
            return 0.5 * (full + full.T)
        if len(values) == size:
            return np.diag(values)
        if len(values) == size * (size + 1) // 2:
            out = np.zeros((size, size))
            out[np.tril_indices(size) if self._by_rows else np.triu_indices(size)] = values
            return out + out.T - np.diag(out.diagonal())
        raise FormatError(
            f"{where}: {len(values)} numbers fit no matrix of {size} rows, full, triangular or"
            " diagonal",
            self.binary.path,
        )

    def _packed_by_rows(self) -> bool:
        """Return whether a lower triangle is stored row by row, rather than column by column.

        The description does not say. A stiffness that is unpacked in the right order makes no force
        on a structure that is moved as it is: its entries between one row and the same direction of
        all nodes add up to nothing.
        """
        left = []
        for by_rows in (True, False):
            self._by_rows, rest = by_rows, 0.0
            for i in range(min(len(self.elements), _SAMPLE)):
                element = self._read(i)
                K = element.matrices.get("stiffness")
                if K is not None and np.any(K):
                    moved = sum(
                        np.abs(K[:, element.dofs == number].sum(axis=1)).max()
                        for number in (1, 2, 3)
                    )
                    rest += float(moved) / float(np.abs(K).max())
            left.append(rest)
        return left[0] <= left[1]
