"""Base class of the noise models, and those whose variance is stated or follows from the data."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DofSet
from updyn.errors import OptionError
from updyn.frf import FRF

__all__ = [
    "ASSUMED",
    "SMALLEST",
    "Assumed",
    "Coherence",
    "NoiseModel",
    "Stated",
    "Steady",
    "Variance",
    "Wrapping",
    "level_by_unit",
    "level_of_units",
    "steady",
    "two_part",
    "unit_kinds",
]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Relative noise below this is rounding; it keeps the weights of exact data finite.
SMALLEST = 1e-12

#: Noise that is assumed where neither the user nor the data say how large it is.
ASSUMED = {"relative": 0.05, "floor": 0.001}


class NoiseModel(ABC):
    """Base of the noise models: how uncertain each measured value is.

    Attributes
    ----------
    needs : str
        Field of the FRF without which the model cannot be used, such as ``"coherence"``; may be
        empty.
    """

    __slots__ = ()

    needs: ClassVar[str] = ""

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> NoiseModel:
        """Return the model for the data of a fit.

        Parameters
        ----------
        frf : FRF
            The data.
        tails : float
            Degrees of freedom of Student's distribution, where it is estimated; inf: Gaussian.
        """
        return cls()

    @property
    @abstractmethod
    def kind(self) -> str:
        """How the noise is known, for the record."""

    @property
    def source(self) -> str:
        """Where it is known from: ``"data"``, ``"stated"``, ``"estimated"`` or ``"assumed"``."""
        return "data"

    @property
    def scale_known(self) -> bool:
        """Whether the variance is known absolutely, or only up to one factor."""
        return True

    @property
    def size_known(self) -> bool:
        """Whether the variance is known absolutely, and not from a fit."""
        return self.scale_known and self.source in ("data", "stated")

    @property
    def bulk(self) -> NoiseModel:
        """The noise without outliers: the same where there are none."""
        return self

    @property
    def heavy_tails(self) -> bool:
        """Whether a few values that are far off hardly count."""
        return False

    @abstractmethod
    def variance(self, H: _Complex, frf: FRF) -> _Real:
        """Return E|dH|^2 for a model's H, shape (n_f, n_i, n_j), in squared units of the data."""

    def beforehand(self, frf: FRF) -> _Real:
        """Return E|dH|^2 as far as it is known before a fit, shape (n_f, n_i, n_j)."""
        return self.variance(frf.values, frf)

    def unlikelihood(self, H: _Complex, frf: FRF) -> float:
        """Return minus the logarithm of the likelihood of the data, but for a constant.

        Noise of known shape and unknown size counts with the size that the residual gives it.

        Parameters
        ----------
        H : ndarray of complex, shape (n_f, n_i, n_j)
            The model's.
        frf : FRF
            The data.
        """
        v = self.variance(H, frf)
        power = np.abs(frf.values - H) ** 2 / v
        if self.scale_known:
            return float(np.sum(np.log(v) + power))
        typical = max(float(np.mean(power)), SMALLEST)
        return float(np.sum(np.log(v)) + v.size * np.log(typical))

    def refit(self, H: _Complex, frf: FRF, n_parameters: int) -> NoiseModel:
        """Return the noise model refitted to the residual; itself where nothing is estimated."""
        return self

    def figures(self) -> dict[str, Any]:
        """Return the stated or estimated numbers for the record; empty where data hold them."""
        return {}


class Wrapping(NoiseModel):
    """Base of the noise models that are another one with something added.

    Attributes
    ----------
    base : NoiseModel
        The other.
    """

    __slots__ = ()

    base: NoiseModel

    @property
    def kind(self) -> str:
        """How the noise is known."""
        return self.base.kind

    @property
    def source(self) -> str:
        """Where the other is known from."""
        return self.base.source

    @property
    def heavy_tails(self) -> bool:
        """Whether those of the other are."""
        return self.base.heavy_tails

    def beforehand(self, frf: FRF) -> _Real:
        """Return that of the other, shape (n_f, n_i, n_j)."""
        return self.base.beforehand(frf)


