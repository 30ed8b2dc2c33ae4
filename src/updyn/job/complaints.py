"""How the complaints of pydantic about a job file read: sentences with lines, unknown keys first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ValidationError

from updyn.errors import suggest
from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import Job
from updyn.job.toml_lines import Place, line_of

__all__ = ["Complaint", "complaints"]

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


class Complaint(NamedTuple):
    """Something wrong with the text of a job file; sorts unknown keys first, then by line."""

    of_known_key: bool
    line: int
    text: str


def complaints(
    error: ValidationError,
    lines: Mapping[Place, int],
    schema: type[BaseModel],
    at: Place = (),
) -> list[Complaint]:
    """Return what pydantic found wrong with a table as lines and sentences.

    Parameters
    ----------
    error : ValidationError
        What pydantic found.
    lines : mapping of Place to int
        Of the job file.
    schema : type
        Class by which the table was validated.
    at : Place
        Where the table is in the job file.

    Returns
    -------
    list of Complaint
        Sorted, they are in the order of the message: unknown keys first, then by line.
    """
    found = []
    items = [(tuple(item["loc"]), item) for item in error.errors()]
    for place, item in items:
        if any(len(other) > len(place) and other[: len(place)] == place for other, _ in items):
            continue  # an array is "too short" because of a bad item, which has its own complaint
        keys = _keys(place[:-1], schema)
        text = _sentence(item, (*at, *place), keys)
        line = line_of((*at, *place), lines)
        found.append(Complaint(item["type"] != "extra_forbidden", line or 0, text))
    return found


def _sentence(item: Any, place: Place, keys: Iterable[str]) -> str:
    kind, name, given = item["type"], _dotted(place), item["input"]
    shown = f"{name} = {given!r}" if len(repr(given)) <= _LONGEST else name
    if kind == "extra_forbidden":
        return f"unknown key {place[-1]!r}{_inside(place[:-1])}; {suggest(str(place[-1]), keys)}"
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


def _keys(place: Place, schema: type[BaseModel]) -> list[str]:
    """Return the keys that the table at `place` may hold."""
    table = schema
    for part in place:
        field = table.model_fields.get(str(part))
        inner = None if field is None else _table_in(field.annotation)
        table = table if inner is None else inner
    keys = list(table.model_fields)
    return [*keys, *JOB_TABLES] if table is Job else keys


def _table_in(annotation: Any) -> type[BaseModel] | None:
    """Return the table that a field holds, alone or in an array; None where it holds none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    found = (_table_in(inner) for inner in get_args(annotation))
    return next((table for table in found if table is not None), None)
