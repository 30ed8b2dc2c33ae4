"""Checks of the fields of elements: numbers, names, node numbers, and tables of a job file."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import IntArray, RealArray
from updyn.dofs import LARGEST_NODE, whole_numbers
from updyn.errors import ModelError, key_path, suggest

__all__ = [
    "check_connectivity",
    "check_floats",
    "check_keys",
    "check_material",
    "check_name",
    "check_node_number",
    "check_not_negative",
    "check_number",
    "check_pair",
    "check_poisson_ratio",
    "check_positive",
    "check_positive_or_none",
    "check_six",
    "check_vector",
    "check_whole",
    "field_names",
    "is_whole",
    "make_parts",
    "read_parts",
    "read_row",
    "read_rows",
    "set_fields",
    "to_reals",
]

_T = TypeVar("_T")


# -- numbers
def check_number(what: str, name: str, value: object) -> float:
    """Return a finite number; raise `ModelError` for other values."""
    if (
        not isinstance(value, int | float | np.floating | np.integer)
        or isinstance(value, bool)
        or not -sys.float_info.max <= value <= sys.float_info.max  # integers may be of any size
    ):
        raise ModelError(f"{what}: {name} {value!r}; expected a finite number", key=(name,))
    return float(value)


def check_positive(what: str, name: str, value: object) -> float:
    """Return a number above 0; raise `ModelError` for other values."""
    number = check_number(what, name, value)
    if not number > 0:
        raise ModelError(f"{what}: {name} {value!r}; expected a number above 0", key=(name,))
    return number


def check_positive_or_none(what: str, name: str, value: object) -> float | None:
    """Return a number above 0, or None if none is given; raise `ModelError` for other values."""
    return None if value is None else check_positive(what, name, value)


def check_not_negative(what: str, name: str, value: object) -> float:
    """Return a number of at least 0; raise `ModelError` for other values."""
    number = check_number(what, name, value)
    if not number >= 0:
        raise ModelError(f"{what}: {name} {value!r}; expected a number of at least 0", key=(name,))
    return number


def check_poisson_ratio(what: str, value: object) -> float:
    """Return a Poisson's ratio above -1 and at most 0.5; raise `ModelError` for other values."""
    ratio = check_number(what, "nu", value)
    if not -1.0 < ratio <= 0.5:
        raise ModelError(f"{what}: nu {value!r}; expected above -1 and at most 0.5", key=("nu",))
    return ratio


def check_pair(what: str, name: str, value: object) -> tuple[float, float]:
    """Return two numbers above 0; raise `ModelError` for other values."""
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise ModelError(f"{what}: {name} {value!r}; expected two numbers", key=(name,))
    return check_positive(what, name, value[0]), check_positive(what, name, value[1])


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is a whole number and not a boolean."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def check_whole(what: str, name: str, value: object, least: int | None = None) -> int:
    """Return a whole number of at least `least`, such as a node; raise `ModelError` for others."""
    if is_whole(value) and (least is None or value >= least):
        return int(value)
    wanted = "a whole number" if least is None else f"a whole number of at least {least}"
    raise ModelError(f"{what}: {name} {value!r}; expected {wanted}", key=(name,))


