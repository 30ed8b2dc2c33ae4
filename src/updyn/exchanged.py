"""`AxisExchange`: variant of a group with exchanged section axes of its beams (Iy and Iz).

Exchanged axes, or an orientation vector turned by 90 degrees, are frequent mistakes in models. The
matrices are computed only when model errors are sought; bare matrices and stored models have none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import scipy.sparse as sp

from updyn.errors import ModelError

__all__ = ["AxisExchange", "Recipe", "StiffnessAndMass"]


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessAndMass:
    """Stiffness (N/m) and mass (kg) of a group, sparse; None if the group has no such matrix."""

    stiffness: sp.csr_array | None
    mass: sp.csr_array | None


class Recipe(Protocol):
    """Computation of the matrices of a group from its elements."""

    def matrices(self) -> StiffnessAndMass:
        """Return stiffness and mass with exchanged section axes."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisExchange:
    """Stiffness and mass of a group with exchanged section axes, computed on demand.

    `what` and `turn` name the properties to exchange, or to turn instead, for messages: "Iyy and
    Izz in the section of beam 'a'", "its orientation by 90 degrees". Later transformations T in
    `maps` make T^T A T of each matrix A, later factors are `stiffness` and `mass`.
    """

    recipe: Recipe
    what: str
    turn: str = ""
    maps: tuple[sp.csr_array, ...] = ()
    stiffness: float = 1.0
    mass: float = 1.0

    def scale(self, stiffness: float = 1.0, mass: float = 1.0) -> AxisExchange:
        """Return a copy with further factors on the matrices."""
        return replace(self, stiffness=self.stiffness * stiffness, mass=self.mass * mass)

    def transform(self, T: sp.csr_array) -> AxisExchange:
        """Return a copy whose matrices A are T^T A T, T of shape (N, n)."""
        return replace(self, maps=(*self.maps, T))

    def matrices(self) -> StiffnessAndMass:
        """Return stiffness and mass; ModelError if the elements cannot be computed."""
        computed = self.recipe.matrices()
        return StiffnessAndMass(
            self._transform_matrix(computed.stiffness, self.stiffness),
            self._transform_matrix(computed.mass, self.mass),
        )

    def _transform_matrix(self, matrix: sp.csr_array | None, factor: float) -> sp.csr_array | None:
        if matrix is None:
            return None
        for T in self.maps:
            if T.shape[0] != matrix.shape[0]:
                raise ModelError(
                    f"exchanged section axes: {matrix.shape[0]} DOFs; expected {T.shape[0]}"
                )
            matrix = T.T @ matrix @ T
        matrix = factor * matrix
        return sp.csr_array(0.5 * (matrix + matrix.T))
