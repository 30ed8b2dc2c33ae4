"""The basis of a reduced model, and the model's matrices projected on it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from updyn.arrays import IndexArray, RealArray
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.settings import BASIS

__all__ = ["Basis", "whiten"]


def whiten(gram: RealArray) -> RealArray:
    """Return T, shape (r, k), with T^T G T = 1 for a Gram matrix G of the same span."""
    sizes = 1.0 / np.sqrt(np.maximum(np.diag(gram), np.finfo(np.float64).tiny))
    square, axes = np.linalg.eigh(sizes[:, None] * gram * sizes)
    kept = square > BASIS.independent_share * square.max(initial=0.0)
    return np.asarray(sizes[:, None] * axes[:, kept] / np.sqrt(square[kept]))


@dataclass(slots=True, eq=False)
class Basis:
    """Real basis vectors V and the projected matrices V^T A_t V of every term t.

    V is orthonormal in `weight`, shape (N,), which makes translations and rotations comparable.
    """

    system: AffineSystem
    weight: RealArray
    terms: list[RealArray] = field(init=False)
    _blocks: list[RealArray] = field(default_factory=list, init=False)
    _is_normal: bool = field(default=True, init=False)

    def __post_init__(self) -> None:
        self.terms = [np.zeros((0, 0)) for _ in self.system.terms]

    @property
    def size(self) -> int:
        """Number of basis vectors r."""
        return sum(b.shape[1] for b in self._blocks)

    @property
    def blocks(self) -> tuple[RealArray, ...]:
        """The columns of V in blocks; vectors that are appended later are not included."""
        return tuple(self._blocks)

    def at(self, dofs: IndexArray) -> RealArray:
        """Return V at some DOFs, shape (len(dofs), r)."""
        return np.hstack([b[dofs] for b in self._blocks])

    def take_leading(self, size: int) -> Basis:
        """Return the first vectors as a basis."""
        out = Basis(self.system, self.weight)
        for block in self._blocks:
            if out.size < size:
                out._blocks.append(block[:, : size - out.size])
        out.terms = [np.ascontiguousarray(A[:size, :size]) for A in self.terms]
        out._is_normal = self._is_normal
        return out

    def combine_last(self, size: int, C: RealArray) -> Basis:
        """Return a basis of the first `size` vectors and combinations of the others, W C."""
        T = scipy.linalg.block_diag(np.eye(size), C)
        out = self.take_leading(size)
        out._blocks.append(self.expand(T[:, size:]))
        out.terms = [T.T @ A @ T for A in self.terms]
        out._is_normal = False
        return out

    def expand(self, coordinates: RealArray) -> RealArray:
        """Return V q for real coordinates q, shape (r, k), as (N, k)."""
        out = np.zeros((self.system.n, coordinates.shape[1]))
        first = 0
        for block in self._blocks:
            out += block @ coordinates[first : first + block.shape[1]]
            first += block.shape[1]
        return out

    def project(self, F: RealArray) -> RealArray:
        """Return V^T F for forces F, shape (N, k), as (r, k)."""
        return np.vstack([b.T @ F for b in self._blocks])

    def append(self, X: RealArray) -> None:
        """Add the new directions in the columns of X, shape (N, k); X is overwritten."""
        scale = self.weight[:, None]
        X /= np.maximum(np.linalg.norm(scale * X, axis=0), np.finfo(np.float64).tiny)
        root = None if self._is_normal else self._normaliser()
        for _ in range(2):  # the second pass removes rounding errors of the first
            if root is not None:
                X -= self.expand(root @ (root.T @ self.project(scale**2 * X)))
                continue
            for block in self._blocks:
                X -= block @ (block.T @ (scale**2 * X))
        Q, R = np.linalg.qr(scale * X)
        U, s, _ = np.linalg.svd(R)
        Q = Q @ U[:, s > BASIS.new_norm]
        Q /= scale
        self._add(Q)

    def _normaliser(self) -> RealArray:
        """Return T, shape (r, k), for which V T is orthonormal and has the span of V."""
        gram = [self.project(self.weight[:, None] ** 2 * b) for b in self._blocks]
        return whiten(np.hstack(gram))

    def extend(self, W: RealArray) -> None:
        """Add columns unchanged, shape (N, k), and project the model's matrices on them."""
        if W.shape[1]:
            self._is_normal = False
            self._add(W)

    def _add(self, W: RealArray) -> None:
        if W.shape[1] == 0:
            return
        if W.strides[1] != W.itemsize:
            W = np.ascontiguousarray(W)
        rows: IndexArray | None = None
        for t, term in enumerate(self.system.terms):
            if term.rows is not rows:  # stiffness and mass of a group share the array
                rows, row_index = term.rows, term.row_index
                parts, w = [b[row_index] for b in self._blocks], W[row_index]
            product = term.local @ w
            corner = w.T @ product
            r = len(self.terms[t])
            grown = np.empty((r + W.shape[1], r + W.shape[1]))
            grown[:r, :r], grown[r:, r:] = self.terms[t], 0.5 * (corner + corner.T)
            if parts:
                grown[:r, r:] = np.vstack([p.T @ product for p in parts])
                grown[r:, :r] = grown[:r, r:].T
            self.terms[t] = grown
        self._blocks.append(W)

    def rotate(self, C: RealArray) -> None:
        """Replace V by V C, C of shape (r, s), in one block."""
        V = np.empty((self.system.n, C.shape[1]))
        for first in range(0, len(V), BASIS.rows_per_step):
            part = slice(first, first + BASIS.rows_per_step)
            V[part] = np.hstack([b[part] for b in self._blocks]) @ C
        self._blocks, self._is_normal = [V], False
        self.terms = [C.T @ A @ C for A in self.terms]

    def weighted_sum(self, weights: RealArray) -> RealArray:
        """Return the sum of weight_t V^T A_t V, shape (r, r)."""
        return np.tensordot(weights, np.stack(self.terms), axes=1)
