"""FRFs by a mapping, which selects the column or the variable of each part of each channel.

A mapping is::

    {"frequency": "Freq (Hz)", "frequency_unit": "Hz", "unit": "g/N", "channels": [
        {"response": "3:Z", "reference": "1:Z", "real": 2, "imaginary": 3, "coherence": 4}]}

The forms of a channel are those of `FORMS`. The units are optional: by default those that the
source states, else Hz and SI. A `Source` returns the numbers by name, the same for all formats.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from updyn.arrays import NumberArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import DofError, FormatError, OptionError, suggest
from updyn.io.items import as_reals, format_key, locate_errors
from updyn.io.ratio import Ratio
from updyn.units import find_ratio, find_unit, suggest_unit

__all__ = [
    "FORMS",
    "OTHER_ANGLES",
    "PARTS",
    "Key",
    "Name",
    "Source",
    "Values",
    "check_keys",
    "combine_parts",
    "read_channels",
    "read_frequency",
]

#: Combinations of parts that define a complex value.
FORMS = (
    ("complex",),
    ("real", "imaginary"),
    ("magnitude", "phase_deg"),
    ("magnitude", "phase_rad"),
    ("magnitude_dB", "phase_deg"),
    ("magnitude_dB", "phase_rad"),
)
#: Names of the parts of a value.
PARTS = tuple(dict.fromkeys(part for form in FORMS for part in form))
_CHANNEL = ("response", "reference", *PARTS, "coherence", "unit")
_DEGREES = ("deg", "degree", "degrees", "°", "grad")
_RADIANS = ("rad", "radian", "radians")
#: Units of phases that are refused.
OTHER_ANGLES = ("mrad", "turn", "turns", "cycle", "cycles", "rev")
#: Names, and words in names, of an angular frequency, which are also used for a frequency.
_ANGULAR, _ANGULAR_WORDS = ("ω", "w"), {"omega", "rad", "angular", "circular"}
_EXAMPLE = '{ response = "3:Z", reference = "1:Z", real = 2, imaginary = 3 }'

#: A column or variable: its name, or the number of a column from 1.
Name = str | int
#: Path of a key within the arguments of the reader.
Key = tuple[str | int, ...]


class Source(Protocol):
    """Numbers of a file by name."""

    @property
    def path(self) -> str | Path:
        """The file."""

    def numbers(self, name: Any, key: Key, *, is_complex: bool = False) -> NumberArray:
        """Return the numbers with a name; `key` is the place of the name, for messages."""

    def title(self, name: Any) -> str:
        """Return the name in the file, or an empty text."""

    def unit(self, name: Any) -> str:
        """Return the unit that the file states, or an empty text."""


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """Combined values, in SI units if their unit is known; `unit` is the unit before."""

    values: NumberArray
    unit: Ratio | None

    @property
    def quantity(self) -> str | None:
        """Quantity by the unit."""
        return None if self.unit is None else self.unit.quantity


def check_keys(given: object, known: Iterable[str], required: Iterable[str], key: Key) -> None:
    """Raise an `OptionError` if a mapping has an unknown key or lacks a required one."""
    place = format_key(key)
    if not isinstance(given, Mapping) or not given:
        raise OptionError(f"{place} = {given!r}: expected a table of keys", key=key)
    for name in given:
        if name not in known:
            raise OptionError(f"{place}: no key {name!r}; {suggest(str(name), known)}", key=key)
    for name in required:
        if name not in given:
            raise OptionError(f"{place}: missing key {name!r}", key=key)


def read_frequency(
    source: Source, name: object, stated: object, key: Key, unit_key: Key
) -> RealArray:
    """Return frequencies in Hz, from the unit in the mapping (`stated`), else of the file."""
    numbers = as_reals(source.numbers(name, key), _format_name(name), source.path)
    label = source.unit(name)
    if stated is None and not label:
        label = _find_unit_in_title(source.title(name), name, key)
    unit = find_unit(label, "frequency") if label else None
    if stated is None and label and unit is None:
        raise FormatError(
            f"{_format_name(name)} in {label!r}, which is not a known unit of frequency; state"
            " frequency_unit",
            source.path,
            key=key,
        )
    if stated is not None:
        wanted = find_unit(stated, "frequency") if isinstance(stated, str) else None
        if wanted is None:
            hint = suggest_unit(str(stated), "frequency")
            raise OptionError(f"{format_key(unit_key)} = {stated!r}; {hint}", key=unit_key)
        if unit not in (None, wanted):
            raise FormatError(
                f"{format_key(unit_key)} = {stated!r} contradicts the file, which states {label!r}",
                source.path,
                key=unit_key,
            )
        unit = wanted
    freq = np.asarray(numbers, dtype=np.float64).reshape(-1)
    return freq if unit is None else freq * unit.factor


def _find_unit_in_title(title: str, name: object, key: Key) -> str:
    """Return the unit in a name such as ``f_kHz``, or an empty text; refuse ``omega``."""
    words = re.split(r"[\s_]+", title)
    if find_unit(words[-1], "frequency"):
        return words[-1]
    if title.casefold() in _ANGULAR or _ANGULAR_WORDS & {word.casefold() for word in words}:
        raise OptionError(
            f"{_format_name(name)} may be in rad/s or in Hz; state frequency_unit", key=key
        )
    return ""


def combine_parts(
    source: Source, given: Mapping[str, Any], unit: object, key: Key, unit_key: Key
) -> Values:
    """Return complex values from their parts, or real ones of the part ``real`` alone."""
    parts = [part for part in PARTS if part in given]
    if not any(set(parts) == set(form) for form in (*FORMS, ("real",))):
        forms = ", ".join(" + ".join(form) for form in FORMS)
        raise OptionError(
            f"{format_key(key)}: found {' + '.join(parts) or 'no values'}; expected one of {forms}",
            key=key,
        )
    used = [given[part] for part in parts]
    if any(used.count(name) > 1 for name in used):
        raise OptionError(
            f"{format_key(key)}: {' and '.join(parts)} are the same: {used[0]!r}", key=key
        )
    stated = None
    if unit is not None:
        if not isinstance(unit, str):
            raise OptionError(f"{format_key(unit_key)} = {unit!r}: expected a text", key=unit_key)
        try:
            stated = Ratio.of(unit, "", source.path)
        except FormatError as error:
            error.key = unit_key
            raise
    numbers: dict[str, NumberArray] = {}
    ratios: list[Ratio] = []
    for part in parts:
        place = (*key, part)
        numbers[part] = source.numbers(given[part], place, is_complex=part == "complex")
        ratio = _find_ratio(source, given[part], part, stated, place)
        ratios += [] if ratio is None else [ratio]
        if part != "complex":
            numbers[part] = as_reals(numbers[part], _format_name(given[part]), source.path)
    if any(not ratio.agrees(ratios[0]) for ratio in ratios):
        labels = " and ".join(repr(ratio.label) for ratio in ratios)
        raise FormatError(f"{format_key(key)}: parts in {labels}", source.path, key=key)
    sizes = {values.shape for values in numbers.values()}
    if len(sizes) > 1:
        raise FormatError(
            f"{format_key(key)}: parts of different shapes: {sorted(sizes)}", source.path, key=key
        )
    values = _join(numbers, source.path, key)
    if not ratios:
        return Values(values, None)
    return Values(values * ratios[0].factor, ratios[0])


def _find_ratio(
    source: Source, name: Name, part: str, stated: Ratio | None, key: Key
) -> Ratio | None:
    """Return the unit of the numbers of a part; refuse a label of the file that contradicts it."""
    label = source.unit(name)
    shown = f"{_format_name(name)} in {label!r}"
    is_phase = part.startswith("phase")
    wrong = ""
    if is_phase and label.casefold() in (_RADIANS if part == "phase_deg" else _DEGREES):
        wrong = "phase_rad" if part == "phase_deg" else "phase_deg"
    elif not is_phase and "db" in label.casefold() and part != "magnitude_dB":
        wrong = "magnitude_dB"
    elif is_phase and label.casefold() in OTHER_ANGLES:
        wrong = "a phase in deg or rad"
    if wrong:
        raise FormatError(f"{shown}, used as {part}; expected {wrong}", source.path, key=key)
    if is_phase:
        return None
    is_plain = not label or (part == "magnitude_dB" and label.casefold() == "db")
    if is_plain:
        return stated
    if find_ratio(label) is None:
        if stated is None:
            raise FormatError(
                f"{shown}, which is not a known motion per force; state unit, such as 'g/N'",
                source.path,
                key=key,
            )
        return stated
    found = Ratio.of(label, "", source.path)
    if stated is not None and not found.agrees(stated):
        raise FormatError(
            f"unit = {stated.label!r} contradicts the file: {shown}", source.path, key=key
        )
    return found


def _join(numbers: Mapping[str, NumberArray], path: str | Path, key: Key) -> NumberArray:
    if "complex" in numbers:
        return numbers["complex"]
    if "real" in numbers:
        if "imaginary" not in numbers:
            return numbers["real"]
        return np.asarray(numbers["real"] + 1j * numbers["imaginary"])
    if "magnitude" in numbers:
        size = np.asarray(numbers["magnitude"])
        if (size < 0).any():
            raise FormatError(
                f"{format_key(key)}: magnitude {size.min():g}; expected 0 or above. For decibels"
                " use magnitude_dB",
                path,
                key=key,
            )
    else:
        size = 10.0 ** (np.asarray(numbers["magnitude_dB"]) / 20.0)
    angle = numbers.get("phase_rad")
    if angle is None:
        angle = np.deg2rad(numbers["phase_deg"])
    return np.asarray(size * np.exp(1j * angle))


@dataclass(frozen=True, slots=True, eq=False)
class _Channel:
    """One FRF of a table."""

    pair: tuple[Dof, Dof]
    values: NumberArray
    coherence: RealArray | None
    quantity: str | None


def read_channels(source: Source, mapping: Mapping[str, Any], key: Key) -> dict[str, Any]:
    """Return the channels of a mapping as items of `updyn.io.named.build_frf`, without ``freq``."""
    given, place = mapping["channels"], (*key, "channels")
    is_array = isinstance(given, Sequence) and not isinstance(given, str)
    if not is_array or not given:
        raise OptionError(
            f"{format_key(place)} = {given!r}: expected an array of channels, such as [{_EXAMPLE}]",
            key=place,
        )
    found: dict[tuple[Dof, Dof], _Channel] = {}
    for i, one in enumerate(given):
        channel = _read_channel(source, one, mapping.get("unit"), (*place, i))
        if channel.pair in found:
            raise OptionError(
                f"{format_key((*place, i))}: H({_format_pair(channel.pair)}) occurs twice",
                key=(*place, i),
            )
        found[channel.pair] = channel
    return _arrange(found, source.path, place)


def _read_channel(source: Source, given: Any, unit: Any, key: Key) -> _Channel:
    check_keys(given, _CHANNEL, ("response", "reference"), key)
    pair = (_read_label(given, "response", key), _read_label(given, "reference", key))
    unit_key = (*key, "unit") if "unit" in given else (key[0], "unit")
    found = combine_parts(source, given, given.get("unit", unit), key, unit_key)
    if found.unit is not None:
        try:
            found.unit.check(pair, source.path, remedy="state the unit of each channel")
        except FormatError as error:
            error.key = key
            raise
    coherence = None
    if "coherence" in given:
        name, place = given["coherence"], (*key, "coherence")
        coherence = as_reals(source.numbers(name, place), _format_name(name), source.path)
    return _Channel(pair, found.values, coherence, found.quantity)


def _read_label(given: Mapping[str, object], side: str, key: Key) -> Dof:
    label = given[side]
    if not isinstance(label, str):
        raise OptionError(
            f"{format_key((*key, side))} = {label!r}: expected a label such as '3:Z'",
            key=(*key, side),
        )
    try:
        return Dof.parse(label)
    except DofError as error:
        raise OptionError(f"{format_key((*key, side))}: {error}", key=(*key, side)) from error


def _arrange(
    found: Mapping[tuple[Dof, Dof], _Channel], path: str | Path, key: Key
) -> dict[str, object]:
    """Return the channels as arrays over lines, responses and references."""
    with locate_errors(path, format_key(key)):
        rows = DofSet(dict.fromkeys(pair[0] for pair in found))
        columns = DofSet(dict.fromkeys(pair[1] for pair in found))
    for pair in ((i, j) for i in rows for j in columns):
        if pair not in found:
            raise OptionError(
                f"{format_key(key)}: no channel for H({_format_pair(pair)}); expected every"
                " response with every reference",
                key=key,
            )
    quantities = {channel.quantity for channel in found.values()}
    if len(quantities) > 1:
        shown = " and ".join(sorted(kind or "none stated" for kind in quantities))
        raise OptionError(
            f"{format_key(key)}: units of several quantities: {shown}; state unit in the same way"
            " for all",
            key=key,
        )
    of_coherence = {channel.coherence is None for channel in found.values()}
    if len(of_coherence) > 1:
        raise OptionError(
            f"{format_key(key)}: some channels have a coherence, others none", key=key
        )
    items: dict[str, object] = {
        "responses": list(map(str, rows)),
        "references": list(map(str, columns)),
    }
    (quantity,) = quantities
    if quantity is not None:
        items["quantity"] = quantity
    items["H"] = _stack([[found[i, j].values for j in columns] for i in rows], path, key)
    if of_coherence == {False}:
        coherence = [[found[i, j].coherence for j in columns] for i in rows]
        items["coherence"] = _stack(coherence, path, key)
    return items


def _stack(rows: Sequence[Sequence[object]], path: str | Path, key: Key) -> NumberArray:
    """Return vectors as one array over lines, responses and references."""
    vectors = [np.asarray(vector) for row in rows for vector in row]
    for vector in vectors:
        if vector.size != max(vector.shape, default=1) or vector.size != vectors[0].size:
            raise FormatError(
                f"{format_key(key)}: found shapes {vectors[0].shape} and {vector.shape}; expected"
                " one row or column of the same length for each channel",
                path,
                key=key,
            )
    whole = np.stack([vector.reshape(-1) for vector in vectors], axis=1)
    return whole.reshape(-1, len(rows), len(rows[0]))


def _format_pair(pair: tuple[Dof, Dof]) -> str:
    return f"{pair[0]}/{pair[1]}"


def _format_name(name: object) -> str:
    return f"column {name}" if isinstance(name, int) else repr(name)
