"""The blocks of Z for retained and eliminated DOFs: where their entries stand, found once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dynamics.affine import AffineSystem

__all__ = ["Partition"]


@dataclass(frozen=True, slots=True, eq=False)
class Partition:
    """Blocks of Z on one pattern.

    Attributes
    ----------
    retained, eliminated : ndarray of int
        DOFs, n and s of them.
    nn, sn : sparse CSR of int
        Position of each entry of the block among the values of Z.
    ss : sparse CSC of complex
        The block of the line that was asked for last: its pattern is checked once, its memory
        serves every line.
    ss_places : ndarray of int
        Position of each of its entries among the values of Z.
    """

    retained: NDArray[np.intp]
    eliminated: NDArray[np.intp]
    nn: Any
    sn: Any
    ss: Any
    ss_places: NDArray[Any]

    @classmethod
    def find(cls, system: AffineSystem, retained: NDArray[np.intp]) -> Partition:
        """Find the blocks for some retained DOFs, in the order wanted."""
        n = system.n
        keep = np.zeros(n, dtype=np.bool_)
        keep[retained] = True
        eliminated = np.flatnonzero(~keep)
        counted = np.arange(len(system.indices), dtype=system.indptr.dtype)
        places = sp.csr_array((counted, system.indices, system.indptr), shape=(n, n))
        ss = places[eliminated][:, eliminated]
        ss.sort_indices()
        return cls(
            retained,
            eliminated,
            places[retained][:, retained],
            places[eliminated][:, retained],
            empty_matrix(ss.indptr, ss.indices),
            ss.data,
        )

    def blocks(
        self, values: NDArray[np.complex128]
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128], Any]:
        """Return Z_nn and Z_sn dense, and Z_ss sparse (CSC), from the values of Z, shape (nnz,)."""
        np.take(values, self.ss_places, out=self.ss.data, mode="clip")
        return _filled(self.nn, values), _filled(self.sn, values), self.ss


def empty_matrix(indptr: NDArray[Any], indices: NDArray[Any]) -> Any:
    """Return a complex CSC array of a symmetric pattern, whose values are to be written.

    Parameters
    ----------
    indptr, indices : ndarray of int
        Of CSR; as the matrix is symmetric they are those of CSC, which factorisations want.
    """
    n = len(indptr) - 1
    return sp.csc_array(
        (np.zeros(len(indices), dtype=np.complex128), indices, indptr), shape=(n, n)
    )


def _filled(places: Any, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    block = sp.csr_array((values[places.data], places.indices, places.indptr), shape=places.shape)
    return np.asarray(block.toarray())
