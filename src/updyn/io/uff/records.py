"""Time records of universal files: time responses (type 1) of dataset 58, text or binary.

Channels are called by their DOF, ``3:-Z``; a force by ``3:-Z force``, as there may be a motion at
the same DOF; one without node and direction by the first line of its identification. A channel that
stands several times is a record each time, in the order of the file; all channels have to stand
equally often. Units are the labels of record 9; without a label the SI unit of its data type, after
dataset 164.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from updyn.dofs import DIRECTIONS
from updyn.errors import AbsentError, FormatError, UpdynWarning
from updyn.io.items import counted, existing, placed
from updyn.io.uff.datasets import datasets
from updyn.io.uff.functions import Function, read_function
from updyn.io.uff.geometry import NUMBERS, Collector, Units
from updyn.signals.records import Records

__all__ = ["read_records"]

_TIME_RESPONSE = 1
#: Specific data types.
_TIME, _UNKNOWN = 17, (0, 1)
_MOTION = {8: "", 11: "/s", 12: "/s^2"}
_FORCE = (9, 13)
_SECONDS = re.compile(r"(s|sec|second|seconds)?", re.I)
_SAME = 1e-9


def read_records(path: str | Path) -> Records:
    """Read time records.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    Records

    Raises
    ------
    AbsentError
        If it holds no time response.
    FormatError
        If the file is damaged, a time response is complex or not evenly spaced, or channels differ
        in length, step, start or number of records.

    Warns
    -----
    UpdynWarning
        If it holds other functions besides; they are counted.
    """
    collector = Collector(existing(path))
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
            f" {counted(others) or 'no function'}",
            path,
        )
    if others:
        warnings.warn(
            f"{path}: functions that are no time responses are left out: {counted(others)}",
            UpdynWarning,
            stacklevel=2,
        )
    for function in chosen:
        _check(function, chosen[0], path)
    channels: dict[str, list[Function]] = {}
    for function in chosen:
        channels.setdefault(_name(function, path), []).append(function)
    _check_complete(channels, path)
    values, units = [], []
    for name, records in channels.items():
        said = {_unit(function, collector.units) for function in records}
        if len(said) > 1:
            texts = " and ".join(repr(unit) for unit, _ in sorted(said))
            raise FormatError(f"channel {name!r}: records in {texts}; expected one unit", path)
        unit, factor = said.pop()
        units.append(unit)
        values.append([factor * function.y for function in records])
    with placed(path):
        return Records.of(
            np.array(values).transpose(1, 0, 2),
            _step(chosen[0]),
            list(channels),
            units,
            Path(path).name,
        )


def _step(function: Function) -> float:
    return float((function.x[-1] - function.x[0]) / (len(function.x) - 1))


def _check(function: Function, first: Function, path: str | Path) -> None:
    """Refuse a function that is no evenly spaced, real time response like the first one."""
    if np.iscomplexobj(function.y):
        raise FormatError("a complex time response; expected real numbers", path, function.line)
    if len(function.x) < 2:
        raise FormatError("a time response of one sample", path, function.line)
    if function.abscissa.kind not in (_TIME, *_UNKNOWN):
        raise FormatError(
            f"a time response over data type {function.abscissa.kind}; expected time (17)",
            path,
            function.abscissa.line,
        )
    label = function.abscissa.unit.strip("()[] ")
    if _SECONDS.fullmatch(label) is None:
        raise FormatError(
            f"times in {function.abscissa.unit!r}; expected s", path, function.abscissa.line
        )
    step = _step(function)
    if (np.abs(np.diff(function.x) - step) > 1e-3 * step).any():
        raise FormatError("a time response that is not evenly spaced", path, function.line)
    if len(function.x) != len(first.x):
        raise FormatError(
            f"a time response of {len(function.x)} samples, that on line {first.line} has"
            f" {len(first.x)}; records of a file have to be alike",
            path,
            function.line,
        )
    apart = max(abs(step - _step(first)) * len(first.x), abs(function.x[0] - first.x[0]))
    if apart > max(1e-6 * step, _SAME * abs(float(first.x[-1]))):
        raise FormatError(
            f"a time response from {function.x[0]:g} s in steps of {step:g} s, that on line"
            f" {first.line} from {first.x[0]:g} s in steps of {_step(first):g} s; records of a"
            " file have to be alike",
            path,
            function.line,
        )


def _name(function: Function, path: str | Path) -> str:
    """Return what a channel is called."""
    node, code = function.response
    if not -6 <= code <= 6:
        raise FormatError(f"record 6: direction {code}; expected -6 to 6", path, function.line + 6)
    if code == 0:
        name = str(node) if node else function.title
    else:
        name = f"{node}:{'-' if code < 0 else ''}{DIRECTIONS[abs(code) - 1]}"
    return f"{name} force" if function.numerator.kind in _FORCE and node else name


def _check_complete(channels: dict[str, list[Function]], path: str | Path) -> None:
    """Refuse channels that stand more or less often than others."""
    counts = {name: len(functions) for name, functions in channels.items()}
    if len(set(counts.values())) > 1:
        most, least = max(counts, key=counts.__getitem__), min(counts, key=counts.__getitem__)
        raise FormatError(
            f"channel {most!r} stands {counts[most]} times, {least!r} {counts[least]}: records are"
            " told by their order, so that all channels have to stand equally often",
            path,
            channels[least][-1].line,
        )


def _unit(function: Function, units: Units) -> tuple[str, float]:
    """Return the unit of a channel, and what makes it of the numbers of the file."""
    kind, label = function.numerator.kind, function.numerator.unit.strip("()[] ")
    if label:
        return label, 1.0
    turns = abs(function.response[1]) > 3
    if kind in _MOTION:
        return ("rad" if turns else "m") + _MOTION[kind], 1.0 if turns else 1.0 / units.length
    if kind in _FORCE:
        factor = units.force * units.length if turns else units.force
        return "N m" if turns else "N", 1.0 / factor
    return "", 1.0
