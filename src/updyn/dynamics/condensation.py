"""Exact dynamic condensation of a model to its measured DOFs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver, split_into_blocks
from updyn.frf import check_lines
from updyn.model import Model

__all__ = ["Condensed", "condense"]


@dataclass(frozen=True, slots=True, eq=False)
class Condensed:
    """A model condensed onto its retained DOFs, line by line."""

    #: Lines in Hz, shape (n_f,).
    freq: RealArray
    #: The n retained DOFs.
    retained: DofSet
    #: Condensed dynamic stiffness Z_red in N/m, shape (n_f, n, n); its inverse is the receptance on
    #: the retained DOFs.
    Z: ComplexArray
    #: Motion of every DOF for unit motion of each retained one, shape (n_f, N, n).
    T: ComplexArray


def condense(
    model: Model,
    freq: ArrayLike,
    retained: Iterable[str | Dof],
    *,
    tier: str | None = None,
    backend: str | None = None,
) -> Condensed:
    """Condense a model exactly onto `retained` DOFs at every line.

    Parameters
    ----------
    model : Model
        The structure.
    freq : array_like of float, shape (n_f,)
        Lines in Hz.
    retained : iterable of str or Dof
        DOFs to keep; a sign reverses the DOF.
    tier : {"dense", "sparse"}, optional
        The way of solving; by default chosen by size.
    backend : str, optional
        Sparse factorisation.

    Returns
    -------
    Condensed

    Raises
    ------
    DataError
        If a line is not finite, negative or out of order.
    DofError
        If a DOF is not in the model.
    SolverError
        If the structure with its retained DOFs fixed has an undamped natural frequency at a line.

    Notes
    -----
    Z_red = T^T Z T = Z_nn - Z_ns Z_ss^-1 Z_sn, T = [I; -Z_ss^-1 Z_sn] (Bao, Wang & Cheng 2010, eqs.
    8, 9). It is exact: H_nn = Z_red^-1 at every line.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> condensed = updyn.condense(chain.build(), [1.0, 2.0], ["1:X", "12:X"])
    >>> condensed.Z.shape  # lines, retained DOFs, retained DOFs
    (2, 2, 2)
    """
    kept = DofSet(retained)
    at = model.dofs.match(kept, "retained DOF")
    if np.isscalar(freq):
        freq = np.atleast_1d(freq)
    lines = check_lines(freq)
    solver = LineSolver.choose(AffineSystem.compile(model), tier, backend)
    Z = np.empty((len(lines), len(kept), len(kept)), dtype=np.complex128)
    T = np.empty((len(lines), model.n_dofs, len(kept)), dtype=np.complex128)
    for block in split_into_blocks(len(lines), solver.block_size(len(kept))):
        c = solver.system.coefficients(solver.system.start, 2.0 * np.pi * lines[block])
        Z_block, T_block = solver.condense(c, at.index, lines[block])
        Z[block] = Z_block * at.sign[:, None] * at.sign
        T[block] = T_block.transpose(1, 0, 2) * at.sign
    return Condensed(lines, kept, Z, T)
