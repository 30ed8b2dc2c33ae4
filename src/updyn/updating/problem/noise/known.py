"""Base classes of the noise models, and models whose variance is stated or in the data."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.updating.problem.noise.settings import NOISE_LIMITS, SMOOTH_VARIANCE

__all__ = [
    "ASSUMED",
    "Assumed",
    "Coherence",
    "NoiseModel",
    "SmoothVariance",
    "Stated",
    "Variance",
    "WrappedNoise",
    "level_by_unit",
    "level_of_units",
    "smooth_variance",
    "two_part_variance",
    "unit_kinds",
]


#: Noise that is assumed if neither the user nor the data give its size.
ASSUMED = {"relative": 0.05, "floor": 0.001}


class NoiseModel(ABC):
    """Base class of the noise models: the variance of each measured value.

    Attributes
    ----------
    needs : str
        Field of the FRF that the model requires, such as ``"coherence"``; may be empty.
    """

    __slots__ = ()

    needs: ClassVar[str] = ""

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> NoiseModel:
        """Return the noise model for the data of a fit.

        Parameters
        ----------
        frf : FRF
            The data.
        tails : float
            Degrees of freedom of Student's distribution if the noise is estimated; inf: Gaussian.

        Returns
        -------
        NoiseModel
            The model before any residual is known.
        """
        return cls()

    @property
    @abstractmethod
    def kind(self) -> str:
        """Description of the noise for the record of a run."""

    @property
    def source(self) -> str:
        """Origin of the noise level: ``"data"``, ``"stated"``, ``"estimated"`` or ``"assumed"``."""
        return "data"

    @property
    def scale_known(self) -> bool:
        """Whether the variance is known absolutely, not only up to a common factor."""
        return True

    @property
    def size_known(self) -> bool:
        """Whether the variance is known absolutely without a fit."""
        return self.scale_known and self.source in ("data", "stated")

    @property
    def bulk(self) -> NoiseModel:
        """The noise model without its treatment of outliers; the model itself if it has none."""
        return self

    @property
    def heavy_tails(self) -> bool:
        """Whether the model gives less weight to outliers."""
        return False

    @abstractmethod
    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2 in squared units of the data, shape (n_f, n_i, n_j).

        Parameters
        ----------
        H : ndarray of complex, shape (n_f, n_i, n_j)
            FRF of the model.
        frf : FRF
            The data.
        """

    def initial_variance(self, frf: FRF) -> RealArray:
        """Return E|dH|^2 as far as it is known before a fit, shape (n_f, n_i, n_j)."""
        return self.variance(frf.values, frf)

    def negative_log_likelihood(self, H: ComplexArray, frf: FRF) -> float:
        """Return the negative log-likelihood of the data, up to a constant.

        If the variance is known only up to a factor, the factor is estimated from the residual.

        Parameters
        ----------
        H : ndarray of complex, shape (n_f, n_i, n_j)
            FRF of the model.
        frf : FRF
            The data.

        Returns
        -------
        float
        """
        v = self.variance(H, frf)
        power = np.abs(frf.values - H) ** 2 / v
        if self.scale_known:
            return float(np.sum(np.log(v) + power))
        typical = max(float(np.mean(power)), NOISE_LIMITS.least_noise)
        return float(np.sum(np.log(v)) + v.size * np.log(typical))

    def refit(self, H: ComplexArray, frf: FRF, n_parameters: int) -> NoiseModel:
        """Return the noise model refitted to the residual frf - H; itself if nothing is estimated.

        Parameters
        ----------
        H : ndarray of complex, shape (n_f, n_i, n_j)
            FRF of the model.
        frf : FRF
            The data.
        n_parameters : int
            Number of fitted unknowns.

        Returns
        -------
        NoiseModel
        """
        return self

    def figures(self) -> dict[str, Any]:
        """Return the stated or estimated numbers for the record; empty if the data hold them."""
        return {}


class WrappedNoise(NoiseModel):
    """Base class of the noise models that modify another noise model, `base`."""

    __slots__ = ()

    base: NoiseModel

    @property
    def kind(self) -> str:
        """Description of the base model's noise."""
        return self.base.kind

    @property
    def source(self) -> str:
        """Origin of the base model's noise level."""
        return self.base.source

    @property
    def heavy_tails(self) -> bool:
        """Whether the base model gives less weight to outliers."""
        return self.base.heavy_tails

    def initial_variance(self, frf: FRF) -> RealArray:
        """Return the base model's E|dH|^2 before a fit, shape (n_f, n_i, n_j)."""
        return self.base.initial_variance(frf)


def level_by_unit(frf: FRF) -> RealArray:
    """Return the rms of |H_X| over all data of the same unit, shape (1, n_i, n_j)."""
    squared = np.mean(np.abs(frf.values) ** 2, axis=0)
    return level_of_units(squared, frf.responses, frf.references)[None]


