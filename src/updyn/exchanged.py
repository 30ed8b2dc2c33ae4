"""`Exchanged`: a group as it would be with the section axes of its beams exchanged (Iy and Iz).

Models of beams with exchanged section axes, or with an orientation vector that is turned by 90
degrees, are a frequent mistake. The elements that make a group know its sections and keep a recipe
for the other matrices; they are computed where an error of the model is looked for, and only then.
A reader of matrices alone keeps no recipe, and a stored model has none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import scipy.sparse as sp

from updyn.errors import ModelError

__all__ = ["Exchanged", "Recipe", "StiffnessAndMass"]


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessAndMass:
    """Stiffness and mass of a group.

    Parameters
    ----------
    stiffness, mass : sparse, shape (N, N), or None
        In N/m and kg; None: the group has none.
    """

    stiffness: Any | None
    mass: Any | None


class Recipe(Protocol):
    """How the matrices of a group follow from its elements."""

    def matrices(self) -> StiffnessAndMass:
        """Compute stiffness and mass with exchanged section axes.

        Returns
        -------
        StiffnessAndMass
        """


@dataclass(frozen=True, slots=True, eq=False)
class Exchanged:
    """Stiffness and mass of a group with exchanged section axes, computed on demand.

    Parameters
    ----------
    recipe : Recipe
        Computes the matrices as the elements give them.
    what : str
        What to exchange in the definition of the model: "Iyy and Izz in the section of beam 'a'".
    turn : str
        What to turn instead: "its orientation by 90 degrees"; empty where there is none.
    maps : tuple of sparse
        Transformations T of the DOFs since then, in order: A becomes T^T A T.
    stiffness, mass : float
        Factors on the matrices since then.
    """

    recipe: Recipe
    what: str
    turn: str = ""
    maps: tuple[Any, ...] = ()
    stiffness: float = 1.0
    mass: float = 1.0

    def scaled(self, stiffness: float = 1.0, mass: float = 1.0) -> Exchanged:
        """Return a copy with factors on the matrices.

        Parameters
        ----------
        stiffness, mass : float
            The factors.

        Returns
        -------
        Exchanged
        """
        return replace(self, stiffness=self.stiffness * stiffness, mass=self.mass * mass)

    def transformed(self, T: Any) -> Exchanged:
        """Return a copy whose matrices A are T^T A T.

        Parameters
        ----------
        T : sparse, shape (N, n)
            The present DOFs by the new ones.

        Returns
        -------
        Exchanged
        """
        return replace(self, maps=(*self.maps, T))

    def matrices(self) -> StiffnessAndMass:
        """Compute stiffness and mass.

        Returns
        -------
        StiffnessAndMass

        Raises
        ------
        ModelError
            If the elements cannot be computed.
        """
        own = self.recipe.matrices()
        return StiffnessAndMass(
            self._now(own.stiffness, self.stiffness), self._now(own.mass, self.mass)
        )

    def _now(self, matrix: Any | None, factor: float) -> Any | None:
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
