"""Time records of LabVIEW measurement files (.lvm).

Layout: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)". A segment is
a record. With ``Multi_Headings No`` only the first segment has a header; if all times are
continuous, all rows form one record. Spectra, channels that start at different times (``X0``), and
unknown tags that may change the meaning of numbers are refused.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import FormatError, UpdynWarning, suggest
from updyn.io.items import locate_errors, read_windows_text, require_file
from updyn.io.settings import MEASURED_FILE
from updyn.io.text_numbers import find_rounding, parse_integer, parse_real, parse_rows
from updyn.signals.records import Records
from updyn.units import find_unit

__all__ = ["read_records"]

_T = TypeVar("_T")

_END = re.compile(r"(?m)^\*\*\*End_of_Header\*\*\*[^\n]*\n")
_SPECIAL = re.compile(
    r"(?ms)^\*\*\*Start_Special\*\*\*[^\n]*\n.*?^\*\*\*End_Special\*\*\*[^\n]*(?:\n|\Z)"
)
_TAG = re.compile(r"(?m)^[A-Za-z]")
_SEPARATORS = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}
_X_COLUMNS = ("No", "One", "Multi")
_HEADINGS = ("Yes", "No")
#: Tags of the header of a record that are read.
_ONCE = ("Channels", "Samples", "Delta_X", "X0", "X_Dimension", "X_Unit_Label", "Y_Unit_Label")
#: Other tags that may change the meaning of the numbers.
_MEANING = re.compile(r"(?i)^[xy]_|^delta|scale|scaling|factor|gain|offset|slope|sensitivity")
_HARMLESS = ("Y_Dimension",)
#: Units and names of channels with a spectrum.
_LEVELS = re.compile(r"(?i)^dB|/\s*\W*(?:sqrt|rt)?\W*Hz")
_SPECTRA = re.compile(r"(?i)\bdB\b|\bFFT\b|\bPSD\b|spectr(?:um|al)")
_NAMES_FROM, _NAMES_TO = "X_Value", "Comment"


def read_records(path: str | Path) -> Records:
    """Read time records, one per segment, in the units of the file.

    A `Delta_X` of 1 s, the value of LabVIEW without timing, causes a warning.
    """
    text = _without_special(read_windows_text(require_file(path)))
    ends = list(_END.finditer(text))
    if not text.startswith("LabVIEW Measurement") or not ends:
        raise FormatError("no header of a LabVIEW measurement file", path, 1)
    head = _LVMHeader.of(text[: ends[0].start()], path)
    if len(ends) < 2:
        raise FormatError("a header without records", path)
    segments = list(_segments(text, ends, head, path))
    first = segments[0]
    for segment in segments[1:]:
        first.check_same_channels(segment, path)
    _warn(first, path)
    with locate_errors(path):
        return Records.of(
            [segment.values for segment in segments],
            first.step,
            first.channels,
            first.units,
            Path(path).name,
        )


@dataclass(frozen=True, slots=True)
class _LVMHeader:
    """The header of the file: the format of its rows."""

    separator: str
    decimal: str
    x_columns: str
    has_headings: bool

    @classmethod
    def of(cls, text: str, path: str | Path) -> _LVMHeader:
        found: dict[str, str] = {}
        for number, line in enumerate(text.split("\n")[1:], 2):
            name, *value = _SPLIT.split(line, maxsplit=1)
            if line.strip() and not value:
                raise FormatError(
                    f"found {line.strip()[:40]!r}; expected a name and its value", path, number
                )
            if name in found:
                raise FormatError(f"{name} occurs twice", path, number)
            if value:
                found[name] = value[0]
        named = found.get("Separator", "Tab").strip()
        decimal = found.get("Decimal_Separator", ".").strip()
        x_columns = found.get("X_Columns", "One").strip()
        if named not in _SEPARATORS:
            raise FormatError(f"Separator {named!r}; {suggest(named, _SEPARATORS)}", path)
        if decimal not in (".", ",") or decimal == _SEPARATORS[named]:
            raise FormatError(f"Decimal_Separator {decimal!r} with columns by {named}", path)
        if x_columns not in _X_COLUMNS:
            raise FormatError(f"X_Columns {x_columns!r}; {suggest(x_columns, _X_COLUMNS)}", path)
        headings = found.get("Multi_Headings", "Yes").strip()
        if headings not in _HEADINGS:
            raise FormatError(f"Multi_Headings {headings!r}; {suggest(headings, _HEADINGS)}", path)
        return cls(_SEPARATORS[named], decimal, x_columns, headings == "Yes")


#: The header may use another separator than the rows.
_SPLIT = re.compile(r"[\t,;]")


@dataclass(frozen=True, slots=True)
class _Segment:
    """One record: samples by channel."""

    line: int
    step: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    empty: tuple[str, ...]
    values: RealArray

    def check_same_channels(self, other: _Segment, path: str | Path) -> None:
        """Refuse another segment whose channels differ from this one."""
        for what in ("channels", "units", "step"):
            mine, its = getattr(self, what), getattr(other, what)
            if mine != its:
                raise FormatError(
                    f"this record has {what} {its!r}, the first one {mine!r}; expected equal"
                    " records",
                    path,
                    other.line,
                )
        lengths = [segment.values.shape[1] for segment in (self, other)]
        if lengths[0] != lengths[1]:
            raise FormatError(
                f"this record has {lengths[1]} samples, the first one {lengths[0]}; expected"
                " records of the same length",
                path,
                other.line,
            )


def _warn(segment: _Segment, path: str | Path) -> None:
    """Warn of channels without samples, and of the default step of LabVIEW."""
    if segment.empty:
        names = ", ".join(map(repr, segment.empty))
        warnings.warn(
            f"{path}: channels without samples are ignored: {names}", UpdynWarning, stacklevel=3
        )
    if segment.step == 1.0:
        warnings.warn(
            f"{path}:{segment.line}: Delta_X is 1 s, which LabVIEW also writes for data without a"
            " sampling rate; check that the rate is one sample per second",
            UpdynWarning,
            stacklevel=3,
        )


def _segments(
    text: str, ends: list[re.Match[str]], head: _LVMHeader, path: str | Path
) -> Iterator[_Segment]:
    """Yield the records, each from the start of its header to the start of the next."""
    begins = [ends[0].end()]
    for before, end in pairwise(ends[1:]):
        # The preceding rows are numbers; the tags of a header begin with a letter.
        of_rows = text.index("\n", before.end()) + 1 if before.end() < len(text) else before.end()
        tag = _TAG.search(text, of_rows, end.start())
        begins.append(end.start() if tag is None else tag.start())
    for begin, end, stop in zip(begins, ends[1:], [*begins[1:], len(text)], strict=True):
        skipped = len(text[begin : end.start()]) - len(text[begin : end.start()].lstrip("\n"))
        begin += skipped
        lines = [text.count("\n", 0, place) + 1 for place in (begin, end.end())]
        fields = _fields(text[begin : end.start()], head.separator, path, lines[0])
        yield from _packets(fields, text[end.end() : stop], head, path, lines)


def _without_special(text: str) -> str:
    """Return a text with the special blocks of other programs replaced by empty lines."""
    return _SPECIAL.sub(lambda found: "\n" * found[0].count("\n"), text)


def _without_comments(rows: str, titles: list[str], width: int, separator: str) -> str:
    """Return rows without the last column, the comments."""
    if titles[-1:] != [_NAMES_TO]:
        return rows
    kept = [separator.join(row.split(separator)[:width]) for row in rows.split("\n")]
    return "\n".join(kept)


def _fields(text: str, separator: str, path: str | Path, first: int) -> Mapping[str, list[str]]:
    """Return the values of a segment's header by name; `first` is its first line."""
    found: dict[str, list[str]] = {}
    for number, line in enumerate(text.split("\n"), first):
        name, *values = [word.strip() for word in line.split(separator)]
        if name in found and name in _ONCE:
            raise FormatError(f"{name} occurs twice", path, number)
        if name not in (*_ONCE, *_HARMLESS) and _MEANING.search(name):
            raise FormatError(
                f"tag {name!r} is not known and may change the numbers; delete the line if it does"
                " not",
                path,
                number,
            )
        found[name] = values
    return found


