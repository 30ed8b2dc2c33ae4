"""An element: a rod of two nodes with stiffness and mass along X."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from updyn.elements.structure.element import Element, ElementMatrices


@dataclass(frozen=True, slots=True)
class Rod(Element):
    """Rods that differ by their nodes: stiffness in N/m, a mass in kg at each end."""

    name: str
    connectivity: Any
    stiffness: float
    mass: float
    loss_factor: float = 0.0

    directions: ClassVar[tuple[int, ...]] = (0,)

    def matrices(self, numbers, xyz):
        """Return stiffness and mass of each rod."""
        m = len(numbers)
        K = self.stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return ElementMatrices(np.tile(K, (m, 1, 1)), np.tile(self.mass * np.eye(2), (m, 1, 1)))
