"""Time records from named arrays of MATLAB and HDF5 files.

Options select the arrays::

    values    {"hammer": "f", "1:Z": "data.acc"}    channel = array; or an array of names that
                                                    channels and arrays share; or one array
    channels  ["hammer", "1:Z"]                     names of the channels in one array
    order     ["time", "record"]                    axes of the arrays; a single row or column is
                                                    along time
    time      "t"                                   times, evenly spaced; or
    rate      51200, or "fs"                        samples per second, or the name of this number

``"data(:,2)"`` is the second column of a table. Times are in s unless the file states another unit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError, OptionError, suggest
from updyn.io.items import as_number, as_reals, as_vector, describe_kind, locate_errors
from updyn.io.variable_names import select_column, split_column
from updyn.signals.records import Records, find_step, seconds
from updyn.units import find_unit, suggest_unit

__all__ = ["build_records", "refuse_without_values"]

_AXES = ("record", "channel", "time")


def build_records(
    items: Mapping[str, object],
    path: str | Path,
    *,
    values: str | Sequence[str] | Mapping[str, str] | None,
    channels: Sequence[str] | None,
    order: Sequence[str] | None,
    time: str | None,
    rate: float | str | None,
    units: Mapping[str, str] | None = None,
) -> Records:
    """Build records from arrays, by the options of the module; dots in a name separate levels.

    Without `units`, times are in s and rates in Hz.
    """
    arrays = _flatten(items)
    if values is None:
        raise OptionError(
            f"{path}: select the arrays of records with values = {{ CHANNEL = ARRAY }}; the file"
            f" holds {_format_arrays(arrays)}",
            key=("values",),
        )
    units = units or {}
    if isinstance(values, str):
        names, array = _one_array(arrays, values, channels, order, path)
        labels = [units.get(values, "")] * len(names)
    else:
        named = _arrays_by_channel(values)
        names, array = _arrays_of_channels(arrays, named, channels, order, path)
        labels = [units.get(name, "") for name in named.values()]
    step = _step(arrays, time, rate, units, array.shape[2], path)
    with locate_errors(path):
        return Records.of(array, step, names, labels, Path(path).name)


def refuse_without_values(**options: object) -> None:
    """Refuse options that describe the datasets of `values`."""
    for name, given in options.items():
        if given is not None:
            raise OptionError(f"{name} without values; expected a dataset in values", key=(name,))


def _arrays_by_channel(values: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    named = dict(values) if isinstance(values, Mapping) else {name: name for name in values}
    if not named:
        raise OptionError("values: no channel", key=("values",))
    return named


def _one_array(
    arrays: Mapping[str, object],
    name: str,
    channels: Sequence[str] | None,
    order: Sequence[str] | None,
    path: str | Path,
) -> tuple[list[str], RealArray]:
    if channels is None:
        raise OptionError(
            f"values = {name!r}: one array for all channels; name them with channels = [...]",
            key=("channels",),
        )
    whole = _order_axes(_array(arrays, name, path), name, order, path)
    if whole.shape[1] != len(channels):
        raise OptionError(
            f"{len(channels)} channels, but {whole.shape[1]} in {name!r}", key=("channels",)
        )
    return list(channels), whole


def _arrays_of_channels(
    arrays: Mapping[str, object],
    named: Mapping[str, str],
    channels: Sequence[str] | None,
    order: Sequence[str] | None,
    path: str | Path,
) -> tuple[list[str], RealArray]:
    if channels is not None:
        raise OptionError(
            "channels: only for one array with all channels; here values give the array of each"
            " channel",
            key=("channels",),
        )
    if order is not None and "channel" in order:
        raise OptionError("order: each channel has a separate array", key=("order",))
    parts = {}
    for channel, name in named.items():
        parts[channel] = _order_axes(_array(arrays, name, path), name, order, path)
    first, *others = parts.items()
    for channel, part in others:
        if part.shape != first[1].shape:
            raise FormatError(
                f"{named[channel]!r} holds {_size(part)}, {named[first[0]]!r} {_size(first[1])};"
                " expected channels of equal size",
                path,
            )
    return list(parts), np.concatenate(list(parts.values()), axis=1)


def _size(array: RealArray) -> str:
    return f"{array.shape[0]} records of {array.shape[2]} samples"


def _array(arrays: Mapping[str, object], name: str, path: str | Path) -> RealArray:
    variable, column = split_column(name)
    if variable not in arrays:
        raise FormatError(f"no array {variable!r}; {suggest(variable, sorted(arrays))}", path)
    array = np.asarray(as_reals(arrays[variable], name, path), dtype=np.float64)
    return array if column is None else select_column(array, name, path)


def _order_axes(
    array: RealArray, name: str, order: Sequence[str] | None, path: str | Path
) -> RealArray:
    if order is None:
        if array.size != max(array.shape, default=1):
            raise OptionError(
                f"{name!r} has shape {array.shape}: give its axes, such as order ="
                " ['time', 'record']",
                key=("order",),
            )
        return array.reshape(1, 1, -1)
    axes = list(order)
    for axis in axes:
        if axis not in _AXES or axes.count(axis) > 1:
            raise OptionError(
                f"order {axes}: expected record, channel and time, each at most once; found"
                f" {axis!r}",
                key=("order",),
            )
    if "time" not in axes:
        raise OptionError(f"order {axes}: expected the axis time", key=("order",))
    # MATLAB drops trailing axes of length 1, and stores a row as a column.
    shape = list(array.shape)
    while len(shape) > len(axes) and shape[-1] == 1:
        shape.pop()
    shape += [1] * (len(axes) - len(shape))
    if len(shape) != len(axes):
        raise FormatError(
            f"{name!r} has shape {array.shape}; expected {len(axes)} axes: {', '.join(axes)}",
            path,
        )
    array = array.reshape(shape)
    missing = [axis for axis in _AXES if axis not in axes]
    array = array.reshape((1,) * len(missing) + array.shape)
    places = [(missing + axes).index(axis) for axis in _AXES]
    return np.ascontiguousarray(array.transpose(places))


def _step(
    arrays: Mapping[str, object],
    time: str | None,
    rate: float | str | None,
    units: Mapping[str, str],
    n_samples: int,
    path: str | Path,
) -> float:
    if (time is None) == (rate is None):
        raise OptionError(
            "expected either time, the array of times in s, or rate, the samples per second",
            key=("time",) if time is not None else ("rate",),
        )
    if time is not None:
        times = as_vector(_array(arrays, time, path), time, path)
        if len(times) != n_samples:
            raise FormatError(f"{time!r}: {len(times)} times for {n_samples} samples", path)
        with locate_errors(path):
            passed = seconds(times, units.get(time, ""), time)
        with locate_errors(path, time):
            return find_step(passed)
    if isinstance(rate, str):
        if rate not in arrays:
            raise FormatError(f"no number {rate!r}; {suggest(rate, sorted(arrays))}", path)
        rate = as_number(arrays[rate], rate, path) * _rate_factor(units.get(rate, ""), rate, path)
    if not (isinstance(rate, int | float) and np.isfinite(rate) and rate > 0.0):
        raise OptionError(f"rate {rate!r}: expected samples per second, above 0", key=("rate",))
    return 1.0 / float(rate)


def _rate_factor(label: str, name: str, path: str | Path) -> float:
    """Return the unit of a rate in Hz; 1 without a label."""
    unit = find_unit(label or "Hz", "frequency")
    if unit is None:
        raise FormatError(f"{name}: unit {label!r}; {suggest_unit(label, 'frequency')}", path)
    return unit.factor


def _flatten(items: Mapping[str, object], before: str = "") -> dict[str, object]:
    """Return nested items by their dotted names."""
    out: dict[str, object] = {}
    for name, item in items.items():
        if isinstance(item, Mapping):
            out |= _flatten(item, f"{before}{name}.")
        else:
            out[f"{before}{name}"] = item
    return out


def _format_arrays(arrays: Mapping[str, object]) -> str:
    texts = [f"{name!r} ({describe_kind(item)})" for name, item in sorted(arrays.items())]
    more = f", ... ({len(texts)} in all)" if len(texts) > 8 else ""
    return (", ".join(texts[:8]) or "nothing") + more