def unit_kinds(responses: DofSet, references: DofSet) -> IndexArray:
    """Return a number for each channel, equal for channels of one unit, shape (n_i, n_j)."""
    rows, columns = responses.axes >= 3, references.axes >= 3
    return np.asarray(2 * rows[:, None] + columns[None, :], dtype=np.intp)


def level_of_units(squared: RealArray, responses: DofSet, references: DofSet) -> RealArray:
    """Return the rms, above 0, over all channels of one unit for the mean squares, (n_i, n_j)."""
    kind = unit_kinds(responses, references)
    level = np.zeros(kind.shape)
    for k in np.flatnonzero(np.bincount(kind.ravel())):
        is_of_unit = kind == k
        level[is_of_unit] = np.sqrt(np.mean(squared[is_of_unit]))
    return np.asarray(np.maximum(level, np.finfo(float).tiny ** 0.25))


def two_part_variance(
    relative: float | RealArray, floor: float | RealArray, H: ComplexArray, level: RealArray
) -> RealArray:
    """Return (relative |H|)^2 + (floor level)^2, shape (n_f, n_i, n_j)."""
    floor = np.maximum(floor, NOISE_LIMITS.least_noise)
    return np.asarray((relative * np.abs(H)) ** 2 + (floor * level) ** 2)


@dataclass(frozen=True, slots=True)
class Stated(NoiseModel):
    """Noise with the variance E|dH|^2 = (relative |H|)^2 + (floor rms)^2 that the user states.

    The rms is that of all data of the same unit.
    """

    relative: float
    floor: float
    kind: ClassVar[str] = "stated"
    source: ClassVar[str] = "stated"

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return two_part_variance(self.relative, self.floor, H, level_by_unit(frf))

    def figures(self) -> dict[str, Any]:
        """Return the relative noise and the floor."""
        return {"relative": self.relative, "floor": self.floor}


@dataclass(frozen=True, slots=True)
class Assumed(Stated):
    """Noise of typical size, for data that do not determine it.

    If there are as many unknowns as measured numbers, the residual vanishes for any noise.
    """

    source: ClassVar[str] = "assumed"
    kind: ClassVar[str] = "assumed: as many unknowns as measured numbers, the residual cannot tell"


