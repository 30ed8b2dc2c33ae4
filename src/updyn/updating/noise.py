"""Noise models: how uncertain each measured value is, given or estimated.

Everywhere E|dH|^2 is the variance of the complex value: the real and the imaginary part have half of it each. Where the
noise is proportional the model's |H| is used, not the measured one, as weights made from noisy data bias the estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError, suggest
from updyn.frf import FRF

__all__ = [
    "ASSUMED",
    "Assumed",
    "Coherence",
    "Estimated",
    "NoiseModel",
    "Stated",
    "Variance",
    "choose_noise",
    "level_by_unit",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Relative noise below this is rounding; it keeps the weights of exact data finite.
_SMALLEST = 1e-12
_SAMPLES = 20_000

#: Noise that is assumed where neither the user nor the data say how large it is.
ASSUMED = {"relative": 0.05, "floor": 0.001}


class NoiseModel(Protocol):
    """What a noise model offers."""

    @property
    def kind(self) -> str:
        """How the noise is known."""

    @property
    def scale_known(self) -> bool:
        """Whether the variance is known absolutely, or only up to one factor."""

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2 of each value for a model's H, shape (n_f, n_i, n_j), in the unit of the data squared."""

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> NoiseModel:
        """Return the noise model after a look at the residual; the same where nothing is estimated."""

    def figures(self) -> dict[str, float]:
        """Return what is stated or was estimated, for the record."""


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

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return _two_part(self.relative, self.floor, H, level_by_unit(frf))

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> Stated:
        """Return itself."""
        return self

    def figures(self) -> dict[str, float]:
        """Return relative and floor."""
        return {"relative": self.relative, "floor": self.floor}


@dataclass(frozen=True, slots=True)
class Assumed(Stated):
    """Noise of ordinary size, where nothing says how large it is.

    As many unknowns as measured numbers fit any noise, and leave no residual to estimate it from.
    """

    kind: ClassVar[str] = "assumed: as many unknowns as measured numbers, the residual cannot tell"


@dataclass(frozen=True, slots=True)
class Variance:
    """The variance that came with the data."""

    kind: ClassVar[str] = "variance"
    scale_known: ClassVar[bool] = True

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        assert frf.variance is not None
        return np.maximum(frf.variance, (1e-9 * level_by_unit(frf)) ** 2)

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> Variance:
        """Return itself."""
        return self

    def figures(self) -> dict[str, float]:
        """Return nothing: the numbers are in the data."""
        return {}


@dataclass(frozen=True, slots=True)
class Coherence:
    """E|dH|^2 = |H|^2 (1 - gamma^2) / (gamma^2 n_avg), plus a floor of 1e-4 |H| (Bendat & Piersol, Random Data, 2010).

    Parameters
    ----------
    scale_known : bool
        Whether the number of averages is known.
    """

    scale_known: bool
    kind: ClassVar[str] = "coherence"

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        assert frf.coherence is not None
        coherence = np.clip(frf.coherence, 1e-6, 1.0)
        relative = (1.0 - coherence) / (coherence * (frf.averages or 1))
        return np.abs(H) ** 2 * (relative + 1e-8) + (1e-6 * level_by_unit(frf)) ** 2

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> Coherence:
        """Return itself."""
        return self

    def figures(self) -> dict[str, float]:
        """Return nothing: the numbers are in the data."""
        return {}