def level_by_unit(frf: FRF) -> _Real:
    """Return the rms of |H_X| over all data of one unit, shape (1, n_i, n_j)."""
    squared = np.mean(np.abs(frf.values) ** 2, axis=0)
    return level_of_units(squared, frf.responses, frf.references)[None]


def unit_kinds(responses: DofSet, references: DofSet) -> NDArray[np.intp]:
    """Return a number that tells the units of channels apart, shape (n_i, n_j)."""
    rows, columns = responses.axes >= 3, references.axes >= 3
    return np.asarray(2 * rows[:, None] + columns[None, :], dtype=np.intp)


def level_of_units(squared: _Real, responses: DofSet, references: DofSet) -> _Real:
    """Return the rms over all channels of one unit from the mean square of each.

    Parameters
    ----------
    squared : ndarray of float, shape (n_i, n_j)
        Mean of |H|^2 over the lines.
    responses, references : DofSet
        The channels.

    Returns
    -------
    ndarray of float, shape (n_i, n_j)
        Above 0.
    """
    kind = unit_kinds(responses, references)
    level = np.zeros(kind.shape)
    for k in np.unique(kind):
        level[kind == k] = np.sqrt(np.mean(squared[kind == k]))
    return np.asarray(np.maximum(level, np.finfo(float).tiny ** 0.25))


def two_part(relative: float | _Real, floor: float | _Real, H: _Complex, level: _Real) -> _Real:
    """Return (relative |H|)^2 + (floor level)^2, shape (n_f, n_i, n_j)."""
    return np.asarray((relative * np.abs(H)) ** 2 + (np.maximum(floor, SMALLEST) * level) ** 2)


@dataclass(frozen=True, slots=True)
class Stated(NoiseModel):
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
    source: ClassVar[str] = "stated"

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        return two_part(self.relative, self.floor, H, level_by_unit(frf))

    def figures(self) -> dict[str, Any]:
        """Return relative and floor."""
        return {"relative": self.relative, "floor": self.floor}


@dataclass(frozen=True, slots=True)
class Assumed(Stated):
    """Noise of ordinary size, where its size is not known.

    As many unknowns as measured numbers fit any noise, and leave no residual to estimate it from.
    """

    source: ClassVar[str] = "assumed"
    kind: ClassVar[str] = "assumed: as many unknowns as measured numbers, the residual cannot tell"


@dataclass(frozen=True, slots=True)
class Variance(NoiseModel):
    """The variance that came with the data."""

    kind: ClassVar[str] = "variance"
    needs: ClassVar[str] = "variance"

    @classmethod
    def tells(cls, frf: FRF) -> bool:
        """Whether data have a variance, at one value at least."""
        return frf.variance is not None and bool(frf.variance.any())

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> Variance:
        """Return the model for the data of a fit.

        Raises
        ------
        OptionError
            If the variance is zero everywhere.
        """
        if not cls.tells(frf):
            raise OptionError(
                "noise 'variance': that of the data is zero everywhere; it says nothing",
                key=("noise",),
            )
        return cls()

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        assert frf.variance is not None
        return np.maximum(frf.variance, (1e-9 * level_by_unit(frf)) ** 2)


#: Averages that are taken for the smoothing, where their number is not known.
_USUAL = 10


