"""`structure`: beams, trusses, springs, shells, solids, masses and rigid links as one model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from updyn.arrays import BoolArray, IndexArray, IntArray, RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet, whole_numbers
from updyn.elements.checks import check_keys, read_parts, read_row, read_rows, to_reals
from updyn.elements.constraints import Equation, RigidLink, constrain, rigid_link
from updyn.elements.settings import ELEMENT
from updyn.elements.structure.element import ELEMENTS, Element, ElementMatrices
from updyn.errors import ModelError, key_path
from updyn.exchanged import AxisExchange, StiffnessAndMass
from updyn.geometry import Geometry
from updyn.model import Group, Model
from updyn.shapes import as_quadrangles, outer_faces

__all__ = ["structure", "structure_from_table"]


def structure(
    nodes: Mapping[int, ArrayLike] | ArrayLike | Geometry,
    parts: Iterable[Element],
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
        Positions in m by node number; nodes of an array are numbered 1, 2, ... n.
    parts : iterable of Element
        Elements of the structure: `Beam`, `Truss`, `Spring`, `Shell`, `Solid`, `PointMass` or
        another `Element`. Parts of the same name form one group.
    links : iterable of RigidLink
        Nodes that move rigidly with another. A master that no part uses gets the DOFs that the
        link needs.
    equations : iterable of Equation
        Further ties (multi-point constraints). A DOF on the right that no part uses is added.
    grounded : iterable of str, Dof or int
        Supports: a label fixes one DOF, a node number all DOFs of the node.
    title : str
        Title, for documentation.

    Returns
    -------
    Model
        DOFs ``node:X`` to ``node:RZ``, node by node in the order of `nodes`, without unused DOFs
        (nodes of solids and trusses have X, Y, Z only) and without fixed or tied DOFs. Its
        geometry has all nodes, and the edges of the elements as lines.

    Raises
    ------
    ModelError
        If a node is unknown, an element has no size, loss factors in a group differ, a DOF is
        fixed or tied twice, or a DOF has neither stiffness, mass nor damping. Also if a library is
        missing; the message explains its installation.
    DofError
        If a fixed or tied DOF is not used by any part.
    """
    with key_path("nodes"):
        table = _read_nodes(nodes)
    elements = list(parts)
    _check_elements(elements)
    used = np.zeros((len(table.numbers), 6), dtype=np.bool_)
    for element in elements:
        _mark_used(element, table, used)
    geometry = Geometry(table.numbers, table.xyz, _edges(elements), faces=_faces(elements))
    ties = _tie_equations(table, geometry, list(links), list(equations), used)
    dofs = _dofs(table, used)
    with key_path("grounded"):
        held = _fixed_dofs(table, used, dofs, grounded)
    # A fixed DOF without ties is never assembled; the transformation removes the others.
    tied = {dof for tie in ties for dof in (tie.dof, *tie.terms)}
    left_out = np.zeros(len(dofs), dtype=np.bool_)
    left_out[dofs.match([dof for dof in held if dof not in tied]).index] = True
    if left_out.all():
        raise ModelError("every DOF of the structure is fixed: the structure has no free DOF")
    groups = _groups(elements, table, used, left_out)
    free = Model(groups, dofs[np.flatnonzero(~left_out)], geometry, title)
    out = constrain(free, ties, [dof for dof in held if dof in tied])
    return Model.from_groups(out.groups, out.dofs, geometry=geometry, title=title)


def structure_from_table(table: Mapping[str, Any]) -> Model:
    """Build a structure from a table of a job file, ``[model] kind = "structure"``.

    Parameters
    ----------
    table : mapping
        ``kind`` (``"structure"``, optional); ``nodes``, a table from node number to position in m;
        an array of tables for each kind of element (`ELEMENTS`: ``beam``, ``truss``, ``shell``,
        ``solid``, ``spring``, ``mass``), keys as its fields, and ``link``, as those of
        `RigidLink`; ``equation`` with ``dof`` and ``terms``; ``grounded``, an array of DOFs and
        node numbers; ``title``. The ``section`` of a beam is a table with the fields of `Section`,
        or with ``shape`` ``"rectangle"`` or ``"tube"`` and its dimensions.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If a key is missing or unknown (the message gives the nearest), or as `structure`.
    """
    data = dict(table)
    kind = data.pop("kind", "structure")
    if kind != "structure":
        raise ModelError(f"model: kind {kind!r}; expected 'structure'")
    check_keys("model", data, ["nodes"], [*ELEMENTS, "link", "equation", "grounded", "title"])
    parts: list[Element] = []
    for key, kind_of_element in ELEMENTS.items():
        parts += read_rows(data, key, partial(_build_element, kind_of_element))
    links = read_parts(data, "link", RigidLink)
    equations = read_rows(data, "equation", _build_equation)
    grounded = data.get("grounded", [])
    if not isinstance(grounded, list | tuple):
        raise ModelError(
            f"model: grounded {grounded!r}; expected an array of DOFs and node numbers",
            key=("grounded",),
        )
    return structure(
        _nodes_of_table(data["nodes"]),
        parts,
        links=links,
        equations=equations,
        grounded=grounded,
        title=data.get("title", ""),
    )


