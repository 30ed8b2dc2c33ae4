"""Effective modal masses of a structure on a moving base.

Under a unit translation r of its base, a mode phi of unit modal mass has the effective mass (phi^T
M r)^2; those of all modes sum to the total mass r^T M r (J. J. Wijker, *Mechanical Vibrations in
Spacecraft Design*, 2004, on modal effective mass).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import DofSet
from updyn.group import Matrix

__all__ = ["DIRECTION_NAMES", "MassShares", "unit_motions"]

DIRECTION_NAMES = "XYZ"


def unit_motions(dofs: DofSet) -> RealArray:
    """Return the unit translations along X, Y and Z at some DOFs, shape (N, 3)."""
    return np.where(dofs.axes[:, None] == np.arange(3), dofs.signs[:, None], 0).astype(np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class MassShares:
    """Effective masses of modes as shares of the total mass, by direction.

    `directions` are those of X, Y and Z in which the model has mass; `total`, shape (d,), is the
    moving mass in kg; `shares`, shape (n, d).
    """

    directions: str
    total: RealArray
    shares: RealArray

    @classmethod
    def of(
        cls, shapes: RealArray, M: Matrix, dofs: DofSet, directions: str = DIRECTION_NAMES
    ) -> MassShares | None:
        """Return the shares of modes of unit modal mass; None without mass in any direction."""
        motions = unit_motions(dofs)
        total = np.einsum("id,id->d", motions, M @ motions)
        is_used = (total > 0.0) & [name in directions for name in DIRECTION_NAMES]
        if not is_used.any():
            return None
        names = "".join(np.array(list(DIRECTION_NAMES))[is_used])
        masses = (shapes.T @ (M @ motions[:, is_used])) ** 2
        return cls(names, total[is_used], masses / total[is_used])

    @property
    def largest(self) -> RealArray:
        """Largest share of each mode over the directions, shape (n,)."""
        return np.asarray(self.shares.max(axis=1))

    def text(self, k: int) -> str:
        """Return the largest share of a mode with its direction as text."""
        d = int(np.argmax(self.shares[k]))
        return f"{100.0 * self.shares[k, d]:.3g} % of the mass in {self.directions[d]}"
