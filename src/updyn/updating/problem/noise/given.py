"""The variance that came with the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise.base import level_by_unit

__all__ = ["Variance"]


@dataclass(frozen=True, slots=True)
class Variance:
    """The variance that came with the data."""

    kind: ClassVar[str] = "variance"
    scale_known: ClassVar[bool] = True

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        assert frf.variance is not None
        return np.maximum(frf.variance, (1e-9 * level_by_unit(frf)) ** 2)

    def refit(self, H: NDArray[np.complex128], frf: FRF, n_parameters: int) -> Variance:
        """Return itself."""
        return self

    def figures(self) -> dict[str, Any]:
        """Return nothing: the numbers are in the data."""
        return {}
