"""Time records of universal files: time responses (type 1) of dataset 58, text or binary.

Forces are named ``3:-Z force``, because there may be a motion at the same DOF; channels without
node and direction by the first line of their identification. Each occurrence of a channel is a
record. Units are those of `updyn.io.uff.labels`.
"""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import DIRECTIONS
from updyn.errors import AbsentError, FormatError, UpdynWarning
from updyn.io.items import format_counts, locate_errors, require_file
from updyn.io.settings import MEASURED_FILE
from updyn.io.uff.datasets import datasets
from updyn.io.uff.functions import Function, read_function
from updyn.io.uff.geometry import NUMBERS, GeometryCollector
from updyn.io.uff.labels import FORCE, abscissa_factor, channel_unit
from updyn.signals.records import Records

__all__ = ["read_records"]

_TIME_RESPONSE = 1


def read_records(path: str | Path) -> Records:
    """Read time records; raise an `AbsentError` if the file holds no time response."""
    collector = GeometryCollector(require_file(path))
    functions: list[Function] = []
    for dataset in datasets(path):
        if dataset.number == 58:
            functions.append(read_function(dataset, path))
        elif dataset.number in NUMBERS:
            collector.take(dataset)
    chosen = [f for f in functions if f.kind == _TIME_RESPONSE]
    others = Counter(f.name for f in functions if f.kind != _TIME_RESPONSE)
    if not chosen:
        raise AbsentError(
            "holds no time response (dataset 58, function type 1); it holds"
            f" {format_counts(others) or 'no function'}",
            path,
        )
    if others:
        warnings.warn(
            f"{path}: functions other than time responses are ignored: {format_counts(others)}",
            UpdynWarning,
            stacklevel=2,
        )
    chosen = [_to_seconds(f, path) for f in chosen]
    line, expected = chosen[0].line, chosen[0].x
    for function in chosen:
        _check(function, line, expected, path)
    channels: dict[str, list[Function]] = {}
    for function in chosen:
        channels.setdefault(_name(function, path), []).append(function)
    _check_complete(channels, path)
    values = np.empty((len(next(iter(channels.values()))), len(channels), chosen[0].points))
    units = []
    for at, (name, records) in enumerate(channels.items()):
        channel_units = {channel_unit(function, collector.units, path) for function in records}
        if len(channel_units) > 1:
            texts = " and ".join(repr(unit) for unit, _ in sorted(channel_units))
            raise FormatError(f"channel {name!r}: records in {texts}; expected one unit", path)
        unit, factor = channel_units.pop()
        units.append(unit)
        for record, function in enumerate(records):
            values[record, at] = factor * function.y
    values.flags.writeable = False  # Records does not copy read-only arrays
    with locate_errors(path):
        return Records.of(values, _step(expected), list(channels), units, Path(path).name)


def _to_seconds(function: Function, path: str | Path) -> Function:
    return replace(function, unit_of_x=abscissa_factor(function.abscissa, "time", path))


def _step(x: RealArray) -> float:
    return float((x[-1] - x[0]) / (len(x) - 1))


def _check(function: Function, first: int, expected: RealArray, path: str | Path) -> None:
    """Refuse a function other than an evenly spaced, real time response with given times.

    `first` is the line of the first function of the channel, for the message.
    """
    if function.is_complex:
        raise FormatError("a complex time response; expected real numbers", path, function.line)
    if function.points < 2:
        raise FormatError("a time response of one sample", path, function.line)
    x = function.x
    step = _step(x)
    if (np.abs(np.diff(x) - step) > 1e-3 * step).any():
        raise FormatError("a time response that is not evenly spaced", path, function.line)
    if len(x) != len(expected):
        raise FormatError(
            f"a time response of {len(x)} samples, but {len(expected)} on line {first}; expected"
            " records of the same length",
            path,
            function.line,
        )
    apart = max(abs(step - _step(expected)) * len(x), abs(x[0] - expected[0]))
    if apart > max(1e-6 * step, MEASURED_FILE.time_tolerance * abs(float(expected[-1]))):
        raise FormatError(
            f"a time response from {x[0]:g} s in steps of {step:g} s, but on line {first} from"
            f" {expected[0]:g} s in steps of {_step(expected):g} s; expected records with the same"
            " times",
            path,
            function.line,
        )


def _name(function: Function, path: str | Path) -> str:
    node, code = function.response
    if not -6 <= code <= 6:
        raise FormatError(f"record 6: direction {code}; expected -6 to 6", path, function.line + 6)
    if code == 0:
        name = str(node) if node else function.title
    else:
        name = f"{node}:{'-' if code < 0 else ''}{DIRECTIONS[abs(code) - 1]}"
    return f"{name} force" if function.numerator.kind in FORCE and node else name


def _check_complete(channels: dict[str, list[Function]], path: str | Path) -> None:
    """Refuse channels with different numbers of records."""
    counts = {name: len(functions) for name, functions in channels.items()}
    if len(set(counts.values())) > 1:
        most, least = max(counts, key=counts.__getitem__), min(counts, key=counts.__getitem__)
        raise FormatError(
            f"channel {most!r} occurs {counts[most]} times, {least!r} {counts[least]}: expected"
            " all channels equally often, because records are identified by their order",
            path,
            channels[least][-1].line,
        )
