"""Noise estimated from the residual for each sensor by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise.base import ASSUMED, level_by_unit, two_part
from updyn.updating.problem.noise.estimated import Estimated, two_numbers
from updyn.updating.problem.noise.stated import Assumed, Stated

__all__ = ["EstimatedByChannel"]

_Real = NDArray[np.float64]
#: Fewest values of a sensor from which its noise is told: their variance is known to 20 % then.
_ENOUGH = 25


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedByChannel:
    """E|dH|^2 = (relative |H|)^2 + (floor rms)^2 with two numbers for each response, from its own residual.

    Parameters
    ----------
    tails : float
        Degrees of freedom of Student's distribution in the likelihood; inf: Gaussian.
    relative, floor : ndarray of float, shape (n_i,), optional
        The numbers, once a residual was seen; before, noise of ordinary size is taken. The floor is
        a share of the rms of all data of the same unit.
    names : tuple of str
        The responses, then.
    held : bool
        Whether the numbers stay as they are.
    """

    tails: float = np.inf
    relative: _Real | None = None
    floor: _Real | None = None
    names: tuple[str, ...] = ()
    held: bool = False
    kind: ClassVar[str] = "estimated from the residual, channel by channel"
    scale_known: ClassVar[bool] = True  # once it has been estimated

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> _Real:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        if self.relative is None or self.floor is None:
            return Stated(**ASSUMED).variance(H, frf)
        return two_part(self.relative[:, None], self.floor[:, None], H, level_by_unit(frf))

    def refit(
        self, H: NDArray[np.complex128], frf: FRF, n_parameters: int
    ) -> EstimatedByChannel | Estimated | Assumed:
        """Return the model with the numbers of each response, or of all together where these have too few values."""
        if self.held:
            return self
        if 2 * H.size <= n_parameters or H[:, 0].size < _ENOUGH:
            return Estimated(tails=self.tails).refit(H, frf, n_parameters)
        level = np.broadcast_to(level_by_unit(frf), H.shape)
        squared = np.abs(frf.values - H) ** 2 * H.size / (H.size - 0.5 * n_parameters)
        found = np.array(
            [
                two_numbers(np.abs(H[:, i]), level[:, i], squared[:, i], self.tails)
                for i in range(H.shape[1])
            ]
        )
        return replace(
            self, relative=found[:, 0], floor=found[:, 1], names=tuple(frf.responses.labels)
        )

    def figures(self) -> dict[str, Any]:
        """Return relative and floor of each response."""
        if self.relative is None or self.floor is None:
            return {}
        return {
            "relative_by_channel": dict(zip(self.names, self.relative.tolist(), strict=True)),
            "floor_by_channel": dict(zip(self.names, self.floor.tolist(), strict=True)),
        }
