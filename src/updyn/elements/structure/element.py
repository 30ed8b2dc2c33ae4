"""`Element`: finite elements of one kind in one group, and `ELEMENTS`, the registry of kinds.

To add a kind, register a dataclass derived from `Element` with ``ELEMENTS.register("kind", Kind)``
or an entry point of the group ``updyn.elements``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from updyn.arrays import BoolArray, IntArray, RealArray
from updyn.registry import Registry

__all__ = ["ALL_DIRECTIONS", "ELEMENTS", "TRANSLATIONS", "Element", "ElementMatrices"]

#: Directions of a DOF, by position in `updyn.dofs.DIRECTIONS`.
TRANSLATIONS = (0, 1, 2)
ALL_DIRECTIONS = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True, slots=True, eq=False)
class ElementMatrices:
    """Matrices of m elements of k nodes with d DOFs each, in global axes, node by node.

    Attributes
    ----------
    K, M, C : ndarray of float, shape (m, k d, k d), or None
        Stiffness (N/m, N, N m), mass (kg, kg m, kg m2) and viscous damping (N s/m, N s, N m s),
        symmetric; None if the elements have none.
    """

    K: RealArray | None = None
    M: RealArray | None = None
    C: RealArray | None = None

    @property
    def nonzero(self) -> BoolArray:
        """DOFs with a diagonal entry other than 0 in any of the matrices, shape (m, k d)."""
        present = [A for A in (self.K, self.M, self.C) if A is not None]
        return np.asarray(np.logical_or.reduce([np.einsum("mii->mi", A) != 0 for A in present]))


class Element(ABC):
    """Elements of one kind in one group: base class of `Beam`, `Shell`, `Spring` and the others.

    A derived class is a dataclass. Its fields are the keys of a row of its table in a job file.
    They include ``name``, the group name, and, for elements with stiffness, ``loss_factor``, the
    structural loss factor. Elements that differ only by their nodes have these in a field
    ``connectivity``; others define `node_numbers`.
    """

    __slots__ = ()

    #: Directions of the DOFs of each node, d of the positions 0 to 5 in `updyn.dofs.DIRECTIONS`.
    directions: ClassVar[tuple[int, ...]] = ALL_DIRECTIONS
    #: Whether the faces enclose a volume; a face that two elements share is then an inner face.
    encloses: ClassVar[bool] = False

    name: str
    connectivity: Any

    @property
    def label(self) -> str:
        """Kind and name, for messages."""
        return f"{type(self).__name__.lower()} {self.name!r}"

    @property
    def node_numbers(self) -> IntArray:
        """Node numbers of the m elements, shape (m, k)."""
        return np.asarray(self.connectivity, dtype=np.int64)

    @abstractmethod
    def matrices(self, numbers: IntArray, xyz: RealArray) -> ElementMatrices:
        """Compute the matrices of given elements.

        Parameters
        ----------
        numbers : ndarray of int, shape (m, k)
            Node numbers of the elements, for messages.
        xyz : ndarray of float, shape (m, k, 3)
            Positions of the nodes in m.

        Returns
        -------
        ElementMatrices

        Raises
        ------
        ModelError
            If an element has no size, or a library is missing.
        """

    def used_dofs(self, xyz: RealArray) -> BoolArray:
        """Return a mask of the node DOFs that the elements use, shape (m, k, d); by default all.

        Parameters
        ----------
        xyz : ndarray of float, shape (m, k, 3)
            Positions of all nodes in m.
        """
        return np.ones((*xyz.shape[:2], len(self.directions)), dtype=np.bool_)

    def edges(self) -> IntArray:
        """Return node numbers of the lines to draw, shape (n, 2); by default none."""
        return np.empty((0, 2), dtype=np.int64)

    def faces(self) -> IntArray:
        """Return node numbers of the faces to draw, shape (k, 3) or (k, 4); by default none."""
        return np.empty((0, 4), dtype=np.int64)

    def with_exchanged_axes(self) -> Self | None:
        """Return the elements with exchanged section axes; None if this changes nothing.

        By default, elements have no section axes.
        """
        return None

    def orientation_turned(self, xyz: RealArray) -> str:
        """Return the orientation rotated by 90 degrees about the elements, as text.

        By default empty, as elements have no orientation.

        Parameters
        ----------
        xyz : ndarray of float, shape (m, k, 3)
            Positions of all nodes in m.
        """
        return ""

    @classmethod
    def fields_of_row(cls, where: str, row: Mapping[str, object]) -> Mapping[str, object]:
        """Convert the values of a row of a job file to field values; by default unchanged.

        Parameters
        ----------
        where : str
            Place of the row, for messages.
        row : mapping
            Values by key.
        """
        return row


#: Kinds of elements by the name of their array of tables in a job file.
ELEMENTS: Registry[type[Element]] = Registry(
    "element",
    "updyn.elements",
    {
        "beam": "updyn.elements.structure.beams:Beam",
        "truss": "updyn.elements.structure.beams:Truss",
        "shell": "updyn.elements.structure.shells:Shell",
        "solid": "updyn.elements.structure.solids:Solid",
        "spring": "updyn.elements.structure.springs:Spring",
        "mass": "updyn.elements.structure.springs:PointMass",
    },
)
