"""`Wind`: torque of gusty wind with Davenport's spectrum."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.control.servo.settings import WIND_SERIES
from updyn.errors import OptionError
from updyn.group import is_number

__all__ = ["LENGTH", "Wind"]

#: Length scale of the spectrum in m.
LENGTH = 1200.0


@dataclass(frozen=True, slots=True)
class Wind:
    """Wind of mean speed V with gusts u, and its torque c (V + u)^2 to first order in u.

    The gusts have the spectrum of Davenport (1961), "The spectrum of horizontal gustiness near the
    ground in high winds", Q. J. R. Meteorol. Soc. 87, 194-211:

        f S(f) = 4 roughness V^2 X^2 / (1 + X^2)^(4/3),    X = 1200 m f / V,

    whose integral is 6 roughness V^2. The torque c V^2 + 2 c V u is the usual one of antennas
    (Gawronski, Modeling and Control of Antennas and Telescopes, 2008).

    Parameters
    ----------
    mean_speed : float
        V in m/s, above 0; 10 m above ground for the spectrum.
    coefficient : float
        c in N m / (m/s)^2 (N / (m/s)^2 for a force), other than 0.
    roughness : float, optional
        Surface drag coefficient: 0.005 in open country, up to 0.05 in a city (Davenport).
    turbulence : float, optional
        Standard deviation of u over V, sqrt(6 roughness), instead of `roughness`.
    duration : float
        Duration of the series in s.
    dt : float, optional
        Sampling interval of the series in s; by default fine enough for the loop.
    seed : int
        Seed of the random phases.

    Raises
    ------
    OptionError
        If a number is out of its range, or not exactly one of `roughness` and `turbulence` is
        given.

    Examples
    --------
    >>> wind = updyn.Wind(mean_speed=10.0, coefficient=30.0, roughness=0.005)
    >>> wind.mean_torque  # in N m
    3000.0
    >>> round(wind.intensity, 3)
    0.173
    """

    mean_speed: float
    coefficient: float
    roughness: float | None = None
    turbulence: float | None = None
    duration: float = 600.0
    dt: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        for name, unit in (
            ("mean_speed", "m/s"),
            ("duration", "s"),
            ("dt", "s"),
            ("roughness", ""),
            ("turbulence", ""),
        ):
            value = getattr(self, name)
            if value is None and name not in ("mean_speed", "duration"):
                continue
            if not is_number(value) or not math.isfinite(value) or value <= 0:
                raise OptionError(
                    f"wind: {name} is {value!r}; expected a number above"
                    f" 0{', in ' + unit if unit else ''}"
                )
        if (
            not is_number(self.coefficient)
            or not math.isfinite(self.coefficient)
            or self.coefficient == 0
        ):
            raise OptionError(
                f"wind: coefficient is {self.coefficient!r}; expected N m / (m/s)^2, other than 0"
            )
        if (self.roughness is None) == (self.turbulence is None):
            raise OptionError("wind: expected roughness or turbulence, not both")
        if (
            isinstance(self.seed, bool)
            or not isinstance(self.seed, int | np.integer)
            or self.seed < 0
        ):
            raise OptionError(f"wind: seed is {self.seed!r}; expected a whole number, 0 or above")

    @property
    def drag(self) -> float:
        """Surface drag coefficient, as given or from the turbulence."""
        return (
            float(self.roughness)
            if self.roughness is not None
            else float(self.turbulence or 0.0) ** 2 / 6.0
        )

    @property
    def intensity(self) -> float:
        """Standard deviation of the gusts over the mean speed: sqrt(6 roughness)."""
        return float(np.sqrt(6.0 * self.drag))

    @property
    def mean_torque(self) -> float:
        """The torque of the mean speed, c V^2, in N m."""
        return self.coefficient * self.mean_speed**2

    def spectrum(self, freq: ArrayLike) -> RealArray:
        """Return the one-sided spectral density of the gusts.

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            Lines in Hz.

        Returns
        -------
        ndarray of float, shape (n_f,)
            In (m/s)^2 / Hz.
        """
        X = LENGTH * np.asarray(freq, dtype=np.float64) / self.mean_speed
        return np.asarray(
            4.0 * self.drag * self.mean_speed * LENGTH * X / (1.0 + X**2) ** (4.0 / 3.0)
        )

    def variance_below(self, freq: ArrayLike) -> RealArray:
        """Return the integral of the spectrum from 0: 6 roughness V^2 (1 - (1 + X^2)^(-1/3)).

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            Upper limits in Hz; inf is allowed.

        Returns
        -------
        ndarray of float, shape (n_f,)
            In (m/s)^2.
        """
        X = LENGTH * np.asarray(freq, dtype=np.float64) / self.mean_speed
        # 1 - (1 + x)^(-1/3) without loss of digits for small x
        return np.asarray(6.0 * self.drag * self.mean_speed**2 * -np.expm1(-np.log1p(X**2) / 3.0))

    def torque_variance(self, edges: RealArray) -> RealArray:
        """Return the variance of the torque between consecutive frequencies.

        Parameters
        ----------
        edges : ndarray of float, shape (n + 1,)
            In Hz, ascending.

        Returns
        -------
        ndarray of float, shape (n,)
            In (N m)^2.
        """
        return np.asarray(
            (2.0 * self.coefficient * self.mean_speed) ** 2 * np.diff(self.variance_below(edges))
        )

    def series(self, dt: float | None = None) -> tuple[RealArray, RealArray]:
        """Return a random series of the torque.

        A sum of cosines at multiples of 1 / duration with random phases (Shinozuka & Deodatis 1991,
        Appl. Mech. Rev. 44, 191-204), each with the variance of the spectrum around it, up to half
        the sampling rate.

        Parameters
        ----------
        dt : float, optional
            Interval in s if the wind has none.

        Returns
        -------
        time, torque : ndarray of float, shape (n,)
            In s and N m.

        Raises
        ------
        OptionError
            If the interval is missing, or gives too few or too many samples.
        """
        step = self.dt if self.dt is not None else dt
        if step is None:
            raise OptionError("wind: expected dt, the interval of the series in s")
        n = 2 * round(0.5 * self.duration / step)
        if not 16 <= n <= WIND_SERIES.most_samples:
            raise OptionError(
                f"wind: {self.duration:g} s in intervals of {step:g} s give {n} samples; expected"
                f" 16 to {WIND_SERIES.most_samples}"
            )
        lines = np.arange(1, n // 2)
        edges: RealArray = np.arange(1, n // 2 + 1) - np.float64(0.5)
        width = 1.0 / (n * step)
        amplitude = np.sqrt(2.0 * self.torque_variance(edges * width))
        phase = np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, len(lines))
        waves = np.zeros(n // 2 + 1, dtype=np.complex128)
        waves[lines] = 0.5 * n * amplitude * np.exp(1j * phase)
        return np.asarray(np.arange(n) * step, dtype=np.float64), self.mean_torque + np.fft.irfft(
            waves, n
        )
