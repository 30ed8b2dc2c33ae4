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
    nn, sn, ss : sparse CSR of int
        Position of each entry of the block among the values of Z.
    """

    retained: NDArray[np.intp]
    eliminated: NDArray[np.intp]
    nn: Any
    sn: Any
    ss: Any

    @classmethod
    def find(cls, system: AffineSystem, retained: NDArray[np.intp]) -> Partition:
        """Find the blocks for some retained DOFs, in the order wanted."""
        n = system.n
        keep = np.zeros(n, dtype=np.bool_)
        keep[retained] = True
        eliminated = np.flatnonzero(~keep)
        places = sp.csr_array((np.arange(len(system.indices)), system.indices, system.indptr), shape=(n, n))
        ss = places[eliminated][:, eliminated]
        ss.sort_indices()
        return cls(retained, eliminated, places[retained][:, retained], places[eliminated][:, retained], ss)

    def blocks(self, values: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.complex128], Any]:
        """Return Z_nn and Z_sn dense, and Z_ss sparse (CSC), from the values of Z, shape (nnz,)."""
        # Z is symmetric: the CSR arrays of a diagonal block are its CSC arrays, which factorisations want.
        ss = sp.csc_array((values[self.ss.data], self.ss.indices, self.ss.indptr), shape=self.ss.shape)
        return _filled(self.nn, values), _filled(self.sn, values), ss


def _filled(places: Any, values: NDArray[np.complex128]) -> NDArray[np.complex128]:
    block = sp.csr_array((values[places.data], places.indices, places.indptr), shape=places.shape)
    return np.asarray(block.toarray())
