"""Edits of a job by hand, as changes of its TOML, comments kept."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, cast

import tomlkit
from tomlkit import TOMLDocument
from tomlkit.items import AoT, Array, Table

from updyn.errors import InputError

__all__ = [
    "add_repair",
    "as_value",
    "exclude",
    "hold_out",
    "include_all",
    "listed_lines",
    "match_sensor",
    "set_band",
    "set_bounds",
    "set_key",
    "set_unknowns",
    "toggle_pick",
]

Edit = Callable[[TOMLDocument], None]

#: Picks this near are one, as a share of the frequency.
_SAME_PICK = 1e-3


def set_band(low: float, high: float, test: int = 0) -> Edit:
    """Return the edit that uses the lines of a band.

    Lines that ``[method]`` lists by their frequency and that lie outside are taken from the list.

    Parameters
    ----------
    low, high : float
        Its ends, in Hz.
    test : int
        Which test.
    """

    def edit(document: TOMLDocument) -> None:
        _test(document, test)["band"] = _numbers((low, high))
        _keep_lines(document, lambda line: low <= line <= high)

    return edit


def exclude(low: float, high: float, test: int = 0) -> Edit:
    """Return the edit that leaves lines out of a test.

    They are taken from those that ``[method]`` lists by their frequency, too.

    Parameters
    ----------
    low, high : float
        Both ends of the band that is left out, in Hz.
    test : int
        Which test.
    """

    def edit(document: TOMLDocument) -> None:
        table = _test(document, test)
        entry = _numbers((low, high))
        if "exclude" in table:
            cast(Array, table["exclude"]).append(entry)
        else:
            made = tomlkit.array()
            made.append(entry)
            table["exclude"] = made
        _keep_lines(document, lambda line: not low <= line <= high)

    return edit


def listed_lines(text: str) -> int:
    """Return how many lines ``[method]`` of a job lists by their frequency.

    Parameters
    ----------
    text : str
        The job.

    Returns
    -------
    int
    """
    method = tomlkit.parse(text).unwrap().get("method")
    lines = method.get("lines") if isinstance(method, dict) else None
    return len(lines) if isinstance(lines, list) else 0


def include_all(test: int = 0) -> Edit:
    """Return the edit that leaves no line of a test's band out.

    Parameters
    ----------
    test : int
        Which test.
    """

    def edit(document: TOMLDocument) -> None:
        _test(document, test).pop("exclude", None)

    return edit


def add_repair(written: str, test: int = 0) -> Edit:
    """Return the edit that undoes a fault of the data.

    Parameters
    ----------
    written : str
        The fault as the job writes it.
    test : int
        Which test.
    """

    def edit(document: TOMLDocument) -> None:
        table = _test(document, test)
        present = [str(item) for item in table.get("repair", [])]
        if written not in present:
            table["repair"] = [*present, written]

    return edit


def hold_out(responses: Sequence[str], test: int = 0) -> Edit:
    """Return the edit that holds responses out of the fit, to validate it with.

    Parameters
    ----------
    responses : sequence of str
        Their labels; none: nothing is held out.
    test : int
        Which test; its own ``validation`` is changed where it has one, else that of ``[method]``.
    """

    def edit(document: TOMLDocument) -> None:
        own = _test(document, test)
        table = own if "validation" in own else _table(document, "method")
        if responses:
            table["validation"] = list(responses)
        else:
            table.pop("validation", None)

    return edit


def match_sensor(sensor: str, dof: str) -> Edit:
    """Return the edit that says which DOF of the model a sensor or force is.

    Parameters
    ----------
    sensor, dof : str
        Labels in the test and in the model.
    """

    def edit(document: TOMLDocument) -> None:
        matching = _table(document, "match")
        if "table" not in matching:
            matching["table"] = tomlkit.table()
        cast(Table, matching["table"])[sensor] = dof

    return edit


def set_key(table: str, key: str, value: Any) -> Edit:
    """Return the edit that sets a key of a table.

    Parameters
    ----------
    table, key : str
        Of the job.
    value : object
        A number, a text or a list of them; None: the key is left out.
    """

    def edit(document: TOMLDocument) -> None:
        changed = _table(document, table)
        if value is None:
            changed.pop(key, None)
        else:
            changed[key] = value

    return edit


def as_value(kind: str, text: str, label: str) -> Any:
    """Return what was typed as a value of a job.

    Parameters
    ----------
    kind : {"number", "whole", "numbers", "text", "texts"}
        What is expected; several are separated by commas.
    text : str
        What was typed.
    label : str
        Of the entry, for messages.

    Returns
    -------
    object
        None of an empty text.

    Raises
    ------
    InputError
        If it is no number where one is expected.
    """
    if not text:
        return None
    parts = [part.strip() for part in text.split(",") if part.strip()]
    try:
        match kind:
            case "whole":
                return int(text)
            case "number":
                return float(text)
            case "numbers":
                return [float(part) for part in parts]
            case "texts":
                return parts
    except ValueError as error:
        what = {"whole": "a whole number", "number": "a number"}.get(kind, "numbers and commas")
        raise InputError(f"{label}: {text!r}; expected {what}") from error
    return text


def toggle_pick(frequency: float) -> Edit:
    """Return the edit that picks a pole for the modes of the job, or takes the pick back.

    Parameters
    ----------
    frequency : float
        Of the pole, in Hz; a pick beside it, within a thousandth, is the same one.
    """

    def edit(document: TOMLDocument) -> None:
        table = _table(document, "modes")
        present = [float(item) for item in table.get("pick", [])]
        kept = [item for item in present if abs(item - frequency) > _SAME_PICK * item]
        if len(kept) == len(present):
            kept = sorted([*present, float(f"{frequency:.7g}")])
        if kept:
            table["pick"] = kept
        else:
            table.pop("pick", None)

    return edit


# -- unknowns --------------------------------------------------------------------------------------
def set_unknowns(chosen: Mapping[str, Collection[str]], groups: Sequence[str]) -> Edit:
    """Return the edit after which the unknowns of groups are those chosen.

    A table that needs no change keeps its text. In one that loses groups these are listed by name,
    and groups that come new go to a table of their quantity, with its bounds, else to a new one.

    Parameters
    ----------
    chosen : mapping of str to collection of str
        Groups by quantity (``"stiffness"``, ...).
    groups : sequence of str
        All groups of the model, in their order.
    """

    def edit(document: TOMLDocument) -> None:
        tables = document.get("parameter")
        if not isinstance(tables, AoT):
            tables = tomlkit.aot()
            document["parameter"] = tables
        missing = {quantity: set(names) for quantity, names in chosen.items()}
        for table in list(tables):
            if "groups" not in table or "quantity" not in table:
                continue  # a linked unknown
            quantity = str(table["quantity"])
            present = _fitting(groups, table["groups"])
            kept = [name for name in present if name in missing.get(quantity, ())]
            missing.get(quantity, set()).difference_update(kept)
            if not kept:
                tables.remove(table)
            elif kept != present:
                table["groups"] = kept
        for quantity, names in missing.items():
            _add(tables, quantity, [name for name in groups if name in names], groups)

    return edit


def _add(tables: AoT, quantity: str, new: Sequence[str], groups: Sequence[str]) -> None:
    """Add groups to the first table of a quantity that is about nothing else, else a table."""
    if not new:
        return
    for table in tables:
        if str(table.get("quantity", "")) == quantity and "nominal" not in table:
            both = {*_fitting(groups, table["groups"]), *new}
            table["groups"] = [name for name in groups if name in both]
            return
    table = tomlkit.table()
    table["groups"] = list(new)
    table["quantity"] = quantity
    tables.append(table)


def set_bounds(name: str, low: float, high: float, groups: Sequence[str]) -> Edit:
    """Return the edit that gives one unknown its own bounds.

    Parameters
    ----------
    name : str
        ``"group.quantity"``.
    low, high : float
        The bounds, in the unit of the unknown.
    groups : sequence of str
        All groups of the model, in their order.
    """
    group, _, quantity = name.rpartition(".")

    def edit(document: TOMLDocument) -> None:
        tables = cast(AoT, document["parameter"])
        for table in list(tables):
            if str(table.get("quantity", "")) != quantity:
                continue
            present = _fitting(groups, table.get("groups", []))
            if group not in present:
                continue
            if present == [group]:
                table["bounds"] = _numbers((low, high))
                return
            own = tomlkit.table()
            own.update({key: value for key, value in table.unwrap().items() if key != "groups"})
            own["groups"], own["bounds"] = [group], _numbers((low, high))
            table["groups"] = [name for name in present if name != group]
            tables.append(own)
            return

    return edit


def _fitting(groups: Sequence[str], patterns: Any) -> list[str]:
    """Return the groups that patterns of a table name."""
    texts = [str(patterns)] if isinstance(patterns, str) else [str(item) for item in patterns]
    return [
        name
        for name in groups
        if any(text == "all" or fnmatch.fnmatchcase(name, text) for text in texts)
    ]


def _keep_lines(document: TOMLDocument, keep: Callable[[float], bool]) -> None:
    """Keep some of the lines that ``[method]`` lists; those of several tests are left alone."""
    method = document.get("method")
    several = isinstance(document.get("test"), AoT) and len(cast(AoT, document["test"])) > 1
    if several or not isinstance(method, Table) or not isinstance(method.get("lines"), Array):
        return
    lines = [float(line) for line in method["lines"]]
    kept = [line for line in lines if keep(line)]
    if not kept:
        method.pop("lines")
    elif len(kept) < len(lines):
        method["lines"] = kept


# -- parts of a document ---------------------------------------------------------------------------
def _test(document: TOMLDocument, number: int) -> Table:
    """Return the table of a test."""
    tests = document.get("test")
    if isinstance(tests, AoT):
        return tests[number]
    return _table(document, "test")


def _table(document: TOMLDocument, name: str) -> Table:
    """Return a table, made where there is none."""
    if name not in document:
        document[name] = tomlkit.table()
    return cast(Table, document[name])


def _numbers(values: Sequence[float]) -> Array:
    """Return numbers as an array on one line, with eight digits."""
    made = tomlkit.array()
    made.extend([float(f"{value:.8g}") for value in values])
    return made