@dataclass(frozen=True, slots=True)
class Variance(NoiseModel):
    """Noise with the variance that comes with the data."""

    kind: ClassVar[str] = "variance"
    needs: ClassVar[str] = "variance"

    @classmethod
    def is_informative(cls, frf: FRF) -> bool:
        """Return whether the data have a variance other than zero."""
        return frf.variance is not None and bool(frf.variance.any())

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> Variance:
        """Return the noise model for the data of a fit; raise if the variance is zero."""
        if not cls.is_informative(frf):
            raise OptionError(
                "noise 'variance': the variance of the data is zero everywhere",
                key=("noise",),
            )
        return cls()

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        assert frf.variance is not None
        return np.maximum(frf.variance, (1e-9 * level_by_unit(frf)) ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class Coherence(NoiseModel):
    """Noise with the variance |H_X|^2 (1 - gamma^2) / (gamma^2 (n - 1)), smoothed along the lines.

    S_nn = (1 - gamma^2) S_yy (Bendat & Piersol, Random Data, 4th ed. 2010, sections 6.1.4 and
    9.2.3, there n for n - 1); S_nn / (n S_xx) is without bias, although gamma^2 is biased (Carter,
    Knapp & Nuttall, IEEE Trans. Audio Electroacoust. 21 (1973) 337). The model's |H| for |H_X|
    would give nearly zero at an antiresonance. `scale_known`: the number of averages is known;
    `smoothed` at `freq` (Hz) is computed from the data of each call if None.
    """

    scale_known: bool
    freq: RealArray | None = None
    smoothed: SmoothVariance | None = None
    kind: ClassVar[str] = "coherence"
    needs: ClassVar[str] = "coherence"

    @classmethod
    def is_informative(cls, frf: FRF) -> bool:
        """Return whether the data have a coherence that carries information on the noise."""
        # The coherence of a single average is 1 for any noise; so is a constant that was filled
        # in.
        if frf.coherence is None or frf.averages == 1:
            return False
        return bool((frf.coherence < 1.0).any())

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> Coherence:
        """Return the model with the variance of all lines of `frf`, for these or some of them."""
        if not cls.is_informative(frf):
            single = "of a single average" if frf.averages == 1 else "of the data"
            raise OptionError(
                f"noise 'coherence': the coherence {single} is 1 for any noise",
                key=("noise",),
            )
        return cls(frf.averages is not None, frf.freq, _smooth_coherence(frf))

    def variance(self, H: ComplexArray, frf: FRF) -> RealArray:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        if (
            self.freq is not None
            and self.smoothed is not None
            and self.smoothed.floor.shape[1:] == H.shape[1:]
        ):
            at = np.searchsorted(self.freq, frf.freq)
            if at[-1] < len(self.freq) and (self.freq[at] == frf.freq).all():
                return self.smoothed.at(np.abs(H), at)
        return _smooth_coherence(frf).at(np.abs(H))


def _smooth_coherence(frf: FRF) -> SmoothVariance:
    assert frf.coherence is not None
    gamma2 = np.clip(frf.coherence, 1e-6, 1.0)
    size = np.abs(frf.values)
    share = (1.0 - gamma2) / (gamma2 * max((frf.averages or 2) - 1, 1))
    least = (1e-4 * size) ** 2 + (1e-6 * level_by_unit(frf)) ** 2
    averages = frf.averages or SMOOTH_VARIANCE.assumed_averages
    return smooth_variance(size**2 * share + least, size, max(averages - 1, 1))


@dataclass(frozen=True, slots=True, eq=False)
class SmoothVariance:
    """A smooth variance, floor + relative |H|^2, both of shape (n_f, ...)."""

    floor: RealArray
    relative: RealArray

    def at(self, size: RealArray, lines: slice | IndexArray = slice(None)) -> RealArray:
        """Return the variance for magnitudes `size` at some of the lines, shape (n_f, ...)."""
        return np.asarray(self.floor[lines] + self.relative[lines] * size**2)


def smooth_variance(variance: RealArray, size: RealArray, freedom: int) -> SmoothVariance:
    """Smooth independent estimates, distributed as Gamma(freedom) / freedom, along the lines."""
    # A floor and a part proportional to |H|^2, piecewise linear, are fitted to each channel by
    # maximum likelihood (multiplicative updates of Fevotte, Bertin & Durrieu, Neural Computation
    # 21 (2009) 793, with the exponent 1/2 for descent). The ratio to this fit is averaged over
    # neighbours; a line ten times above their median keeps its variance (hum). The mean inverse of
    # a mean of d Gamma(1) variables, d / (d - 1), is corrected: weights are unbiased.
    from scipy.ndimage import uniform_filter1d

    width = min(-(-SMOOTH_VARIANCE.smoothed_freedoms // freedom), len(variance) // 4) // 2 * 2 + 1
    window = max(width, SMOOTH_VARIANCE.least_outlier_window)
    floor, relative = _fit_two_parts(variance, size, freedom, window)
    ratio = variance / (floor + relative * size**2)
    is_usual = _is_near_median(ratio, window)
    share = uniform_filter1d(is_usual.astype(float), width, axis=0, mode="reflect")
    total = uniform_filter1d(np.where(is_usual, ratio, 0.0), width, axis=0, mode="reflect")
    smooth = np.where(is_usual, total / np.maximum(share, 1e-9), ratio)
    n_values = np.where(is_usual, np.maximum(share * width, 1.0), 1.0) * freedom
    smooth *= n_values / np.maximum(n_values - 1.0, 0.5)
    return SmoothVariance(floor * smooth, relative * smooth)


def _is_near_median(ratio: RealArray, width: int) -> BoolArray:
    """Return which ratios, shape (n_f, ...), are not far above the median of nearby lines."""
    from scipy.ndimage import median_filter

    around = median_filter(ratio, size=(width, *(1,) * (ratio.ndim - 1)), mode="reflect")
    return np.asarray(ratio <= SMOOTH_VARIANCE.outlier_ratio * around)


def _fit_two_parts(
    variance: RealArray, size: RealArray, freedom: int, width: int
) -> tuple[RealArray, RealArray]:
    """Return the floor and the relative part of the variance, both of shape (n_f, ...)."""
    n_f, channels = len(variance), variance.shape[1:]
    wanted = n_f * freedom // SMOOTH_VARIANCE.smoothed_freedoms
    knots = min(max(wanted, 1), SMOOTH_VARIANCE.most_knots)
    hats = _hat_functions(n_f, knots)
    v = variance.reshape(n_f, int(np.prod(channels)))
    s = np.maximum(size.reshape(v.shape), np.finfo(float).tiny ** 0.25) ** 2
    level = s.mean(axis=0)
    s = s / level
    floor = np.tile(np.median(v, axis=0), (knots, 1))
    relative = np.tile(np.median(v / s, axis=0), (knots, 1))
    is_usual = _is_near_median(v / (floor[0] + relative[0] * s), width)
    sample = slice(None, None, -(-n_f // SMOOTH_VARIANCE.most_lines))
    v, s, hat, counts = v[sample], s[sample], hats[sample], is_usual[sample].astype(float)
    for _ in range(SMOOTH_VARIANCE.iterations):
        model = hat @ floor + (hat @ relative) * s
        excess, inverse = counts * v / model**2, counts / model
        gains = [np.sqrt((hat.T @ (b * excess)) / (hat.T @ (b * inverse))) for b in (1.0, s)]
        floor, relative = floor * gains[0], relative * gains[1]
    return (hats @ floor).reshape(n_f, *channels), (hats @ (relative / level)).reshape(
        n_f, *channels
    )


def _hat_functions(n_f: int, knots: int) -> RealArray:
    """Return piecewise linear functions of the lines with the sum 1, shape (n_f, knots)."""
    if knots == 1:
        return np.ones((n_f, 1))
    at = np.linspace(0.0, knots - 1.0, n_f)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots)), 0.0)
