"""A basis of motions, kept in blocks of columns so that it can grow without being copied."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.affine import AffineSystem

__all__ = ["Basis"]

_Real = NDArray[np.float64]

#: What is left of a unit column after those before it were taken out; less is rounding of what they
#: hold already.
_NEW = 1e-9
_ROWS = 1 << 16


@dataclass(slots=True, eq=False)
class Basis:
    """Real motions V and the matrices of a model projected on them, V^T A_t V for every term t.

    Parameters
    ----------
    system : AffineSystem
        The compiled model, N DOFs.
    weight : ndarray of float, shape (N,)
        Scale of each DOF, so that translations and rotations compare; the columns are normal in it.

    Attributes
    ----------
    terms : list of ndarray of float, shape (r, r)
        The projected matrices, one a term of the system.
    """

    system: AffineSystem
    weight: _Real
    terms: list[_Real] = field(init=False)
    _blocks: list[_Real] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        self.terms = [np.zeros((0, 0)) for _ in self.system.terms]

    @property
    def size(self) -> int:
        """Number of motions r."""
        return sum(b.shape[1] for b in self._blocks)

    def at(self, dofs: NDArray[np.intp]) -> _Real:
        """Return V at some DOFs, shape (len(dofs), r)."""
        return np.hstack([b[dofs] for b in self._blocks])

    def moved(self, coordinates: _Real) -> _Real:
        """Return V q for real coordinates q, shape (r, k), as (N, k)."""
        out = np.zeros((self.system.n, coordinates.shape[1]))
        first = 0
        for block in self._blocks:
            out += block @ coordinates[first : first + block.shape[1]]
            first += block.shape[1]
        return out

    def projected(self, F: _Real) -> _Real:
        """Return V^T F for forces F, shape (N, k), as (r, k)."""
        return np.vstack([b.T @ F for b in self._blocks])

    def append(self, X: _Real) -> None:
        """Add what is new in the columns of X, shape (N, k); X is overwritten."""
        scale = self.weight[:, None]
        X /= np.maximum(np.linalg.norm(scale * X, axis=0), np.finfo(np.float64).tiny)
        for _ in range(2):  # once more, for what rounding left
            for block in self._blocks:
                X -= block @ (block.T @ (scale**2 * X))
        Q, R = np.linalg.qr(scale * X)
        U, s, _ = np.linalg.svd(R)
        Q = Q @ U[:, s > _NEW]
        Q /= scale
        self.extend(Q)

    def extend(self, W: _Real) -> None:
        """Add columns as they are, shape (N, k), and project the model's matrices on them."""
        if W.shape[1] == 0:
            return
        W = np.ascontiguousarray(W)
        rows: Any = None
        for t, term in enumerate(self.system.terms):
            if term.rows is not rows:  # stiffness and mass of a group share theirs
                rows, own = term.rows, term.own
                parts, w = [b[own] for b in self._blocks], W[own]
            product = term.local @ w
            cross = (
                np.vstack([p.T @ product for p in parts]) if parts else np.zeros((0, W.shape[1]))
            )
            corner = w.T @ product
            self.terms[t] = np.block([[self.terms[t], cross], [cross.T, 0.5 * (corner + corner.T)]])
        self._blocks.append(W)

    def rotate(self, C: _Real) -> None:
        """Replace V by V C, C of shape (r, s), in one block."""
        V = np.empty((self.system.n, C.shape[1]))
        for first in range(0, len(V), _ROWS):
            V[first : first + _ROWS] = (
                np.hstack([b[first : first + _ROWS] for b in self._blocks]) @ C
            )
        self._blocks = [V]
        self.terms = [C.T @ A @ C for A in self.terms]

    def combined(self, weights: _Real) -> _Real:
        """Return the sum of weight_t V^T A_t V, shape (r, r)."""
        return np.tensordot(weights, np.stack(self.terms), axes=1)
