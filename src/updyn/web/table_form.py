"""`TableForm`: the choice of columns or variables of FRFs, as options of `updyn.read_frf`."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any, Literal

from updyn.dofs import Dof
from updyn.errors import DofError
from updyn.frf import QUANTITIES, TRANSMISSIBILITY
from updyn.io.channels import FORMS, Name
from updyn.io.csv_proposal import UNKNOWN
from updyn.io.csv_table import SEPARATORS
from updyn.io.inventory import Inventory
from updyn.io.point_files import has_fields
from updyn.units import find_ratio
from updyn.web.form import REQUIRED

__all__ = ["FORM_NAMES", "Entry", "Key", "TableForm"]

#: Path of an entry within the options.
Key = tuple[str | int, ...]
#: Options of the reader, or one of their tables.
_Options = dict[str, Any]

#: Names of the forms of a value, by their parts.
FORM_NAMES = {
    ("real", "imaginary"): "real and imaginary part",
    ("magnitude", "phase_deg"): "magnitude and phase in degrees",
    ("magnitude", "phase_rad"): "magnitude and phase in radians",
    ("magnitude_dB", "phase_deg"): "decibels and phase in degrees",
    ("magnitude_dB", "phase_rad"): "decibels and phase in radians",
    ("complex",): "one complex value",
}
#: Units and quantities that a form offers; other units can be typed.
_FREQUENCIES = {unit: unit for unit in ("Hz", "kHz", "rad/s", "rpm")}
_VALUES = {unit: unit for unit in ("m/s^2/N", "g/N", "m/s/N", "mm/s/N", "m/N", "mm/N")}
_QUANTITIES = {name: name for name in (*QUANTITIES, TRANSMISSIBILITY)}
#: Names of the entries; ``H`` is that of the complex values of an array.
_NAMES = {
    "frequency": "frequency",
    "freq": "frequency",
    "real": "real part",
    "imaginary": "imaginary part",
    "magnitude": "magnitude",
    "magnitude_dB": "magnitude (dB)",
    "phase_deg": "phase (degrees)",
    "phase_rad": "phase (radians)",
    "complex": "complex value",
    "H": "complex value",
    "coherence": "coherence",
    "response": "response",
    "reference": "reference",
}
#: Axes of arrays of all channels, as the option ``order`` names them, and their orders.
_AXES = {"freq": "lines", "response": "responses", "reference": "references"}
_ORDERS = {
    ", ".join(order): " x ".join(_AXES[axis] for axis in order) for order in permutations(_AXES)
}
_FOUND = "detected, if empty"


@dataclass(frozen=True, slots=True)
class Entry:
    """An entry of the form: its place in the options, its name for the page, and its kind.

    An ``"item"`` is a column or variable; a ``"unit"`` is chosen or typed; ``"texts"`` are
    separated by commas. `relists` states whether the columns depend on the entry.
    """

    key: Key
    label: str
    kind: Literal["item", "unit", "choice", "text", "texts", "whole"]
    choices: Mapping[str, str] = field(default_factory=dict)
    required: bool = False
    example: str = ""
    relists: bool = False


class TableForm:
    """Entries that select FRFs from the columns or variables of a file.

    `options` has the entries, nested as the options of `updyn.read_frf`; an empty text is an entry
    that is not filled. `parts` is one of `FORMS`. `is_array` states whether the variables have the
    values of all channels.
    """

    def __init__(self, file: str, inventory: Inventory, given: Mapping[str, Any]) -> None:
        self.file = file
        self.inventory = inventory
        self.root = inventory.option
        mapping = copy.deepcopy(dict(given.get(self.root) or inventory.proposal))
        self.is_array = self.root == "variables" and "channels" not in mapping
        self.options: _Options = {**given, self.root: mapping}
        self.parts = self._find_parts()
        if not self.is_array:
            mapping.setdefault("channels", [{}])
            for channel in mapping["channels"]:
                for side in ("response", "reference"):
                    if channel.get(side) == UNKNOWN:
                        del channel[side]

    # -- entries -----------------------------------------------------------------------------------
    @property
    def channels(self) -> list[_Options]:
        """The channels; empty for variables with the values of all channels."""
        found: list[_Options] = self.options[self.root].get("channels", [])
        return found

    def get(self, key: Key) -> Any:
        """Return an entry, or an empty text."""
        place: Any = self.options
        for name in key[:-1]:
            place = place[name]
        value = place.get(key[-1], "")
        return ", ".join(value) if isinstance(value, list | tuple) else value

    def set(self, key: Key, value: Any) -> None:
        """Set an entry; an empty text or None removes it."""
        place: Any = self.options
        for name in key[:-1]:
            place = place[name]
        if isinstance(value, str) and key[-1] != "separator":
            value = value.strip()
        if value in ("", None):
            place.pop(key[-1], None)
        else:
            place[key[-1]] = value

    def entries(self) -> list[Entry]:
        """Return the entries that are not of a channel."""
        root = self.root
        frequency = "frequency" if root == "columns" else "freq"
        found = [self._item((root, frequency), required=True)]
        if self.is_array:
            found += [self._item((root, name), required=True) for name in self._value_names()]
            found.append(self._item((root, "coherence")))
        found += [
            Entry((root, "frequency_unit"), "unit of the frequency", "unit", _FREQUENCIES),
            Entry((root, "unit"), "unit of the values", "unit", _VALUES),
            Entry(
                ("quantity",),
                "measured quantity",
                "choice",
                _QUANTITIES,
                not self._states_quantity(),
            ),
        ]
        if root == "columns":
            separator, first_row = (root, "separator"), (root, "first_row")
            found += [
                Entry(separator, "columns separated by", "choice", SEPARATORS, relists=True),
                Entry(first_row, "first row of numbers in line", "whole", relists=True),
            ]
        if self.is_array:
            found += [
                Entry(("response_labels",), "responses", "texts", example="3:Z, 5:Z"),
                Entry(("reference_labels",), "references", "texts", example="1:Z"),
                Entry(("order",), "axes of the arrays", "choice", _ORDERS),
            ]
        return found

    def channel_entries(self, number: int) -> list[Entry]:
        """Return the entries of a channel."""
        place = (self.root, "channels", number)
        node = "{node}" if has_fields(self.file) else "3"
        labels = [
            Entry((*place, side), side, "text", required=True, example=f"{node}:Z")
            for side in ("response", "reference")
        ]
        items = [self._item((*place, name), required=True) for name in self.parts]
        return [*labels, *items, self._item((*place, "coherence"))]

    def choose_file(self, file: str) -> None:
        """Choose a file, or a name with fields, whose texts then replace those in labels."""
        self.file = file
        for channel in self.channels:
            if not has_fields(file):
                for side in ("response", "reference"):
                    if "{" in channel.get(side, ""):
                        del channel[side]
            elif "{node}{axis}" in file and "response" not in channel:
                channel["response"] = "{node}:{axis}"

    def choose_parts(self, parts: Sequence[str]) -> None:
        """Choose another form of the values; parts of both forms keep their items."""
        old = self._value_names()
        self.parts = tuple(parts)
        for name in set(old) - set(self._value_names()):
            for place in self._value_places():
                place.pop(name, None)

    def choose_array(self, is_array: bool) -> None:
        """Choose between arrays of all channels and items by channel; the others are discarded."""
        mapping = self.options[self.root]
        for name in ("channels", "coherence", *self._value_names()):
            mapping.pop(name, None)
        self.is_array = is_array
        if not is_array:
            mapping["channels"] = [{}]
            for name in ("response_labels", "reference_labels", "order"):
                self.options.pop(name, None)

    def add_channel(self) -> None:
        """Add a channel with the next items that are not used, and the last reference."""
        last = self.channels[-1]
        names = [name for name in (*self.parts, "coherence") if name in last]
        free = self._free_items(last, names)
        new = dict(zip(names, free, strict=False)) if len(free) >= len(names) else {}
        if "reference" in last:
            new["reference"] = last["reference"]
        self.channels.append(new)

    def remove_channel(self, number: int) -> None:
        """Remove a channel, but not the only one."""
        if len(self.channels) > 1:
            del self.channels[number]

    def repeat_reference(self) -> None:
        """Set the reference of the first channel in all channels."""
        reference = self.channels[0].get("reference", "")
        for number in range(len(self.channels)):
            self.set((self.root, "channels", number, "reference"), reference)

    def hints(self) -> dict[Key, str]:
        """Return how empty entries are read, as text."""
        frequency = self.get(self.entries()[0].key)
        stated = {
            "frequency_unit": self._units().get(frequency, ""),
            "unit": self._value_units()[0],
        }
        usual = {"frequency_unit": "Hz", "unit": "SI"}
        found: dict[Key, str] = {
            (self.root, key): f"{unit}, by the file" if unit else f"{usual[key]}, if empty"
            for key, unit in stated.items()
        }
        if self.root == "columns":
            found |= {(self.root, key): _FOUND for key in ("separator", "first_row")}
        return found

    def uses(self) -> dict[Name, list[str]]:
        """Return the uses of each item, in words."""
        found: dict[Name, list[str]] = {}
        for entry in self._all_entries():
            item = self.get(entry.key)
            if entry.kind == "item" and item != "":
                found.setdefault(item, []).append(self._describe(entry))
        return found

    # -- result ------------------------------------------------------------------------------------
    def build_options(self) -> _Options:
        """Return the options of `updyn.read_frf` and keys of ``[test]``."""
        found = copy.deepcopy(self.options)
        for entry in self.entries():
            value = self.get(entry.key)
            if value and (entry.kind == "texts" or entry.key == ("order",)):
                found[str(entry.key[0])] = [p.strip() for p in value.split(",") if p.strip()]
        return found

    def faults(self) -> dict[Key, str]:
        """Return a message for each entry that is missing or cannot be read."""
        found = {}
        for entry in self._all_entries():
            text = self.get(entry.key)
            if entry.required and text == "":
                found[entry.key] = REQUIRED
            elif entry.kind == "whole" and text != "" and not isinstance(text, int):
                found[entry.key] = f"{text!r}; expected a whole number"
            elif entry.kind == "text" and "{" not in text:
                message = _check_label(text)
                if message:
                    found[entry.key] = message
        return found

    def preview_options(self) -> _Options | None:
        """Return options for a preview, missing ones replaced; None without an item."""
        faults = self.faults()
        if not faults:
            return self.build_options()
        is_ready = all(key[-1] in ("response", "reference", "quantity") for key in faults)
        if not is_ready or has_fields(self.file):
            return None
        options = self.build_options()
        if ("quantity",) in faults:
            options["quantity"] = next(iter(QUANTITIES))
        for number, channel in enumerate(options[self.root].get("channels", ()), 1):
            channel |= {"response": f"{number}:X", "reference": "1:X"}
        return options

    # -- parts -------------------------------------------------------------------------------------
    def _find_parts(self) -> tuple[str, ...]:
        """Return the form of the values in the mapping; the usual one if it has none."""
        mapping = self.options[self.root]
        place = mapping if self.is_array else next(iter(mapping.get("channels", ())), {})
        has_complex = any("complex" in item.size for item in self.inventory.items)
        usual = ("complex",) if "H" in place or has_complex else ("real", "imaginary")
        found = (form for form in FORMS if any(part in place for part in form))
        return max(found, key=lambda form: sum(p in place for p in form), default=usual)

    def _value_names(self) -> tuple[str, ...]:
        return ("H",) if self.is_array and self.parts == ("complex",) else self.parts

    def _item(self, key: Key, *, required: bool = False) -> Entry:
        return Entry(key, _NAMES[str(key[-1])], "item", required=required)

    def _all_entries(self) -> Iterator[Entry]:
        yield from self.entries()
        for number in range(len(self.channels)):
            yield from self.channel_entries(number)

    def _describe(self, entry: Entry) -> str:
        """Return the use of an item, with its channel if there are several."""
        if "channels" not in entry.key or len(self.channels) == 1:
            return entry.label
        number = int(entry.key[2])
        label = self.get((*entry.key[:3], "response")) or f"channel {number + 1}"
        return f"{entry.label} of {label}"

    def _states_quantity(self) -> bool:
        """Return whether the unit of the values, in the form or the file, states their quantity."""
        if self.get((self.root, "unit")) != "":
            return True
        return any(unit and find_ratio(unit) is not None for unit in self._value_units())

    def _units(self) -> dict[Name, str]:
        return {item.select: item.unit for item in self.inventory.items}

    def _value_places(self) -> list[_Options]:
        """Return the mappings that name items of values: that of all channels, or one for each."""
        return [self.options[self.root]] if self.is_array else self.channels

    def _value_units(self) -> list[str]:
        """Return the units of the first part of the values by the file; empty if unknown."""
        units, name = self._units(), self._value_names()[0]
        return [units.get(place.get(name, ""), "") for place in self._value_places()]

    def _free_items(self, last: Mapping[str, Any], names: Sequence[str]) -> list[Name]:
        """Return the unused items after those of a channel, in the order of the file."""
        order = [item.select for item in self.inventory.items]
        used = self.uses()
        at = max((order.index(last[n]) for n in names if last[n] in order), default=-1)
        return [name for name in order[at + 1 :] if name not in used]


def _check_label(text: str) -> str:
    """Return the fault of a label as text; empty if it is valid."""
    try:
        Dof.parse(text)
    except DofError:
        return f"{text!r}; expected a node and a direction, such as 3:-Z"
    return ""