@dataclass(frozen=True, slots=True)
class _LVMAxis:
    """The header of a record, from `line` on: its channels, and the times of their samples.

    `kept` are the channels with samples, from 0, of `n_channels`; each has `count` samples and one
    of `units`. `step` is Delta_X in s, `digit` its largest rounding error.
    """

    line: int
    kept: tuple[int, ...]
    n_channels: int
    count: int
    step: float
    digit: float
    units: tuple[str, ...]

    @classmethod
    def of(
        cls, fields: Mapping[str, list[str]], head: _LVMHeader, path: str | Path, line: int
    ) -> _LVMAxis:
        """Return the axis defined by the tags of a header."""
        tags = _Tags(fields, (0,), path, line)
        (n,) = tags.each("Channels", parse_integer)
        # With a time column for each channel, LabVIEW leaves the tags of these columns blank.
        stride = 2 if head.x_columns == "Multi" and fields.get("Samples", [])[1:2] == [""] else 1
        tags = replace(tags, places=range(0, stride * n, stride))
        samples = tags.each("Samples", parse_integer)
        kept = tuple(i for i in range(n) if samples[i] != 0) or tuple(range(n))
        tags = replace(tags, places=tuple(stride * i for i in kept))
        steps = tags.each("Delta_X", lambda text: parse_real(text.replace(head.decimal, ".")))
        if len({samples[i] for i in kept}) != 1 or len(set(steps)) != 1:
            raise tags.error("channels of one record with different Samples or Delta_X")
        tags.check_start(steps[0], head.decimal)
        tags.check_dimension()
        printed = tags.each("Delta_X", str)[0].replace(head.decimal, ".")
        half_digit = 0.5 * float(find_rounding([printed], np.array(steps[:1]))[0])
        digit = min(half_digit, MEASURED_FILE.step_rounding * abs(steps[0]))
        return cls(line, kept, n, samples[kept[0]], steps[0], digit, tags.units())


