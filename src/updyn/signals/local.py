"""FRFs by the local rational method, which estimates leakage instead of windowing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import scipy  # loads scipy.ndimage on use

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError
from updyn.signals.local_model import LocalModel, LocalValues, Windows
from updyn.signals.settings import LOCAL_RATIONAL
from updyn.signals.spectra import Spectra

__all__ = ["local_rational", "without_transients"]


#: Candidate local models of each line. Polynomials are for lines far from resonances, where two
#: poles would follow the noise. Degrees are such that the bias stays below the standard deviation
#: for lightly damped modes that are one window apart (`benchmarks/records.py`).
_MODELS = (
    LocalModel(poles=0, half=8, degree=2),
    LocalModel(poles=0, half=16, degree=2),
    LocalModel(poles=0, half=32, degree=4),
    LocalModel(poles=0, half=64, degree=4),
    LocalModel(poles=0, half=128, degree=4),
    LocalModel(poles=2, half=8, degree=2),
    LocalModel(poles=2, half=16, degree=3),
    LocalModel(poles=2, half=32, degree=4),
)


def local_rational(
    spectra: Spectra, freq: RealArray, names: Sequence[str]
) -> tuple[ComplexArray, RealArray]:
    """Return FRFs by the local rational method, and the variance of each value."""
    # Around each line the responses are (B F + C) / A with polynomials in the frequency: A is
    # common to all responses and records; C, the transient at the ends of a record, is separate
    # for each record (McKelvey and Guerin, IFAC SYSID 2012; without A it is the local polynomial
    # method of Pintelon, Schoukens, Vandersteen and Barbe, Mech. Syst. Signal Process. 24 (2010)
    # 573). The model of each line is selected by cross-validation (Stone, J. R. Stat. Soc. B 36,
    # 1974). The spectra are those of records without a window, at evenly spaced lines. Errors of
    # lines in one window are correlated.
    spectra.check_power(freq, names)
    found = _local_values(spectra, freq, names)
    return found.values, found.variance


def without_transients(
    spectra: Spectra, freq: RealArray, names: Sequence[str]
) -> tuple[ComplexArray, RealArray]:
    """Return H1 of records without their transients, and the variance of each value."""
    # H is (X - C / A) F^H (F F^H)^-1 over the records, with C / A of `local_rational`; the
    # variance is the noise of the local model over the power of the force. The remaining noise is
    # independent from line to line, so a fit to all lines loses no information.
    spectra.check_forces(freq, names)
    found = _local_values(spectra, freq, names)
    power = spectra.ff * len(spectra.force)
    # (F F^H)^-1 is Hermitian: of rows, x (F F^H)^-1 = ((F F^H)^-T x^T)^T.
    across = np.linalg.solve(power.conj(), np.swapaxes(found.unexplained, 1, 2))
    identity = np.broadcast_to(np.eye(power.shape[1]), power.shape)
    inverse = np.einsum("frr->fr", np.linalg.solve(power, identity)).real
    values = found.values + np.swapaxes(across, 1, 2)
    return values, found.noise[:, :, None] * inverse[:, None, :]


def _local_values(spectra: Spectra, freq: RealArray, names: Sequence[str]) -> LocalValues:
    """Return for each line the values of the model with the best prediction of its neighbours."""
    F, X = spectra.force, spectra.motion
    records, lines, forces = F.shape
    models = [one for one in _sufficient_models(records, forces) if one.width <= lines]
    if not models:
        raise DataError(_too_few(lines, records, forces), key=("band",))
    levels = [np.sqrt(np.mean(np.abs(values) ** 2, axis=(0, 1))) for values in (F, X)]
    level_F, level_X = (np.where(level > 0.0, level, 1.0) for level in levels)
    best = _values_at_lines(F / level_F, X / level_X, models[0])
    least, separable = _omission_errors(best), best.separable
    for model in models[1:]:
        found = _values_at_lines(F / level_F, X / level_X, model)
        error = _omission_errors(found)
        best, least = best.better(error < least, found), np.minimum(error, least)
        separable = np.maximum(found.separable, separable)
    _check_separable(separable, freq, names)
    ratio = level_X[:, None] / level_F
    return replace(
        best,
        values=best.values * ratio,
        variance=best.variance * ratio**2,
        noise=best.noise * level_X**2,
        unexplained=best.unexplained * level_X[:, None] * level_F,
    )


def _sufficient_models(records: int, forces: int) -> list[LocalModel]:
    """Return the models whose residual has enough degrees of freedom."""
    least = LOCAL_RATIONAL.least_freedom
    return [one for one in _MODELS if one.freedom(records, forces) >= least]


def _too_few(lines: int, records: int, forces: int) -> str:
    """Return a message with the sufficient number of lines."""
    narrowest = _sufficient_models(records, forces)[0]
    return (
        f"{lines} lines of {records} records or segments; LRM of {forces} forces requires at least"
        f" {narrowest.width} lines. Widen the band, or use longer records"
    )


def _omission_errors(found: LocalValues) -> RealArray:
    """Return the mean logarithm of the error at omitted lines; inf where forces are inseparable."""
    lines = LOCAL_RATIONAL.comparison_lines
    smooth = scipy.ndimage.uniform_filter1d(found.omission_error, lines, axis=0, mode="nearest")
    error = np.mean(np.log(np.maximum(smooth, LOCAL_RATIONAL.least_noise)), axis=1)
    separable = found.separable >= LOCAL_RATIONAL.least_separable_share
    return np.where(separable.all(axis=1), error, np.inf)


def _check_separable(separable: RealArray, freq: RealArray, names: Sequence[str]) -> None:
    """Raise DataError for lines at which a force is not distinct from a transient."""
    unknown = separable < LOCAL_RATIONAL.least_separable_share
    if not unknown.any():
        return
    at, force = (int(place[0]) for place in np.nonzero(unknown))
    others = " or the other forces" if len(names) > 1 else ""
    count = np.count_nonzero(unknown.any(axis=1))
    raise DataError(
        f"channel {names[force]!r}: at {freq[at]:g} Hz ({count} of {len(freq)} lines in all) the"
        f" response to it cannot be distinguished from a transient{others}; expected a force that"
        " varies from line to line, such as independent random forces over most of the record."
        " Narrow the band, or use estimator H1",
        key=("excitation",),
    )


def _values_at_lines(force: ComplexArray, motion: ComplexArray, model: LocalModel) -> LocalValues:
    records, lines, forces = force.shape
    served = max(1, model.half // LOCAL_RATIONAL.half_width_per_use)
    offsets = np.arange(served) - served // 2
    centres = np.arange(0, lines, served) + served // 2
    columns = motion.shape[2] * (model.poles + 2) + forces * (model.degree + 1)
    size = max(1, LOCAL_RATIONAL.batch_values // (records * model.width * columns))
    parts = [
        Windows.of(force, motion, centres[at : at + size], model).values_at(offsets)
        for at in range(0, len(centres), size)
    ]

    def concatenate(name: str) -> Any:
        """Return an attribute of all parts, by line."""
        whole = np.concatenate([getattr(part, name) for part in parts])
        return whole.reshape(-1, *whole.shape[2:])[:lines]

    return LocalValues(*(concatenate(one.name) for one in fields(LocalValues)))
