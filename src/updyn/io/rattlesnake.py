"""Time records of Rattlesnake, the vibration controller of Sandia, in netCDF-4.

Layout, from its source code (``components/streaming.py`` and ``components/modal_environment.py``,
January 2025): variables ``time_data``, ``time_data_1``, ... of channels and samples, one for each
stream; the attribute ``sample_rate``; and the group ``channels``, a table with a text for each
channel. The file of a modal test has one stream of frames, ``samples_per_frame`` each, and FRFs in
the group of its environment.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from updyn.errors import FormatError
from updyn.io.items import as_number, as_reals, locate_errors
from updyn.io.record_groups import build_group_records
from updyn.signals.records import Records
from updyn.units import find_unit

__all__ = ["build_rattlesnake_records", "is_rattlesnake"]

_STREAM = re.compile(r"time_data(_[0-9]+)?")
_DIRECTION = re.compile(r"([+-]?)(R?[XYZ])([+-]?)")
_TEXTS = ("node_number", "node_direction", "comment", "unit")


def is_rattlesnake(names: Mapping[str, Any], attributes: Mapping[str, Any]) -> bool:
    """Return whether a file with these members and attributes has the layout."""
    return {"time_data", "channels"} <= set(names) and "sample_rate" in attributes


def build_rattlesnake_records(
    root: Mapping[str, Any],
    path: str | Path,
    *,
    group: str | Sequence[str] | None,
    channels: Sequence[str] | None,
) -> Records:
    """Return the records of a loaded file: one for each stream, or for each frame of a modal test.

    A channel has the name of its DOF, with " force" if it measures a force.
    """
    members = root["members"]
    rate = as_number(root["attributes"]["sample_rate"], "sample_rate", path)
    if not (np.isfinite(rate) and rate > 0.0):
        raise FormatError(f"sample_rate {rate:g}; expected samples per second, above 0", path)
    names, units = _read_table(members["channels"], path)
    stored = []
    for name, item in sorted(members.items()):
        if not _STREAM.fullmatch(name):
            continue
        values = np.atleast_2d(as_reals(item, name, path))
        if values.shape[0] != len(names):
            raise FormatError(
                f"{name} has {values.shape[0]} channels; the group channels has {len(names)}", path
            )
        stored.append(
            {
                "name": name,
                "channels": [
                    {
                        "name": channel,
                        "unit": unit,
                        "n_samples": row.size,
                        "step": 1.0 / rate,
                        "start": "",
                        "abscissa": "s",
                        "values": row,
                    }
                    for channel, unit, row in zip(names, units, values, strict=True)
                ],
            }
        )
    found = build_group_records(stored, path, group=group, channels=channels, time=None, rate=None)
    frame = _frame_length(members, path)
    return found if frame is None else _split_frames(found, frame, path)


def _read_table(table: Any, path: str | Path) -> tuple[list[str], list[str]]:
    """Return the name and the unit of each channel."""
    members = table.get("members", {}) if isinstance(table, Mapping) else {}
    columns = []
    for name in _TEXTS:
        texts = members.get(name)
        if not isinstance(texts, np.ndarray) or texts.dtype.kind not in "OU" or texts.ndim != 1:
            raise FormatError(f"channels: expected the column {name!r} of texts", path)
        columns.append([str(text).strip() for text in texts])
    names = []
    for number, (node, direction, comment, unit) in enumerate(zip(*columns, strict=True), 1):
        force = find_unit(unit, "force") is not None
        names.append(_name_channel(node, direction, force) or comment or f"channel {number}")
    counts = Counter(names)
    unique = []
    for number, name in enumerate(names, 1):
        unique.append(name if counts[name] == 1 else f"{name} (channel {number})")
    return unique, columns[-1]


def _name_channel(node: str, direction: str, is_force: bool) -> str:
    """Return the DOF of a channel as its name; its texts if they are no DOF."""
    found = _DIRECTION.fullmatch(direction.replace(" ", "").upper())
    if found is None or not node.isdecimal() or (found[1] and found[3]):
        return f"{node} {direction}".strip()
    sign = "-" if "-" in (found[1], found[3]) else ""
    return f"{int(node)}:{sign}{found[2]}" + (" force" if is_force else "")


def _frame_length(members: Mapping[str, Any], path: str | Path) -> int | None:
    """Return the samples per frame of a modal test; None for continuous streams."""
    for name, item in members.items():
        if isinstance(item, Mapping) and "frf_data_real" in item["members"]:
            stated = item["attributes"].get("samples_per_frame")
            if stated is not None:
                return int(as_number(stated, f"{name}.samples_per_frame", path))
    return None


def _split_frames(records: Records, frame: int, path: str | Path) -> Records:
    """Return each frame as a record."""
    _, n_channels, n_samples = records.values.shape
    if frame < 1 or n_samples % frame:
        raise FormatError(f"{n_samples} samples in frames of {frame}; expected whole frames", path)
    frames = records.values.reshape(-1, n_channels, n_samples // frame, frame)
    values = frames.transpose(0, 2, 1, 3).reshape(-1, n_channels, frame)
    with locate_errors(path):
        return Records.of(values, records.step, records.channels, records.units, records.source)
