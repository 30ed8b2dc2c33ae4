"""`cut_hits`: cut records with several hits into one record per hit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from updyn.arrays import BoolArray
from updyn.errors import DataError, OptionError, key_path
from updyn.signals.records import Records, as_records

if TYPE_CHECKING:
    import xarray

__all__ = ["cut_hits", "cut_records"]


def cut_hits(
    records: xarray.DataArray | Records,
    excitation: str,
    *,
    length: float,
    before: float | None = None,
    level: float = 0.2,
) -> xarray.DataArray:
    """Cut records with several hits into one record per hit.

    A hit starts when the force exceeds the level; the search for the next one starts after the end
    of the hit's record, so a second hit within it remains there, for `check_records` to find.

    Parameters
    ----------
    records : xarray.DataArray
        From `read_records`, such as those of a WAV file.
    excitation : str
        Channel of the force.
    length : float
        Length of each new record, in s.
    before : float, optional
        Time of each record before the hit, in s; by default a twentieth of the length.
    level : float
        Share of the largest force that starts a hit, above 0 and below 1.

    Returns
    -------
    xarray.DataArray
        As from `read_records`; the records are the hits in order.

    Raises
    ------
    DataError
        If the channel is missing or zero throughout, or a record starts too late or ends too early
        for one of its hits.
    OptionError
        If a length or the level is invalid.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray
    >>> force = np.zeros((3, 1024))
    >>> force[:, 100:110] = 50.0 * np.sin(np.pi * np.arange(10) / 10)
    >>> records = xarray.DataArray(
    ...     np.stack([force, force / 2.0], axis=1),  # a mass of 2 kg
    ...     dims=("record", "channel", "time"),
    ...     coords={
    ...         "channel": ["1:X", "2:X"],
    ...         "unit": ("channel", ["N", "m/s^2"]),
    ...         "time": np.arange(1024) / 1024,
    ...     },
    ... )
    >>> updyn.cut_hits(records, "1:X", length=0.5).shape  # records, channels, samples
    (3, 2, 512)
    """
    lead = length / 20.0 if before is None else before
    return cut_records(as_records(records), excitation, length, lead, level).to_xarray()


def cut_records(
    records: Records, excitation: str, length: float, before: float, level: float
) -> Records:
    """Return one record per hit; as `cut_hits`."""
    step, n = records.step, records.values.shape[2]
    if not 2.0 * step <= length <= n * step:
        raise OptionError(
            f"length {length} s; expected {2.0 * step:g} to {n * step:g} s, a record",
            key=("length",),
        )
    if not 0.0 <= before < length:
        raise OptionError(
            f"before {before} s; expected 0 to below the length, {length:g} s", key=("before",)
        )
    if not 0.0 < level < 1.0:
        raise OptionError(f"level {level}; expected a share between 0 and 1", key=("level",))
    with key_path("excitation", excitation):
        row = records.index(excitation)
    force = records.values[:, row]
    size = np.abs(force - np.median(force, axis=1, keepdims=True))
    if not size.any():
        raise DataError(f"channel {excitation!r}: the force is zero throughout")
    lead, width = round(before / step), round(length / step)
    parts = []
    for number, (record, share) in enumerate(
        zip(records.values, size / size.max(), strict=True), 1
    ):
        for begin in _hits(share > level, width - lead):
            start = begin - lead
            if start < 0 or start + width > n:
                raise DataError(
                    f"record {number}: the hit at {begin * step:g} s has {begin * step:g} s before"
                    f" it and {(n - begin) * step:g} s after it; expected {before:g} and"
                    f" {length - before:g} s: reduce before or length",
                    key=("length",),
                )
            parts.append(record[:, start : start + width])
    return Records.of(parts, step, records.channels, records.units, records.source)


def _hits(above: BoolArray, rest: int) -> list[int]:
    """Return the first samples of hits, at least the rest of a record apart."""
    begins: list[int] = []
    for at in np.flatnonzero(above).tolist():
        if not begins or at >= begins[-1] + rest:
            begins.append(at)
    return begins
