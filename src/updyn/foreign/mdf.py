"""Time records of ASAM MDF 4 files as plain data, by asammdf."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from updyn.arrays import NumberArray
from updyn.errors import OptionError
from updyn.foreign.limits import limits_of
from updyn.foreign.plain import Other, to_native

try:
    from asammdf import MDF
except ImportError as error:
    raise OptionError(
        f"MDF files are read by asammdf, which cannot be loaded ({error}): pip install"
        " 'updyn[records]'"
    ) from error

__all__ = ["load"]

#: Types of channels that are the abscissa of their group, stored or implied by the sample number.
_MASTERS = (2, 3)
_TIME = 1
#: Units of times, which the format requires to be in s.
_SECONDS = ("", "s", "sec", "second", "seconds")


def load(path: str, wanted: Sequence[str] | None) -> list[dict[str, object]]:
    """Load the groups of a file, with values for the `wanted` groups; None: for a single group.

    The step of other groups is that of their first two samples.
    """
    limits = limits_of(path)
    mdf: Any = MDF(path, process_bus_logging=False)
    with mdf as found:
        names = _name_groups(found)
        filled = [
            at
            for at, group in enumerate(found.groups)
            if group.channel_group.cycles_nr and _list_channels(group)
        ]
        if wanted is None:
            wanted = [names[at] for at in filled] if len(filled) == 1 else []
        start = found.header.start_time.isoformat()
        loaded: list[dict[str, Any]] = []
        n_values = 0
        for at in filled:
            group = found.groups[at]
            is_wanted = names[at] in wanted
            channels = _list_channels(group)
            if is_wanted:
                n_values += group.channel_group.cycles_nr * (len(channels) + 1)
                limits.check(8 * n_values)
            loaded.append(
                {
                    "name": names[at],
                    "times": _times(found, at, None if is_wanted else 2),
                    "channels": [
                        {
                            "name": channel.name,
                            "unit": found.get_channel_unit(group=at, index=index),
                            "n_samples": group.channel_group.cycles_nr,
                            "start": start,
                            "abscissa": _abscissa(group),
                            "values": _values(found, at, index) if is_wanted else None,
                        }
                        for index, channel in channels
                    ],
                }
            )
        return loaded


def _name_groups(found: Any) -> list[str]:
    """Return a unique name of each group: the stated one, or its number from 1."""
    stated = [str(group.channel_group.acq_name or "").strip() for group in found.groups]
    counts = Counter(stated)
    names = []
    for number, name in enumerate(stated, 1):
        if not name:
            names.append(f"group {number}")
        else:
            names.append(name if counts[name] == 1 else f"{name} (group {number})")
    return names


def _list_channels(group: Any) -> list[tuple[int, Any]]:
    """Return the channels of a group without its abscissa, with their numbers."""
    return [(i, c) for i, c in enumerate(group.channels) if c.channel_type not in _MASTERS]


def _abscissa(group: Any) -> str:
    """Return the unit of the abscissa of a group: "s", or for messages its name."""
    for channel in group.channels:
        is_time = channel.sync_type == _TIME and channel.unit in _SECONDS
        if channel.channel_type in _MASTERS and not is_time:
            return f"{channel.unit} ({channel.name})"
    return "s"


def _times(found: Any, at: int, count: int | None) -> NumberArray | None:
    """Return the first `count` times of a group; None if it has none."""
    if not any(channel.channel_type in _MASTERS for channel in found.groups[at].channels):
        return None
    times = found.get_master(at, record_offset=0, record_count=count)
    return to_native(np.asarray(times, dtype=np.float64))


def _values(found: Any, at: int, index: int) -> NumberArray | Other:
    """Return the samples of a channel in its unit; invalid ones are NaN."""
    signal = found.get(group=at, index=index, ignore_invalidation_bits=True)
    samples = np.asarray(signal.samples)
    if samples.dtype.kind not in "biuf" or samples.ndim != 1:
        return Other(str(samples.dtype))
    invalid = signal.invalidation_bits
    if invalid is None or not np.any(invalid):
        return to_native(samples)
    return np.where(np.asarray(invalid), np.nan, samples.astype(np.float64))