@dataclass(frozen=True, slots=True, eq=False)
class Coherence(NoiseModel):
    """E|dH|^2 = |H_X|^2 (1 - gamma^2) / (gamma^2 (n - 1)), smoothed along the lines (`steady`).

    H_X and gamma^2 belong together: they come from the same n spectra, and S_nn = (1 - gamma^2)
    S_yy is the output that the input does not explain (Bendat & Piersol, Random Data, 4th ed. 2010,
    sections 6.1.4 and 9.2.3, there with n for n - 1). Given the inputs, H1 is a regression with one
    complex unknown: its variance S_nn / (n S_xx) is estimated by this without bias, whatever that
    of gamma^2 itself (Carter, Knapp & Nuttall, IEEE Trans. Audio Electroacoust. 21 (1973) 337), and
    independently of the error of H_X. The model's |H| in place of |H_X| would give nearly no
    variance in an antiresonance, where gamma^2 was formed by |H_X|, mostly noise. It scatters with
    n - 1 degrees of freedom, too few for a weight.

    Parameters
    ----------
    scale_known : bool
        Whether the number of averages is known.
    freq : ndarray of float, shape (n_f,), optional
        Lines of which it has learnt, in Hz.
    learnt : Steady, optional
        What these lines say. Else it learns from the data that it is asked about.
    """

    scale_known: bool
    freq: NDArray[np.float64] | None = None
    learnt: Steady | None = None
    kind: ClassVar[str] = "coherence"
    needs: ClassVar[str] = "coherence"

    @classmethod
    def tells(cls, frf: FRF) -> bool:
        """Whether data have a coherence that says something of their noise.

        That of a single average is 1 whatever the noise, and so is one that was filled in.
        """
        if frf.coherence is None or frf.averages == 1:
            return False
        return bool((frf.coherence < 1.0).any())

    @classmethod
    def of_data(cls, frf: FRF, tails: float = np.inf) -> Coherence:
        """Return the model that has learnt from all lines of `frf`, for these or fewer of them.

        Raises
        ------
        OptionError
            If the data are of a single average, or their coherence is 1 everywhere.
        """
        if not cls.tells(frf):
            single = "of a single average" if frf.averages == 1 else "of the data"
            raise OptionError(
                f"noise 'coherence': that {single} is 1 whatever the noise; it says nothing",
                key=("noise",),
            )
        return cls(frf.averages is not None, frf.freq, _learn(frf))

    def variance(self, H: NDArray[np.complex128], frf: FRF) -> NDArray[np.float64]:
        """Return E|dH|^2, shape (n_f, n_i, n_j)."""
        if (
            self.freq is not None
            and self.learnt is not None
            and self.learnt.floor.shape[1:] == H.shape[1:]
        ):
            at = np.searchsorted(self.freq, frf.freq)
            if at[-1] < len(self.freq) and (self.freq[at] == frf.freq).all():
                return self.learnt.at(np.abs(H), at)
        return _learn(frf).at(np.abs(H))


def _learn(frf: FRF) -> Steady:
    assert frf.coherence is not None
    gamma2 = np.clip(frf.coherence, 1e-6, 1.0)
    size = np.abs(frf.values)
    share = (1.0 - gamma2) / (gamma2 * max((frf.averages or 2) - 1, 1))
    least = (1e-4 * size) ** 2 + (1e-6 * level_by_unit(frf)) ** 2
    return steady(size**2 * share + least, size, max((frf.averages or _USUAL) - 1, 1))


#: Degrees of freedom that a smoothed variance should have.
_FREEDOM = 48
#: A variance is an outlier above this multiple of the median of the lines around it.
_APART = 10.0
#: Steps of the fit of floor and relative noise.
_STEPS = 100
#: Lines of that fit.
_SAMPLES = 400
#: Knots along the lines.
_KNOTS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Steady:
    """A variance floor + relative |H|^2, smooth where it was noisy.

    Attributes
    ----------
    floor : ndarray of float, shape (n_f, ...)
        The part that does not depend on |H|, in the unit of the data squared.
    relative : ndarray of float, shape (n_f, ...)
        The other, over |H|^2.
    """

    floor: _Real
    relative: _Real

    def at(self, size: _Real, lines: slice | NDArray[np.intp] = slice(None)) -> _Real:
        """Return the variance for magnitudes `size`, shape (n_f, ...), at some of the lines."""
        return np.asarray(self.floor[lines] + self.relative[lines] * size**2)


