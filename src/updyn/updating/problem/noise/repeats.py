"""Mean and variance of repeated measurements."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from updyn.dofs import DofSet
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.updating.problem.noise.known import level_by_unit, smooth_variance

__all__ = ["average"]


def average(repeats: Iterable[FRF]) -> FRF:
    """Return the mean of repeated measurements, with the variance of the mean.

    Parameters
    ----------
    repeats : iterable of FRF
        At least two, with equal lines, responses, references, quantity and decay, in the same
        order: nothing is reordered, converted or interpolated (use `FRF.select` and
        `FRF.converted`). All have the same weight.

    Returns
    -------
    FRF
        The mean of the values. Its variance E|dH|^2 is sum |H - mean|^2 / (m (m - 1)) over m
        repeats. With few repeats this estimate has a relative error of 1 / sqrt(m - 1), so it is
        smoothed along the lines of each channel to be usable as a weight. The geometry is that of
        the first repeat that has one. The coherence and averages of the repeats are dropped: the
        variance contains their information, and the differences between repeats.

    Raises
    ------
    DataError
        If there are fewer than two, they do not agree, or two hold the same values.

    Notes
    -----
    The variance of n complex values about their mean has n - 1 complex degrees of freedom (Bendat &
    Piersol, Random Data, 4th ed. 2010, section 4.2, for one real variable). An error that all
    repeats share (calibration, the mass of a sensor) is not included.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> one = updyn.response(chain.build(), [1.0, 2.0], ["12:X"], ["1:X"], "accelerance")
    >>> two = updyn.FRF(one.freq, 1.02 * one.values, ["12:X"], ["1:X"], "accelerance")
    >>> mean = updyn.average([one, two])
    >>> bool(abs(mean.values / one.values - 1.01).max() < 1e-9)
    True
    """
    listed = list(repeats)
    for number, frf in enumerate(listed, 1):
        if not isinstance(frf, FRF):
            raise DataError(
                f"average: expected FRFs, found {type(frf).__name__} as number {number}"
            )
    if len(listed) < 2:
        raise DataError(f"average: expected at least two repeats, found {len(listed)}")
    first = listed[0]
    for number, other in enumerate(listed[1:], 2):
        _check(first, other, number)
    for i, one in enumerate(listed):
        for j in range(i):
            if np.array_equal(one.values, listed[j].values):
                raise DataError(
                    f"average: repeats {j + 1} and {i + 1} hold the same values; each test counts"
                    " once"
                )
    values = np.array([frf.values for frf in listed])
    mean, m = np.asarray(values.mean(axis=0), dtype=np.complex128), len(listed)
    least = (1e-9 * np.abs(mean)) ** 2 + (1e-9 * level_by_unit(replace(first, values=mean))) ** 2
    spread = np.sum(np.abs(values - mean) ** 2, axis=0) / (m * (m - 1))
    variance = smooth_variance(spread + least, np.abs(mean), m - 1).at(np.abs(mean))
    return replace(
        first,
        values=mean,
        variance=variance,
        coherence=None,
        averages=None,
        geometry=next((frf.geometry for frf in listed if frf.geometry is not None), None),
        source=f"mean of {m}: "
        + ", ".join(dict.fromkeys(frf.source or "unnamed" for frf in listed)),
    )


def _check(first: FRF, other: FRF, number: int) -> None:
    if other.quantity != first.quantity:
        raise DataError(
            f"average: repeat {number} holds {other.quantity}, the first {first.quantity};"
            " convert one"
        )
    if other.decay != first.decay:
        raise DataError(
            f"average: repeat {number} has the decay of a window of {other.decay:g} 1/s left, the"
            f" first of {first.decay:g} 1/s; measure all with one window"
        )
    if other.level_text != first.level_text:
        raise DataError(
            f"average: repeat {number} has the {other.level_text or 'level not stated'}, the first"
            f" the {first.level_text or 'level not stated'}; fit levels as tests of one structure"
            " (`updyn.update_jointly`)"
        )
    if len(other.freq) != len(first.freq) or (other.freq != first.freq).any():
        what = f"has {len(other.freq)} lines, the first {len(first.freq)}"
        if len(other.freq) == len(first.freq):
            at = int(np.flatnonzero(other.freq != first.freq)[0])
            what = (
                f"has line {at + 1} at {other.freq[at]:.9g} Hz, the first at"
                f" {first.freq[at]:.9g} Hz"
            )
        raise DataError(f"average: repeat {number} {what}; lines are not interpolated")
    for what in ("responses", "references"):
        _check_labels(getattr(first, what), getattr(other, what), what, number)


def _check_labels(wanted: DofSet, found: DofSet, what: str, number: int) -> None:
    ours, theirs = list(wanted.labels), list(found.labels)
    if ours == theirs:
        return
    lacking = [label for label in ours if label not in theirs]
    more = [label for label in theirs if label not in ours]
    if lacking or more:
        parts = [f"lacks {', '.join(lacking[:3])}"] * bool(lacking) + [
            f"has {', '.join(more[:3])} besides"
        ] * bool(more)
        raise DataError(
            f"average: {what} of repeat {number}: {' and '.join(parts)}; select what all have"
        )
    raise DataError(
        f"average: {what} of repeat {number} are in another order; `select` brings them into one"
    )
