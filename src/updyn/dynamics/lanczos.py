"""Block Lanczos for the modes of large models (Grimes, Lewis & Simon, SIMAX 15 (1994) 228).

The operator A^-1 M with A = K + s M is symmetric in the inner product of A. A block of vectors
takes little more time than one, because a solve reads the factors once for all of its columns.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from updyn.arrays import RealArray
from updyn.dynamics.settings import LANCZOS
from updyn.errors import SolverError
from updyn.group import Matrix
from updyn.linalg.direct import Direct, Refactorisation

__all__ = ["BlockLanczos", "RealPencil"]


class RealPencil:
    """K + s M for any s, on one sparsity pattern that is analysed once."""

    def __init__(self, K: Matrix, M: Matrix) -> None:
        both = sp.csr_array(K + 1j * M)  # a complex sum keeps the entries of both
        both.sort_indices()
        self._stiffness, self._mass = both.data.real.copy(), both.data.imag.copy()
        self._pattern = both.indices, both.indptr
        self._refactorisation = Refactorisation(self._matrix(sp.csc_array, 0.0))
        self.mass = sp.csr_array(M)

    def matrix(self, shift: float) -> Matrix:
        """Return K + s M in CSR, which multiplies blocks fastest."""
        return self._matrix(sp.csr_array, shift)

    def factor(self, shift: float) -> Direct:
        """Return the factors of K + s M, valid until the next call; SolverError if singular."""
        try:
            # The matrix is symmetric, so its CSR arrays are also its CSC arrays.
            return self._refactorisation.factor(self._matrix(sp.csc_array, shift))
        except RuntimeError as error:
            raise SolverError(
                "the model has a motion with neither stiffness nor mass, or its stiffness is far"
                " from positive: no modes can be computed"
            ) from error

    def _matrix(self, form: type[sp.csr_array] | type[sp.csc_array], shift: float) -> Matrix:
        values = self._stiffness + shift * self._mass
        n = len(self._pattern[1]) - 1
        return form((values, *self._pattern), shape=(n, n))


@dataclass(slots=True, eq=False)
class BlockLanczos:
    """An A-orthonormal Krylov basis V that grows by blocks until the wanted modes converge."""

    pencil: RealPencil
    shift: float
    A: Matrix
    factors: Direct
    block: int
    seed: int = 0
    #: V in its first `_size` columns, V^T M V, the next block, and its coupling to the last one.
    _V: RealArray = field(init=False)
    _size: int = field(default=0, init=False)
    _projected: RealArray = field(init=False)
    _next: RealArray = field(init=False)
    _coupling: RealArray = field(init=False)

    @classmethod
    def begin(
        cls, pencil: RealPencil, shift: float, block: int = LANCZOS.block, seed: int = 0
    ) -> BlockLanczos:
        """Return a process for the modes nearest to -s; SolverError if K + s M is not definite."""
        factors = pencil.factor(shift)
        if factors.negative:
            raise SolverError(f"K + s M is not positive definite at s = {shift:g}")
        return cls(pencil, shift, pencil.matrix(shift), factors, block, seed)

    def repeat(self) -> BlockLanczos:
        """Return a process with another start and larger blocks, which finds missed modes."""
        return BlockLanczos.begin(self.pencil, self.shift, 2 * self.block, self.seed + 1)

    def __post_init__(self) -> None:
        N = self.A.shape[0]
        self._V = np.empty((N, 8 * self.block), order="F")
        self._projected = np.zeros((0, 0))
        start = np.random.default_rng(self.seed).standard_normal((N, self.block))
        W = self._step(start)  # without massless motions
        self._next, _ = _normalise(W, W.T @ (self.A @ W))

    def solve(self, n: int, tolerance: float = LANCZOS.tolerance) -> tuple[RealArray, RealArray]:
        """Return the n lowest eigenvalues in 1/s2, ascending, or all, and their vectors."""
        while True:
            if self._size >= max(LANCZOS.most_vectors, LANCZOS.vectors_per_mode * n):
                self._restart(n + self.block)
            n_last = self._extend()
            nu, Y = np.linalg.eigh(self._projected)
            nu, Y = nu[::-1][:n], Y[:, ::-1][:, :n]
            residual = np.linalg.norm(self._coupling @ Y[-n_last:], axis=0)
            if not self._next.size or (len(nu) == n and (residual <= tolerance * nu).all()):
                break
        has_mass = nu > LANCZOS.vanishing * nu[0]
        # One more step removes rounding errors by massless motions from the vectors.
        vectors = self._step(self._V[:, : self._size] @ Y[:, has_mass])
        return 1.0 / nu[has_mass] - self.shift, vectors

    def _step(self, X: RealArray) -> RealArray:
        return np.asarray(self.factors.solve(self.pencil.mass @ X), dtype=np.float64)

    def _extend(self) -> int:
        """Add the next block to the basis; return its number of vectors."""
        first, n_last = self._size, int(self._next.shape[1])
        self._append(self._next)
        V = self._V[:, : self._size]
        MX = self.pencil.mass @ V[:, first:]
        column = V.T @ MX
        self._projected = np.pad(self._projected, (0, n_last))
        self._projected[:, first:], self._projected[first:] = column, column.T
        W = self.factors.solve(MX) - V @ column
        # Orthogonalise and normalise twice, against rounding.
        AW = self.A @ W
        rest = V.T @ AW
        W -= V @ rest
        W, R = _normalise(W, W.T @ AW - rest.T @ rest)
        self._next, S = _normalise(W, W.T @ (self.A @ W))
        self._coupling = S @ R
        return n_last

    def _append(self, X: RealArray) -> None:
        size = self._size + X.shape[1]
        if size > self._V.shape[1]:
            grown = np.empty((len(X), 2 * size), order="F")
            grown[:, : self._size] = self._V[:, : self._size]
            self._V = grown
        self._V[:, self._size : size] = X
        self._size = size

    def _restart(self, n: int) -> None:
        """Keep the n leading Ritz vectors of the basis."""
        # Thick restart (Wu & Simon, SIMAX 22 (2000) 602); their couplings are projected anew.
        nu, Y = np.linalg.eigh(self._projected)
        self._V[:, :n] = self._V[:, : self._size] @ Y[:, : -n - 1 : -1]
        self._size, self._projected = n, np.diag(nu[: -n - 1 : -1])


def _normalise(W: RealArray, G: RealArray) -> tuple[RealArray, RealArray]:
    """Return an A-orthonormal Q without vanishing directions, and R of W = Q R; G is W^T A W."""
    size = np.sqrt(np.maximum(np.diag(G), np.finfo(np.float64).tiny))
    g, U = np.linalg.eigh(G / size / size[:, None])
    kept = g > LANCZOS.vanishing
    root, U = np.sqrt(g[kept]), U[:, kept]
    return W @ (U / root / size[:, None]), root[:, None] * U.T * size