@dataclass(frozen=True, slots=True)
class Estimated:
    """E|dH|^2 = (relative |H|)^2 + (floor rms)^2 with both numbers estimated from the residual.

    They maximise the likelihood of the residual under complex Gaussian noise; the residual is first corrected for the
    unknowns that were fitted. Model error counts as noise here: nothing else is known.
    """

    relative: float = np.nan
    floor: float = np.nan
    kind: ClassVar[str] = "estimated from the residual"
    scale_known: ClassVar[bool] = True  # once it has been estimated

    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return _two_part(self.relative, self.floor, H, level_by_unit(frf))

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> Estimated | Assumed:
        """Return the model with `relative` and `floor` estimated from frf - H, or `Assumed` where nothing is left."""
        from scipy.optimize import minimize

        if 2 * H.size <= n_parameters:
            return Assumed(**ASSUMED)
        level = np.broadcast_to(level_by_unit(frf), H.shape)
        stride = max(1, H.size // _SAMPLES)
        size, floor = np.abs(H).ravel()[::stride], level.ravel()[::stride]
        squared = np.abs(frf.values - H).ravel()[::stride] ** 2
        squared = squared * H.size / (H.size - 0.5 * n_parameters)

        def unlikely(logs: NDArray[Any]) -> float:
            a, b = np.exp(np.clip(logs, np.log(_SMALLEST), 3.0))
            v = (a * size) ** 2 + (b * floor) ** 2
            return float(np.mean(np.log(v) + squared / v))

        positive = size > 0
        guess = np.sqrt(np.mean(squared[positive] / size[positive] ** 2)) if positive.any() else 1.0
        both = max(guess, _SMALLEST), max(np.sqrt(np.mean(squared / floor**2)), _SMALLEST)
        tries = [np.log([both[0], 0.03 * both[1]]), np.log([0.03 * both[0], both[1]])]
        found = min(
            (minimize(unlikely, t, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-6}) for t in tries),
            key=lambda m: float(m.fun),
        )
        a, b = np.exp(np.clip(found.x, np.log(_SMALLEST), 3.0))
        return replace(self, relative=float(a), floor=float(b))

    def figures(self) -> dict[str, float]:
        """Return relative and floor."""
        return {"relative": self.relative, "floor": self.floor}


NoiseChoice: TypeAlias = "str | Mapping[str, float] | None"


def choose_noise(noise: NoiseChoice, frf: FRF) -> NoiseModel:
    """Choose the noise model.

    Parameters
    ----------
    noise : None, str or mapping
        None: from the data's variance, else their coherence, else estimated. ``"variance"``, ``"coherence"`` or
        ``"estimated"`` to force one. A mapping with ``relative`` and/or ``floor`` states it.
    frf : FRF
        The data of the fit.

    Raises
    ------
    OptionError
        If a name or key is not known, a number is not usable, or the data lack what is asked for.
    """
    if isinstance(noise, Mapping):
        for key, value in noise.items():
            if key not in ("relative", "floor"):
                raise OptionError(f"noise: no key {key!r}; {suggest(str(key), ('relative', 'floor'))}")
            if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value) or value < 0:
                raise OptionError(f"noise: {key} = {value!r}; expected a number of at least 0")
        stated = Stated(float(noise.get("relative", 0.0)), float(noise.get("floor", 0.0)))
        if stated.relative == stated.floor == 0.0:
            raise OptionError(
                "noise: relative and floor are both 0; data without noise need no noise model, leave it out"
            )
        return stated
    choices = ("variance", "coherence", "estimated")
    if noise is not None and noise not in choices:
        raise OptionError(f"noise {noise!r}: {suggest(str(noise), choices)}, or a table with relative and floor")
    if noise in ("variance", "coherence") and getattr(frf, str(noise)) is None:
        raise OptionError(f"noise {noise!r}: the data carry no {noise}")
    if noise == "variance" or (noise is None and frf.variance is not None):
        return Variance()
    if noise == "coherence" or (noise is None and frf.coherence is not None):
        return Coherence(scale_known=frf.averages is not None)
    return Estimated()


def level_by_unit(frf: FRF) -> _Real:
    """Return the rms of |H_X| over all data of one unit (translation or rotation), shape (1, n_i, n_j)."""
    rows, columns = frf.responses.axes >= 3, frf.references.axes >= 3
    kind = 2 * rows[:, None] + columns[None, :]
    squared = np.mean(np.abs(frf.values) ** 2, axis=0)
    level = np.zeros(kind.shape)
    for k in np.unique(kind):
        level[kind == k] = np.sqrt(np.mean(squared[kind == k]))
    return np.asarray(np.maximum(level, np.finfo(float).tiny ** 0.25)[None])


def _two_part(relative: float, floor: float, H: _Complex, level: _Real) -> _Real:
    return np.asarray((relative * np.abs(H)) ** 2 + (max(floor, _SMALLEST) * level) ** 2)
