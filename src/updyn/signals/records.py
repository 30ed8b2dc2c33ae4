"""`Records`: time records by record (a hit, a run) and channel."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import NumberArray, RealArray
from updyn.errors import DataError, key_path, suggest
from updyn.signals.settings import RECORD_TIME
from updyn.units import Unit, find_unit, merge_units, suggest_unit

if TYPE_CHECKING:
    import xarray

__all__ = ["Records", "as_records", "chain_records", "find_step", "find_time_unit", "seconds"]

#: A name with a last word in square or in round brackets, or without.
_TIME_NAME = re.compile(r"(?:.*?)(?:\[([^\[\]]+)\]|\(([^()]+)\)|(?:^|(?<=[\s/_-]))([^\s/_-]+))")


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """Records of the same channels, all of equal length.

    `values`, shape (n_records, n_channels, n_samples), are in the `units` of the channels as in the
    file, empty if unknown; `step` is the time between two samples in s. Names of channels are
    unique.
    """

    values: RealArray
    step: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    source: str = ""

    @classmethod
    def of(
        cls,
        values: ArrayLike,
        step: float,
        channels: Sequence[str],
        units: Sequence[str],
        source: str = "",
    ) -> Records:
        """Return immutable records after a check; DataError for invalid values or names.

        `values` has shape (n_records, n_channels, n_samples), in the units of the channels, and is
        copied unless it is immutable and owns its memory.
        """
        array = np.asarray(values)
        is_shared = array.flags.writeable or array.base is not None
        array = array.astype(np.float64, copy=is_shared)
        if array.ndim != 3 or array.shape[1] != len(channels) or len(units) != len(channels):
            raise DataError(
                f"records of shape {array.shape} with {len(channels)} channels and {len(units)}"
                " units; expected (records, channels, samples)"
            )
        if 0 in array.shape or array.shape[2] < 2:
            raise DataError(f"records of shape {array.shape}; expected at least two samples")
        if not np.isfinite(array).all():
            record, channel, sample = np.argwhere(~np.isfinite(array))[0]
            raise DataError(
                f"record {record + 1}, channel {channels[channel]!r}, sample {sample + 1} is"
                f" {array[record, channel, sample]}; expected a number"
            )
        if not (np.isfinite(step) and step > 0.0):
            raise DataError(f"time between samples is {step} s; expected a positive number")
        twice = next((name for name, count in Counter(channels).items() if count > 1), None)
        if twice is not None:
            raise DataError(f"two channels are named {twice!r}")
        array.setflags(write=False)
        return cls(array, float(step), tuple(channels), tuple(units), source)

    @classmethod
    def from_xarray(cls, given: xarray.DataArray) -> Records:
        """Return the records of a labelled array, as made by `to_xarray`.

        Dimensions may have any order; an array without ``record`` is one record. Times are in s, in
        the unit of their attribute ``units``, or timedelta64 or datetime64. An attribute ``units``
        of the array is the unit of all channels.
        """
        if "record" not in given.dims:
            given = given.expand_dims("record")
        for name in ("channel", "time"):
            if name not in given.dims or name not in given.coords:
                raise DataError(
                    f"records with the dimensions {', '.join(map(str, given.dims))}: expected the"
                    f" dimension {name!r}, with its coordinate"
                )
        if len(given.dims) != 3:
            raise DataError(
                f"records with the dimensions {', '.join(map(str, given.dims))}: expected record,"
                " channel, time"
            )
        label = str(given["time"].attrs.get("units", ""))
        step = find_step(seconds(given["time"].values, label))
        channels = [str(name) for name in given["channel"].values]
        common = str(given.attrs.get("units", "")).strip()
        units = [common] * len(channels)
        if "unit" in given.coords:
            units = [str(unit) for unit in np.broadcast_to(given["unit"].values, len(channels))]
            _check_common(common, units, channels)
        values = given.transpose("record", "channel", "time").values
        return cls.of(values, step, channels, units, str(given.attrs.get("source", "")))

    def to_xarray(self) -> xarray.DataArray:
        """Return the records as a labelled array.

        Dimensions ``record`` (from 1), ``channel``, ``time`` (s, from 0 in each record), with
        ``unit`` along ``channel``.
        """
        import xarray

        return xarray.DataArray(
            self.values,
            dims=("record", "channel", "time"),
            coords={
                "record": np.arange(1, len(self.values) + 1),
                "channel": list(self.channels),
                "unit": ("channel", list(self.units)),
                "time": ("time", self.step * np.arange(self.values.shape[2]), {"units": "s"}),
            },
            name="records",
            attrs={"source": self.source} if self.source else {},
        )

    def calibrate(
        self,
        units: Mapping[str, str] | None = None,
        factors: Mapping[str, float] | None = None,
    ) -> Records:
        """Return the records in given units, with their values multiplied by factors.

        `units` are those after the factor; without a factor, one that contradicts the records is an
        error. A factor is the inverse of a sensitivity.
        """
        given_units, multiplied = dict(units or {}), dict(factors or {})
        values, names = self.values, list(self.units)
        for name, factor in multiplied.items():
            with key_path("factors", name):
                at = self.index(name)
                if not np.isfinite(factor) or factor == 0.0:
                    raise DataError(f"channel {name!r}: factor {factor}; expected a nonzero number")
            scale = np.ones(len(self.channels))
            scale[at] = factor
            values = values * scale[:, None]
            names[at] = ""  # the unit in the file is that before the factor
        for name, told_unit in given_units.items():
            with key_path("units", name):
                at = self.index(name)
                names[at] = merge_units(told_unit, names[at], name)
        values.setflags(write=False)
        return replace(self, values=values, units=tuple(names))

    def index(self, channel: str) -> int:
        """Return the index of a channel; raises DataError with the nearest name if unknown."""
        if channel not in self.channels:
            raise DataError(f"no channel {channel!r}; {suggest(channel, self.channels)}")
        return self.channels.index(channel)


def _check_common(common: str, units: Sequence[str], channels: Sequence[str]) -> None:
    """Raise DataError for a common unit that contradicts the unit of a channel."""
    if not common:
        return
    expected = find_unit(common)
    for name, unit in zip(channels, units, strict=True):
        is_same = unit == common or (expected is not None and find_unit(unit) == expected)
        if not is_same:
            raise DataError(f"channel {name!r}: unit {unit!r}, but the records are in {common!r}")


def seconds(times: NumberArray, label: str, name: str = "time") -> RealArray:
    """Return times in s, from 0; `label` is the unit of numbers, such as ``"ms since 2020-01-01"``.

    Numbers without a label are in the unit at the end of their name, else in s.
    """
    stated = label.partition(" since ")[0].strip()
    unit = find_unit(stated, "time") if stated else find_time_unit(name)
    if unit is None:
        raise DataError(f"{name}: unit {label!r}; {suggest_unit(stated, 'time')}")
    if times.dtype.kind not in "iufmM":
        raise DataError(f"{name}: found {times.dtype}; expected numbers, timedelta64 or datetime64")
    if times.dtype.kind == "u":
        times = times.astype(np.int64)
    # Relative to the first time: counts of ns since 1970 have more digits than a double.
    passed = times - times[:1]
    if times.dtype.kind in "mM":
        return np.asarray(passed / np.timedelta64(1, "s"), dtype=np.float64)
    return np.asarray(passed * unit.factor, dtype=np.float64)


def find_time_unit(name: str) -> Unit:
    """Return the unit at the end of a name of times, such as ``t_ms`` or ``Time (min)``; else s."""
    # Without brackets only parts of a second, because t_h or t_min may be names of channels.
    found = _TIME_NAME.fullmatch(name)
    if found is not None:
        unit = find_unit(found[1] or found[2] or found[3], "time")
        if unit is not None and (found[3] is None or unit.factor < 1.0):
            return unit
    return Unit("time", 1.0)


def find_step(times: RealArray, rounding: RealArray | None = None) -> float:
    """Return the step of times in s; raises DataError if they do not ascend in even steps.

    `rounding` is the place value of the last printed digit of each time.
    """
    steps = np.diff(times)
    if len(times) >= 2:
        mean = float((times[-1] - times[0]) / (len(times) - 1))
        is_even = bool((np.abs(steps - mean) <= RECORD_TIME.step_variation * mean).all())
        if is_even or (rounding is not None and _is_rounded(times, mean, rounding)):
            return mean
    found = f"{steps.min():g} to {steps.max():g} s apart" if len(steps) else f"{len(times)} of them"
    raise DataError(f"times of the records: {found}; expected ascending times in even steps")


def _is_rounded(times: RealArray, step: float, rounding: RealArray) -> bool:
    """Return whether times are even ones, each rounded to its last digit."""
    if not rounding.max() < RECORD_TIME.last_digit_share * step:
        return False
    away = np.abs(times - times[0] - step * np.arange(len(times)))
    # Each may be off by half a digit, and the line is drawn through the first and the last.
    allowed = 0.5 * (rounding + max(rounding[0], rounding[-1]))
    return bool((away <= (1.0 + RECORD_TIME.step_variation) * allowed).all())


def as_records(given: Any) -> Records:
    """Return records from records or a labelled array."""
    return given if isinstance(given, Records) else Records.from_xarray(given)


def chain_records(parts: Sequence[Records]) -> Records:
    """Return records of several files as one; DataError if their setups differ."""
    first = parts[0]
    for other in parts[1:]:
        for what, mine, its in (
            ("channels", first.channels, other.channels),
            ("units", first.units, other.units),
            ("samples", first.values.shape[2], other.values.shape[2]),
        ):
            if mine != its:
                raise DataError(
                    f"{other.source} has {what} {its!r}, {first.source} {mine!r}; records of one"
                    " setup must agree"
                )
        if abs(other.step - first.step) > RECORD_TIME.step_difference * first.step:
            raise DataError(
                f"{other.source} has {other.step:g} s between samples, {first.source}"
                f" {first.step:g} s; records of one setup must agree"
            )
    values = np.concatenate([part.values for part in parts])
    values.setflags(write=False)
    return replace(first, values=values, source=", ".join(part.source for part in parts))