def _build_element(kind: type[Element], where: str, row: Mapping[str, object]) -> Element:
    return read_row(kind, where, kind.fields_of_row(where, row))


def _build_equation(where: str, row: Mapping[str, Any]) -> Equation:
    check_keys(where, row, ("dof", "terms"), ())
    if not isinstance(row["terms"], Mapping):
        raise ModelError(
            f"{where}: terms {row['terms']!r}; expected a table from DOF to coefficient"
        )
    return Equation(row["dof"], row["terms"])


def _nodes_of_table(table: Any) -> dict[int, Any]:
    if not isinstance(table, Mapping):
        raise ModelError(
            f"model: nodes holds {type(table).__name__}; expected a table from node number to"
            " position",
            key=("nodes",),
        )
    out: dict[int, Any] = {}
    for key, position in table.items():
        text = str(key)
        if not text.isdecimal():
            raise ModelError(f"model.nodes: {key!r}; expected a node number", key=("nodes",))
        if not isinstance(position, list | tuple) or len(position) != 3:
            raise ModelError(
                f"model.nodes: node {text} has the position {position!r}; expected three numbers",
                key=("nodes",),
            )
        if int(text) in out:
            raise ModelError(f"model.nodes: node {int(text)} occurs twice", key=("nodes",))
        out[int(text)] = position
    return out


# -- nodes and elements
@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """Node numbers, shape (n,), with their positions in m, shape (n, 3)."""

    numbers: IntArray
    xyz: RealArray
    _order: IndexArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_order", np.argsort(self.numbers))

    def find(self, what: str, wanted: IntArray) -> IndexArray:
        """Return the indices in the table of node numbers of any shape; raise if one is missing."""
        at = np.searchsorted(self.numbers, wanted, sorter=self._order)
        found = self._order[np.minimum(at, len(self._order) - 1)]
        missing = np.asarray(wanted)[self.numbers[found] != wanted]
        if missing.size:
            distance = np.abs(self.numbers - missing.flat[0])
            near = self.numbers[np.argsort(distance, kind="stable")[:3]].tolist()
            raise ModelError(
                f"{what}: node {missing.flat[0]} is not among the {len(self.numbers)} nodes;"
                f" nearest: {', '.join(map(str, near))}"
            )
        return np.asarray(found)


def _read_nodes(given: Mapping[int, ArrayLike] | ArrayLike | Geometry) -> _Nodes:
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
    return _Nodes(numbers, xyz)


def _positions(given: object) -> RealArray:
    try:
        xyz = to_reals(given)
    except ValueError as error:
        raise ModelError(f"structure: expected three numbers for each node ({error})") from error
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ModelError(
            f"structure: positions of shape {xyz.shape}; expected three numbers for each node,"
            " (n, 3)"
        )
    return xyz


def _check_elements(elements: Sequence[Element]) -> None:
    if not elements:
        raise ModelError("structure: there are no parts")
    for element in elements:
        if not isinstance(element, Element):
            known = ", ".join(kind.__name__ for kind in ELEMENTS.values())
            raise ModelError(f"structure: {element!r}; expected a {known}, or another Element")


def _mark_used(element: Element, table: _Nodes, used: BoolArray) -> None:
    """Mark the DOFs that an element uses in `used`, shape (n, 6)."""
    at = table.find(element.label, element.node_numbers)
    used_dofs = element.used_dofs(table.xyz[at])
    for position, direction in enumerate(element.directions):
        used[at[used_dofs[:, :, position]], direction] = True


def _edges(elements: Iterable[Element]) -> IntArray:
    """Return the unique edges of all elements as node numbers, shape (n, 2)."""
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for element in elements:
        pairs.append(element.edges())
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)


def _faces(elements: Iterable[Element]) -> IntArray:
    """Return the unique faces to draw as node numbers, shape (n, 4); triangles repeat the last."""
    found = {True: [np.empty((0, 4), dtype=np.int64)], False: [np.empty((0, 4), dtype=np.int64)]}
    for element in elements:
        found[element.encloses].append(as_quadrangles(element.faces()))
    return outer_faces(*(np.concatenate(found[encloses]) for encloses in (True, False)))


