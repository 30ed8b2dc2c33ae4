"""Degrees of freedom: strict labels, sign, order, matching and complement.

A label has the form ``node:direction`` with an optional sign on the direction: ``"12:Z"``,
``"12:-Z"``, ``"3:RX"``. The sign gives the orientation of the sensor (or the hammer); the DOFs of
a model are positive.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.arrays import BoolArray, IndexArray, IntArray, NumberArray, RealArray
from updyn.errors import DofError, InputError, in_all

_T = TypeVar("_T", bound=np.generic)

__all__ = ["DIRECTIONS", "LARGEST_NODE", "Dof", "DofSet", "Match"]

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
_INDEX = {name: i for i, name in enumerate(DIRECTIONS)}
_LABEL = re.compile(r"(-?[0-9]+):([+-]?)(R?[XYZ])")
#: Largest node number: node * 6 + direction, and a difference of two, have to fit 64 bits.
LARGEST_NODE = 10**17
_SHAPE = "node:direction, with an integer node, an optional sign and one of " + ", ".join(
    DIRECTIONS
)


@dataclass(frozen=True, slots=True)
class Dof:
    """One degree of freedom: a node, a direction and a sign.

    Parameters
    ----------
    node : int
        Node number.
    direction : str
        One of ``X Y Z RX RY RZ``.
    sign : {1, -1}
        Sense along the direction.

    Raises
    ------
    DofError
        If the node is not a whole number, or the direction or the sign is not one of those.

    Examples
    --------
    >>> dof = updyn.Dof.parse("12:-Z")
    >>> dof.node, abs(dof) == updyn.Dof.parse("12:Z")
    (12, True)
    """

    node: int
    direction: str
    sign: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.node, int | np.integer) or isinstance(self.node, bool):
            raise DofError(f"node {self.node!r}: expected a whole number")
        if abs(int(self.node)) > LARGEST_NODE:
            raise DofError(f"node: expected at most {LARGEST_NODE:g} in size")
        if self.direction not in DIRECTIONS:
            raise DofError(
                f"direction {self.direction!r} of node {self.node}: expected one of"
                f" {', '.join(DIRECTIONS)}"
            )
        if self.sign not in (1, -1) or isinstance(self.sign, bool):
            raise DofError(
                f"sign {self.sign!r} of DOF {self.node}:{self.direction}: expected 1 or -1"
            )
        object.__setattr__(self, "node", int(self.node))
        object.__setattr__(self, "sign", int(self.sign))

    @classmethod
    def parse(cls, label: str | Dof) -> Dof:
        """Read a label such as ``"12:-Z"``.

        Parameters
        ----------
        label : str or Dof
            The text; a `Dof` is returned unchanged.

        Returns
        -------
        Dof
            The degree of freedom.

        Raises
        ------
        DofError
            If the text is not exactly a label; the message shows the nearest one.
        """
        if isinstance(label, Dof):
            return label
        node, axis, sign = _parse_label(label)
        return cls(node, DIRECTIONS[axis], sign)

    def __str__(self) -> str:
        return f"{self.node}:{'-' if self.sign < 0 else ''}{self.direction}"

    def __neg__(self) -> Dof:
        return Dof(self.node, self.direction, -self.sign)

    def __abs__(self) -> Dof:
        return self if self.sign > 0 else -self


@dataclass(frozen=True, slots=True)
class Match:
    """Positions of the DOFs of one set in another, and products of both signs, shape (n,)."""

    index: IndexArray
    sign: RealArray


class DofSet(Sequence[Dof]):
    """An ordered, immutable set of degrees of freedom.

    The DOFs are stored as arrays: a million DOFs take about 35 MB and are matched in a fraction of
    a second. Two sets are equal if they have the same DOFs with the same signs in the same order;
    `in` and `match` compare node and direction only.

    Parameters
    ----------
    dofs : iterable of str or Dof, or DofSet
        The DOFs, in order.

    Raises
    ------
    DofError
        If a label cannot be read or a DOF occurs twice (with either sign).

    Examples
    --------
    >>> dofs = updyn.DofSet(["1:X", "2:-Z"])
    >>> dofs.labels
    ['1:X', '2:-Z']
    """

    __slots__ = ("_by_key", "_order", "_sorted", "axes", "nodes", "signs")
    __hash__ = None  # type: ignore[assignment]

    nodes: IntArray
    axes: NDArray[np.int8]
    signs: NDArray[np.int8]
    _by_key: IntArray
    _order: IndexArray
    _sorted: IntArray

    def __init__(self, dofs: Iterable[str | Dof]) -> None:
        if isinstance(dofs, DofSet):
            for name in DofSet.__slots__:  # immutable, so the arrays are shared
                object.__setattr__(self, name, getattr(dofs, name))
            return
        if isinstance(dofs, str):
            raise DofError(
                f"DOFs {dofs!r}: expected a list of labels, found one text; write [{dofs!r}]"
            )
        if not isinstance(dofs, Iterable):
            raise DofError(f"DOFs {dofs!r}: expected a list of labels, found {type(dofs).__name__}")
        parsed = np.array(list(map(_parse_label, dofs)), dtype=np.int64).reshape(-1, 3)
        nodes, axes, signs = parsed.T
        self._set(nodes, axes.astype(np.int8), signs.astype(np.int8))

    @classmethod
    def from_arrays(
        cls, nodes: ArrayLike, axes: ArrayLike, signs: ArrayLike | None = None
    ) -> DofSet:
        """Build from arrays instead of labels.

        Parameters
        ----------
        nodes : array_like of int, shape (n,)
            Node numbers.
        axes : array_like of int, shape (n,)
            Directions, 0 to 5 for X Y Z RX RY RZ.
        signs : array_like of int, shape (n,), optional
            +1 or -1; by default all +1.

        Returns
        -------
        DofSet
            The n DOFs, in order.

        Raises
        ------
        DofError
            If an index or a sign is out of range, or a DOF occurs twice.
        """
        node = whole_numbers(nodes, "DOF nodes")
        axis = whole_numbers(axes, "DOF directions")
        sign = np.ones(node.shape, dtype=np.int64)
        if signs is not None:
            sign = whole_numbers(signs, "DOF signs")
        if not (node.shape == axis.shape == sign.shape and node.ndim == 1):
            raise DofError(
                f"DOF arrays: expected equal lengths, found {node.shape}, {axis.shape},"
                f" {sign.shape}"
            )
        if axis.size and (axis.min() < 0 or axis.max() > 5):
            raise DofError(
                f"DOF directions: expected 0..5 for {', '.join(DIRECTIONS)}, found"
                f" {axis.min()}..{axis.max()}"
            )
        if not np.isin(sign, (-1, 1)).all():
            raise DofError(f"DOF signs: expected 1 or -1, found {sign[~np.isin(sign, (-1, 1))][0]}")
        out = cls.__new__(cls)
        out._set(node, axis.astype(np.int8), sign.astype(np.int8))
        return out

    def _set(self, nodes: IntArray, axes: NDArray[np.int8], signs: NDArray[np.int8]) -> None:
        key = nodes * 6 + axes
        order = np.argsort(key, kind="stable")
        arrays: dict[str, NumberArray]
        arrays = {
            "nodes": nodes,
            "axes": axes,
            "signs": signs,
            "_by_key": key,
            "_order": order,
            "_sorted": key[order],
        }
        for name, array in arrays.items():
            object.__setattr__(self, name, _read_only(array))
        same = np.flatnonzero(np.diff(self._sorted) == 0)
        if same.size:
            first, second = sorted(self._order[same[0] : same[0] + 2])
            raise DofError(
                f"DOF {self[int(first)]} occurs twice: at positions {first + 1} and {second + 1}"
            )

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"a DofSet cannot be changed: {name!r} is read-only")

    # -- a sequence of Dof ---------------------------------------------------------------------
    def __len__(self) -> int:
        return len(self.nodes)

    @overload
    def __getitem__(self, item: int) -> Dof: ...
    @overload
    def __getitem__(self, item: slice | NumberArray | list[int]) -> DofSet: ...
    def __getitem__(self, item: Any) -> Dof | DofSet:
        if isinstance(item, int | np.integer):
            return Dof(int(self.nodes[item]), DIRECTIONS[self.axes[item]], int(self.signs[item]))
        nodes, axes, signs = self.nodes[item], self.axes[item], self.signs[item]
        if nodes.ndim != 1:
            return DofSet.from_arrays(nodes, axes, signs)  # an error
        out = DofSet.__new__(DofSet)
        out._set(nodes, axes, signs)
        return out

    def __iter__(self) -> Iterator[Dof]:
        return map(self.__getitem__, range(len(self)))

    def __contains__(self, dof: object) -> bool:
        try:
            wanted = DofSet([dof])  # type: ignore[list-item]
        except DofError:
            return False
        return bool(self._find(wanted)[1][0])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, DofSet):
            return NotImplemented
        if self._by_key is other._by_key and self.signs is other.signs:
            return True
        return (
            len(self) == len(other)
            and np.array_equal(self._by_key, other._by_key)
            and np.array_equal(self.signs, other.signs)
        )

    def __repr__(self) -> str:
        shown = self[:6].labels
        if len(self) > 6:
            shown.append("...")
        return f"DofSet([{', '.join(shown)}], n={len(self)})"

    def __reduce__(self) -> tuple[object, ...]:
        return DofSet.from_arrays, (self.nodes, self.axes, self.signs)

    # -- labels, matching, complement ----------------------------------------------------------
    @property
    def labels(self) -> list[str]:
        """The labels, in order."""
        return [
            f"{node}:{'-' if sign < 0 else ''}{DIRECTIONS[axis]}"
            for node, axis, sign in zip(
                self.nodes.tolist(), self.axes.tolist(), self.signs.tolist(), strict=True
            )
        ]

    def _find(self, other: DofSet) -> tuple[IndexArray, BoolArray]:
        if len(self) == 0:
            return np.zeros(len(other), dtype=np.intp), np.zeros(len(other), dtype=np.bool_)
        at = np.minimum(np.searchsorted(self._sorted, other._by_key), len(self) - 1)
        return self._order[at], self._sorted[at] == other._by_key

    def match(self, other: Iterable[str | Dof], what: str = "DOF") -> Match:
        """Find the DOFs of `other` in this set, by node and direction.

        Parameters
        ----------
        other : iterable of str or Dof
            The DOFs to find.
        what : str
            Name of the DOFs in an error message, such as ``"response"``.

        Returns
        -------
        Match
            Position in this set and product of the two signs, for each DOF of `other`.

        Raises
        ------
        DofError
            If a DOF is not in this set; the message lists the nearest ones.
        """
        wanted = DofSet(other)
        index, found = self._find(wanted)
        if not found.all():
            missing = np.flatnonzero(~found)
            first = wanted[int(missing[0])]
            raise DofError(
                f"{what} {first} is not among the {len(self)} DOFs{in_all(missing.size)};"
                f" {self._nearest_labels(first)}"
            )
        return Match(index, (self.signs[index] * wanted.signs).astype(np.float64))

    def complement(self, other: Iterable[str | Dof]) -> IndexArray:
        """Return the positions of the DOFs of this set that are not in `other`, ascending.

        Parameters
        ----------
        other : iterable of str or Dof
            DOFs of this set, with either sign.

        Returns
        -------
        ndarray of int, shape (len(self) - len(other),)
            Positions in this set.

        Raises
        ------
        DofError
            If a DOF of `other` is not in this set; the message gives the nearest ones.
        """
        keep = np.ones(len(self), dtype=np.bool_)
        keep[self.match(other).index] = False
        return np.flatnonzero(keep)

    def _nearest_labels(self, dof: Dof, n: int = 3) -> str:
        if len(self) == 0:
            return "no choices exist"
        distance = np.abs(self.nodes - dof.node) * 6 + (self.axes != _INDEX[dof.direction])
        best = np.argsort(distance, kind="stable")[:n]
        return "nearest: " + ", ".join(self[best].labels)


def positions(
    given: ArrayLike, n: int, what: str, error: type[InputError] = DofError
) -> IndexArray:
    """Return the positions of items given by their numbers from 0 (each once) or by `n` flags.

    Raises `error`, with the name `what`, for a number out of range or twice, or another type.
    """
    array = _as_array(given, what, error)
    if array.dtype.kind == "b" and array.shape == (n,):
        return np.flatnonzero(array)
    found = whole_numbers(array, what, error).reshape(-1)
    if found.size and (found.min() < 0 or found.max() >= n):
        raise error(f"{what}: expected numbers from 0 to {n - 1}, found {found.tolist()}")
    if len(np.unique(found)) < len(found):
        raise error(f"{what}: expected each number once, found {found.tolist()}")
    return found.astype(np.intp)


def whole_numbers(given: ArrayLike, what: str, error: type[InputError] = DofError) -> IntArray:
    """Return `given` as a new integer array; raise `error` for fractions and booleans."""
    array = _as_array(given, what, error)
    if array.dtype.kind not in "iuf":
        raise error(f"{what}: expected whole numbers, found {array.dtype}")
    if array.dtype.kind == "f":
        array = array.astype(np.float64)  # half precision cannot represent the limit
    with np.errstate(invalid="ignore"):
        bad = ~((array >= -LARGEST_NODE) & (array <= LARGEST_NODE)) | (array != np.floor(array))
    if bad.any():
        raise error(
            f"{what}: expected whole numbers of at most {LARGEST_NODE:g} in size, found"
            f" {array[bad][0]}"
        )
    return array.astype(np.int64)


def _as_array(given: ArrayLike, what: str, error: type[InputError]) -> NumberArray:
    try:
        return np.asarray(given)
    except (ValueError, OverflowError) as cause:
        raise error(f"{what}: expected whole numbers in an array ({cause})") from cause


def _parse_label(label: object) -> tuple[int, int, int]:
    """Return node, direction index and sign of a label or a `Dof`."""
    if isinstance(label, Dof):
        return label.node, _INDEX[label.direction], label.sign
    if not isinstance(label, str):
        raise DofError(f"DOF {label!r}: expected a text {_SHAPE}")
    found = _LABEL.fullmatch(label)
    if found is None:
        tidy = _LABEL.fullmatch(re.sub(r"\s+", "", label).upper())
        hint = ""
        if tidy:
            hint = f"; did you mean {tidy[0]!r}?"
        raise DofError(f"DOF {label!r}: expected {_SHAPE}{hint}")
    digits = found[1].lstrip("-0") or "0"  # without leading zeros, as Python limits their number
    if len(digits) > len(str(LARGEST_NODE)) or int(digits) > LARGEST_NODE:
        raise DofError(f"DOF {label[:40]!r}: expected a node of at most {LARGEST_NODE:g} in size")
    node = -int(digits) if found[1].startswith("-") else int(digits)
    return node, _INDEX[found[3]], -1 if found[2] == "-" else 1


def _read_only(array: NDArray[_T]) -> NDArray[_T]:
    out = array.copy()
    out.flags.writeable = False
    return out
