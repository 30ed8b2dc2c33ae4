"""The frequency response functions of a model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import IndexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import FieldSolver, LineSolver, split_into_blocks
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import REDUCTION
from updyn.errors import SolverError
from updyn.frf import FRF, QUANTITIES, check_decay, check_lines, check_quantity
from updyn.linalg.solver import check_backend
from updyn.model import Model

__all__ = ["response"]


def response(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    quantity: str = "receptance",
    *,
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    decay: float = 0.0,
) -> FRF:
    """Compute frequency response functions exactly, with one full factorisation per line.

    With ``tier="reduced"`` they are computed by a reduced model of proven accuracy. It needs only a
    few real factorisations for any number of lines.

    Parameters
    ----------
    model : Model
        The structure.
    freq : array_like of float, shape (n_f,)
        Lines in Hz, increasing.
    responses, references : iterable of str or Dof
        Signed DOFs of sensors and forces.
    quantity : {"receptance", "mobility", "accelerance"}
        Motion over force.
    tier : {"dense", "sparse", "reduced"}, optional
        The way of solving; by default an exact tier chosen by size.
    backend : str, optional
        Sparse factorisation.
    accuracy : float
        For the reduced tier, the largest error relative to the largest receptance of its line.
    decay : float
        Rate in 1/s of an exponential window exp(-decay t) on the records. The result is then H at
        i omega + decay.

    Returns
    -------
    FRF
        Values of shape (n_f, n_responses, n_references), in m/N, m/s/N or m/s2/N (rad and N m for
        rotations).

    Raises
    ------
    DataError
        If a line is not finite, negative or out of order, or the decay is negative.
    DofError
        If a DOF is not in the model.
    OptionError
        If the tier, the backend or the accuracy cannot be used.
    SolverError
        If the dynamic stiffness is singular at a line, or no reduced model of this accuracy was
        found.

    Notes
    -----
    H = Z^-1 with Z = K + i D - omega^2 M (Bao, Wang & Cheng 2010, eqs. 2, 3).

    Examples
    --------
    >>> from updyn.demos import chain
    >>> frf = updyn.response(chain.build(), [1.0, 2.0], ["12:X"], ["1:X"], "accelerance")
    >>> frf.values.shape
    (2, 1, 1)
    """
    check_quantity(quantity)
    rows, columns = DofSet(responses), DofSet(references)
    at_rows, at_columns = model.dofs.match(rows, "response"), model.dofs.match(columns, "reference")
    if np.isscalar(freq):
        freq = np.atleast_1d(freq)
    lines = check_lines(freq)
    system = AffineSystem.compile(model).with_decay(check_decay(decay))
    solver, source = _solver(
        system, at_rows.index, at_columns.index, lines, tier, backend, accuracy
    )
    # By symmetry, the forces can act on the side with fewer DOFs.
    swap = len(rows) < len(columns)
    loaded, read = at_columns, at_rows
    if swap:
        loaded, read = at_rows, at_columns
    values = np.empty((len(lines), len(rows), len(columns)), dtype=np.complex128)
    omega, start = 2.0 * np.pi * lines, solver.system.start
    pencil = solver.pencil(start, lines)
    if pencil is not None:
        pencil = replace(pencil, refines=True)
    for block in split_into_blocks(len(lines), solver.block_size(len(loaded.index))):
        c = solver.system.coefficients(start, omega[block])
        X = solver.solve(c, loaded.index, lines[block], pencil)
        X = solver.at(X, read.index).transpose(1, 0, 2)
        if swap:
            X = X.transpose(0, 2, 1)
        values[block] = X
    values *= at_rows.sign[:, None] * at_columns.sign[None, :]
    values *= ((1j * omega + system.decay) ** QUANTITIES[quantity])[:, None, None]
    return FRF(
        lines,
        values,
        rows,
        columns,
        quantity,
        geometry=model.geometry,
        source=source,
        decay=system.decay,
    )


def _solver(
    system: AffineSystem,
    rows: IndexArray,
    columns: IndexArray,
    lines: RealArray,
    tier: str | None,
    backend: str | None,
    accuracy: float,
) -> tuple[FieldSolver, str]:
    """Return the solver, and a description of it as the source of the FRF."""
    if tier != "reduced":
        return LineSolver.choose(system, tier, backend), "model"
    reduction = Reduction(
        system, rows, columns, (float(lines[0]), float(lines[-1])), check_backend(backend), accuracy
    )
    reduction.build(system.start)
    found = reduction.certify(system.start, lines)
    if found.error > accuracy:
        raise SolverError(
            f"tier 'reduced': {found.size} basis vectors reach an error of {found.error:.1g} of the"
            f" largest receptance of a line, not {accuracy:g}; use tier 'sparse', or a larger"
            " accuracy="
        )
    return (
        reduction.solver(),
        f"model, reduced to {found.size} basis vectors, error at most {found.error:.1g}",
    )
