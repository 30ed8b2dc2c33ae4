"""`AxisExchange`: variant of a group with exchanged section axes of its beams (Iy and Iz).

Exchanged axes, or an orientation vector turned by 90 degrees, are frequent mistakes in models. The
matrices are computed only when model errors are sought; bare matrices and stored models have none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import scipy.sparse as sp

from updyn.errors import ModelError

__all__ = ["AxisExchange", "Recipe", "StiffnessAndMass"]


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessAndMass:
    """Stiffness and mass of a group.

    Parameters
    ----------
    stiffness, mass : sparse, shape (N, N), or None
        In N/m and kg; None if the group has no such matrix.
    """

    stiffness: Any | None
    mass: Any | None


class Recipe(Protocol):
    """Computation of the matrices of a group from its elements."""

    def matrices(self) -> StiffnessAndMass:
        """Return stiffness and mass with exchanged section axes."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisExchange:
    """Stiffness and mass of a group with exchanged section axes, computed on demand.

    Parameters
    ----------
    recipe : Recipe
        Computation of the matrices from the elements.
    what : str
        Properties to exchange in the definition of the model: "Iyy and Izz in the section of beam
        'a'".
    turn : str
        Property to turn instead: "its orientation by 90 degrees"; empty if there is none.
    maps : tuple of sparse
        Later transformations T of the DOFs, in order: A becomes T^T A T.
    stiffness, mass : float
        Later factors on the matrices.
    """

    recipe: Recipe
    what: str
    turn: str = ""
    maps: tuple[Any, ...] = ()
    stiffness: float = 1.0
    mass: float = 1.0

    def scale(self, stiffness: float = 1.0, mass: float = 1.0) -> AxisExchange:
        """Return a copy with factors on the matrices.

        Parameters
        ----------
        stiffness, mass : float
            The factors.

        Returns
        -------
        AxisExchange
        """
        return replace(self, stiffness=self.stiffness * stiffness, mass=self.mass * mass)

    def transform(self, T: Any) -> AxisExchange:
        """Return a copy whose matrices A are T^T A T.

        Parameters
        ----------
        T : sparse, shape (N, n)
            Present DOFs as combinations of the new DOFs.

        Returns
        -------
        AxisExchange
        """
        return replace(self, maps=(*self.maps, T))

    def matrices(self) -> StiffnessAndMass:
        """Return stiffness and mass; ModelError if the elements cannot be computed."""
        computed = self.recipe.matrices()
        return StiffnessAndMass(
            self._transform_matrix(computed.stiffness, self.stiffness),
            self._transform_matrix(computed.mass, self.mass),
        )

    def _transform_matrix(self, matrix: Any | None, factor: float) -> Any | None:
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
