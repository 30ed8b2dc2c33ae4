"""Items of a model in variables selected by the user, the option ``variables`` of a reader.

Matrices and damping are read only from the selected variables, because K may be the sum of K_1 and
K_2. Other items (labels, geometry, title) are read from the variables with their names by default.
``groups`` is one variable, a list of variables, or a mapping of group name to a variable or to a
mapping of items.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from updyn.errors import FormatError, OptionError, suggest
from updyn.io.damping import DAMPING
from updyn.io.items import Items, describe_kind, format_key
from updyn.io.variable_names import find_variable, warn_of_omitted

__all__ = ["stated_items"]

_PARTS = ("K", "M", "C", *DAMPING)
_MATRICES = ("groups", *_PARTS)
_LABELS = ("dofs", "dof_ref")
_REST = (*_LABELS, "title", "nodes", "xyz", "lines", "axes")
_REMAINDER = "model"


def stated_items(
    found: Items, variables: Mapping[str, object], path: str | Path
) -> dict[str, object]:
    """Return the items of a model, as arguments of `updyn.io.named.build_model`.

    Matrices or damping with the name of an item that are not selected cause a warning.
    """
    if not isinstance(variables, Mapping) or not variables:
        raise OptionError(
            f"variables = {variables!r}: expected a table of item = variable, such as"
            ' { K = "K0", M = "M0" }',
            key=("variables",),
        )
    for item in variables:
        if item not in (*_MATRICES, *_REST):
            raise OptionError(
                f"variables: no item {item!r}; {suggest(item, (*_MATRICES, *_REST))}",
                key=("variables", item),
            )
    file = _File(found, path)
    items: dict[str, object] = {}
    for item, name in variables.items():
        if item != "groups":
            items[item] = file.variable(name, ("variables", item))
    if "groups" in variables:
        given = variables["groups"]
        if isinstance(given, str):
            items["groups"] = file.variable(given, ("variables", "groups"))
        else:
            items["groups"] = file.groups(given)
            _add_remainder(items)
    for item in _REST:
        labelled = item in _LABELS and any(label in items for label in _LABELS)
        if item in found and item not in items and not labelled:
            items[item] = file.variable(item, ("variables",))
    omitted = [item for item in _MATRICES if item in found and item not in file.used]
    warn_of_omitted(omitted, path)
    return items


def _add_remainder(items: dict[str, Any]) -> None:
    """Make additional matrices and damping a separate group."""
    rest = {item: items.pop(item) for item in _PARTS if item in items}
    if not rest:
        return
    if _REMAINDER in items["groups"]:
        raise OptionError(
            f"variables: {', '.join(rest)} in addition to groups become the group {_REMAINDER!r},"
            " but there is a group of that name; rename it",
            key=("variables", "groups"),
        )
    items["groups"][_REMAINDER] = rest


class _File:
    """The variables of a file, with a record of the used ones."""

    def __init__(self, found: Items, path: str | Path) -> None:
        self._found = found
        self._path = path
        self.used: set[str] = set()

    def variable(self, name: Any, key: tuple[str | int, ...]) -> object:
        """Return a variable, or a field of a struct."""
        value = find_variable(self._found, name, self._path, key)
        self.used.add(name.split(".")[0])
        return value

    def groups(self, given: Any) -> dict[str, dict[str, Any]]:
        """Return K, M, C and so on by group."""
        key: tuple[str | int, ...] = ("variables", "groups")
        if isinstance(given, Sequence):
            out = {}
            for i, name in enumerate(given):
                if name in out:
                    raise OptionError(f"{format_key(key)}: {name!r} occurs twice", key=(*key, i))
                out[name] = self._parts(name, (*key, i))
        elif isinstance(given, Mapping):
            out = {group: self._parts(name, (*key, group)) for group, name in given.items()}
        else:
            out = {}
        if not out:
            raise OptionError(
                f"{format_key(key)} = {given!r}: expected variables, such as"
                ' ["K_1", "K_2"] or { shaft = "K_1" }',
                key=key,
            )
        return out

    def _parts(self, given: object, key: tuple[str | int, ...]) -> dict[str, object]:
        """Return K, M, C and so on of one group."""
        if isinstance(given, Mapping):
            parts = {}
            for item, name in given.items():
                if item not in _PARTS:
                    raise OptionError(
                        f"{format_key(key)}: no item {item!r}; {suggest(item, _PARTS)}",
                        key=(*key, item),
                    )
                parts[item] = self.variable(name, (*key, item))
            return parts
        value = self.variable(given, key)
        if isinstance(value, Mapping):
            return dict(value)
        if isinstance(value, list):
            raise FormatError(
                f"{given}: found {describe_kind(value)}; expected a matrix, or a struct of K, M"
                " and C",
                self._path,
                key=key,
            )
        return {"K": value}
