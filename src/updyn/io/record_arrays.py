"""Time records from arrays by name, as MATLAB and HDF5 files hold them.

The user says which arrays are what::

    values    {"hammer": "f", "1:Z": "data.acc"}    channel = array; or an array of names that
                                                    channels and arrays share; or one array
    channels  ["hammer", "1:Z"]                     names of the channels in one array
    order     ["time", "record"]                    what the axes of the arrays are; in one row or
                                                    column they are times
    time      "t"                                   times, evenly spaced; or
    rate      51200, or "fs"                        samples a second, or the number that says it

Times are in s unless the file states another unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.errors import FormatError, OptionError, suggest
from updyn.io.items import kind_of, number, placed, real, vector
from updyn.signals.records import Records, seconds, step_of
from updyn.units import find_unit, suggest_unit

__all__ = ["build_records"]

_Real = NDArray[np.float64]
_AXES = ("record", "channel", "time")


def build_records(
    items: Mapping[str, Any],
    path: str | Path,
    *,
    values: str | Sequence[str] | Mapping[str, str] | None,
    channels: Sequence[str] | None,
    order: Sequence[str] | None,
    time: str | None,
    rate: float | str | None,
    units: Mapping[str, str] | None = None,
) -> Records:
    """Return the records that arrays hold.

    Parameters
    ----------
    items : mapping of str to object
        What the file holds, nested or not; in a name, dots stand between the levels.
    path : path
        The file, for messages.
    values, channels, order, time, rate
        See the module.
    units : mapping of str to str, optional
        Unit of each array for which the file states one; by default times are in s, rates in Hz.

    Returns
    -------
    Records

    Raises
    ------
    FormatError
        If an array is not there, is of another kind or shape, or times are not evenly spaced.
    OptionError
        If the options do not say what is needed, or contradict one another.
    """
    arrays = _flat(items)
    if values is None:
        raise OptionError(
            f"{path}: which arrays are records? values = {{ CHANNEL = ARRAY }} says it; the file"
            f" holds {_held(arrays)}",
            key=("values",),
        )
    units = units or {}
    if isinstance(values, str):
        names, array = _one_array(arrays, values, channels, order, path)
        labels = [units.get(values, "")] * len(names)
    else:
        named = _named(values)
        names, array = _by_channel(arrays, named, channels, order, path)
        labels = [units.get(name, "") for name in named.values()]
    step = _step(arrays, time, rate, units, array.shape[2], path)
    with placed(path):
        return Records.of(array, step, names, labels, Path(path).name)


def _named(values: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Return the array of each channel."""
    named = dict(values) if isinstance(values, Mapping) else {name: name for name in values}
    if not named:
        raise OptionError("values: no channel", key=("values",))
    return named


def _one_array(
    arrays: Mapping[str, Any],
    name: str,
    channels: Sequence[str] | None,
    order: Sequence[str] | None,
    path: str | Path,
) -> tuple[list[str], _Real]:
    """Return the names and values of all channels in one array."""
    if channels is None:
        raise OptionError(
            f"values = {name!r}: one array of all channels; channels = [...] says which they are",
            key=("channels",),
        )
    whole = _arranged(_array(arrays, name, path), name, order, path)
    if whole.shape[1] != len(channels):
        raise OptionError(
            f"{len(channels)} channels, and {whole.shape[1]} in {name!r}", key=("channels",)
        )
    return list(channels), whole


def _by_channel(
    arrays: Mapping[str, Any],
    named: Mapping[str, str],
    channels: Sequence[str] | None,
    order: Sequence[str] | None,
    path: str | Path,
) -> tuple[list[str], _Real]:
    """Return the names and values of channels that have an array each."""
    if channels is not None:
        raise OptionError(
            "channels: names of the channels in one array; values say here which array each has",
            key=("channels",),
        )
    if order is not None and "channel" in order:
        raise OptionError("order: each channel has an array of its own", key=("order",))
    parts = {}
    for channel, name in named.items():
        parts[channel] = _arranged(_array(arrays, name, path), name, order, path)
    first, *others = parts.items()
    for channel, part in others:
        if part.shape != first[1].shape:
            raise FormatError(
                f"{named[channel]!r} holds {_size(part)}, {named[first[0]]!r} {_size(first[1])};"
                " channels have to be alike",
                path,
            )
    return list(parts), np.concatenate(list(parts.values()), axis=1)