@dataclass(frozen=True, slots=True)
class _Tags:
    """The values of tags in a header that starts at a line, for some channels."""

    fields: Mapping[str, list[str]]
    places: Sequence[int]
    path: str | Path
    line: int

    def error(self, why: str) -> FormatError:
        return FormatError(why, self.path, self.line)

    def each(self, name: str, convert: Callable[[str], _T]) -> list[_T]:
        given = self.fields.get(name, [])
        # The slice limits the loop, because a damaged file may state any number of channels.
        chosen = [given[place] for place in self.places[: len(given)] if place < len(given)]
        if not self.places or len(chosen) < len(self.places) or not all(chosen):
            raise self.error(
                f"{name} of this record: expected {len(self.places)} values, found"
                f" {sum(map(bool, chosen))}"
            )
        try:
            return [convert(value) for value in chosen]
        except ValueError as error:
            raise self.error(f"{name} of this record: {error}") from error

    def check_start(self, step: float, decimal: str) -> None:
        """Refuse channels with different start times."""
        if not self.fields.get("X0"):
            return
        starts = self.each("X0", lambda text: parse_real(text.replace(decimal, ".")))
        if max(starts) - min(starts) > MEASURED_FILE.step_rounding * abs(step):
            raise self.error(
                f"channels of one record start at {min(starts):g} to {max(starts):g} (X0); expected"
                " equal start times"
            )

    def check_dimension(self) -> None:
        """Refuse an abscissa that is not time in s."""
        for name in self.each("X_Dimension", str) if self.fields.get("X_Dimension") else []:
            if name != "Time":
                raise self.error(f"X_Dimension {name!r}: not a time record")
        for label in filter(None, self.fields.get("X_Unit_Label", [])):
            _check_seconds(label, self.path, self.line)

    def units(self) -> tuple[str, ...]:
        """Return the units of the channels, empty for a channel without unit."""
        given = self.fields.get("Y_Unit_Label", [])
        units = tuple(given[place] if place < len(given) else "" for place in self.places)
        for unit in units:
            if _LEVELS.search(unit):
                raise self.error(f"Y_Unit_Label {unit!r}: a spectrum, not a time record")
        return units


def _check_seconds(label: str, path: str | Path, line: int) -> None:
    """Refuse a unit of the abscissa other than s, which LabVIEW uses regardless of the label."""
    unit = find_unit(label, "time")
    if unit is None and find_unit(label, "frequency"):
        raise FormatError(f"X_Unit_Label {label!r}: a spectrum, not a time record", path, line)
    if unit is None or unit.factor != 1.0:
        raise FormatError(
            f"X_Unit_Label {label!r}; expected s: write Delta_X and X_Value in s with the label s",
            path,
            line,
        )


