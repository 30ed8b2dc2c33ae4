"""Degrees of freedom: strict labels, sign, order, matching and complement.

A label reads ``node:direction`` with an optional sign on the direction: ``"12:Z"``, ``"12:-Z"``, ``"3:RX"``.
The sign says which way the sensor (or the hammer) pointed; a model's own DOFs are positive.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from updyn.errors import DofError

_T = TypeVar("_T", bound=np.generic)

__all__ = ["DIRECTIONS", "Dof", "DofSet", "Match"]

DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
_INDEX = {name: i for i, name in enumerate(DIRECTIONS)}
_LABEL = re.compile(r"(-?\d+):([+-]?)(R?[XYZ])")
_SHAPE = "node:direction, with an integer node, an optional sign and one of " + ", ".join(DIRECTIONS)


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
        If the direction or the sign is not one of those.
    """

    node: int
    direction: str
    sign: int = 1

    def __post_init__(self) -> None:
        if self.direction not in _INDEX:
            raise DofError(f"direction {self.direction!r} of node {self.node}: expected one of {', '.join(DIRECTIONS)}")
        if self.sign not in (1, -1):
            raise DofError(f"sign {self.sign!r} of DOF {self.node}:{self.direction}: expected 1 or -1")

    @classmethod
    def parse(cls, label: str | Dof) -> Dof:
        """Read a label such as ``"12:-Z"``.

        Raises
        ------
        DofError
            If the text is not exactly a label; the message shows the nearest one.
        """
        if isinstance(label, Dof):
            return label
        if not isinstance(label, str):
            raise DofError(f"DOF {label!r}: expected a text {_SHAPE}")
        found = _LABEL.fullmatch(label)
        if found is None:
            tidy = _LABEL.fullmatch(re.sub(r"\s+", "", label).upper())
            hint = f"; did you mean {tidy[0]!r}?" if tidy else ""
            raise DofError(f"DOF {label!r}: expected {_SHAPE}{hint}")
        return cls(int(found[1]), found[3], -1 if found[2] == "-" else 1)

    def __str__(self) -> str:
        return f"{self.node}:{'-' if self.sign < 0 else ''}{self.direction}"

    def __neg__(self) -> Dof:
        return Dof(self.node, self.direction, -self.sign)


@dataclass(frozen=True, slots=True)
class Match:
    """Where the DOFs of one set stand in another.

    Attributes
    ----------
    index : ndarray of int, shape (n,)
        Position in the other set.
    sign : ndarray of float, shape (n,)
        Product of the two signs, +1 or -1.
    """

    index: NDArray[np.intp]
    sign: NDArray[np.float64]


