"""Spectrum of a random force: its one-sided power spectral density over the excited band."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.errors import DataError, key_path
from updyn.settings import ROUNDING

__all__ = ["check_spectrum", "find_rms", "make_flat_spectrum"]


def find_rms(spectrum: RealArray) -> float:
    """Return the RMS in N (N m) of a force with this spectrum, (n_s, 2), linear in between."""
    return float(np.sqrt(np.trapezoid(spectrum[:, 1], spectrum[:, 0])))


def make_flat_spectrum(band: tuple[float, float], rms: float) -> RealArray:
    """Return the constant spectrum of a force of this RMS in a band in Hz."""
    density = rms**2 / (band[1] - band[0])
    return np.array([[band[0], density], [band[1], density]])


def check_spectrum(given: ArrayLike) -> RealArray:
    """Return a spectrum with columns Hz and N^2/Hz, read-only; else raise DataError."""
    with key_path("spectrum"):
        try:
            spectrum = np.array(given, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise DataError(f"spectrum: not an array of numbers ({error})") from error
        if spectrum.ndim != 2 or spectrum.shape[1] != 2 or len(spectrum) < 2:
            raise DataError(
                "spectrum: expected two rows or more of a frequency in Hz and a density in N^2/Hz,"
                f" shape (n, 2), found shape {spectrum.shape}"
            )
        freq, density = spectrum.T
        if not np.isfinite(spectrum).all() or freq[0] < 0.0 or (np.diff(freq) <= 0.0).any():
            raise DataError(
                "spectrum: expected finite frequencies in Hz that increase from 0 or more"
            )
        if (density < 0.0).any() or not density.any():
            i = int(np.argmin(density))
            raise DataError(
                f"spectrum at {freq[i]:g} Hz is {density[i]:g} N^2/Hz; expected densities that are"
                " not negative, and one above 0"
            )
    return spectrum


def check_rms(spectrum: RealArray, level: RealArray) -> RealArray:
    """Return the RMS of a spectrum for each line; DataError if a stated level is another one."""
    rms = np.full(level.shape, find_rms(spectrum))
    wrong = np.abs(level - rms) > ROUNDING.rms_difference * rms
    if wrong.any():
        raise DataError(
            f"level {level[int(np.argmax(wrong))]:g} of a random force: its spectrum has the RMS"
            f" {rms[0]:g}; state one of them",
            key=("level",),
        )
    return rms
