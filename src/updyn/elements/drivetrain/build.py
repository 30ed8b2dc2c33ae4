"""`drivetrain`: a torsional drive train from its parts, a group each, and `mounted`: its place on a structure."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS, DofSet
from updyn.elements.checks import check_keys, from_row, rows_of, whole
from updyn.elements.constraints import Equation, about_axis, constrain, join
from updyn.elements.drivetrain.pieces import PARTS, Hold, Mass, Part, Piece, Spring, Tie, resolve
from updyn.errors import ModelError, suggest
from updyn.model import Group, Model

__all__ = [
    "Train",
    "assemble",
    "drivetrain",
    "drivetrain_from_table",
    "mounted",
]

_GROUP_OPTIONS = ("held", "keep", "title")


@dataclass(frozen=True, slots=True)
class Train:
    """The parts of a train, come down to springs, inertias, rigid ratios and holds.

    Parameters
    ----------
    pieces : tuple of (str, Piece)
        Each with the name of its part.
    nodes : tuple of int
        All nodes, ascending.
    """

    pieces: tuple[tuple[str, Piece], ...]
    nodes: tuple[int, ...]

    @property
    def springs(self) -> list[Spring]:
        """The springs."""
        return [p for _, p in self.pieces if isinstance(p, Spring)]

    @property
    def ties(self) -> list[Tie]:
        """The rigid ratios."""
        return [p for _, p in self.pieces if isinstance(p, Tie)]

    @property
    def holds(self) -> list[Hold]:
        """What cannot turn."""
        return [p for _, p in self.pieces if isinstance(p, Hold)]


def drivetrain(
    parts: Iterable[Part], *, held: Iterable[int] = (), keep: Iterable[int] = (), title: str = ""
) -> Model:
    """Build a torsional drive train.

    Parameters
    ----------
    parts : iterable of part
        `Inertia`, `Shaft`, `Coupling`, `GearPair`, `Planetary`, `Worm`, `Belt`, `DualDrive`,
        `Motor`, `Brake` and `Ground`, in any order; nodes are numbers of your choice. Parts of one
        kind and one name form one group.
    held : iterable of int
        Nodes that cannot turn.
    keep : iterable of int
        Nodes that stay DOFs (sensors, a mount) where a rigid ratio lets another follow instead.
    title : str
        For the record.

    Returns
    -------
    Model
        DOFs ``node:RZ`` by ascending node: the rotation in rad of each shaft about its own axis,
        right-handed about a direction that parallel shafts share. Nodes that are held, or follow
        others by a rigid ratio, are left out. A rigid part without inertia has no group.

    Raises
    ------
    ModelError
        If a number is not usable, names collide, ratios contradict each other, or a node has
        neither stiffness, inertia nor damping.
    """
    train = assemble(parts, held)
    n = len(train.nodes)
    at = {node: i for i, node in enumerate(train.nodes)}
    groups = {name: _group(name, pieces, at) for name, pieces in _by_group(train).items()}
    if not groups:
        raise ModelError("drive train: no part has stiffness, inertia or damping")
    dofs = DofSet.from_arrays(np.array(train.nodes), np.full(n, DIRECTIONS.index("RZ")))
    follow = resolve(train.ties, train.holds, _existing(keep, "keep", at))
    equations = [
        Equation(f"{node}:RZ", {f"{other}:RZ": c for other, c in terms.items()})
        for node, terms in follow.items()
    ]
    tied = constrain(Model(groups, dofs), equations)
    return Model.from_groups(tied.groups, tied.dofs, title=title)


def drivetrain_from_table(table: Mapping[str, Any]) -> Model:
    """Build a drive train from a table of a job file, ``[model] kind = "drivetrain"``.

    Parameters
    ----------
    table : mapping
        ``kind`` (``"drivetrain"``, may be left out), ``held``, ``keep`` and ``title`` as for
        `drivetrain`, and an array of tables for each kind of part with its fields as keys:
        ``motors``, ``brakes``, ``inertias``, ``shafts``, ``couplings``, ``gear_pairs``,
        ``planetaries``, ``worms``, ``belts``, ``dual_drives``, ``grounds``.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If a key is missing or unknown (the nearest is named), or as `drivetrain`.
    """
    data = dict(table)
    kind = data.pop("kind", "drivetrain")
    if kind != "drivetrain":
        raise ModelError(f"model: kind {kind!r}; expected 'drivetrain'")
    check_keys("model", data, (), (*PARTS, *_GROUP_OPTIONS))
    parts: list[Part] = []
    for key, part in PARTS.items():
        for number, row in enumerate(rows_of(data, key), 1):
            parts.append(from_row(part, key, number, row))
        data.pop(key, None)
    if not parts:
        raise ModelError(
            "model: a drive train has no parts; expected [[model.shafts]] or others of"
            f" {', '.join(PARTS)}"
        )
    return drivetrain(parts, **data)


def assemble(parts: Iterable[Part], held: Iterable[int] = ()) -> Train:
    """Return the pieces of all parts, after a check of names and nodes.

    Parameters
    ----------
    parts : iterable of part
        As for `drivetrain`.
    held : iterable of int
        Nodes that cannot turn.

    Returns
    -------
    Train

    Raises
    ------
    ModelError
        If an object is no part, a name stands for two kinds, or a node to be held is not there.
    """
    every = _checked(parts)
    named = [n for part in every for n in _named_nodes(part)]
    numbers = itertools.count(max(named, default=0) + 1)
    pieces = [(part.name, piece) for part in every for piece in part.pieces(lambda: next(numbers))]
    nodes = {n for _, piece in pieces for n in _nodes_of(piece)} | set(named)
    holds = _existing(held, "held", nodes)
    pieces += [(f"held {node}", Hold(f"held node {node}", node)) for node in holds]
    return Train(tuple(pieces), tuple(sorted(nodes)))


def _checked(parts: Iterable[Part]) -> list[Part]:
    every = list(parts)
    kinds: dict[str, type[Any]] = {}
    for part in every:
        if not isinstance(part, Part):
            names = ", ".join(kind.__name__ for kind in PARTS.values())
            raise ModelError(f"drive train: {part!r} is no part; expected one of {names}")
        kind = type(part).__name__
        if not isinstance(part.name, str):
            raise ModelError(f"{kind} {part.name!r}: expected a text as its name")
        if kinds.setdefault(part.name, type(part)) is not type(part):
            raise ModelError(
                f"{part.name!r} names a {kinds[part.name].__name__} and a {kind}; a group is of one"
                " kind"
            )
    return every


def _named_nodes(part: Part) -> list[int]:
    """Return the nodes that a part names; the part itself refuses values that are no whole number."""
    values: list[Any] = []
    for field in part.node_fields:
        value = getattr(part, field)
        if isinstance(value, tuple | list):
            values += value
        else:
            values.append(value)
    return [int(v) for v in values if isinstance(v, int | np.integer) and not isinstance(v, bool)]


def _nodes_of(piece: Piece) -> tuple[int, ...]:
    return (piece.node,) if isinstance(piece, Hold) else piece.nodes


def _existing(nodes: Iterable[int], what: str, known: Iterable[int]) -> list[int]:
    if isinstance(nodes, str) or not isinstance(nodes, Iterable):
        raise ModelError(f"drive train: {what} {nodes!r}; expected a list of nodes", key=(what,))
    there = set(known)
    out = [whole("drive train", what, n) for n in nodes]
    for node in out:
        if node not in there:
            raise ModelError(
                f"drive train: {what} names node {node}, which no part has; "
                f"{suggest(str(node), [str(n) for n in sorted(there)])}",
                key=(what,),
            )
    return out


def _by_group(train: Train) -> dict[str, list[Spring | Mass]]:
    out: dict[str, list[Spring | Mass]] = {}
    owner: dict[str, str] = {}
    for part, piece in train.pieces:
        if isinstance(piece, Spring | Mass):
            if owner.setdefault(piece.group, part) != part:
                raise ModelError(
                    f"group {piece.group!r} belongs to {owner[piece.group]!r} and {part!r};"
                    " rename one"
                )
            out.setdefault(piece.group, []).append(piece)
    return out


def _group(name: str, pieces: Sequence[Spring | Mass], at: Mapping[int, int]) -> Group:
    springs = [p for p in pieces if isinstance(p, Spring)]
    losses = {p.loss_factor for p in springs if p.stiffness}
    if len(losses) > 1:
        raise ModelError(f"{name!r}: loss factors {sorted(losses)} in one group; use two names")
    K = [(p.nodes, p.stiffness * np.outer(p.row, p.row)) for p in springs if p.stiffness]
    C = [(p.nodes, p.viscous * np.outer(p.row, p.row)) for p in springs if p.viscous]
    M = [(p.nodes, p.matrix) for p in pieces if isinstance(p, Mass)]
    return Group(
        _sum(K, at), _sum(M, at), loss_factor=max(losses, default=0.0), viscous=_sum(C, at)
    )


def _sum(
    blocks: Sequence[tuple[tuple[int, ...], NDArray[np.float64]]], at: Mapping[int, int]
) -> Any:
    if not blocks:
        return None
    rows, columns, values = [], [], []
    for nodes, block in blocks:
        index = np.array([at[n] for n in nodes])
        rows.append(np.repeat(index, len(index)))
        columns.append(np.tile(index, len(index)))
        values.append(block.ravel())
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_array(sp.coo_array(entries, shape=(len(at), len(at))))


def mounted(
    drive: Model, structure: Model, at: Mapping[int, tuple[int, Sequence[float]]], title: str = ""
) -> Model:
    """Couple a drive train to a structure: shafts of the one turn with nodes of the other.

    A load that the structure carries, a wheel bolted to it, a motor's housing (`housing`) that
    stands on it: each is a node of the train whose rotation is that of a structure node about an
    axis.

    Parameters
    ----------
    drive : Model
        From `drivetrain`, DOFs ``node:RZ``.
    structure : Model
        With rotations at the nodes used (those of a solid by `rigid_link`). Its node numbers must
        not be the train's.
    at : mapping of int to (int, sequence of float)
        For each node of the train: node of the structure, and axis in that node's own system, shape
        (3,), any length. A positive rotation of the train is right-handed about it.
    title : str
        For the record; None stated: that of the structure.

    Returns
    -------
    Model
        All groups of both; the DOFs of the structure, then those of the train that were not
        coupled.

    Raises
    ------
    ModelError
        If the two share a DOF or a group name, a node is not in the train, or an axis is not
        usable.
    DofError
        If a node of the structure lacks a rotation that the axis needs.
    """
    if not isinstance(at, Mapping) or not at:
        raise ModelError(
            "mounted: expected {node of the train: (node of the structure, axis)} with one entry or"
            " more"
        )
    shared = [str(d) for d in drive.dofs if d in structure.dofs]
    if shared:
        raise ModelError(
            f"mounted: {', '.join(shared[:3])} {'is' if len(shared) == 1 else 'are'} in the train"
            " and in the structure; number the nodes of the train otherwise"
        )
    nodes = [str(d.node) for d in drive.dofs]
    equations = []
    for node, place in at.items():
        if str(whole("mounted", "node", node)) not in nodes:
            raise ModelError(
                f"mounted: the train has no DOF {node}:RZ (held, or it follows another by a rigid"
                f" ratio: see keep); {suggest(str(node), nodes)}"
            )
        if not isinstance(place, tuple | list) or len(place) != 2:
            raise ModelError(
                f"mounted: node {node}: {place!r}; expected (node of the structure, axis)"
            )
        equations.append(
            about_axis(f"{node}:RZ", whole("mounted", f"node {node} on", place[0]), place[1])
        )
    return constrain(join([structure, drive], title=title or structure.title), equations)
