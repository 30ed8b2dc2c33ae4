"""Checks of what a part of a structure is given."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import whole_numbers
from updyn.elements._mesh import not_negative, number, positive
from updyn.errors import ModelError

__all__ = [
    "check_name",
    "connectivity",
    "floats",
    "material",
    "node_number",
    "six",
    "store",
    "vector",
]

LARGEST_NODE = 10**17  # as of a DOF


def store(part: Any, **values: Any) -> None:
    """Set fields of a frozen part; arrays become read-only."""
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(part, name, value)


def material(what: str, part: Any) -> dict[str, float]:
    """Return the checked numbers that all elements of a material have."""
    check_name(what, part.name)
    out = {"E": positive(what, "E", part.E), "rho": not_negative(what, "rho", part.rho)}
    if getattr(part, "G", None) is not None:
        out["G"] = positive(what, "G", part.G)
    if hasattr(part, "nu"):
        out["nu"] = number(what, "nu", part.nu)
        if not -1.0 < out["nu"] <= 0.5:
            raise ModelError(f"{what}: nu {part.nu!r}; expected above -1 and at most 0.5")
    return out | {"loss_factor": not_negative(what, "loss_factor", part.loss_factor)}


def check_name(what: str, name: Any) -> None:
    """Refuse a name that is no text."""
    if not isinstance(name, str):
        raise ModelError(f"{what}: expected a text as its name")


def connectivity(what: str, given: ArrayLike, widths: Iterable[int]) -> NDArray[np.int64]:
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
        at = int(np.flatnonzero(twice)[0])
        raise ModelError(f"{what}: element {at + 1} names a node twice: {nodes[at].tolist()}")
    return nodes


def node_number(what: str, name: str, given: Any) -> int:
    """Return a node number."""
    whole = isinstance(given, int | np.integer) and not isinstance(given, bool)
    if not whole or not -LARGEST_NODE <= int(given) <= LARGEST_NODE:
        raise ModelError(f"{what}: {name} {given!r}; expected a node number")
    return int(given)


def floats(what: str, name: str, given: Any) -> NDArray[np.float64]:
    """Return an array of finite numbers."""
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{what}: {name} {given!r}; expected numbers") from error
    if not np.isfinite(array).all():
        raise ModelError(f"{what}: {name} {given!r}; expected finite numbers")
    return array


def vector(what: str, name: str, given: Any) -> NDArray[np.float64]:
    """Return three numbers that are not all 0."""
    vector = floats(what, name, given)
    if vector.shape != (3,) or not vector.any():
        raise ModelError(f"{what}: {name} {given!r}; expected three numbers that are not all 0")
    return vector


def six(what: str, name: str, given: Any) -> NDArray[np.float64]:
    """Return six numbers of at least 0."""
    six = floats(what, name, given)
    if six.shape != (6,) or (six < 0).any():
        raise ModelError(f"{what}: {name} {given!r}; expected six numbers of at least 0")
    return six