def _packets(
    fields: Mapping[str, list[str]],
    body: str,
    head: _LVMHeader,
    path: str | Path,
    lines: Sequence[int],
) -> Iterator[_Segment]:
    """Yield the records of a header and its rows; `lines` are their first lines."""
    first, of_names = lines
    axis = _LVMAxis.of(fields, head, path, first)
    n, count = axis.n_channels, axis.count

    def format_error(why: str, line: int = first) -> FormatError:
        return FormatError(why, path, line)

    names, _, rows = body.partition("\n")
    titles = [title.strip() for title in names.split(head.separator)]
    if titles[:1] != [_NAMES_FROM]:
        raise format_error(f"expected a line of names from {_NAMES_FROM}", of_names)
    channel_names = [title for title in titles if title and title not in (_NAMES_FROM, _NAMES_TO)]
    if len(channel_names) != n:
        raise format_error(f"{len(channel_names)} names for {n} channels", of_names)
    channels = tuple(channel_names[i] for i in axis.kept)
    for name in channels:
        if _SPECTRA.search(name):
            raise format_error(
                f"channel {name!r}: by its name a spectrum, not a time record; rename it if this is"
                " wrong",
                of_names,
            )
    with_x = {"No": 0, "One": 1, "Multi": n}[head.x_columns]
    # Without times, their column is blank.
    rows = _without_comments(rows, titles, n + max(with_x, 1), head.separator)
    empty = sorted(set(range(n)).difference(axis.kept))
    if empty:
        rows = _without_empty(rows, channel_names, empty, head, path, of_names + 1)
    if head.decimal != "." and "." in rows:
        at = of_names + 1 + rows[: rows.index(".")].count("\n")
        raise format_error(f"a point in numbers with the decimal sign {head.decimal!r}", at)
    blanks = rows.replace(head.separator, " ").replace(head.decimal, ".").encode()
    with_x = len(axis.kept) if head.x_columns == "Multi" else with_x
    width = len(axis.kept) + with_x
    table = parse_rows(blanks, "r" * width, f"{width} numbers", path, of_names + 1)
    is_other = len(table) != count and (head.has_headings or not len(table))
    if count < 1 or is_other:
        hint = ""
        if len(table) > count:
            hint = "; packets without separate headers need Multi_Headings No"
        raise format_error(f"Samples is {count}, found {len(table)} rows{hint}")
    columns = table.T
    if head.x_columns == "Multi":
        times, values = columns[::2], columns[1::2]
    else:
        times, values = columns[:with_x], columns[with_x:]
    if _is_continuous(times, axis, path, of_names + 1):
        count = len(table)
    if len(table) % count:
        also = ", and their times are not continuous" if len(times) else ""
        raise format_error(f"{len(table)} rows are not packets of {count} (Samples){also}")
    left_out = tuple(channel_names[i] for i in empty)
    for start in range(0, len(table), count):
        part = slice(start, start + count)
        step = _step(times[:, part], axis)
        yield _Segment(first, step, channels, axis.units, left_out, values[:, part])


def _without_empty(
    rows: str,
    names: Sequence[str],
    empty: Sequence[int],
    head: _LVMHeader,
    path: str | Path,
    first: int,
) -> str:
    """Return rows without the blank cells of channels without samples."""
    is_multi = head.x_columns == "Multi"
    cut = {2 * i + k: i for i in empty for k in (0, 1)} if is_multi else {i + 1: i for i in empty}
    out = []
    for number, row in enumerate(rows.split("\n"), first):
        cells = row.split(head.separator)
        for at, channel in cut.items():
            if at < len(cells) and cells[at].strip():
                raise FormatError(
                    f"a value of channel {names[channel]!r}, although its Samples is 0",
                    path,
                    number,
                )
        out.append(head.separator.join(cell for at, cell in enumerate(cells) if at not in cut))
    return "\n".join(out)


def _step(times: RealArray, axis: _LVMAxis) -> float:
    """Return Delta_X, or the mean step of the times if Delta_X has too few digits."""
    steps = times.shape[1] - 1
    if not len(times) or not steps:
        return axis.step
    span = float(times[0, -1] - times[0, 0])
    if abs(span - steps * axis.step) <= MEASURED_FILE.time_rounding * axis.step:
        return axis.step
    return float(span / steps)


def _is_continuous(times: RealArray, axis: _LVMAxis, path: str | Path, first: int) -> bool:
    """Return whether the times of consecutive packets are continuous; refuse gaps in a packet."""
    if not len(times):
        return False
    rounded = MEASURED_FILE.time_rounding * abs(axis.step)
    spread = np.flatnonzero(np.ptp(times, axis=0) > rounded)
    if spread.size:
        low, high = times[:, spread[0]].min(), times[:, spread[0]].max()
        raise FormatError(
            f"times of {low:g} to {high:g} in one row; expected one time", path, first + spread[0]
        )
    time, row = times[0], np.arange(times.shape[1])
    since = row % axis.count
    expected = time[row - since] + axis.step * since
    wrong = np.flatnonzero(np.abs(time - expected) > rounded + axis.digit * since)
    if wrong.size:
        at = int(wrong[0])
        raise FormatError(
            f"a time of {time[at]:g}; expected {expected[at]:g} by Delta_X", path, first + at
        )
    away = np.abs(time - time[0] - axis.step * row)
    return bool((away <= rounded + axis.digit * row).all())
