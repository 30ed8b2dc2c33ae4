"""Units of the values of dataset 58: the labels of records 8 to 10, and dataset 164.

A label states the unit of the values and takes precedence; an axis without a label has the unit of
dataset 164, or the SI unit. A label, or a unit in brackets in the name of an axis, that contradicts
the others is an error. Dataset 164 does not affect g or the unit of an angle.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from updyn.errors import FormatError
from updyn.io.settings import MEASURED_FILE
from updyn.io.uff.functions import Function, Record8
from updyn.io.uff.geometry import Units
from updyn.units import RATES, Unit, find_unit, split_ratio, strip_brackets, suggest_unit

__all__ = [
    "FORCE",
    "MOTION",
    "UNKNOWN",
    "abscissa_factor",
    "channel_unit",
    "frf_factor",
    "type_name",
]

#: Specific data types of records 8 to 10.
MOTION = {8: "receptance", 11: "mobility", 12: "accelerance"}
FORCE = (9, 13)
UNKNOWN = (0, 1)
_TYPES = {
    2: "stress",
    3: "strain",
    5: "temperature",
    8: "displacement",
    9: "reaction force",
    11: "velocity",
    12: "acceleration",
    13: "excitation force",
    15: "pressure",
    16: "mass",
    17: "time",
    18: "frequency",
    19: "rotational speed",
}
#: Data type and SI unit of an abscissa.
_ABSCISSAE = {"time": (17, "s"), "frequency": (18, "Hz")}
#: Names of the kinds of a unit, for translations and for rotations.
_NAMES = {
    "force": ("force", "moment"),
    "receptance": ("displacement", "angle"),
    "mobility": ("velocity", "angular velocity"),
    "accelerance": ("acceleration", "angular acceleration"),
}
#: Units of acceleration that dataset 164, with its factors of length, cannot contradict.
_GRAVITY = tuple(find_unit(label, "accelerance") for label in ("g", "mg"))
_AT_THE_END = re.compile(r"[(\[]([^()\[\]]+)[)\]]$")
_REMEDY = "; set scale=, the factor that converts the values to SI (9.80665 for g/N)"


@dataclass(frozen=True, slots=True)
class _AxisUnit:
    """Numerator or denominator: its record, its required kind, and its unit without a label."""

    record: int
    axis: Record8
    kind: str
    angular: bool
    units: Units
    remedy: str
    path: str | Path

    @property
    def name(self) -> str:
        return _NAMES[self.kind][self.angular]

    @property
    def unit_of_dataset(self) -> float:
        """SI value of the unit derived from dataset 164."""
        if self.kind == "force":
            return 1.0 / (self.units.force * (self.units.length if self.angular else 1.0))
        return 1.0 if self.angular else 1.0 / self.units.length

    def fits(self, unit: Unit) -> bool:
        return (unit.kind, unit.angular) == (self.kind, self.angular)

    def agrees(self, unit: Unit) -> bool:
        is_free = unit in _GRAVITY or (unit.angular and unit.kind != "force")
        return is_free or not self.units.line or _is_same(unit.factor, self.unit_of_dataset)

    def error(self, message: str) -> FormatError:
        return FormatError(
            f"record {self.record}: {message}{self.remedy}", self.path, self.axis.line
        )

    def contradiction(self, label: str) -> str:
        return (
            f"unit {label!r} contradicts dataset 164 on line {self.units.line}, where the unit of"
            f" {self.name} is {self.unit_of_dataset:g} in SI"
        )


def type_name(kind: int) -> str:
    """Return the name of a specific data type, for messages."""
    return _TYPES.get(kind, f"data type {kind}")


def _is_same(a: float, b: float) -> bool:
    return math.isclose(a, b, rel_tol=MEASURED_FILE.factor_tolerance)


# -- abscissa ------------------------------------------------------------------------------------
def abscissa_factor(axis: Record8, kind: str, path: str | Path) -> float:
    """Return the factor of an abscissa of a kind ("frequency", "time") to Hz or s."""
    number, si = _ABSCISSAE[kind]
    unit = find_unit(axis.unit or si, kind)
    if unit is None or axis.kind not in (number, *UNKNOWN):
        raise FormatError(
            f"record 8: the abscissa is {type_name(axis.kind)} in {axis.unit!r}; expected {kind} in"
            f" {si}",
            path,
            axis.line,
        )
    named = _text_in_brackets(axis.name)
    other = named and find_unit(named, *_ABSCISSAE)
    if other and other != unit:
        raise FormatError(
            f"record 8: the axis name {axis.name!r} has the unit {named!r}, the unit label is"
            f" {axis.unit!r}; expected one unit",
            path,
            axis.line,
        )
    return unit.factor


# -- ordinate ------------------------------------------------------------------------------------
def frf_factor(
    function: Function, quantity: str, turns: tuple[bool, bool], units: Units, path: str | Path
) -> float:
    """Return the factor that converts the values of an FRF to SI.

    `turns` states whether response and reference are rotations. The two motions of a
    transmissibility are accelerations if their data types are unknown.
    """
    above, below = function.numerator, function.denominator
    kinds = quantity, "force"
    if quantity == "transmissibility":
        kinds = (MOTION.get(above.kind, "accelerance"),) * 2
    motion = _AxisUnit(9, above, kinds[0], turns[0], units, _REMEDY, path)
    force = _AxisUnit(10, below, kinds[1], turns[1], units, _REMEDY, path)
    ratio = split_ratio(above.unit)
    if ratio is None:
        factors = _unit_value(motion), _unit_value(force)
    else:
        _check_ratio(motion, force, ratio)
        factors = ratio[0].factor, ratio[1].factor
    factor = factors[0] / factors[1]
    _check_name(motion, factors[0], factor)
    _check_name(force, factors[1], factor)
    return factor


def channel_unit(function: Function, units: Units, path: str | Path) -> tuple[str, float]:
    """Return the unit of a time response, and the factor that converts its values to this unit.

    The unit is the label of the file, known or not; without a label the SI unit of its data type,
    or an empty text if the type is unknown.
    """
    axis, turns = function.numerator, abs(function.response[1]) > 3
    label = strip_brackets(axis.unit)
    kind = "force" if axis.kind in FORCE else MOTION.get(axis.kind)
    if kind is None:
        return label, 1.0
    side = _AxisUnit(9, axis, kind, turns, units, "; correct the label or the dataset", path)
    found = find_unit(label)
    if found:
        _check_unit(side, label, found)
    _check_name(side, found.factor if found else side.unit_of_dataset)
    if label:
        return label, 1.0
    if kind == "force":
        return "N m" if turns else "N", side.unit_of_dataset
    return ("rad" if turns else "m") + RATES[kind], side.unit_of_dataset


def _unit_value(side: _AxisUnit) -> float:
    """Return the SI value of the unit of the label, by default of the unit of dataset 164."""
    label = side.axis.unit
    if not label:
        return side.unit_of_dataset
    found = find_unit(label, side.kind) or find_unit(label)
    if found is None:
        raise side.error(
            f"unit {label!r} of the {side.name} is not known; {suggest_unit(label, side.kind)}"
        )
    _check_unit(side, label, found)
    return found.factor


def _check_unit(side: _AxisUnit, label: str, unit: Unit) -> None:
    if not side.fits(unit):
        raise side.error(f"{label!r} is a unit of {_name(unit)}; expected a unit of {side.name}")
    if not side.agrees(unit):
        raise side.error(side.contradiction(label))


def _check_ratio(motion: _AxisUnit, force: _AxisUnit, ratio: tuple[Unit, Unit]) -> None:
    """Refuse a ratio in record 9 that is of another kind or contradicts another label."""
    label = motion.axis.unit
    if not (motion.fits(ratio[0]) and force.fits(ratio[1])):
        raise motion.error(
            f"{label!r} is a unit of {_name(ratio[0])} per {_name(ratio[1])}; expected a unit of"
            f" {motion.name} per {force.name}"
        )
    for side, unit in zip((motion, force), ratio, strict=True):
        if not side.agrees(unit):
            raise motion.error(side.contradiction(label))
    if force.axis.unit and not _is_same(_unit_value(force), ratio[1].factor):
        raise force.error(f"{force.axis.unit!r} contradicts {label!r} of record 9")


def _name(unit: Unit) -> str:
    return _NAMES[unit.kind][unit.angular]


def _check_name(side: _AxisUnit, factor: float, ratio: float | None = None) -> None:
    """Refuse an axis name with a unit that differs from the unit of the values."""
    axis = side.axis
    named = _text_in_brackets(axis.name)
    unit = find_unit(named)
    pair = split_ratio(named)
    agrees = True
    if unit:
        agrees = side.fits(unit) and _is_same(unit.factor, factor)
    elif pair and ratio:
        agrees = _is_same(pair[0].factor / pair[1].factor, ratio)
    if not agrees:
        stated = f"the unit label is {axis.unit!r}" if axis.unit else "there is no unit label"
        raise side.error(f"the axis name {axis.name!r} has the unit {named!r}, but {stated}")


def _text_in_brackets(name: str) -> str:
    """Return the text in brackets at the end of a name; empty without brackets."""
    found = _AT_THE_END.search(name)
    return found[1].strip() if found else ""