def steady(variance: _Real, size: _Real, freedom: int) -> Steady:
    """Return a steady form of variances that scatter as chi-square.

    Two parts, one of them proportional to |H|^2, both piecewise linear along the lines, are fitted
    to each channel by the likelihood of variances that scatter in proportion to themselves (the
    Itakura-Saito divergence, by the multiplicative steps of Fevotte, Bertin & Durrieu, Neural
    Computation 21 (2009) 793, with the exponent 1/2 with which they descend). What the lines hold
    beyond them is a mean over neighbouring lines. A line that stands out by a factor of ten from
    the median around it keeps its own: it is a hum or a glitch, not scatter.

    Parameters
    ----------
    variance : ndarray of float, shape (n_f, ...)
        Estimates above 0, independent from line to line, in the unit of the data squared.
    size : ndarray of float, shape (n_f, ...)
        Magnitude |H_X| of the data.
    freedom : int
        Complex degrees of freedom of each estimate: it scatters as Gamma(freedom) / freedom.

    Returns
    -------
    Steady
        Such that the mean of its inverse is the inverse of the variance, so that it makes unbiased
        weights: for a mean of d Gamma(1) the mean of the inverse is d / (d - 1) too large.
    """
    from scipy.ndimage import uniform_filter1d

    width = min(-(-_FREEDOM // freedom), len(variance) // 4) // 2 * 2 + 1
    floor, relative = _parts(variance, size, freedom, max(width, 7))
    ratio = variance / (floor + relative * size**2)
    usual = _usual(ratio, max(width, 7))
    share = uniform_filter1d(usual.astype(float), width, axis=0, mode="reflect")
    total = uniform_filter1d(np.where(usual, ratio, 0.0), width, axis=0, mode="reflect")
    smooth = np.where(usual, total / np.maximum(share, 1e-9), ratio)
    rests_on = np.where(usual, np.maximum(share * width, 1.0), 1.0) * freedom
    smooth *= rests_on / np.maximum(rests_on - 1.0, 0.5)
    return Steady(floor * smooth, relative * smooth)


def _usual(ratio: _Real, width: int) -> NDArray[np.bool_]:
    """Return where a ratio, shape (n_f, ...), is not far above its median over `width` lines."""
    from scipy.ndimage import median_filter

    around = median_filter(ratio, size=(width, *(1,) * (ratio.ndim - 1)), mode="reflect")
    return np.asarray(ratio <= _APART * around)


def _parts(variance: _Real, size: _Real, freedom: int, width: int) -> tuple[_Real, _Real]:
    """Return floor and relative of v = floor + relative |H|^2, each of shape (n_f, ...)."""
    n_f, channels = len(variance), variance.shape[1:]
    knots = int(np.clip(n_f * freedom // _FREEDOM, 1, _KNOTS))
    hats = _hats(n_f, knots)
    v = variance.reshape(n_f, int(np.prod(channels)))
    s = np.maximum(size.reshape(v.shape), np.finfo(float).tiny ** 0.25) ** 2
    level = s.mean(axis=0)
    s = s / level
    floor = np.tile(np.median(v, axis=0), (knots, 1))
    relative = np.tile(np.median(v / s, axis=0), (knots, 1))
    usual = _usual(v / (floor[0] + relative[0] * s), width)
    every = slice(None, None, -(-n_f // _SAMPLES))
    v, s, hat, counts = v[every], s[every], hats[every], usual[every].astype(float)
    for _ in range(_STEPS):
        model = hat @ floor + (hat @ relative) * s
        excess, inverse = counts * v / model**2, counts / model
        gains = [np.sqrt((hat.T @ (b * excess)) / (hat.T @ (b * inverse))) for b in (1.0, s)]
        floor, relative = floor * gains[0], relative * gains[1]
    return (hats @ floor).reshape(n_f, *channels), (hats @ (relative / level)).reshape(
        n_f, *channels
    )


def _hats(n_f: int, knots: int) -> _Real:
    """Return piecewise linear functions over the lines, shape (n_f, knots), of sum 1."""
    if knots == 1:
        return np.ones((n_f, 1))
    at = np.linspace(0.0, knots - 1.0, n_f)
    return np.maximum(1.0 - np.abs(at[:, None] - np.arange(knots)), 0.0)
