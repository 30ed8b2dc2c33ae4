"""`structure`: beams, trusses, springs, shells, solids, masses and rigid links as one model of named groups."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from updyn.dofs import DIRECTIONS, Dof, DofSet, whole_numbers
from updyn.elements.constraints import Equation, constrain, rigid_link
from updyn.elements.structure.blocks import Nodes, blocks_of, touch
from updyn.elements.structure.drawing import lines_of
from updyn.elements.structure.parts import Part, PointMass, RigidLink
from updyn.errors import ModelError
from updyn.geometry import Geometry
from updyn.model import Group, Model

__all__ = ["structure"]

_LOOSE = 4_000_000  # entries of element matrices that wait to be summed up


def structure(
    nodes: Mapping[int, ArrayLike] | ArrayLike | Geometry,
    parts: Iterable[Part],
    *,
    links: Iterable[RigidLink] = (),
    equations: Iterable[Equation] = (),
    grounded: Iterable[str | Dof | int] = (),
    title: str = "",
) -> Model:
    """Build a model of a structure in space.

    Parameters
    ----------
    nodes : mapping of int to three floats, array_like of shape (n, 3), or Geometry
        Positions in m by node number; of an array the nodes are 1, 2, ... n.
    parts : iterable of Beam, Truss, Spring, Shell, Solid or PointMass
        What the structure is made of. Parts of the same name form one group.
    links : iterable of RigidLink
        Nodes that move rigidly with another. A master that no part touches gets the DOFs that the
        link needs.
    equations : iterable of Equation
        Further ties (multi-point constraints). A DOF on the right that no part touches is taken in.
    grounded : iterable of str, Dof or int
        What is held: a label holds one DOF, a node number all that the node has.
    title : str
        For the record.

    Returns
    -------
    Model
        DOFs ``node:X`` to ``node:RZ``, node by node in the order of `nodes`, without those that
        nothing touches (nodes of solids and trusses have X, Y, Z only) and without those that are
        held or tied. Its geometry has all nodes, and the edges of the elements as lines.

    Raises
    ------
    ModelError
        If a node is not known, an element has no size, loss factors in a group differ, a DOF is
        held or tied twice, or a DOF is left without stiffness, mass and damping. If a library is
        missing; the message says how to install it.
    DofError
        If a DOF that is held or tied is touched by nothing.
    """
    table, items = _nodes(nodes), list(parts)
    if not items:
        raise ModelError("structure: there are no parts")
    for item in items:
        if not isinstance(item, Part):
            raise ModelError(
                f"structure: {item!r}; expected a Beam, Truss, Spring, Shell, Solid or PointMass"
            )
    touched = np.zeros((len(table.numbers), 6), dtype=np.bool_)
    for item in items:
        touch(item, table, touched)
    geometry = Geometry(table.numbers, table.xyz, lines_of(items))
    ties = _ties(table, geometry, list(links), list(equations), touched)
    dofs = _dofs(table, touched)
    held = _held(table, touched, dofs, grounded)
    # What is held and in no tie is never assembled; the rest is left to the transformation.
    tied = {dof for tie in ties for dof in (tie.dof, *tie.terms)}
    gone = np.zeros(len(dofs), dtype=np.bool_)
    gone[dofs.match([dof for dof in held if dof not in tied]).index] = True
    if gone.all():
        raise ModelError("every DOF of the structure is held: nothing is left to move")
    free = Model(_groups(items, table, touched, gone), dofs[np.flatnonzero(~gone)], geometry, title)
    out = constrain(free, ties, [dof for dof in held if dof in tied])
    return Model.from_groups(out.groups, out.dofs, geometry=geometry, title=title)


def _nodes(given: Mapping[int, ArrayLike] | ArrayLike | Geometry) -> Nodes:
    if isinstance(given, Geometry):
        if given.axes is not None:
            raise ModelError(
                "structure: the nodes have displacement directions of their own; expected global"
                " ones"
            )
        numbers, xyz = given.nodes, given.xyz
    elif isinstance(given, Mapping):
        numbers = whole_numbers(list(given), "structure: nodes", ModelError)
        xyz = _positions(list(given.values()) or np.empty((0, 3)))
    else:
        xyz = _positions(given)
        numbers = np.arange(1, len(xyz) + 1)
    if not len(numbers):
        raise ModelError("structure: there are no nodes")
    return Nodes(numbers, xyz)


def _positions(given: Any) -> NDArray[np.float64]:
    try:
        xyz = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"structure: expected three numbers for each node ({error})") from error
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ModelError(
            f"structure: positions of shape {xyz.shape}; expected three numbers for each node,"
            " (n, 3)"
        )
    return xyz


# -- DOFs --------------------------------------------------------------------------------------------------
def _ties(
    table: Nodes,
    geometry: Geometry,
    links: Sequence[RigidLink],
    equations: list[Equation],
    touched: NDArray[np.bool_],
) -> list[Equation]:
    """Return the equations of links and ties; what stands on their right is taken into `touched`."""
    for link in links:
        if not isinstance(link, RigidLink):
            raise ModelError(f"structure: {link!r}; expected a RigidLink")
    masters = {link.master for link in links}
    for link in links:  # what leads a link and follows another has all six DOFs, which vanish
        between = np.array([s for s in link.slaves.tolist() if s in masters], dtype=np.int64)
        touched[table.find("rigid link", between)] = True
    ties = list(equations)
    for link in links:
        ties += _link(table, geometry, link, touched)
    terms = list(dict.fromkeys(d for tie in ties for d in tie.terms))
    at = table.find("equation", np.array([d.node for d in terms], dtype=np.int64))
    touched[at, [DIRECTIONS.index(d.direction) for d in terms]] = True
    return ties


def _link(
    table: Nodes, geometry: Geometry, link: RigidLink, touched: NDArray[np.bool_]
) -> list[Equation]:
    what = f"rigid link of node {link.master}"
    table.find(what, np.array([link.master]))
    own = touched[table.find(what, link.slaves)]
    if not own.any(axis=1).all():
        node = link.slaves[~own.any(axis=1)][0]
        raise ModelError(f"{what}: nothing touches node {node}, so that nothing of it could follow")
    if link.directions is not None:
        return rigid_link(geometry, link.master, link.slaves.tolist(), link.directions)
    out = []
    for pattern in np.unique(own, axis=0):
        alike = link.slaves[(own == pattern).all(axis=1)].tolist()
        out += rigid_link(
            geometry,
            link.master,
            alike,
            [d for d, has in zip(DIRECTIONS, pattern, strict=True) if has],
        )
    return out


def _dofs(table: Nodes, touched: NDArray[np.bool_]) -> DofSet:
    node, axis = np.nonzero(touched)
    return DofSet.from_arrays(table.numbers[node], axis)


def _held(
    table: Nodes, touched: NDArray[np.bool_], dofs: DofSet, grounded: Iterable[str | Dof | int]
) -> list[Dof]:
    out: list[Dof] = []
    for item in grounded:
        if isinstance(item, str | Dof):
            dof = Dof.parse(item)
            out.append(dof if dof.sign > 0 else -dof)
            continue
        if isinstance(item, bool) or not isinstance(item, int | np.integer):
            raise ModelError(f"grounded {item!r}: expected a DOF such as '3:X', or a node number")
        number = Dof(int(item), "X").node
        (place,) = table.find("grounded", np.array([number])).tolist()
        own = [Dof(number, d) for i, d in enumerate(DIRECTIONS) if touched[place, i]]
        if not own:
            raise ModelError(f"grounded: nothing touches node {item}")
        out += own
    once = list(dict.fromkeys(out))
    dofs.match(once, "grounded DOF")
    return once


# -- groups ------------------------------------------------------------------------------------------------
def _groups(
    parts: Sequence[Part], table: Nodes, touched: NDArray[np.bool_], gone: NDArray[np.bool_]
) -> dict[str, Group]:
    n = int((~gone).sum())
    number = np.full(len(gone), -1, dtype=np.int32)
    number[~gone] = np.arange(n, dtype=np.int32)
    place = np.full(touched.shape, -1, dtype=np.int32)
    place[touched] = number
    loss = _loss_factors(parts)
    groups: dict[str, Group] = {}
    for name in dict.fromkeys(part.name for part in parts):
        sums = {kind: _Sum(n) for kind in "KMC"}
        for block in (b for part in parts if part.name == name for b in blocks_of(part, table)):
            at = place[block.nodes[:, :, None], np.array(block.axes)].reshape(len(block.nodes), -1)
            for kind, total in sums.items():
                total.add(getattr(block, kind), at)
        K, M, C = (total.total() for total in sums.values())
        groups[name] = Group(K, M, loss.get(name, 0.0), C)
    return groups


def _loss_factors(parts: Sequence[Part]) -> dict[str, float]:
    loss: dict[str, float] = {}
    for part in parts:
        if isinstance(part, PointMass):
            continue
        if loss.setdefault(part.name, part.loss_factor) != part.loss_factor:
            raise ModelError(
                f"group {part.name!r}: loss factors {loss[part.name]} and {part.loss_factor} in one"
                " group; use two names"
            )
    return loss


class _Sum:
    """A sparse sum of symmetric element matrices, merged in pairs of like size.

    The upper half is summed, with half the diagonal, so that the whole is symmetric to the last
    bit.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.loose: list[tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]] = []
        self.waiting: list[tuple[int, Any]] = []

    def add(self, A: NDArray[np.float64] | None, at: NDArray[np.int32]) -> None:
        """Add matrices, shape (m, s, s), at rows and columns `at`, shape (m, s); -1: nowhere."""
        if A is None:
            return
        s = at.shape[1]
        values, rows, columns = (
            A.ravel(),
            np.repeat(at, s, axis=1).ravel(),
            np.tile(at, (1, s)).ravel(),
        )
        keep = np.flatnonzero((values != 0.0) & (rows >= 0) & (columns >= rows))
        values, rows, columns = values[keep], rows[keep], columns[keep]
        values[rows == columns] *= 0.5
        self.loose.append((values, rows, columns))
        if sum(len(values) for values, _, _ in self.loose) > _LOOSE:
            self._gather()

    def _gather(self) -> None:
        if not self.loose:
            return
        values, rows, columns = (np.concatenate(some) for some in zip(*self.loose, strict=True))
        self.loose = []
        weight, matrix = (
            1,
            sp.csr_array(sp.coo_array((values, (rows, columns)), shape=(self.n, self.n))),
        )
        while self.waiting and self.waiting[-1][0] <= weight:
            more, other = self.waiting.pop()
            weight, matrix = weight + more, other + matrix
        self.waiting.append((weight, matrix))

    def total(self) -> Any:
        """Return the sum, a `csr_array` of shape (n, n); None where nothing was added."""
        self._gather()
        if not self.waiting:
            return None
        out = self.waiting[-1][1]
        for _, other in reversed(self.waiting[:-1]):
            out = out + other
        return sp.csr_array(out + out.T)