class DofSet(Sequence[Dof]):
    """An ordered, immutable set of degrees of freedom.

    Held as arrays, so that a million DOFs cost a few megabytes.

    Parameters
    ----------
    dofs : iterable of str or Dof, or DofSet
        The DOFs, in order.

    Raises
    ------
    DofError
        If a label cannot be read or a DOF stands twice (with either sign).
    """

    __slots__ = ("_by_key", "_order", "_sorted", "axes", "nodes", "signs")
    __hash__ = None  # type: ignore[assignment]

    nodes: NDArray[np.int64]
    axes: NDArray[np.int8]
    signs: NDArray[np.int8]

    def __init__(self, dofs: Iterable[str | Dof]) -> None:
        if isinstance(dofs, DofSet):
            self._set(dofs.nodes, dofs.axes, dofs.signs)
            return
        if isinstance(dofs, str):
            raise DofError(f"DOFs {dofs!r}: expected a list of labels, found one text; write [{dofs!r}]")
        parsed = [Dof.parse(d) for d in dofs]
        self._set(
            np.array([d.node for d in parsed], dtype=np.int64),
            np.array([_INDEX[d.direction] for d in parsed], dtype=np.int8),
            np.array([d.sign for d in parsed], dtype=np.int8),
        )

    @classmethod
    def from_arrays(cls, nodes: NDArray[Any], axes: NDArray[Any], signs: NDArray[Any] | None = None) -> DofSet:
        """Build from node numbers, direction indices (0..5 for X..RZ) and signs.

        Raises
        ------
        DofError
            If an index or a sign is out of range, or a DOF stands twice.
        """
        nodes = np.asarray(nodes)
        axes = np.asarray(axes)
        signs = np.ones(len(nodes), dtype=np.int8) if signs is None else np.asarray(signs)
        if not (nodes.shape == axes.shape == signs.shape and nodes.ndim == 1):
            raise DofError(f"DOF arrays: expected equal lengths, found {nodes.shape}, {axes.shape}, {signs.shape}")
        for name, array in (("nodes", nodes), ("directions", axes), ("signs", signs)):
            if array.size and not np.array_equal(array, np.asarray(array).astype(np.int64)):
                raise DofError(f"DOF {name}: expected whole numbers")
        if axes.size and (axes.min() < 0 or axes.max() > 5):
            raise DofError(
                f"DOF directions: expected 0..5 for {', '.join(DIRECTIONS)}, found {axes.min()}..{axes.max()}"
            )
        if not np.isin(signs, (-1, 1)).all():
            raise DofError("DOF signs: expected 1 or -1")
        out = cls.__new__(cls)
        out._set(nodes.astype(np.int64), axes.astype(np.int8), signs.astype(np.int8))
        return out

    def _set(self, nodes: NDArray[np.int64], axes: NDArray[np.int8], signs: NDArray[np.int8]) -> None:
        self.nodes, self.axes, self.signs = _read_only(nodes), _read_only(axes), _read_only(signs)
        self._by_key = nodes * 6 + axes
        self._order = np.argsort(self._by_key, kind="stable")
        self._sorted = self._by_key[self._order]
        same = np.flatnonzero(np.diff(self._sorted) == 0)
        if same.size:
            first, second = sorted(self._order[same[0] : same[0] + 2])
            raise DofError(f"DOF {self[int(first)]} stands twice: at positions {first + 1} and {second + 1}")

    # -- a sequence of Dof ---------------------------------------------------------------------------------
    def __len__(self) -> int:
        return len(self.nodes)

    @overload
    def __getitem__(self, item: int) -> Dof: ...
    @overload
    def __getitem__(self, item: slice | NDArray[Any] | list[int]) -> DofSet: ...
    def __getitem__(self, item: Any) -> Dof | DofSet:
        if isinstance(item, int | np.integer):
            return Dof(int(self.nodes[item]), DIRECTIONS[self.axes[item]], int(self.signs[item]))
        return DofSet.from_arrays(self.nodes[item], self.axes[item], self.signs[item])

    def __iter__(self) -> Iterator[Dof]:
        return (self[i] for i in range(len(self)))

    def __contains__(self, dof: object) -> bool:
        try:
            wanted = DofSet([dof])  # type: ignore[list-item]
        except DofError:
            return False
        return bool(self._find(wanted)[1][0])

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, DofSet):
            return NotImplemented
        return (
            len(self) == len(other)
            and np.array_equal(self._by_key, other._by_key)
            and np.array_equal(self.signs, other.signs)
        )

    def __repr__(self) -> str:
        shown = ", ".join(str(d) for d in self[:6])
        return f"DofSet([{shown}{', ...' if len(self) > 6 else ''}], n={len(self)})"

    def __reduce__(self) -> tuple[Any, ...]:
        return DofSet.from_arrays, (self.nodes, self.axes, self.signs)

    # -- what one asks of it -------------------------------------------------------------------------------
    @property
    def labels(self) -> list[str]:
        """The labels, in order."""
        return [str(d) for d in self]

    def _find(self, other: DofSet) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
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
            How to call them in an error, for instance ``"response"``.

        Returns
        -------
        Match
            Position here, and product of the two signs, of each DOF of `other`.

        Raises
        ------
        DofError
            If one is not here; the message lists the nearest that are.
        """
        wanted = other if isinstance(other, DofSet) else DofSet(other)
        index, found = self._find(wanted)
        if not found.all():
            missing = np.flatnonzero(~found)
            first = wanted[int(missing[0])]
            more = f" ({len(missing)} such)" if len(missing) > 1 else ""
            raise DofError(f"{what} {first} is not among the {len(self)} DOFs{more}; {self._near(first)}")
        return Match(index, (self.signs[index] * wanted.signs).astype(np.float64))

    def complement(self, other: Iterable[str | Dof]) -> NDArray[np.intp]:
        """Return the positions of the DOFs of this set that are not in `other`, ascending."""
        keep = np.ones(len(self), dtype=np.bool_)
        keep[self.match(other).index] = False
        return np.flatnonzero(keep)

    def _near(self, dof: Dof, n: int = 3) -> str:
        if len(self) == 0:
            return "there is none to choose from"
        distance = np.abs(self.nodes - dof.node) * 6 + (self.axes != _INDEX[dof.direction])
        best = np.argsort(distance, kind="stable")[:n]
        return "nearest: " + ", ".join(str(self[int(i)]) for i in best)


def _read_only(array: NDArray[_T]) -> NDArray[_T]:
    out = array.copy()
    out.flags.writeable = False
    return out
