"""How the complaints of pydantic about a job file read: sentences with lines, unknown keys first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError

from updyn.control.job.plant_tables import PlantTable, PortTable, SamplingTable
from updyn.control.job.servo_tables import (
    ControllerTable,
    NonlinearTable,
    NotchTable,
    ServoTable,
    WindTable,
)
from updyn.errors import suggest
from updyn.job.schema import (
    CalibrationTable,
    DampingTable,
    Job,
    MatchTable,
    MethodTable,
    ModelTable,
    OutputTable,
    ParameterTable,
    SelectionTable,
    TestTable,
    UncertaintyTable,
)
from updyn.job.toml_lines import Place, line_of

__all__ = ["complaints"]

_LONGEST = 40  # characters of a value that a message repeats
_WORDS = {
    "bool_type": "expected true or false",
    "dict_type": "expected a table",
    "finite_number": "expected a finite number",
    "float_type": "expected a number",
    "int_type": "expected a whole number",
    "list_type": "expected an array",
    "model_type": "expected a table",
    "string_type": "expected a text",
    "too_long": "too many entries",
    "too_short": "too few entries",
    "tuple_type": "expected an array",
}


def complaints(error: ValidationError, lines: Mapping[Place, int]) -> list[tuple[int | None, str]]:
    """Turn what pydantic says into lines and sentences, unknown keys first, then by line."""
    found, items = [], [(tuple(item["loc"]), item) for item in error.errors()]
    for place, item in items:
        if any(len(other) > len(place) and other[: len(place)] == place for other, _ in items):
            continue  # an array is "too short" because of a bad item, which has its own complaint
        found.append(
            (item["type"] != "extra_forbidden", line_of(place, lines) or 0, _sentence(item, place))
        )
    return [(line or None, text) for _, line, text in sorted(found)]


def _sentence(item: Any, place: Place) -> str:
    kind, name, given = item["type"], _dotted(place), item["input"]
    shown = f"{name} = {given!r}" if len(repr(given)) <= _LONGEST else name
    if kind == "extra_forbidden":
        return (
            f"unknown key {place[-1]!r}{_inside(place[:-1])};"
            f" {suggest(str(place[-1]), _keys(place[:-1]))}"
        )
    if kind == "missing":
        if isinstance(place[-1], int):
            return f"{_dotted(place[:-1])}: expected at least {place[-1] + 1} entries"
        return f"missing key {place[-1]!r}{_inside(place[:-1])}"
    if kind == "literal_error":
        choices = [c.strip("' ") for c in item["ctx"]["expected"].replace(" or ", ",").split(",")]
        return f"{shown}: {suggest(str(given), choices)}"
    if (
        kind == "value_error"
        and isinstance(given, Mapping)
        and place
        and isinstance(place[-1], int)
    ):
        return f"{item['ctx']['error']}{_inside(place)}"
    if kind == "value_error":
        return f"{shown}: {item['ctx']['error']}"
    if kind in ("greater_than", "greater_than_equal"):
        bound = next(iter(item["ctx"].values()))
        return (
            f"{shown}: expected a number {'above' if kind == 'greater_than' else 'of at least'}"
            f" {bound:g}"
        )
    if kind in ("less_than", "less_than_equal"):
        bound = next(iter(item["ctx"].values()))
        return (
            f"{shown}: expected a number {'below' if kind == 'less_than' else 'of at most'}"
            f" {bound:g}"
        )
    return f"{shown}: {_WORDS.get(kind, item['msg'])}"


def _inside(table: Place) -> str:
    if not table:
        return ""
    return (
        f" in [[{table[0]}]] {table[1] + 1}"
        if len(table) == 2 and isinstance(table[1], int)
        else f" in [{_dotted(table)}]"
    )


def _dotted(place: Place) -> str:
    out = ""
    for part in place:
        out += f"[{part + 1}]" if isinstance(part, int) else f".{part}" if out else str(part)
    return out


def _keys(place: Place) -> list[str]:
    """Return the keys that the table at `place` may hold."""
    table: Any = Job
    for part in place:
        if isinstance(part, str) and part in getattr(table, "model_fields", {}):
            table = _TABLES.get(part, table)
    return list(table.model_fields)


_TABLES = {
    "model": ModelTable,
    "test": TestTable,
    "match": MatchTable,
    "parameter": ParameterTable,
    "damping": DampingTable,
    "calibration": CalibrationTable,
    "selection": SelectionTable,
    "method": MethodTable,
    "uncertainty": UncertaintyTable,
    "plant": PlantTable,
    "inputs": PortTable,
    "outputs": PortTable,
    "sampling": SamplingTable,
    "servo": ServoTable,
    "controller": ControllerTable,
    "notch": NotchTable,
    "nonlinear": NonlinearTable,
    "wind": WindTable,
    "output": OutputTable,
}
