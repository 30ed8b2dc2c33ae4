"""Noise as the user states it, and as it is assumed where nobody says anything."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise.base import level_by_unit, two_part

__all__ = ["Assumed", "Stated"]


@dataclass(frozen=True, slots=True)
class Stated:
    """E|dH|^2 = (relative |H|)^2 + (floor rms)^2, as the user states it.

    Parameters
    ----------
    relative : float
        Noise proportional to |H|.
    floor : float
        Noise that does not depend on |H|, as a share of the rms of all data of the same unit.
    """

    relative: float
    floor: float
    kind: ClassVar[str] = "stated"
    scale_known: ClassVar[bool] = True

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return two_part(self.relative, self.floor, H, level_by_unit(frf))

    def refit(self, H: NDArray[np.complex128], frf: FRF, n_parameters: int) -> Stated:
        """Return itself."""
        return self

    def figures(self) -> dict[str, Any]:
        """Return relative and floor."""
        return {"relative": self.relative, "floor": self.floor}


@dataclass(frozen=True, slots=True)
class Assumed(Stated):
    """Noise of ordinary size, where nothing says how large it is.

    As many unknowns as measured numbers fit any noise, and leave no residual to estimate it from.
    """

    kind: ClassVar[str] = "assumed: as many unknowns as measured numbers, the residual cannot tell"
