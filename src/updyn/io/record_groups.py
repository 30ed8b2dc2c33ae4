"""Time records from groups of channels, as TDMS and MDF files have them.

Each group becomes one record. Options select it::

    group     "hit 1", or ["hit 1", "hit 2"]    one, or several of the same channels, as records
    channels  ["hammer", "3:Z"]                 of the group; by default all with numbers
    time      "Time"                            channel of times, if the file states no rate; or
    rate      51200                             samples per second
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.errors import FormatError, OptionError, UpdynWarning, suggest
from updyn.foreign.plain import Other
from updyn.io.items import locate_errors
from updyn.io.settings import FILE_TEXT
from updyn.signals.records import Records, chain_records, find_step, seconds
from updyn.units import find_unit

__all__ = ["GroupChannel", "RecordGroup", "build_group_records"]


@dataclass(frozen=True, slots=True, eq=False)
class GroupChannel:
    """A channel; its values are None if its group was not loaded."""

    name: str
    unit: str
    n_samples: int
    values: NumberArray | Other | None
    step: float | None
    offset: float
    start: str
    abscissa: str

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> GroupChannel:
        """Return a loaded channel with its step in s, or the name of its abscissa if not time."""
        unit = find_unit(str(stored["abscissa"]), "time")
        step, offset = stored.get("step"), stored.get("offset", 0.0)
        if unit is not None:
            step, offset = step and step * unit.factor, offset * unit.factor
        return cls(
            str(stored["name"]),
            str(stored["unit"]).strip(),
            int(stored["n_samples"]),
            stored.get("values"),
            step or None,
            offset,
            stored["start"],
            "" if unit else str(stored["abscissa"]),
        )

    @property
    def has_numbers(self) -> bool:
        """Whether the channel may be a record."""
        return self.n_samples > 0 and not isinstance(self.values, Other)

    @property
    def timing(self) -> tuple[int, float | None, float, str]:
        """Length, step and start, which the channels of a record have in common."""
        return self.n_samples, self.step, self.offset, self.start


@dataclass(frozen=True, slots=True, eq=False)
class RecordGroup:
    """Channels, with common times if the file stores them."""

    name: str
    channels: tuple[GroupChannel, ...]
    times: RealArray | None

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> RecordGroup:
        """Return a loaded group; channels of the same name get their numbers from 1."""
        channels = [GroupChannel.of(channel) for channel in stored["channels"]]
        counts = Counter(channel.name for channel in channels)
        for at, channel in enumerate(channels):
            if counts[channel.name] > 1:
                channels[at] = replace(channel, name=f"{channel.name} (channel {at + 1})")
        return cls(str(stored["name"]), tuple(channels), stored.get("times"))

    def format(self) -> str:
        """Return name, channels, length and rate, for messages."""
        first = self.channels[0]
        step = first.step
        if self.times is not None and len(self.times) > 1:
            step = float(self.times[1] - self.times[0])
        return f"{self.name!r} ({_format_names(self.channels)}; {_format_rate(first, step)})"


def build_group_records(
    stored: Sequence[Mapping[str, object]],
    path: str | Path,
    *,
    group: str | Sequence[str] | None,
    channels: Sequence[str] | None,
    time: str | None,
    rate: float | None,
) -> Records:
    """Build records from loaded groups, by the options of the module."""
    if time is not None and rate is not None:
        raise OptionError("time and rate; expected one of the two", key=("rate",))
    if rate is not None and not (np.isfinite(rate) and rate > 0.0):
        raise OptionError(f"rate {rate!r}: expected samples per second, above 0", key=("rate",))
    groups = [RecordGroup.of(one) for one in stored]
    parts = []
    for one in _choose_groups(groups, group, path):
        chosen = _choose_channels(one, channels, time, path)
        step = _step(one, chosen, time, rate, path)
        source = [Path(path).name]
        if len(groups) > 1:
            source.append(one.name)
        if chosen[0].start:
            source.append(f"started {chosen[0].start}")
        with locate_errors(path, f"group {one.name!r}"):
            parts.append(
                Records.of(
                    np.array([[channel.values for channel in chosen]], dtype=np.float64),
                    step,
                    [channel.name for channel in chosen],
                    [channel.unit for channel in chosen],
                    ", ".join(source),
                )
            )
    with locate_errors(path):
        return chain_records(parts)


def _choose_groups(
    groups: Sequence[RecordGroup], wanted: str | Sequence[str] | None, path: str | Path
) -> list[RecordGroup]:
    if not groups:
        raise FormatError("holds no group of channels with samples", path)
    by_name = {group.name: group for group in groups}
    if wanted is None:
        if len(groups) == 1:
            return [groups[0]]
        alike = [g.name for g in groups if _names(g) == _names(groups[0])]
        hint = f"select one with group = {groups[0].name!r}"
        if len(alike) > 1:
            hint += f", or several of the same channels, as records, with group = {alike[:3]}"
        listed = [group.format() for group in groups[: FILE_TEXT.listed_columns]]
        if len(groups) > len(listed):
            listed.append("...")
        raise OptionError(
            f"{path}: {len(groups)} groups of channels: {', '.join(listed)}; {hint}",
            key=("group",),
        )
    chosen = []
    for name in [wanted] if isinstance(wanted, str) else wanted:
        if name not in by_name:
            raise FormatError(f"no group {name!r}; {suggest(name, by_name)}", path, key=("group",))
        chosen.append(by_name[name])
    if not chosen:
        raise OptionError("group: no name", key=("group",))
    return chosen


def _names(group: RecordGroup) -> list[str]:
    return [channel.name for channel in group.channels]


def _choose_channels(
    group: RecordGroup, wanted: Sequence[str] | None, time: str | None, path: str | Path
) -> list[GroupChannel]:
    """Return the channels of a record, all of one length, step and start."""
    by_name = {channel.name: channel for channel in group.channels}
    place = f"group {group.name!r}"
    if wanted is None:
        others = [c for c in group.channels if c.name != time]
        chosen = [c for c in others if c.has_numbers]
        ignored = [repr(c.name) for c in others if not c.has_numbers]
        if ignored:
            warnings.warn(
                f"{path}: {place}: channels without samples or numbers are ignored:"
                f" {', '.join(ignored)}",
                UpdynWarning,
                stacklevel=5,
            )
        if not chosen:
            raise FormatError(f"{place} has no channel with numbers", path)
    else:
        chosen = []
        for name in wanted:
            if name not in by_name:
                raise FormatError(
                    f"{place}: no channel {name!r}; {suggest(name, by_name)}",
                    path,
                    key=("channels",),
                )
            if not by_name[name].has_numbers:
                raise FormatError(f"{place}: channel {name!r}: expected numbers", path)
            chosen.append(by_name[name])
        if not chosen:
            raise OptionError("channels: no name", key=("channels",))
    for channel in chosen:
        if channel.abscissa:
            raise FormatError(
                f"{place}: channel {channel.name!r}: abscissa in {channel.abscissa!r}; expected"
                " time, in MDF files in s",
                path,
            )
    _check_timing(chosen, place, path)
    return chosen


def _check_timing(chosen: Sequence[GroupChannel], place: str, path: str | Path) -> None:
    """Refuse channels of several rates, lengths or starts."""
    alike: dict[object, list[GroupChannel]] = {}
    for channel in chosen:
        alike.setdefault(channel.timing, []).append(channel)
    if len(alike) == 1:
        return
    texts = []
    for same in alike.values():
        first = same[0]
        start = f", from {first.start}" if first.start else ""
        offset = f" + {first.offset:g} s" if first.offset else ""
        texts.append(f"{_format_names(same)} ({_format_rate(first, first.step)}{start}{offset})")
    raise FormatError(
        f"{place} has channels of several rates, lengths or starts: {', '.join(texts)}; records"
        " are not resampled; select channels that agree with channels ="
        f" {[channel.name for channel in next(iter(alike.values()))]}",
        path,
        key=("channels",),
    )


def _step(
    group: RecordGroup,
    chosen: Sequence[GroupChannel],
    time: str | None,
    rate: float | None,
    path: str | Path,
) -> float:
    """Return the sampling interval of a record in s."""
    place = f"group {group.name!r}"
    stated = chosen[0].step
    if group.times is not None:
        with locate_errors(path, place):
            stated = find_step(np.asarray(group.times, dtype=np.float64))
    if stated is not None:
        for name, given in (("time", time), ("rate", rate)):
            if given is not None:
                raise OptionError(
                    f"{path}: {name}: the file states {1.0 / stated:g} samples per second",
                    key=(name,),
                )
        return stated
    if rate is not None:
        return 1.0 / float(rate)
    if time is None:
        raise OptionError(
            f"{path}: {place} states no sampling rate; give the channel of times, such as"
            f" time = {group.channels[0].name!r}, or rate, the samples per second",
            key=("rate",),
        )
    return _step_of_times(group, chosen[0].n_samples, time, path)


def _step_of_times(group: RecordGroup, n_samples: int, time: str, path: str | Path) -> float:
    by_name = {channel.name: channel for channel in group.channels}
    clock = by_name.get(time)
    if clock is None:
        raise FormatError(
            f"group {group.name!r}: no channel {time!r} of times; {suggest(time, by_name)}",
            path,
            key=("time",),
        )
    if not isinstance(clock.values, np.ndarray) or clock.n_samples != n_samples:
        raise FormatError(
            f"group {group.name!r}: channel {time!r} has {clock.n_samples} times for {n_samples}"
            " samples; expected a number for each sample",
            path,
        )
    with locate_errors(path, f"group {group.name!r}"):
        return find_step(seconds(clock.values, clock.unit, time))


def _format_names(channels: Sequence[GroupChannel]) -> str:
    names = [channel.name for channel in channels]
    more = f", ... ({len(names)} channels)" if len(names) > 6 else ""
    return ", ".join(names[:6]) + more


def _format_rate(channel: GroupChannel, step: float | None) -> str:
    rate = "no stated rate" if not step else f"{1.0 / step:g} a second"
    return f"{channel.n_samples} samples, {rate}"
