"""`synthesise`: FRFs from the poles of modes, with residues by least squares (LSFD)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, RealArray
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.modal.mode_set import ModeSet
from updyn.modal.settings import SYNTHESIS, UNEXPLAINED_PEAK

__all__ = ["band_of_modes", "line_weights", "synthesise"]


def line_weights(frf: FRF) -> RealArray:
    """Return the weight of each line: the inverse of the rms of all channels around it, or 0."""
    # Without weights, errors of the largest peaks would determine the residues of all modes. Each
    # channel is divided by its rms first, because units may differ.
    power = np.abs(frf.values) ** 2
    mean = power.mean(axis=0)
    power = np.divide(power, mean, out=np.zeros_like(power), where=mean > 0.0).mean(axis=(1, 2))
    lines = UNEXPLAINED_PEAK.narrow_surroundings
    padded = np.pad(power, lines, mode="edge")
    around = np.convolve(padded, np.full(2 * lines + 1, 1.0 / (2 * lines + 1)), "valid")
    heard = (around > 0.0) & (np.abs(frf.s) > 0.0)
    return np.divide(1.0, np.sqrt(around), out=np.zeros_like(around), where=heard)


def band_of_modes(modes: ModeSet, frf: FRF) -> BoolArray:
    """Return the lines that the modes of a set can explain, shape (n_f,)."""
    # These are the lines from five half-power bandwidths below the lowest mode to five above the
    # highest; all lines if none is between.
    reach = SYNTHESIS.band_bandwidths * modes.frequency * np.nan_to_num(modes.loss_factor)
    low, high = (modes.frequency - reach).min(), (modes.frequency + reach).max()
    inside = (frf.freq >= low) & (frf.freq <= high)
    return inside if inside.any() else np.ones_like(inside)


def synthesise(modes: ModeSet, frf: FRF) -> FRF:
    """Return FRFs synthesised from the poles of modes.

    Parameters
    ----------
    modes : ModeSet
        Frequencies and loss factors of the modes; their shapes are not used.
    frf : FRF
        The measurement, to which residues and residual terms are fitted.

    Returns
    -------
    FRF
        FRFs at the lines and DOFs and in the quantity of the measurement.

    Raises
    ------
    DataError
        If the loss factor of a mode is not known, or there are not more lines than terms.

    Notes
    -----
    Least squares frequency domain (LSFD) estimation (W. Heylen, S. Lammens, P. Sas, Modal Analysis
    Theory and Testing, KU Leuven 1997). With s = i omega + decay, each receptance is
    sum_r R_r / (omega_r^2 (1 + i eta_r) + s^2) + L / s^2 + U: the lower residual L represents the
    modes below the band, the upper residual U those above. R_r, L and U are complex and free in
    each channel; lines are weighted by `line_weights`.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> from updyn.correlation import frac
    >>> from updyn.modal import synthesise
    >>> frf = chain.measure()
    >>> bool(frac(frf.values, synthesise(updyn.identify_modes(frf), frf).values).min() > 0.99)
    True
    """
    unknown = modes.frequency[np.isnan(modes.loss_factor)]
    if unknown.size:
        raise DataError(f"synthesis: the loss factor of the mode at {unknown[0]:.6g} Hz is unknown")
    terms, weights = _terms(modes, frf), line_weights(frf)
    count = int(np.count_nonzero(weights))
    if count <= terms.shape[1]:
        raise DataError(
            f"synthesis: {count} lines for {len(modes)} modes and two residual terms; expected more"
            " lines than terms"
        )
    weighted = terms * weights[:, None]
    size = np.linalg.norm(weighted, axis=0)
    size[size == 0.0] = 1.0
    flat = frf.values.reshape(len(frf.freq), -1)
    found = np.linalg.lstsq(weighted / size, flat * weights[:, None], rcond=None)[0]
    values = (terms / size) @ found
    return replace(
        frf, values=values.reshape(frf.values.shape), coherence=None, variance=None, averages=None
    )


def _terms(modes: ModeSet, frf: FRF) -> ComplexArray:
    """Return the terms of the FRFs, shape (n_f, n_modes + 2)."""
    s = frf.s[:, None]
    poles = (2.0 * np.pi * modes.frequency) ** 2 * (1.0 + 1j * modes.loss_factor)
    moving = np.abs(s) > 0.0
    lower = np.divide(1.0, s**2, out=np.zeros_like(s), where=moving)
    receptances = np.concatenate([1.0 / (poles + s**2), lower, np.ones_like(s)], axis=1)
    return np.asarray(receptances * s**frf.modal_power)
