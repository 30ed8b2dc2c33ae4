"""Residuals between model and measurement, each a small object, and their reduction block by block.

A residual turns a block of lines into real residuals and their Jacobian. The blocks are stacked by QR factors, so that
the Jacobian of all lines need never be held, and the normal equations are never formed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from updyn import sensitivity
from updyn.dynamics.fields import line_blocks
from updyn.errors import DataError, SolverError
from updyn.frf import QUANTITIES
from updyn.updating.noise import level_by_unit
from updyn.updating.problem import Block, Problem
from updyn.updating.trust_region import Local

__all__ = ["EquationError", "LogError", "OutputError", "Residual", "reduce", "with_prior"]

_Vector = NDArray[np.float64]
_Matrix = NDArray[np.float64]
_Complex = NDArray[np.complex128]


class Residual(Protocol):
    """What a residual offers: the local least-squares problem at x, and its name."""

    @property
    def name(self) -> str:
        """How the report calls it."""

    def local(self, problem: Problem, x: _Vector) -> Local | None:
        """Return the reduced problem at x, or None where the model cannot be solved."""


@dataclass(frozen=True, slots=True)
class LogError:
    """r = ln(H_A / H_X): difference of log magnitude and of phase.

    Constant relative noise makes it nearly the maximum-likelihood residual, and its basin is wide. Values that are
    exactly zero on either side have no logarithm and are given weight zero.
    """

    name: str = "log"

    def local(self, problem: Problem, x: _Vector) -> Local | None:
        """Return the reduced problem at x, or None where the model cannot be solved."""
        return _local(problem, x, self._block)

    @staticmethod
    def _block(block: Block) -> tuple[_Complex, _Complex]:
        usable = (block.measured != 0) & (block.H != 0)
        ratio = np.where(usable, block.H, 1.0) / np.where(usable, block.measured, 1.0)
        assert block.dH is not None
        return np.log(ratio), np.where(usable, block.dH / np.where(usable, block.H, 1.0), 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class OutputError:
    """r = (H_A - H_X) / sigma.

    Parameters
    ----------
    weight : ndarray of float, shape (n_f, n_i, n_j)
        1 / sigma of the real and of the imaginary part of each value, in the unit of the data.
    name : str
        How the report calls it.
    """

    weight: NDArray[np.float64]
    name: str = "output-error"

    def local(self, problem: Problem, x: _Vector) -> Local | None:
        """Return the reduced problem at x, or None where the model cannot be solved."""
        return _local(problem, x, self._block)

    def _block(self, block: Block) -> tuple[_Complex, _Complex]:
        assert block.dH is not None
        weight = self.weight[block.lines]
        return weight * (block.H - block.measured), block.dH * weight


@dataclass(frozen=True, slots=True)
class EquationError:
    """r = Z_red h_X - e_j, the paper's condensed equation error (Bao, Wang & Cheng 2010, eq. 10).

    Every reference has to be measured as a response too: its unit force stands on a retained DOF. With measured noise
    the estimate is biased, as H_X stands on both sides. Where translations and rotations were measured, forces and
    moments are brought to one scale by the levels of the data (`_same_unit`); otherwise it is the paper's as it stands.
    """

    name: str = "equation-error"

    def local(self, problem: Problem, x: _Vector) -> Local | None:
        """Return the reduced problem at x, or None where the model cannot be solved."""
        try:
            blocks = [_stack(r, J) for r, J in self.blocks(problem, x)]
        except SolverError:
            return None
        return reduce(blocks, problem.n)

    def blocks(self, problem: Problem, x: _Vector) -> Iterable[tuple[_Complex, _Complex]]:
        """Yield Z_red h_X - e_j, shape (n_f, n, m), and its derivatives by x, block by block of lines."""
        state, slope = problem.state(x), problem.coordinates.slope(x)
        unit = (problem.rows[:, None] == problem.columns[None, :]).astype(np.float64)
        if not unit.any(axis=0).all():
            missing = problem.frf.references[int(np.flatnonzero(~unit.any(axis=0))[0])]
            raise DataError(
                f"equation error: reference {missing} is not among the responses; the force has to stand on a retained "
                "DOF. Measure the drive point, or use another method"
            )
        power = QUANTITIES[problem.frf.quantity]
        if power and problem.frf.freq[0] == 0.0:
            raise DataError(
                f"equation error: the 0 Hz line of {problem.frf.quantity} holds no receptance; leave it out"
            )
        weight = _same_unit(problem, unit)
        for lines in line_blocks(len(problem.frf.freq), problem.solver.block_size(2 * len(problem.rows))):
            freq = problem.frf.freq[lines]
            factor = problem.sign / ((2j * np.pi * freq) ** power)[:, None, None]
            product, derivative = sensitivity.condensed_product(
                problem.solver, problem.unknowns, state, freq, problem.rows, problem.frf.values[lines] * factor
            )
            assert derivative is not None
            yield weight * (product - unit), derivative * (slope[:, None, None, None] * weight)


def _same_unit(problem: Problem, unit: _Matrix) -> _Matrix:
    """Return the weights of the equation error, shape (n, m), all 1 for data of one unit.

    The residual at a rotation is a moment per force. Times the level of the motion there, over the level of the motion
    at the force, it becomes a share of work, whatever the unit of length.
    """
    level = level_by_unit(problem.frf)[0]
    return np.asarray(level / (unit * level).sum(axis=0))


def reduce(blocks: Iterable[_Matrix], n: int) -> Local:
    """Stack blocks [J r], shape (m, n + 1), by QR in the order given, and return the local problem.

    Parameters
    ----------
    blocks : iterable of ndarray of float
        Weighted Jacobian with the residual as last column.
    n : int
        Number of unknowns.
    """
    triangle = np.zeros((0, n + 1))
    for block in blocks:
        triangle = _triangle([triangle, block])
    if len(triangle) < n + 1:
        triangle = np.vstack([triangle, np.zeros((n + 1 - len(triangle), n + 1))])
    last = triangle[:, n]
    return Local(0.5 * float(last @ last), triangle[:n, :n], last[:n].copy())


def _triangle(blocks: list[_Matrix]) -> _Matrix:
    return np.asarray(np.linalg.qr(np.vstack(blocks), mode="r"))


def with_prior(local: Local, problem: Problem, x: _Vector) -> Local:
    """Return the local problem with the unknowns' priors added as residuals (x - x_0) / std."""
    centre, weight = problem.coordinates.prior
    if not weight.any():
        return local
    rest = max(local.cost - 0.5 * float(local.q @ local.q), 0.0)
    block = np.hstack([np.diag(weight), (weight * (x - centre))[:, None]])
    joined = reduce([np.hstack([local.R, local.q[:, None]]), block], problem.n)
    return Local(joined.cost + rest, joined.R, joined.q)


def _local(problem: Problem, x: _Vector, make: object) -> Local | None:
    assert callable(make)
    blocks: list[_Matrix] = []
    try:
        for block in problem.blocks(x):
            r, J = make(block)
            blocks.append(_stack(r, J))
            if len(blocks) > 1:
                blocks = [_triangle(blocks)]
    except SolverError:
        return None
    out = reduce(blocks, problem.n)
    return out if np.isfinite(out.cost) and np.isfinite(out.R).all() else None


def _stack(r: _Complex, J: _Complex) -> _Matrix:
    """Return [J r] with real over imaginary parts (eq. 12), shape (2 m, n + 1)."""
    flat = np.empty((2, r.size, len(J) + 1))
    columns = J.reshape(len(J), -1).T
    flat[0, :, :-1], flat[1, :, :-1] = columns.real, columns.imag
    flat[0, :, -1], flat[1, :, -1] = r.real.ravel(), r.imag.ravel()
    return flat.reshape(2 * r.size, -1)