# -- fields of the elements of a structure
def set_fields(part: object, **values: object) -> None:
    """Set fields of a frozen dataclass; arrays become read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(part, name, value)


def check_material(what: str, part: Any) -> dict[str, float]:
    """Return the checked material of a part: E, rho, loss_factor, and nu and G if it has them."""
    check_name(what, part.name)
    out = {"E": check_positive(what, "E", part.E), "rho": check_not_negative(what, "rho", part.rho)}
    if getattr(part, "G", None) is not None:
        out["G"] = check_positive(what, "G", part.G)
    if hasattr(part, "nu"):
        out["nu"] = check_poisson_ratio(what, part.nu)
    out["loss_factor"] = check_not_negative(what, "loss_factor", part.loss_factor)
    return out


def check_name(what: str, name: object) -> None:
    """Raise an error for a name that is not a text."""
    if not isinstance(name, str):
        raise ModelError(f"{what}: expected a text as its name", key=("name",))


def check_connectivity(what: str, given: ArrayLike, widths: Iterable[int]) -> IntArray:
    """Return node numbers, shape (m, k), with k of the widths."""
    nodes = np.atleast_2d(whole_numbers(given, f"{what}: connectivity", ModelError))
    if nodes.ndim != 2 or nodes.shape[1] not in widths or not len(nodes):
        expected = " or ".join(f"(m, {k})" for k in widths)
        raise ModelError(
            f"{what}: connectivity of shape {nodes.shape}; expected {expected} node numbers"
        )
    ordered = np.sort(nodes, axis=1)
    twice = (np.diff(ordered, axis=1) == 0).any(axis=1)
    if twice.any():
        at = int(np.argmax(twice))
        raise ModelError(f"{what}: element {at + 1} names a node twice: {nodes[at].tolist()}")
    return nodes


def check_node_number(what: str, name: str, given: object) -> int:
    """Return a node number."""
    if not is_whole(given) or abs(int(given)) > LARGEST_NODE:
        raise ModelError(f"{what}: {name} {given!r}; expected a node number", key=(name,))
    return int(given)


def to_reals(given: object) -> RealArray:
    """Return a new array of numbers; raise `ValueError` for texts, booleans and complex numbers."""
    array = np.asarray(given)
    if array.dtype.kind not in "iuf":
        raise ValueError(f"found {array.dtype}")
    return array.astype(np.float64)


def check_floats(what: str, name: str, given: object) -> RealArray:
    """Return an array of finite numbers."""
    try:
        array = to_reals(given)
    except ValueError as error:
        raise ModelError(f"{what}: {name} {given!r}; expected numbers", key=(name,)) from error
    if not np.isfinite(array).all():
        raise ModelError(f"{what}: {name} {given!r}; expected finite numbers", key=(name,))
    return array


def check_vector(what: str, name: str, given: object) -> RealArray:
    """Return three numbers that are not all 0."""
    vector = check_floats(what, name, given)
    if vector.shape != (3,) or not vector.any():
        raise ModelError(
            f"{what}: {name} {given!r}; expected three numbers that are not all 0", key=(name,)
        )
    return vector


def check_six(what: str, name: str, given: object) -> RealArray:
    """Return six numbers of at least 0."""
    six = check_floats(what, name, given)
    if six.shape != (6,) or (six < 0).any():
        raise ModelError(
            f"{what}: {name} {given!r}; expected six numbers of at least 0", key=(name,)
        )
    return six


# -- tables
def field_names(kind: type) -> tuple[list[str], list[str]]:
    """Return the names of all fields of a dataclass, and of those without a default."""
    names = []
    required = []
    for field in fields(kind):
        names.append(field.name)
        if field.default is MISSING and field.default_factory is MISSING:
            required.append(field.name)
    return names, required


def make_parts(kind: type[_T], given: Iterable[object]) -> list[_T]:
    """Return objects of a dataclass; tuples of its fields in order are converted."""
    names = ", ".join(field_names(kind)[0])
    out = []
    for item in given:
        if isinstance(item, kind):
            out.append(item)
            continue
        if not isinstance(item, tuple | list):
            raise ModelError(f"{kind.__name__} {item!r}: expected a {kind.__name__} or ({names})")
        try:
            out.append(kind(*item))
        except TypeError as error:
            raise ModelError(f"{kind.__name__} {item!r}: expected ({names})") from error
    return out


def read_parts(table: Mapping[str, object], key: str, kind: type[_T]) -> list[_T]:
    """Return the objects of a dataclass in an array of tables ``[[model.key]]``."""
    return read_rows(table, key, lambda where, row: read_row(kind, where, row))


def read_rows(
    table: Mapping[str, object], key: str, read: Callable[[str, Mapping[str, object]], _T]
) -> list[_T]:
    """Read the rows of an array of tables ``[[model.key]]``; empty if the key is missing.

    `read` converts the place of a row (for messages) and the row to an object.
    """
    rows = table.get(key, [])
    if not isinstance(rows, list | tuple):
        raise ModelError(
            f"model: {key} holds {type(rows).__name__}; expected an array of tables,"
            f" [[model.{key}]]",
            key=(key,),
        )
    out = []
    for number, row in enumerate(rows, 1):
        where = f"model.{key}, number {number}"
        with key_path(key, number - 1):
            if not isinstance(row, Mapping):
                raise ModelError(f"{where}: expected a table, found {row!r}")
            out.append(read(where, row))
    return out


def read_row(kind: type[_T], where: str, row: Mapping[str, object]) -> _T:
    """Return an object of a dataclass from a row; raise `ModelError` for a wrong or missing key."""
    names, required = field_names(kind)
    check_keys(where, row, required, names)
    return kind(**row)


def check_keys(
    where: str, row: Mapping[str, object], required: Iterable[str], optional: Iterable[str]
) -> None:
    """Raise `ModelError` with the nearest key if a key of a table is missing or unknown."""
    known = list(dict.fromkeys([*required, *optional]))
    for key in row:
        if key not in known:
            raise ModelError(f"{where}: no key {key!r}; {suggest(str(key), known)}", key=(key,))
    for key in required:
        if key not in row:
            raise ModelError(f"{where}: {key!r} is missing")