# -- DOFs
def _tie_equations(
    table: _Nodes,
    geometry: Geometry,
    links: Sequence[RigidLink],
    equations: list[Equation],
    used: BoolArray,
) -> list[Equation]:
    """Return the equations of links and ties; mark the DOFs on their right in `used`."""
    for link in links:
        if not isinstance(link, RigidLink):
            raise ModelError(f"structure: {link!r}; expected a RigidLink")
    masters = [link.master for link in links]
    for link in links:  # a slave that is also a master has all six DOFs, which are eliminated
        table_rows = table.find("rigid link", link.slaves[np.isin(link.slaves, masters)])
        used[table_rows] = True
    ties = list(equations)
    for link in links:
        ties += _link_equations(table, geometry, link, used)
    terms = list(dict.fromkeys(dof for tie in ties for dof in tie.terms))
    at = table.find("equation", np.array([dof.node for dof in terms], dtype=np.int64))
    used[at, [DIRECTIONS.index(dof.direction) for dof in terms]] = True
    return ties


def _link_equations(
    table: _Nodes, geometry: Geometry, link: RigidLink, used: BoolArray
) -> list[Equation]:
    what = f"rigid link of node {link.master}"
    table.find(what, np.array([link.master]))
    used_directions = used[table.find(what, link.slaves)]
    unused = link.slaves[~used_directions.any(axis=1)]
    if unused.size:
        raise ModelError(f"{what}: no part uses node {unused[0]}, so that it has no DOF to tie")
    if link.directions is not None:
        return rigid_link(geometry, link.master, link.slaves.tolist(), link.directions)
    out = []
    for pattern in np.unique(used_directions, axis=0):
        slaves = link.slaves[(used_directions == pattern).all(axis=1)].tolist()
        directions = [DIRECTIONS[i] for i in np.flatnonzero(pattern)]
        out += rigid_link(geometry, link.master, slaves, directions)
    return out


def _dofs(table: _Nodes, used: BoolArray) -> DofSet:
    node, axis = np.nonzero(used)
    return DofSet.from_arrays(table.numbers[node], axis)


def _fixed_dofs(
    table: _Nodes, used: BoolArray, dofs: DofSet, grounded: Iterable[str | Dof | int]
) -> list[Dof]:
    out: list[Dof] = []
    for item in grounded:
        if isinstance(item, str | Dof):
            out.append(abs(Dof.parse(item)))
            continue
        if isinstance(item, bool) or not isinstance(item, int | np.integer):
            raise ModelError(f"grounded {item!r}: expected a DOF such as '3:X', or a node number")
        number = Dof(int(item), "X").node
        (place,) = table.find("grounded", np.array([number]))
        directions = np.flatnonzero(used[place])
        if not directions.size:
            raise ModelError(f"grounded: no part uses node {item}")
        out += [Dof(number, DIRECTIONS[i]) for i in directions]
    once = list(dict.fromkeys(out))
    dofs.match(once, "grounded DOF")
    return once


# -- groups
def _groups(
    elements: Sequence[Element],
    table: _Nodes,
    used: BoolArray,
    left_out: BoolArray,
) -> dict[str, Group]:
    n = int((~left_out).sum())
    number = np.full(len(left_out), -1, dtype=np.int32)
    number[~left_out] = np.arange(n, dtype=np.int32)
    place = np.full(used.shape, -1, dtype=np.int32)
    place[used] = number
    assembly = _StructureAssembly(table, place, n)
    loss = _loss_factors(elements)
    by_name: dict[str, list[Element]] = {}
    for element in elements:
        by_name.setdefault(element.name, []).append(element)
    groups: dict[str, Group] = {}
    for name, group_elements in by_name.items():
        K, M, C = assembly.sums(group_elements)
        group = Group(K, M, loss.get(name, 0.0), C)
        groups[name] = group.with_exchanged(_exchange_axes(group_elements, assembly))
    return groups


@dataclass(frozen=True, slots=True, eq=False)
class _StructureAssembly:
    """Rows of the n assembled DOFs, by node and direction, shape (n_nodes, 6)."""

    table: _Nodes
    place: NDArray[np.int32]
    n: int

    def sums(self, elements: Iterable[Element]) -> tuple[Any, Any, Any]:
        """Return stiffness, mass and viscous damping, shape (n, n); None for missing ones."""
        K, M, C = _MatrixSum(self.n), _MatrixSum(self.n), _MatrixSum(self.n)
        for element in elements:
            directions = np.array(element.directions)
            for at, found in _batches(element, self.table):
                rows = self.place[at[:, :, None], directions].reshape(len(at), -1)
                K.add(found.K, rows)
                M.add(found.M, rows)
                C.add(found.C, rows)
        return K.total(), M.total(), C.total()