def _size(array: _Real) -> str:
    return f"{array.shape[0]} records of {array.shape[2]} samples"


def _array(arrays: Mapping[str, Any], name: str, path: str | Path) -> _Real:
    """Return the array of that name."""
    if name not in arrays:
        raise FormatError(f"no array {name!r}; {suggest(name, sorted(arrays))}", path)
    return np.asarray(real(arrays[name], name, path), dtype=np.float64)


def _arranged(array: _Real, name: str, order: Sequence[str] | None, path: str | Path) -> _Real:
    """Return an array with the axes record, channel, time."""
    if order is None:
        if array.size != max(array.shape, default=1):
            raise OptionError(
                f"{name!r} is of shape {array.shape}: say what its axes are, such as order ="
                " ['time', 'record']",
                key=("order",),
            )
        return array.reshape(1, 1, -1)
    axes = list(order)
    for axis in axes:
        if axis not in _AXES or axes.count(axis) > 1:
            raise OptionError(
                f"order {axes}: expected record, channel and time, each once at most; found"
                f" {axis!r}",
                key=("order",),
            )
    if "time" not in axes:
        raise OptionError(f"order {axes}: which axis is time?", key=("order",))
    # MATLAB drops trailing axes of length 1, and makes a column of a row.
    shape = list(array.shape)
    while len(shape) > len(axes) and shape[-1] == 1:
        shape.pop()
    shape += [1] * (len(axes) - len(shape))
    if len(shape) != len(axes):
        raise FormatError(
            f"{name!r} is of shape {array.shape}; expected {len(axes)} axes: {', '.join(axes)}",
            path,
        )
    array = array.reshape(shape)
    missing = [axis for axis in _AXES if axis not in axes]
    array = array.reshape((1,) * len(missing) + array.shape)
    places = [(missing + axes).index(axis) for axis in _AXES]
    return np.ascontiguousarray(array.transpose(places))


def _step(
    arrays: Mapping[str, Any],
    time: str | None,
    rate: float | str | None,
    units: Mapping[str, str],
    n_samples: int,
    path: str | Path,
) -> float:
    """Return the time between two samples, in s."""
    if (time is None) == (rate is None):
        raise OptionError(
            "expected time, the array of times in s, or rate, the samples a second: one of the two",
            key=("time",) if time is not None else ("rate",),
        )
    if time is not None:
        if time not in arrays:
            raise FormatError(f"no array {time!r}; {suggest(time, sorted(arrays))}", path)
        times = vector(arrays[time], time, path)
        if len(times) != n_samples:
            raise FormatError(f"{time!r}: {len(times)} times for {n_samples} samples", path)
        with placed(path):
            passed = seconds(times, units.get(time, ""), time)
        with placed(path, time):
            return step_of(passed)
    if isinstance(rate, str):
        if rate not in arrays:
            raise FormatError(f"no number {rate!r}; {suggest(rate, sorted(arrays))}", path)
        rate = number(arrays[rate], rate, path) * _hertz(units.get(rate, ""), rate, path)
    if not (isinstance(rate, int | float) and np.isfinite(rate) and rate > 0.0):
        raise OptionError(f"rate {rate!r}: expected samples a second, above 0", key=("rate",))
    return 1.0 / float(rate)


def _hertz(label: str, name: str, path: str | Path) -> float:
    """Return the unit of a rate in Hz; 1 without a label."""
    unit = find_unit(label or "Hz", "frequency")
    if unit is None:
        raise FormatError(f"{name}: unit {label!r}; {suggest_unit(label, 'frequency')}", path)
    return unit.factor


def _flat(items: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return nested items by their dotted names."""
    out: dict[str, Any] = {}
    for name, item in items.items():
        if isinstance(item, Mapping):
            out |= _flat(item, f"{before}{name}.")
        else:
            out[f"{before}{name}"] = item
    return out


def _held(arrays: Mapping[str, Any]) -> str:
    """Say what a file holds."""
    texts = [f"{name!r} ({kind_of(item)})" for name, item in sorted(arrays.items())]
    more = f", ... ({len(texts)} in all)" if len(texts) > 8 else ""
    return (", ".join(texts[:8]) or "nothing") + more
