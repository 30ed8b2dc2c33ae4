"""Noise models that are estimated from the residual, along with the unknowns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.updating.problem.noise.known import (
    ASSUMED,
    SMALLEST,
    Assumed,
    NoiseModel,
    Stated,
    level_by_unit,
    two_part,
)
from updyn.updating.problem.noise.neighbours import scatter

__all__ = [
    "Estimated",
    "EstimatedByChannel",
    "two_numbers",
]

_Real = NDArray[np.float64]

_SAMPLES = 20_000


@dataclass(frozen=True, slots=True)
class Estimated(NoiseModel):
    """E|dH|^2 = (relative |H|)^2 + (floor rms)^2 with both numbers estimated from the residual.

    They maximise the likelihood of the residual under complex Gaussian noise; the residual is first
    corrected for the unknowns that were fitted. Model error counts as noise here: nothing else is
    known.

    Parameters
    ----------
    relative, floor : float
        The two numbers, once they are known.
    tails : float
        Degrees of freedom of Student's distribution, whose likelihood is used in place of the
        Gaussian one; inf: that.
    lowest : float
        The floor that neighbouring lines show, known before any residual.
    """

    relative: float = np.nan
    floor: float = np.nan
    tails: float = np.inf
    lowest: float = 0.0
    kind: ClassVar[str] = "estimated from the residual"
    source: ClassVar[str] = "estimated"

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> Estimated:
        """Return the model that has not seen a residual yet."""
        return cls(tails=tails, lowest=floor_of_lines(frf))

    def beforehand(self, frf: FRF) -> _Real:
        """Return the square of the floor that neighbouring lines showed, shape (n_f, n_i, n_j)."""
        return two_part(0.0, self.lowest, frf.values, level_by_unit(frf))

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return two_part(self.relative, self.floor, H, level_by_unit(frf))

    def refit(self, H: NDArray[np.complex128], frf: FRF, n_parameters: int) -> Estimated | Assumed:
        """Return the model estimated from frf - H, or `Assumed` without degrees of freedom."""
        if 2 * H.size <= n_parameters:
            return Assumed(**ASSUMED)
        level = np.broadcast_to(level_by_unit(frf), H.shape)
        squared = np.abs(frf.values - H) ** 2 * H.size / (H.size - 0.5 * n_parameters)
        relative, floor = two_numbers(np.abs(H), level, squared, self.tails)
        return replace(self, relative=relative, floor=floor)

    def figures(self) -> dict[str, Any]:
        """Return relative and floor."""
        return {"relative": self.relative, "floor": self.floor}


def two_numbers(size: _Real, level: _Real, squared: _Real, tails: float) -> tuple[float, float]:
    """Return relative and floor that make a residual most likely.

    Parameters
    ----------
    size : ndarray of float
        |H| of the model.
    level : ndarray of float, shape of `size`
        What the floor is a share of.
    squared : ndarray of float, shape of `size`
        Squared magnitude of the residual.
    tails : float
        As for `Estimated`.
    """
    from scipy.optimize import minimize

    stride = max(1, size.size // _SAMPLES)
    size, level = size.ravel()[::stride], level.ravel()[::stride]
    squared = squared.ravel()[::stride]

    def unlikely(logs: NDArray[Any]) -> float:
        a, b = np.exp(np.clip(logs, np.log(SMALLEST), 3.0))
        v = (a * size) ** 2 + (b * level) ** 2
        if np.isinf(tails):
            return float(np.mean(np.log(v) + squared / v))
        return float(np.mean(np.log(v) + (0.5 * tails + 1.0) * np.log1p(2.0 / tails * squared / v)))

    positive = size > 0
    middle = np.mean if np.isinf(tails) else np.median
    guess = np.sqrt(middle(squared[positive] / size[positive] ** 2)) if positive.any() else 1.0
    both = max(guess, SMALLEST), max(np.sqrt(middle(squared / level**2)), SMALLEST)
    tries = [np.log([both[0], 0.03 * both[1]]), np.log([0.03 * both[0], both[1]])]
    options = {"xatol": 1e-3, "fatol": 1e-6}
    minima = [minimize(unlikely, start, method="Nelder-Mead", options=options) for start in tries]
    found = min(minima, key=lambda minimum: float(minimum.fun))
    a, b = np.exp(np.clip(found.x, np.log(SMALLEST), 3.0))
    return float(a), float(b)


#: Degrees of freedom of Student's distribution for the scatter between lines, a third of which may
#: be the shape of the resonances.
_WILD = 1.0


def floor_of_lines(frf: FRF) -> float:
    """Return the noise floor, as a share of the rms of its unit, that neighbouring lines show.

    The scatter about a local polynomial is noise where lines are dense, and besides the shape of
    resonances where they are not. Both parts of the noise are fitted to it; the shape goes with the
    level and counts as relative noise, which is left out.
    """
    squared = scatter(frf)
    level = np.broadcast_to(level_by_unit(frf), squared.shape)
    if not squared.any():
        return 0.0
    return two_numbers(np.abs(frf.values), level, squared, _WILD)[1]


#: Fewest values of a sensor from which its noise is estimated; they give its variance to 20 %.
_ENOUGH = 25


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedByChannel(NoiseModel):
    """E|dH|^2 = (relative |H|)^2 + (floor rms)^2 with two estimated numbers for each response.

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
    lowest : float
        The floor of all that neighbouring lines show, known before any residual.
    """

    tails: float = np.inf
    relative: _Real | None = None
    floor: _Real | None = None
    names: tuple[str, ...] = ()
    held: bool = False
    lowest: float = 0.0
    kind: ClassVar[str] = "estimated from the residual, channel by channel"
    source: ClassVar[str] = "estimated"

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> EstimatedByChannel:
        """Return the model that has not seen a residual yet."""
        return cls(tails=tails, lowest=floor_of_lines(frf))

    def beforehand(self, frf: FRF) -> _Real:
        """Return the square of the floor that neighbouring lines showed, shape (n_f, n_i, n_j)."""
        return two_part(0.0, self.lowest, frf.values, level_by_unit(frf))

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> _Real:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        if self.relative is None or self.floor is None:
            return Stated(**ASSUMED).variance(H, frf)
        return two_part(self.relative[:, None], self.floor[:, None], H, level_by_unit(frf))

    def refit(
        self, H: NDArray[np.complex128], frf: FRF, n_parameters: int
    ) -> EstimatedByChannel | Estimated | Assumed:
        """Return the model estimated by response, or as one where there are few values."""
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