@dataclass(frozen=True, slots=True, eq=False)
class _ElementRecipe:
    """Recipe of a group: its elements and their assembly."""

    elements: tuple[Element, ...]
    assembly: _StructureAssembly

    def matrices(self) -> StiffnessAndMass:
        K, M, _ = self.assembly.sums(self.elements)
        return StiffnessAndMass(K, M)


def _exchange_axes(
    group_elements: Sequence[Element], assembly: _StructureAssembly
) -> AxisExchange | None:
    """Return a group with exchanged section axes; None if this changes none of its elements."""
    turned = {
        i: new
        for i, one in enumerate(group_elements)
        if (new := one.with_exchanged_axes()) is not None
    }
    if not turned:
        return None
    table = assembly.table
    turns = []
    for i in turned:
        at = table.find(group_elements[i].label, group_elements[i].node_numbers)
        turns.append(group_elements[i].orientation_turned(table.xyz[at]))
    label = next(iter(turned.values())).label
    what = f"Iyy and Izz in the section of {label} (of a rectangle, height and width)"
    turn = turns[0] if len(set(turns)) == 1 else "its orientations by 90 degrees about the beams"
    elements = tuple(turned.get(i, one) for i, one in enumerate(group_elements))
    return AxisExchange(_ElementRecipe(elements, assembly), what, turn)


def _batches(element: Element, table: _Nodes) -> Iterator[tuple[IndexArray, ElementMatrices]]:
    """Yield rows of the table of nodes, shape (m, k), and matrices, for batches of elements."""
    numbers = element.node_numbers
    at = table.find(element.label, numbers)
    size = at.shape[1] * len(element.directions)
    step = max(ELEMENT.entries_at_once // size**2, 1)
    for start in range(0, len(at), step):
        some = slice(start, start + step)
        found = element.matrices(numbers[some], table.xyz[at[some]])
        expected = (len(at[some]), size, size)
        for A in (found.K, found.M, found.C):
            if A is not None and A.shape != expected:
                raise ModelError(
                    f"{element.label}: element matrices of shape {A.shape}; expected {expected}"
                )
        yield at[some], found


def _loss_factors(elements: Sequence[Element]) -> dict[str, float]:
    loss: dict[str, float] = {}
    for element in elements:
        loss_factor = getattr(element, "loss_factor", None)  # masses have none
        if loss_factor is not None and loss.setdefault(element.name, loss_factor) != loss_factor:
            raise ModelError(
                f"group {element.name!r}: loss factors {loss[element.name]} and {loss_factor} in"
                " one group; use two names"
            )
    return loss


class _MatrixSum:
    """Sparse sum of symmetric element matrices, merged in pairs of similar size.

    The upper half is summed, with half the diagonal, which makes the sum exactly symmetric.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        self.pending: list[tuple[RealArray, NDArray[np.int32], NDArray[np.int32]]] = []
        self.waiting = 0  # entries of these batches
        self.merged: list[tuple[int, Any]] = []  # pairs of number of batches and their sum

    def add(self, A: RealArray | None, at: NDArray[np.int32]) -> None:
        """Add matrices, shape (m, s, s), at rows and columns `at`, shape (m, s); -1 to skip."""
        if A is None:
            return
        s = at.shape[1]
        values = A.ravel()
        rows = np.repeat(at, s, axis=1).ravel()
        columns = np.tile(at, (1, s)).ravel()
        keep = np.flatnonzero((values != 0.0) & (rows >= 0) & (columns >= rows))
        values = values[keep]
        rows = rows[keep]
        columns = columns[keep]
        values[rows == columns] *= 0.5
        self.pending.append((values, rows, columns))
        self.waiting += len(values)
        if self.waiting > ELEMENT.pending_entries:
            self._merge()

    def _merge(self) -> None:
        if not self.pending:
            return
        values, rows, columns = (np.concatenate(some) for some in zip(*self.pending, strict=True))
        self.pending = []
        self.waiting = 0
        entries = sp.coo_array((values, (rows, columns)), shape=(self.n, self.n))
        weight = 1
        matrix = sp.csr_array(entries)
        while self.merged and self.merged[-1][0] <= weight:
            more, other = self.merged.pop()
            weight += more
            matrix = other + matrix
        self.merged.append((weight, matrix))

    def total(self) -> Any:
        """Return the sum, a `csr_array` of shape (n, n); None if nothing was added."""
        self._merge()
        if not self.merged:
            return None
        out = self.merged[-1][1]
        for _, other in reversed(self.merged[:-1]):
            out = out + other
        return sp.csr_array(out + out.T)
