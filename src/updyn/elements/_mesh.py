"""Where the nodes of a line of elements stand, and checks of the tables that say so."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.errors import ModelError, suggest

__all__ = [
    "check_cover",
    "check_keys",
    "from_row",
    "make_parts",
    "mesh",
    "not_negative",
    "number",
    "number_nodes",
    "positive",
    "read_stations",
]

_SAME = 1e-9  # of the length: positions closer than this are one node
_DEFAULT_ELEMENTS = 100
_T = TypeVar("_T")


def mesh(
    length: float,
    wanted: Iterable[tuple[str, float]],
    n_elements: int | None,
    nodes: ArrayLike | None,
) -> NDArray[np.float64]:
    """Return node positions that hold every wanted one and leave no element too long.

    Parameters
    ----------
    length : float
        In m; the line runs from 0 to `length`.
    wanted : iterable of (str, float)
        What needs a node, and where in m.
    n_elements : int or None
        No element is longer than `length` over this (None: 100).
    nodes : array_like of float or None
        All positions in m, instead.

    Returns
    -------
    ndarray of float, shape (n,)
        Ascending, in m.

    Raises
    ------
    ModelError
        If a position is not on the line, or not among the nodes given.
    """
    places = [(what, number(what, "position", x)) for what, x in wanted]
    for what, x in places:
        if not -_SAME * length <= x <= (1 + _SAME) * length:
            raise ModelError(
                f"{what} at {x:g} m lies off the beam, which runs from 0 to {length:g} m"
            )
    if nodes is not None:
        if n_elements is not None:
            raise ModelError("beam: give either n_elements or nodes, not both")
        return _given_nodes(length, places, nodes)
    count = _DEFAULT_ELEMENTS if n_elements is None else n_elements
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise ModelError(f"beam: n_elements {count!r}; expected a whole number of at least 1")
    cuts = np.unique(np.clip([0.0, length, *(x for _, x in places)], 0.0, length))
    # Positions that differ by rounding only are one; the ends stay exactly where they are.
    cuts = cuts[np.r_[True, np.diff(cuts) > _SAME * length]]
    cuts[-1] = length
    pieces = np.maximum(np.ceil(np.diff(cuts) / length * count - 1e-6), 1).astype(int)
    inner = [
        np.linspace(a, b, k, endpoint=False)
        for a, b, k in zip(cuts[:-1], cuts[1:], pieces, strict=True)
    ]
    return np.concatenate([*inner, [length]])


def _given_nodes(
    length: float, places: list[tuple[str, float]], nodes: ArrayLike
) -> NDArray[np.float64]:
    try:
        x = np.array(nodes, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"beam: nodes are not numbers ({error})") from error
    if (
        x.ndim != 1
        or len(x) < 2
        or not np.isfinite(x).all()
        or (np.diff(x) <= _SAME * length).any()
    ):
        raise ModelError("beam: nodes must be at least two finite positions that increase")
    if abs(x[0]) > _SAME * length or abs(x[-1] - length) > _SAME * length:
        raise ModelError(
            f"beam: nodes run from {x[0]:g} to {x[-1]:g} m; expected 0 to {length:g} m"
        )
    for what, place in places:
        nearest = x[int(np.argmin(np.abs(x - place)))]
        if abs(nearest - place) > _SAME * length:
            raise ModelError(f"{what} at {place:.9g} m is not a node; nearest: {nearest:.9g} m")
    return x


def read_stations(
    stations: Iterable[float] | Mapping[int, float],
) -> list[tuple[float, int | None]]:
    """Return positions in m, each with the node number that it was given, if any.

    Raises
    ------
    ModelError
        If a node number is not a positive whole number, or a position is not a number.
    """
    if isinstance(stations, Mapping):
        for node in stations:
            if isinstance(node, bool) or not isinstance(node, int | np.integer) or node < 1:
                raise ModelError(f"station {node!r}: expected a node number of at least 1")
        return [(number(f"station {k}", "position", x), int(k)) for k, x in stations.items()]
    if isinstance(stations, str) or not isinstance(stations, Iterable):
        raise ModelError(
            f"stations {stations!r}: expected positions in m, or node numbers with positions"
        )
    return [(number("station", "position", x), None) for x in stations]


def number_nodes(
    x: NDArray[np.float64], stations: list[tuple[float, int | None]]
) -> NDArray[np.int64]:
    """Return the node numbers, shape (n,): those given to stations, else 1, 2, ... in order of x.

    Raises
    ------
    ModelError
        If two stations with different numbers share a position.
    """
    labels = np.zeros(len(x), dtype=np.int64)
    for position, node in stations:
        if node is not None:
            at = int(np.argmin(np.abs(x - position)))
            if labels[at]:
                raise ModelError(
                    f"stations {labels[at]} and {node} share the position {position:g} m"
                )
            labels[at] = node
    taken = set(labels[labels > 0].tolist())
    free = (k for k in range(1, len(x) + len(taken) + 1) if k not in taken)
    for i in np.flatnonzero(labels == 0):
        labels[i] = next(free)
    return labels


def check_cover(segments: Iterable[tuple[str, float, float]], length: float) -> None:
    """Check that segments (name, start, end in m) cover the line from 0 to `length` once.

    Raises
    ------
    ModelError
        If one is empty, two overlap, or a stretch belongs to none.
    """
    reached, before = 0.0, "the start"
    tolerance = _SAME * length
    for name, start, end in sorted(segments, key=lambda s: (s[1], s[2])):
        if end - start <= tolerance:
            raise ModelError(
                f"segment {name!r} runs from {start:g} to {end:g} m; expected its end beyond its"
                " start"
            )
        if start > reached + tolerance:
            raise ModelError(
                f"no segment covers {reached:g} to {start:g} m, between {before} and segment"
                f" {name!r}"
            )
        if start < reached - tolerance:
            raise ModelError(
                f"segment {name!r} starts at {start:g} m, within {before}, which ends at"
                f" {reached:g} m"
            )
        reached, before = end, f"segment {name!r}"
    if reached < length - tolerance:
        raise ModelError(f"no segment covers {reached:g} to {length:g} m, after {before}")


# -- tables --------------------------------------------------------------------------------------------------
def make_parts(kind: type[_T], given: Iterable[Any]) -> list[_T]:
    """Return `given` as objects of `kind`; a tuple stands for its fields in order.

    Raises
    ------
    ModelError
        If one is neither, or has too few or too many fields.
    """
    out = []
    names = [f.name for f in fields(kind)]  # type: ignore[arg-type]
    for item in given:
        if isinstance(item, kind):
            out.append(item)
            continue
        if not isinstance(item, tuple | list):
            raise ModelError(
                f"{kind.__name__} {item!r}: expected a {kind.__name__} or ({', '.join(names)})"
            )
        try:
            out.append(kind(*item))
        except TypeError as error:
            raise ModelError(f"{kind.__name__} {item!r}: expected ({', '.join(names)})") from error
    return out


def from_row(kind: type[_T], key: str, row_number: int, row: Any) -> _T:
    """Return the object of `kind` that a row of an array of tables describes.

    Raises
    ------
    ModelError
        If a key is missing or unknown.
    """
    where = f"model.{key}, number {row_number}"
    if not isinstance(row, Mapping):
        raise ModelError(f"{where}: expected a table, found {row!r}")
    every = fields(kind)  # type: ignore[arg-type]
    needed = [f.name for f in every if f.default is f.default_factory]  # both MISSING
    check_keys(where, row, needed, [f.name for f in every])
    return kind(**row)


def check_keys(
    where: str, row: Mapping[str, Any], required: Iterable[str], optional: Iterable[str]
) -> None:
    """Check the keys of a table.

    Raises
    ------
    ModelError
        If one is unknown (the nearest is named) or missing.
    """
    known = list(dict.fromkeys([*required, *optional]))
    for key in row:
        if key not in known:
            raise ModelError(f"{where}: no key {key!r}; {suggest(str(key), known)}")
    for key in required:
        if key not in row:
            raise ModelError(f"{where}: {key!r} is missing")


def number(what: str, name: str, value: Any) -> float:
    """Return a finite number.

    Raises
    ------
    ModelError
        If it is not one.
    """
    real = isinstance(value, int | float | np.floating | np.integer) and not isinstance(value, bool)
    if not (real and abs(value) <= sys.float_info.max):  # a whole number may be of any size
        raise ModelError(f"{what}: {name} {value!r}; expected a finite number")
    return float(value)


def positive(what: str, name: str, value: Any) -> float:
    """Return a number above 0.

    Raises
    ------
    ModelError
        If it is not one.
    """
    if not number(what, name, value) > 0:
        raise ModelError(f"{what}: {name} {value!r}; expected a number above 0")
    return float(value)


def not_negative(what: str, name: str, value: Any) -> float:
    """Return a number of at least 0.

    Raises
    ------
    ModelError
        If it is not one.
    """
    if not number(what, name, value) >= 0:
        raise ModelError(f"{what}: {name} {value!r}; expected a number of at least 0")
    return float(value)
