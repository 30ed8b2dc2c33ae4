"""The misfit by which faults are judged: the log error of what stands clear of the noise."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF, ROUNDING
from updyn.updating.problem.noise import level_by_unit

__all__ = ["SEEN", "Weighed", "log_misfit", "n_seen"]

_Complex = NDArray[np.complex128]

#: Noise, as a share of the level, at which a value weighs 0.7.
_CLEAR = 0.03
#: Below so many standard deviations of the noise there is no phase, and no level but that.
SEEN = 3.0
#: Least noise, as a share of the rms of all data of one unit: what no sensor resolves.
_LEAST = 1e-5
#: Share of the values that are more exact than those of weight 1, if each counts by its likelihood.
_EXACT = 0.1


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Weighed(FRF):
    """Data near the response of a model, of which each value counts by its likelihood.

    Attributes
    ----------
    relative : float
        Noise of the most exact values, as a share of them: the misfit of a value is its error in
        standard deviations, times this.
    """

    relative: float

    def __init__(self, *about: Any, relative: float, **further: Any) -> None:
        FRF.__init__(self, *about, **further)
        object.__setattr__(self, "relative", relative)

    @classmethod
    def near(cls, H: _Complex, frf: FRF, variance: NDArray[np.float64]) -> Self:
        """Return data whose noise has a variance, near the response H of a model."""
        answer = np.abs(H)
        seen = answer > ROUNDING * answer.max()
        share = np.sqrt(variance[seen]) / answer[seen]
        return cls.of(frf, variance, float(np.quantile(share, _EXACT)) if share.size else 1.0)

    @classmethod
    def of(cls, frf: FRF, variance: NDArray[np.float64], relative: float) -> Self:
        """Return data with a variance of their noise."""
        about = {one.name: getattr(frf, one.name) for one in fields(FRF)}
        about["variance"] = variance
        return cls(relative=relative, **about)

    def __reduce__(self) -> tuple[Any, ...]:
        about = {one.name: getattr(self, one.name) for one in fields(self)}
        return _rebuild, (type(self), about)

    @property
    def scale(self) -> NDArray[np.float64]:
        """Misfit of an error of 1 in each value."""
        return self.relative / _noise(self)

    def misfit(self, H: _Complex) -> tuple[_Complex, NDArray[np.float64]]:
        """Return w (H_X / H_A - 1) and w, as `log_misfit`."""
        scale, size = self.scale, np.abs(H)
        turned = np.where(size > 0.0, H.conj(), 1.0) / np.where(size > 0.0, size, 1.0)
        return scale * (self.values - H) * turned, scale * size


def _rebuild(cls: type[Weighed], about: dict[str, Any]) -> Weighed:
    return cls(**about)


def log_misfit(H: _Complex, frf: FRF) -> tuple[_Complex, NDArray[np.float64]]:
    """Return w ln(H_X / H_A) and w, both shape (n_f, n_i, n_j); of `Weighed` data by likelihood.

    Unlike the residual of a fit, it counts values that only one side has: where the model answers
    and the data are noise, and where the data stand clear of the noise and the model says nothing,
    as with exchanged channels of a structure whose directions are not coupled. What is lost in the
    noise has three times its standard deviation and no phase of its own.

    Parameters
    ----------
    H : ndarray of complex, shape (n_f, n_i, n_j)
        Of the model.
    frf : FRF
        The data, with their variance.
    """
    if isinstance(frf, Weighed):
        return frf.misfit(H)
    noise = _noise(frf)
    least = SEEN * noise
    size = [np.abs(H), np.abs(frf.values)]
    seen = [one > least for one in size]
    level = [np.log(np.maximum(one, least)) for one in size]
    turned = np.where(seen[0] & seen[1], np.angle(frf.values * H.conj()), 0.0)
    clear = np.maximum(np.maximum(*size) ** 2 - least**2, 0.0)
    weight = np.sqrt(clear / (clear + (noise / _CLEAR) ** 2))
    return weight * (level[1] - level[0] + 1j * turned), weight


def n_seen(frf: FRF) -> int:
    """Return the number of real values that count: of `Weighed` data all, else the clear ones."""
    if isinstance(frf, Weighed):
        return 2 * frf.values.size
    return 2 * int(np.count_nonzero(np.abs(frf.values) > SEEN * _noise(frf)))


def _noise(frf: FRF) -> NDArray[np.float64]:
    """Return the standard deviation of the noise of each value."""
    assert frf.variance is not None
    return np.asarray(np.sqrt(frf.variance + (_LEAST * level_by_unit(frf)) ** 2))
