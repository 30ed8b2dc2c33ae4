"""`ReducedSolver`: solves at many lines inside a reduced model, with the methods of `LineSolver`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.affine import AffineSystem, Term
from updyn.dynamics.fields import solve_dense
from updyn.dynamics.reduced.basis import Basis
from updyn.errors import OptionError
from updyn.linalg.threads import alone

__all__ = ["NOT_CONDENSED", "ReducedSolver"]

#: Why the condensed equation error is refused.
NOT_CONDENSED = (
    "tier 'reduced': the condensed equation error needs Z_red = H^-1, which multiplies the error of"
    " a reduced model by the condition number of H; use tier 'sparse', or another method"
)

#: Lines of a block: enough for the matrix products, few enough to be spread and to stop soon.
_BLOCK_BYTES, _LINES = 192 * 2**20, 32


@dataclass(frozen=True, slots=True, eq=False)
class ReducedSolver:
    """Solve in the coordinates of a basis. It holds no motion of the whole model, so that it is small to send.

    Attributes
    ----------
    system : AffineSystem
        The projected model: r coordinates, the same terms as the whole.
    observed : ndarray of int, shape (k,)
        DOFs of the model that can be loaded and read, ascending.
    rows : ndarray of float, shape (k, r)
        The basis there.
    stack : ndarray of float, shape (n_terms, r * r)
        The projected matrices.
    backend : str
        Which backend made the basis.
    label : str
        Tells the reduced models of a run apart.
    """

    system: AffineSystem
    observed: NDArray[np.intp]
    rows: NDArray[np.float64]
    stack: NDArray[np.float64]
    backend: str
    label: str = "reduced"

    tier: ClassVar[str] = "reduced"

    @property
    def used(self) -> dict[str, int]:
        """No sparse solves."""
        return {}

    @classmethod
    def project(
        cls,
        system: AffineSystem,
        basis: Basis,
        observed: NDArray[np.intp],
        backend: str,
        label: str = "reduced",
    ) -> ReducedSolver:
        """Return the solver in a basis as it is.

        Parameters
        ----------
        system : AffineSystem
            The whole model.
        basis : Basis
            Motions and projected matrices.
        observed : ndarray of int
            DOFs that will be loaded or read, ascending.
        backend : str
            Which backend made the basis.
        label : str
            Tells the reduced models of a run apart.
        """
        r = basis.size
        rows, entries = np.arange(r), np.arange(r * r)
        terms = tuple(
            Term(t.group, t.quantity, rows, A, entries, A.ravel(), t.table)
            for t, A in zip(system.terms, basis.terms, strict=True)
        )
        reduced = AffineSystem(
            terms, system.start, r * np.arange(r + 1), np.tile(rows, r), system.dofs
        )
        stack = np.stack([A.ravel() for A in basis.terms])
        return cls(reduced, observed, basis.at(observed), stack, backend, label)

    def block_size(self, n_columns: int) -> int:
        """Return how many lines fit into one block of bounded memory."""
        r = self.system.n
        return int(np.clip(_BLOCK_BYTES // (48 * r * r + 32 * r * n_columns), 1, _LINES))

    @alone
    def solve(
        self,
        coefficients: NDArray[np.complex128],
        columns: NDArray[np.intp],
        freq: NDArray[np.float64],
    ) -> NDArray[np.complex128]:
        """Solve V^T Z V q = V^T E at a block of lines, E the columns `columns` of the identity.

        Parameters
        ----------
        coefficients : ndarray of complex, shape (n_terms, n_lines)
            Of Z.
        columns : ndarray of int, shape (k,)
            DOFs of the model that carry a unit force.
        freq : ndarray of float, shape (n_lines,)
            In Hz, for messages.

        Returns
        -------
        ndarray of complex, shape (r, n_lines, k)
            Coordinates q; `at` gives the motion.

        Raises
        ------
        SolverError
            If the matrix is singular at a line; the message names it.
        """
        r = self.system.n
        Z = np.empty((len(freq), r, r), dtype=np.complex128)
        c = coefficients.T
        Z.real = (c.real @ self.stack).reshape(-1, r, r)
        Z.imag = (c.imag @ self.stack).reshape(-1, r, r)
        loads = self._rows_of(columns).T
        q = solve_dense(Z, np.broadcast_to(loads, (len(freq), *loads.shape)), freq)
        return q.transpose(1, 0, 2)

    def at(self, fields: NDArray[np.complex128], dofs: NDArray[np.intp]) -> NDArray[np.complex128]:
        """Return the motion at some DOFs, shape (len(dofs), n_lines, k), from what `solve` returned."""
        r, n_lines, k = fields.shape
        flat = np.ascontiguousarray(fields).reshape(r, -1).view(np.float64)
        moved = np.ascontiguousarray(self._rows_of(dofs) @ flat)
        return moved.view(np.complex128).reshape(len(dofs), n_lines, k)

    def condense(
        self,
        coefficients: NDArray[np.complex128],
        retained: NDArray[np.intp],
        freq: NDArray[np.float64],
    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Refuse: the condensed stiffness is the inverse of H, and multiplies its error by its condition number.

        Raises
        ------
        OptionError
            Always.
        """
        raise OptionError(NOT_CONDENSED)

    def others(self, seen: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return DOFs besides `seen` that can be read."""
        return np.setdiff1d(self.observed, seen)

    def _rows_of(self, dofs: NDArray[np.intp]) -> NDArray[np.float64]:
        place = np.searchsorted(self.observed, dofs)
        if (place >= len(self.observed)).any() or (self.observed[place] != dofs).any():
            raise KeyError("the reduced model was built without this DOF")
        return self.rows[place]
