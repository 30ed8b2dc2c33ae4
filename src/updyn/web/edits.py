"""Edits of a job by hand, as changes of its TOML, comments kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, MutableMapping, Sequence
from typing import Any, cast

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import AoT, Array, Comment, Item, Table, Whitespace

from updyn.dofs import Dof
from updyn.errors import InputError
from updyn.grouping import match_names
from updyn.io.toml_text import format_mapping
from updyn.web.settings import WEB_PAGE

__all__ = [
    "add_repair",
    "as_value",
    "chosen_groups",
    "exclude",
    "hold_out",
    "include_all",
    "leave_out",
    "listed_lines",
    "match_sensor",
    "set_band",
    "set_bounds",
    "set_key",
    "set_keys",
    "set_picks",
    "set_reading",
    "set_unknowns",
]

Edit = Callable[[TOMLDocument], None]

#: Expected form of an entry by its kind, and the number of its characters repeated in messages.
_EXPECTED = {
    "whole": "a whole number",
    "number": "a number",
    "numbers": "numbers and commas",
    "band": "two frequencies, the lower one first",
}


def set_band(low: float, high: float, test: int = 0) -> Edit:
    """Return the edit that sets the band of a test in Hz, and removes listed lines outside it."""

    def edit(document: TOMLDocument) -> None:
        _set_key(_find_test(document, test), "band", _format_numbers((low, high)))
        _keep_lines(document, lambda line: low <= line <= high)

    return edit


def exclude(low: float, high: float, test: int = 0) -> Edit:
    """Return the edit that excludes a band of a test (Hz, ends included) and listed lines in it."""

    def edit(document: TOMLDocument) -> None:
        table = _find_test(document, test)
        entry = _format_numbers((low, high))
        present = table.get("exclude")
        if isinstance(present, Array):
            present.append(entry)
        else:
            made = tomlkit.array()
            made.append(entry)
            _set_key(table, "exclude", made)
        _keep_lines(document, lambda line: not low <= line <= high)

    return edit


def listed_lines(text: str) -> int:
    """Return the number of lines that ``[method]`` of a job lists by frequency."""
    method = tomlkit.parse(text).unwrap().get("method")
    lines = method.get("lines") if isinstance(method, dict) else None
    return len(lines) if isinstance(lines, list) else 0


def include_all(test: int = 0) -> Edit:
    """Return the edit that removes the exclusions of a test."""

    def edit(document: TOMLDocument) -> None:
        _find_test(document, test).pop("exclude", None)

    return edit


def add_repair(written: str, test: int = 0) -> Edit:
    """Return the edit that adds an entry of ``repair``, which corrects a fault of the data."""

    def edit(document: TOMLDocument) -> None:
        table = _find_test(document, test)
        present = _as_texts(table.get("repair", []))
        if written not in present:
            _set_key(table, "repair", [*present, written])

    return edit


def hold_out(responses: Sequence[str], test: int = 0) -> Edit:
    """Return the edit that holds responses (labels of the model) out of the fit, for validation.

    Each of several tests gets a separate ``validation``, because their responses may differ; for a
    single test without it, that of ``[method]`` is changed.
    """

    def edit(document: TOMLDocument) -> None:
        test_table = _find_test(document, test)
        several = _has_several_tests(document)
        if several:
            _move_to_tests(document, "validation")
        table = (
            test_table if several or "validation" in test_table else _get_table(document, "method")
        )
        if responses:
            _set_key(table, "validation", list(responses))
        else:
            table.pop("validation", None)

    return edit


def _move_to_tests(document: TOMLDocument, key: str) -> None:
    """Move a key from ``[method]`` to all tests that do not have it."""
    method = document.get("method")
    if not isinstance(method, MutableMapping) or key not in method:
        return
    value = method.pop(key).unwrap()
    for test in cast(AoT, document["test"]):
        if key not in test:
            _set_key(test, key, value)


def set_reading(values: Mapping[str, Any], test: int = 0) -> Edit:
    """Return the edit that sets how the file of a test is read; None removes a key."""

    def edit(document: TOMLDocument) -> None:
        table = _find_test(document, test)
        for key, value in values.items():
            present = table.get(key)
            if value is None or isinstance(present, Table | AoT):
                table.pop(key, None)
            if value is None or (present is not None and present.unwrap() == value):
                continue
            if isinstance(value, Mapping):
                value = tomlkit.parse(f"x = {format_mapping(value)}\n")["x"]
            _set_key(table, key, value)

    return edit


def leave_out(
    omissible: Mapping[str, Sequence[str]], known: Mapping[str, Sequence[str]], test: int = 0
) -> Edit:
    """Return the edit that leaves sensors out of a test, by key of ``[test]``.

    `omissible` has their labels without sign, `known` all labels in the file.
    """
    kept: dict[str, list[str]] = {}
    for key, sensors in omissible.items():
        faulty = {abs(Dof.parse(sensor)) for sensor in sensors}
        kept[key] = [label for label in known[key] if abs(Dof.parse(label)) not in faulty]
    return set_reading(kept, test)


def match_sensor(sensor: str, dof: str) -> Edit:
    """Return the edit that matches a sensor or force of the test to a DOF of the model."""

    def edit(document: TOMLDocument) -> None:
        _set_key(_get_table(_get_table(document, "match"), "table"), sensor, dof)

    return edit


def set_key(table: str, key: str, value: object) -> Edit:
    """Return the edit that sets a key of a table, or removes it if the value is None."""

    def edit(document: TOMLDocument) -> None:
        changed = _get_table(document, table)
        if value is None:
            changed.pop(key, None)
        else:
            _set_key(changed, key, value)

    return edit


def set_keys(table: str, values: Mapping[str, object]) -> Edit:
    """Return the edit that sets keys of a table as `set_key`, and removes the table if empty."""

    def edit(document: TOMLDocument) -> None:
        for key, value in values.items():
            set_key(table, key, value)(document)
        if not document[table]:
            document.pop(table)

    return edit


def as_value(kind: str, text: str, label: str) -> Any:
    """Convert typed text to a value of a job; None for an empty text.

    Several values are separated by commas. `label` names the entry in the message of the
    `InputError` that is raised if the text is not of this kind.
    """
    text = text.strip()
    if not text:
        return None
    parts = [part.strip() for part in text.split(",") if part.strip()]
    try:
        match kind:
            case "whole":
                return int(text)
            case "number":
                return _parse_number(text)
            case "numbers":
                return [_parse_number(part) for part in parts] or None
            case "band":
                return _parse_band(parts)
            case "texts":
                return parts or None
    except ValueError as error:
        most = WEB_PAGE.quoted_characters
        given = text if len(text) <= most else f"{text[:most]}..."
        raise InputError(f"{label}: {given!r}; expected {_EXPECTED[kind]}") from error
    return text


def _parse_number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _parse_band(parts: Sequence[str]) -> list[float]:
    low, high = map(_parse_number, parts)
    if not 0 <= low < high:
        raise ValueError(parts)
    return [low, high]


def set_picks(pick: Sequence[float], poles: Sequence[float]) -> Edit:
    """Return the edit that sets the picked modes (empty: all) and the poles to add, in Hz."""

    def edit(document: TOMLDocument) -> None:
        table = _get_table(document, "modes")
        for key, values in (("pick", pick), ("poles", poles)):
            if values:
                _set_key(table, key, sorted(float(f"{value:.7g}") for value in values))
            else:
                table.pop(key, None)

    return edit


# -- unknowns --------------------------------------------------------------------------------------
def set_unknowns(
    chosen: Mapping[str, Collection[str]],
    groups: Mapping[str, Sequence[str]],
    proposals: Mapping[str, Mapping[str, Any]],
) -> Edit:
    """Return the edit that sets the groups with unknowns by quantity; other quantities are kept.

    A table that needs no change keeps its text. One that loses groups lists the others by name. New
    groups are added to a table of their quantity, with its bounds, otherwise to a new table with
    the keys in `proposals`. `groups` are all groups of the model that have the quantity, in order.
    """

    def edit(document: TOMLDocument) -> None:
        tables = _get_parameter_tables(document)
        missing = {quantity: set(names) for quantity, names in chosen.items()}
        for table in list(tables):
            if "groups" not in table or "quantity" not in table:
                continue  # a linked unknown
            quantity = str(table["quantity"])
            present = _match_groups(groups.get(quantity, ()), table["groups"])
            if quantity not in missing or not present:
                continue  # a quantity that is not chosen here, such as masses added by a test
            kept = [name for name in present if name in missing[quantity]]
            missing[quantity].difference_update(kept)
            if not kept:
                _remove(document, tables, table)
            elif kept != present:
                table["groups"] = kept
        for quantity, names in missing.items():
            able = groups.get(quantity, ())
            new = [name for name in able if name in names]
            _add(tables, quantity, new, able, proposals.get(quantity, {}))
        if not tables:
            document.pop("parameter")

    return edit


def chosen_groups(text: str, groups: Mapping[str, Sequence[str]]) -> dict[str, set[str]]:
    """Return the groups that a job chooses, by quantity; InputError without ``[[parameter]]``."""
    chosen: dict[str, set[str]] = {quantity: set() for quantity in groups}
    for table in _get_parameter_tables(tomlkit.parse(text)):
        quantity = str(table.get("quantity", ""))
        if quantity in chosen and "groups" in table:
            chosen[quantity].update(_match_groups(groups[quantity], table["groups"]))
    return chosen


def _add(
    tables: AoT,
    quantity: str,
    new: Sequence[str],
    groups: Sequence[str],
    proposal: Mapping[str, Any],
) -> None:
    """Add groups to the first table of a quantity that is about nothing else, else a table."""
    if not new:
        return
    for table in tables:
        if str(table.get("quantity", "")) == quantity and "nominal" not in table:
            both = {*_match_groups(groups, table.get("groups", [])), *new}
            table["groups"] = [name for name in groups if name in both]
            return
    table = tomlkit.table()
    table["groups"] = list(new)
    table["quantity"] = quantity
    for key, value in proposal.items():
        table[key] = list(value) if isinstance(value, tuple) else value
    _append(tables, table)


def set_bounds(name: str, low: float, high: float, groups: Sequence[str]) -> Edit:
    """Return the edit that gives one unknown, ``"group.quantity"``, separate bounds in its unit."""
    group, _, quantity = name.rpartition(".")
    bounds = [float(low), float(high)]
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(
            f"bounds of {name}: {low:g} and {high:g}; expected a lower bound below the upper one"
        )

    def edit(document: TOMLDocument) -> None:
        tables = _get_parameter_tables(document)
        for table in tables:
            present = _match_groups([*groups, group], table.get("groups", []))
            is_own = str(table.get("quantity", "")) == quantity and group in present
            if str(table.get("name", "")) == name or (is_own and set(present) == {group}):
                _set_key(table, "bounds", bounds)
                return
            if is_own:
                new_table = tomlkit.table()
                new_table["groups"] = [group]
                new_table.update(
                    {k: v for k, v in table.unwrap().items() if k not in ("groups", "bounds")}
                )
                new_table["bounds"] = bounds
                table["groups"] = [each for each in groups if each in present and each != group]
                _append(tables, new_table)
                return
        raise InputError(f"no [[parameter]] of the job chooses {name!r}; edit the text of the job")

    return edit


def _match_groups(groups: Sequence[str], patterns: object) -> list[str]:
    found: set[str] = set()
    for text in _as_texts(patterns):
        found.update(groups if text == "all" else match_names(groups, text))
    return [name for name in groups if name in found]


def _keep_lines(document: TOMLDocument, keep: Callable[[float], bool]) -> None:
    """Keep some of the lines that ``[method]`` lists; those of several tests are left alone."""
    method = document.get("method")
    if (
        _has_several_tests(document)
        or not isinstance(method, Table)
        or not isinstance(method.get("lines"), Array)
    ):
        return
    if not all(isinstance(line, int | float) for line in method["lines"]):
        return
    lines = [float(line) for line in method["lines"]]
    kept = [line for line in lines if keep(line)]
    if not kept:
        method.pop("lines")
    elif len(kept) < len(lines):
        method["lines"] = kept


def _as_texts(given: object) -> list[str]:
    return (
        [str(item) for item in given]
        if isinstance(given, Sequence) and not isinstance(given, str)
        else [str(given)]
    )


# -- parts of a document ---------------------------------------------------------------------------
def _find_test(document: TOMLDocument, number: int) -> Table:
    tests = document.get("test")
    if not isinstance(tests, AoT):
        return _get_table(document, "test")
    if number >= len(tests):
        raise InputError(f"the job has {len(tests)} tests, and no number {number + 1}")
    return tests[number]


def _has_several_tests(document: TOMLDocument) -> bool:
    tests = document.get("test")
    return isinstance(tests, AoT) and len(tests) > 1


def _get_table(outer: MutableMapping[str, Any], name: str) -> Table:
    """Return a table, created if missing."""
    if name not in outer:
        outer[name] = tomlkit.table()
    found = outer[name]
    if not isinstance(found, MutableMapping):
        raise InputError(f"{name} of the job is not a table; edit the text of the job")
    return cast(Table, found)


def _get_parameter_tables(document: TOMLDocument) -> AoT:
    """Return the tables ``[[parameter]]``, possibly empty."""
    if not document.get("parameter"):
        document.pop("parameter", None)  # an empty one, whose place may be before other keys
        document["parameter"] = tomlkit.aot()
    found = document["parameter"]
    if not isinstance(found, AoT):
        raise InputError(
            "parameter of the job is not an array of tables [[parameter]]; edit the text of the job"
        )
    return found


def _set_key(table: Table, key: str, value: object) -> None:
    """Set a key; a new one precedes the comments about the next table."""
    if key in table or not isinstance(table, Table):
        table[key] = value
        return
    tail = _take_tail(table)
    table[key] = value
    table.value.body.extend(tail)


def _append(tables: AoT, table: Table) -> None:
    """Append a table; comments after the last table stay after the new one."""
    tail = []
    if tables:
        last = _find_last_table(tables)
        tail = _take_tail(last)
        last.add(tomlkit.nl())
    tables.append(table)
    table.value.body.extend(tail)


def _remove(document: TOMLDocument, tables: AoT, table: Table) -> None:
    """Remove a table, but not the comments after it, which belong to the next table."""
    number = next(i for i, each in enumerate(tables) if each is table)
    tail = _take_tail(_find_last_table(table))
    if number:
        before: Any = tables[number - 1]
    else:
        items = [item for _, item in document.body]
        before = items[next(i for i, each in enumerate(items) if each is tables) - 1]
    del tables[number]
    if isinstance(before, Table | AoT):
        _find_last_table(before).value.body.extend(tail)


def _find_last_table(item: Table | AoT) -> Table:
    while True:
        if isinstance(item, AoT):
            item = item[-1]
            continue
        inner = [each for key, each in item.value.body if key is not None]
        if not inner or not isinstance(inner[-1], Table | AoT):
            return item
        item = inner[-1]


def _take_tail(table: Table) -> list[tuple[Any, Item]]:
    """Remove and return the lines after a table's last key, from the first empty line on.

    They belong to the table in the document, but are comments on the next table.
    """
    body = table.value.body
    start = len(body)
    while (
        start
        and body[start - 1][0] is None
        and isinstance(body[start - 1][1], Comment | Whitespace)
    ):
        start -= 1
    while start < len(body) and not isinstance(body[start][1], Whitespace):
        start += 1
    tail = body[start:]
    del body[start:]
    return tail


def _format_numbers(values: Sequence[float]) -> Array:
    """Return numbers as an array on one line, with eight digits."""
    made = tomlkit.array()
    made.extend([float(f"{value:.8g}") for value in values])
    return made
