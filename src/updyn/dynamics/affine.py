"""A model compiled for work at many lines: Z(omega) as a sum of coefficients times stored matrices.

    Z(omega) = sum over terms of  c_t(omega, state) A_t,

with one term for each matrix that a group has. The matrices are stored once, on one fixed pattern; a change of the
unknowns touches the coefficients only, and so do all derivatives (Bao, Wang & Cheng 2010, eqs. 13-16, corrected:
the loss factor acts on the updated stiffness).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.model import Model

__all__ = ["AffineSystem", "State", "Term"]

_DENSE_OWN = 400


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """One stored matrix of one group.

    Attributes
    ----------
    group, quantity : str
        Whose it is; ``stiffness``, ``mass`` or ``viscous``.
    rows : ndarray of int, shape (n_t,)
        The group's own DOFs: rows that are not empty.
    local : ndarray or sparse, shape (n_t, n_t), real
        The matrix on its own DOFs.
    slots : ndarray of int
        Where its entries stand among the values of the system's pattern.
    data : ndarray of float
        Its entries, in that order.
    """

    group: str
    quantity: str
    rows: NDArray[np.intp]
    local: Any
    slots: NDArray[np.intp]
    data: NDArray[np.float64]

    def times(self, field: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the matrix times a complex field on its own DOFs, shape (n_t, ...), as one real product."""
        flat = np.ascontiguousarray(field).reshape(len(self.rows), -1).view(np.float64)
        return np.ascontiguousarray(self.local @ flat).view(np.complex128).reshape(field.shape)


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The numbers that may change: one factor and one loss factor a term.

    Attributes
    ----------
    factor : ndarray of float, shape (n_terms,)
        kappa, mu or the viscous factor: 1 where the model stands as it was compiled.
    loss : ndarray of float, shape (n_terms,)
        Loss factor gamma of stiffness terms, 0 elsewhere.
    """

    factor: NDArray[np.float64]
    loss: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class AffineSystem:
    """A compiled model.

    Attributes
    ----------
    terms : tuple of Term
        Every matrix of every group.
    start : State
        The state that gives back the model as it was compiled.
    indptr, indices : ndarray of int
        CSR pattern of Z, symmetric, with a full diagonal.
    dofs : DofSet
        The N degrees of freedom of the model.
    """

    terms: tuple[Term, ...]
    start: State
    indptr: NDArray[Any]
    indices: NDArray[Any]
    dofs: DofSet

    @classmethod
    def compile(cls, model: Model) -> AffineSystem:
        """Compile a model: find the common pattern and each matrix's place in it."""
        n = model.n_dofs
        stored = [
            (name, quantity, matrix, group.loss_factor if quantity == "stiffness" else 0.0)
            for name, group in model.groups.items()
            for quantity in ("stiffness", "mass", "viscous")
            if (matrix := getattr(group, quantity)) is not None
        ]
        # Ones, not values: a sum of values could cancel to zero and drop an entry of the pattern.
        pattern = sp.csr_array(sp.identity(n, format="csr"))
        for _, _, matrix, _ in stored:
            pattern = pattern + sp.csr_array((np.ones(matrix.nnz), matrix.indices, matrix.indptr), shape=(n, n))
        pattern.sort_indices()
        key = _keys(pattern)
        terms = tuple(_term(name, quantity, matrix, key) for name, quantity, matrix, _ in stored)
        start = State(np.ones(len(terms)), np.array([loss for *_, loss in stored]))
        return cls(terms, start, pattern.indptr, pattern.indices, model.dofs)

    @property
    def n(self) -> int:
        """Number of equations: the N DOFs, or the coordinates of a reduced model."""
        return len(self.indptr) - 1

    def find(self, group: str, quantity: str) -> int:
        """Return the position of the term that an unknown (``group``, ``quantity``) acts on."""
        wanted = "stiffness" if quantity == "loss_factor" else quantity
        for i, term in enumerate(self.terms):
            if term.group == group and term.quantity == wanted:
                return i
        raise KeyError(f"{group}.{quantity}")

    def with_values(self, state: State, at: NDArray[np.intp], is_loss: NDArray[Any], values: NDArray[Any]) -> State:
        """Return `state` with the unknowns that act on terms `at` set to `values`."""
        factor, loss = state.factor.copy(), state.loss.copy()
        factor[at[~is_loss]] = values[~is_loss]
        loss[at[is_loss]] = values[is_loss]
        return replace(state, factor=factor, loss=loss)

    def coefficients(self, state: State, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return c_t(omega), shape (n_terms, n_lines); `omega` in rad/s."""
        out = np.empty((len(self.terms), len(omega)), dtype=np.complex128)
        for t, term in enumerate(self.terms):
            if term.quantity == "stiffness":
                out[t] = state.factor[t] * (1.0 + 1j * state.loss[t])
            elif term.quantity == "mass":
                out[t] = -state.factor[t] * omega**2
            else:
                out[t] = 1j * state.factor[t] * omega
        return out

    def values(self, coefficients: NDArray[np.complex128]) -> NDArray[np.complex128]:
        """Return the entries of Z on the pattern, shape (nnz, n_lines)."""
        out = np.zeros((len(self.indices), coefficients.shape[1]), dtype=np.complex128)
        for term, c in zip(self.terms, coefficients, strict=True):
            out[term.slots] += term.data[:, None] * c[None, :]
        return out

    def real_values(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the entries on the pattern, shape (nnz,), of the terms' sum with real weights, shape (n_terms,)."""
        out = np.zeros(len(self.indices))
        for term, weight in zip(self.terms, weights, strict=True):
            if weight:
                out[term.slots] += weight * term.data
        return out

    def rows_of_entries(self) -> NDArray[np.intp]:
        """Return the row of each entry of the pattern, shape (nnz,)."""
        return np.asarray(np.repeat(np.arange(self.n), np.diff(self.indptr)), dtype=np.intp)


def _keys(matrix: Any) -> NDArray[np.int64]:
    rows = np.repeat(np.arange(matrix.shape[0], dtype=np.int64), np.diff(matrix.indptr))
    return np.asarray(rows * matrix.shape[0] + matrix.indices, dtype=np.int64)


def _term(name: str, quantity: str, matrix: Any, key: NDArray[np.int64]) -> Term:
    rows = np.unique(matrix.indices)
    local = sp.csr_array(matrix[rows][:, rows])
    # Sparse rows pay only when the group is large and its matrix mostly empty.
    dense = len(rows) <= _DENSE_OWN and local.nnz > 0.1 * len(rows) ** 2
    return Term(
        group=name,
        quantity=quantity,
        rows=rows,
        local=local.toarray() if dense else local,
        slots=np.searchsorted(key, _keys(matrix)),
        data=matrix.data,
    )
