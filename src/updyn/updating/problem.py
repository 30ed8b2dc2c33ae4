"""A model, the data that were chosen from a measurement, and the unknowns, brought to one set of indices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn import sensitivity
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.fields import LineSolver, line_blocks
from updyn.frf import FRF, QUANTITIES
from updyn.model import Model
from updyn.sensitivity import Unknowns
from updyn.updating.parameters import ParameterSet

__all__ = ["Block", "Coordinates", "Problem"]

_Vector = NDArray[np.float64]
_Complex = NDArray[np.complex128]

_RELAXED = -0.5


@dataclass(frozen=True, slots=True, eq=False)
class Coordinates:
    """The optimiser's coordinates x: logarithms of positive factors, loss factors as they are.

    Parameters
    ----------
    parameters : ParameterSet
        The unknowns.
    """

    parameters: ParameterSet

    def to_x(self, values: _Vector) -> _Vector:
        """Return x for the unknowns' values, both shape (n,)."""
        factor = self.parameters.is_factor
        return np.where(factor, np.log(np.where(factor, values, 1.0)), values)

    def to_values(self, x: _Vector) -> _Vector:
        """Return the unknowns' values for x, both shape (n,)."""
        factor = self.parameters.is_factor
        return np.where(factor, np.exp(np.where(factor, x, 0.0)), x)

    def slope(self, x: _Vector) -> _Vector:
        """Return d values / d x, shape (n,)."""
        return np.where(self.parameters.is_factor, self.to_values(x), 1.0)

    @property
    def bounds(self) -> tuple[_Vector, _Vector]:
        """Bounds in x, each shape (n,)."""
        return self.to_x(self.parameters.lower), self.to_x(self.parameters.upper)

    @property
    def relaxed_lower(self) -> _Vector:
        """Lower bounds in x that let loss factors turn negative on the way, shape (n,).

        The true loss factor of a lightly damped part lies on its bound at zero, and a search that may not step across
        gets caught there.
        """
        lower = self.bounds[0]
        return np.where(self.parameters.is_factor, lower, np.minimum(lower, _RELAXED))

    @property
    def prior(self) -> tuple[_Vector, _Vector]:
        """Centre and inverse standard deviation (0: none) of the priors in x, each shape (n,)."""
        weight = [0.0 if p.prior_std is None else 1.0 / p.prior_std for p in self.parameters]
        return self.to_x(self.parameters.start), np.array(weight)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Model and measurement at a block of lines, in the measured quantity and signs.

    Attributes
    ----------
    lines : slice
        Which lines.
    H : ndarray of complex, shape (n_f, n_i, n_j)
        The model's.
    dH : ndarray of complex, shape (n, n_f, n_i, n_j), or None
        Derivatives by the optimiser's coordinates.
    measured : ndarray of complex, shape (n_f, n_i, n_j)
        The data.
    """

    lines: slice
    H: _Complex
    dH: _Complex | None  # noqa: N815
    measured: _Complex


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What an update works on.

    Attributes
    ----------
    solver : LineSolver
        The compiled model and how it is solved.
    unknowns : Unknowns
        Where the unknowns act.
    coordinates : Coordinates
        The optimiser's coordinates.
    frf : FRF
        The data of the fit: chosen lines, responses and references.
    rows, columns : ndarray of int
        Model DOFs of responses and references.
    sign : ndarray of float, shape (n_i, n_j)
        Product of the signs of response and reference.
    """

    solver: LineSolver
    unknowns: Unknowns
    coordinates: Coordinates
    frf: FRF
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    sign: NDArray[np.float64]

    @classmethod
    def build(
        cls,
        model: Model,
        frf: FRF,
        parameters: ParameterSet,
        *,
        tier: str | None = None,
        backend: str | None = None,
    ) -> Problem:
        """Bring model, data and unknowns together.

        Raises
        ------
        DofError
            If a response or a reference is not in the model.
        OptionError
            If the tier or the backend is not known.
        """
        system = AffineSystem.compile(model)
        rows = model.dofs.match(frf.responses, "response")
        columns = model.dofs.match(frf.references, "reference")
        return cls(
            LineSolver.choose(system, tier, backend),
            Unknowns.find(system, parameters),
            Coordinates(parameters),
            frf,
            rows.index,
            columns.index,
            rows.sign[:, None] * columns.sign,
        )

    def thinned(self, largest: int) -> Problem:
        """Return the problem on every second, third, ... line, so that at most `largest` lines are left.

        Parameters
        ----------
        largest : int
            Number of lines.

        Returns
        -------
        Problem
            Itself where it has no more lines than that.
        """
        stride = -(-len(self.frf.freq) // largest)
        return self if stride <= 1 else replace(self, frf=self.frf.select(lines=self.frf.freq[::stride]))

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return len(self.coordinates.parameters)

    def state(self, x: _Vector) -> State:
        """Return the state of the compiled model at x."""
        return self.unknowns.state(self.solver.system, self.coordinates.to_values(x))

    def blocks(self, x: _Vector, *, derivatives: bool = True) -> Iterator[Block]:
        """Yield model and measurement block by block of lines, in order.

        Raises
        ------
        SolverError
            If the model is singular at a line.
        """
        state, slope = self.state(x), self.coordinates.slope(x)
        n_loaded = len(self.rows) + len(self.columns) + self.n * self.sign.size // self.solver.system.n
        for lines in line_blocks(len(self.frf.freq), self.solver.block_size(n_loaded)):
            freq = self.frf.freq[lines]
            H, dH = sensitivity.receptance(
                self.solver, self.unknowns, state, freq, self.rows, self.columns, derivatives=derivatives
            )
            factor = self.sign * ((2j * np.pi * freq) ** QUANTITIES[self.frf.quantity])[:, None, None]
            if dH is not None:
                dH *= slope[:, None, None, None] * factor
            yield Block(lines, H * factor, dH, self.frf.values[lines])

    def responses(self, x: _Vector) -> _Complex:
        """Return the model's FRF at all lines, shape (n_f, n_i, n_j), in the measured quantity."""
        return np.concatenate([b.H for b in self.blocks(x, derivatives=False)])
