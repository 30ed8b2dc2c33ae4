"""`drivetrain`: a torsional drive train from its parts; `mounted`: coupling to a structure."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import scipy.sparse as sp

from updyn.arrays import RealArray
from updyn.dofs import DIRECTIONS, DofSet
from updyn.elements.checks import check_keys, check_whole, is_whole, read_parts
from updyn.elements.constraints import Equation, about_axis, constrain, join
from updyn.elements.drivetrain.pieces import (
    PARTS,
    FixedNode,
    InertiaMatrix,
    Part,
    Piece,
    RigidRatio,
    TorsionSpring,
    solve_ratios,
)
from updyn.elements.drivetrain.ratios import inverted_ratios
from updyn.errors import ModelError, UpdynWarning, suggest
from updyn.model import Group, Model

__all__ = [
    "Train",
    "assemble",
    "drivetrain",
    "drivetrain_from_table",
    "mounted",
    "ratio_questions",
]

_OPTIONS = ("held", "keep", "title")

#: Nodes, and a matrix of their rotations.
_Block: TypeAlias = tuple[tuple[int, ...], RealArray]


@dataclass(frozen=True, slots=True)
class Train:
    """A train as springs, inertias, rigid ratios and fixed nodes."""

    pieces: tuple[tuple[str, Piece], ...]
    nodes: tuple[int, ...]

    @property
    def springs(self) -> list[TorsionSpring]:
        """The springs."""
        return [piece for _, piece in self.pieces if isinstance(piece, TorsionSpring)]

    @property
    def masses(self) -> list[InertiaMatrix]:
        """The inertias."""
        return [piece for _, piece in self.pieces if isinstance(piece, InertiaMatrix)]

    @property
    def rigid_ratios(self) -> list[RigidRatio]:
        """The rigid ratios."""
        return [piece for _, piece in self.pieces if isinstance(piece, RigidRatio)]

    @property
    def fixed_nodes(self) -> list[FixedNode]:
        """The fixed nodes."""
        return [piece for _, piece in self.pieces if isinstance(piece, FixedNode)]


def drivetrain(
    parts: Iterable[Part], *, held: Iterable[int] = (), keep: Iterable[int] = (), title: str = ""
) -> Model:
    """Build a torsional drive train.

    Parameters
    ----------
    parts : iterable of part
        `Inertia`, `Shaft`, `Coupling`, `GearPair`, `Planetary`, `Worm`, `Belt`, `DualDrive`,
        `Motor`, `Brake` and `Ground`, in any order; nodes are arbitrary numbers. Parts of one kind
        and one name form one group.
    held : iterable of int
        Nodes with fixed rotation.
    keep : iterable of int
        Nodes that remain DOFs (sensors, a mount); a rigid ratio then eliminates another node.
    title : str
        Title, for documentation.

    Returns
    -------
    Model
        DOFs ``node:RZ`` by ascending node: the rotation in rad of each shaft about its axis,
        right-handed about a common direction of parallel shafts. Fixed nodes and nodes that depend
        on others by a rigid ratio are eliminated. A rigid part without inertia has no group.

    Raises
    ------
    ModelError
        If a number is invalid, names collide, ratios contradict each other, or a node has neither
        stiffness, inertia nor damping.

    Warns
    -----
    UpdynWarning
        If a gear ratio may be inverted, as its inverse gives more plausible natural frequencies.
    """
    parts, held, keep = list(parts), _to_list(held), _to_list(keep)
    model = _build_model(parts, held, keep, title)
    for question in inverted_ratios(parts, model, lambda others: _build_model(others, held, keep)):
        warnings.warn(question, UpdynWarning, stacklevel=2)
    return model


def _to_list(nodes: Iterable[int]) -> Iterable[int]:
    """Return nodes as a list if they are an iterator; other types are checked later."""
    return list(nodes) if isinstance(nodes, Iterator) else nodes


def _build_model(
    parts: Iterable[Part], held: Iterable[int], keep: Iterable[int], title: str = ""
) -> Model:
    train = assemble(parts, held)
    groups = {
        name: _build_group(name, pieces, train) for name, pieces in _pieces_by_group(train).items()
    }
    if not groups:
        raise ModelError("drive train: no part has stiffness, inertia or damping")
    direction = np.full(len(train.nodes), DIRECTIONS.index("RZ"))
    dofs = DofSet.from_arrays(np.array(train.nodes), direction)
    equations = []
    kept = _check_nodes(keep, "keep", train.nodes)
    for node, ratios in solve_ratios(train.rigid_ratios, train.fixed_nodes, kept).items():
        terms = {f"{other}:RZ": ratio for other, ratio in ratios.items()}
        equations.append(Equation(f"{node}:RZ", terms))
    tied = constrain(Model(groups, dofs), equations)
    return Model.from_groups(tied.groups, tied.dofs, title=title)


def drivetrain_from_table(table: Mapping[str, Any]) -> Model:
    """Build a drive train from a table of a job file, ``[model] kind = "drivetrain"``.

    Parameters
    ----------
    table : mapping
        ``kind`` (``"drivetrain"``, optional), ``held``, ``keep`` and ``title`` as for
        `drivetrain`, and an array of tables for each kind of part (`PARTS`), with keys as its
        fields: ``motors``, ``brakes``, ``inertias``, ``shafts``, ``couplings``, ``gear_pairs``,
        ``planetaries``, ``worms``, ``belts``, ``dual_drives``, ``grounds``.

    Returns
    -------
    Model

    Raises
    ------
    ModelError
        If a key is missing or unknown (the message gives the nearest), or as `drivetrain`.
    """
    parts, options = _read_table(table)
    return drivetrain(parts, **options)


def _read_table(table: Mapping[str, Any]) -> tuple[list[Part], dict[str, Any]]:
    data = dict(table)
    kind = data.pop("kind", "drivetrain")
    if kind != "drivetrain":
        raise ModelError(f"model: kind {kind!r}; expected 'drivetrain'")
    check_keys("model", data, (), (*PARTS, *_OPTIONS))
    parts: list[Part] = []
    for key, part in PARTS.items():
        parts += read_parts(data, key, part)
        data.pop(key, None)
    if not parts:
        raise ModelError(
            "model: a drive train has no parts; expected [[model.shafts]] or others of"
            f" {', '.join(PARTS)}"
        )
    return parts, data


def ratio_questions(table: Mapping[str, Any], band: tuple[float, float]) -> list[str]:
    """Return a question about each gear ratio that is doubtful for the band of a test.

    Parameters
    ----------
    table : mapping
        As for `drivetrain_from_table`.
    band : (float, float)
        Band of the test in Hz.

    Returns
    -------
    list of str
        Empty if no ratio is doubtful, or if `drivetrain` already warns of one.
    """
    parts, options = _read_table(table)
    held, keep = options.get("held", ()), options.get("keep", ())

    def build(others: Iterable[Part]) -> Model:
        return _build_model(others, held, keep)

    model = build(parts)
    if inverted_ratios(parts, model, build):
        return []
    return inverted_ratios(parts, model, build, band)


def assemble(parts: Iterable[Part], held: Iterable[int] = ()) -> Train:
    """Return the pieces of all parts, after a check of names and nodes."""
    checked = _check_parts(parts)
    named: set[int] = set()
    for part in checked:
        named |= _named_nodes(part)
    counter = itertools.count(max(named, default=0) + 1)
    pieces: list[tuple[str, Piece]] = []
    nodes = set(named)
    for part in checked:
        for piece in part.pieces(lambda: next(counter)):
            pieces.append((part.name, piece))
            nodes.update(piece.nodes)
    for node in _check_nodes(held, "held", nodes):
        pieces.append((f"held {node}", FixedNode(f"held node {node}", node)))
    return Train(tuple(pieces), tuple(sorted(nodes)))


def _check_parts(parts: Iterable[Part]) -> list[Part]:
    checked = list(parts)
    kinds: dict[str, type] = {}
    for part in checked:
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
    return checked


def _named_nodes(part: Part) -> set[int]:
    """Return the nodes that a part names; the part checks that they are whole numbers."""
    values: list[object] = []
    for field in part.node_fields:
        value = getattr(part, field)
        if isinstance(value, tuple | list):
            values += value
        else:
            values.append(value)
    return {int(value) for value in values if is_whole(value)}


def _check_nodes(nodes: Iterable[int], what: str, known: Iterable[int]) -> list[int]:
    """Return nodes of the option `what`, after a check that they belong to parts."""
    if isinstance(nodes, str) or not isinstance(nodes, Iterable):
        raise ModelError(f"drive train: {what} {nodes!r}; expected a list of nodes", key=(what,))
    checked = [check_whole("drive train", what, node) for node in nodes]
    choices = sorted(known)
    for node in checked:
        if node not in choices:
            raise ModelError(
                f"drive train: {what} contains node {node}, which belongs to no part; "
                f"{suggest(str(node), map(str, choices))}",
                key=(what,),
            )
    return checked


def _pieces_by_group(train: Train) -> dict[str, list[TorsionSpring | InertiaMatrix]]:
    """Return springs and inertias by group; each group belongs to one part name."""
    out: dict[str, list[TorsionSpring | InertiaMatrix]] = {}
    owner: dict[str, str] = {}
    for part, piece in train.pieces:
        if isinstance(piece, TorsionSpring | InertiaMatrix):
            if owner.setdefault(piece.group, part) != part:
                raise ModelError(
                    f"group {piece.group!r} belongs to {owner[piece.group]!r} and {part!r};"
                    " rename one"
                )
            out.setdefault(piece.group, []).append(piece)
    return out


def _build_group(name: str, pieces: Iterable[TorsionSpring | InertiaMatrix], train: Train) -> Group:
    K: list[_Block] = []
    M: list[_Block] = []
    C: list[_Block] = []
    losses = set()
    for piece in pieces:
        if isinstance(piece, InertiaMatrix):
            M.append((piece.nodes, piece.matrix))
            continue
        if piece.stiffness:
            losses.add(piece.loss_factor)
            K.append((piece.nodes, piece.stiffness * piece.pattern))
        if piece.viscous:
            C.append((piece.nodes, piece.viscous * piece.pattern))
    if len(losses) > 1:
        raise ModelError(f"{name!r}: loss factors {sorted(losses)} in one group; use two names")
    loss_factor = max(losses, default=0.0)
    return Group(
        _sum_matrices(K, train), _sum_matrices(M, train), loss_factor, _sum_matrices(C, train)
    )


def _sum_matrices(blocks: Sequence[_Block], train: Train) -> sp.csr_array | None:
    """Return the sum of matrices for given nodes, shape (n, n); None without matrices."""
    if not blocks:
        return None
    rows = []
    columns = []
    values = []
    for nodes, block in blocks:
        index = np.searchsorted(train.nodes, nodes)
        rows.append(np.repeat(index, len(index)))
        columns.append(np.tile(index, len(index)))
        values.append(block.ravel())
    entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_array(sp.coo_array(entries, shape=(len(train.nodes),) * 2))


# -- on a structure
def mounted(
    drive: Model, structure: Model, at: Mapping[int, tuple[int, Sequence[float]]], title: str = ""
) -> Model:
    """Couple a drive train to a structure: shafts of the train rotate with structure nodes.

    A load carried by the structure, a wheel fixed to it, and a motor's housing (`housing`) on it
    are nodes of the train whose rotation equals that of a structure node about an axis.

    Parameters
    ----------
    drive : Model
        From `drivetrain`, DOFs ``node:RZ``.
    structure : Model
        Model with rotations at the nodes used (for solids, from `rigid_link`). Its node numbers
        must differ from those of the train.
    at : mapping of int to (int, sequence of float)
        For each coupled node of the train: node of the structure, and axis in its displacement
        system, shape (3,), any length. A positive rotation of the train is right-handed about the
        axis.
    title : str
        Title, for documentation; by default that of the structure.

    Returns
    -------
    Model
        All groups of both; the DOFs of the structure, then the uncoupled DOFs of the train.

    Raises
    ------
    ModelError
        If both share a DOF or a group name, a node is not in the train, or an axis is invalid.
    DofError
        If a node of the structure lacks a rotation that the axis needs.
    """
    if not isinstance(at, Mapping) or not at:
        raise ModelError(
            "mounted: expected {node of the train: (node of the structure, axis)} with one entry or"
            " more"
        )
    shared = [str(dof) for dof in drive.dofs if dof in structure.dofs]
    if shared:
        raise ModelError(
            f"mounted: DOFs in the train and in the structure: {', '.join(shared[:3])}; number the"
            " nodes of the train otherwise"
        )
    nodes = list(map(str, drive.dofs.nodes.tolist()))
    equations = []
    for node, place in at.items():
        if str(check_whole("mounted", "node", node)) not in nodes:
            raise ModelError(
                f"mounted: the train has no DOF {node}:RZ (held, or it follows another by a rigid"
                f" ratio: see keep); {suggest(str(node), nodes)}"
            )
        if not isinstance(place, tuple | list) or len(place) != 2:
            raise ModelError(
                f"mounted: node {node}: {place!r}; expected (node of the structure, axis)"
            )
        master, axis = place
        master = check_whole("mounted", f"node {node} on", master)
        equations.append(about_axis(f"{node}:RZ", master, axis))
    return constrain(join([structure, drive], title=title or structure.title), equations)
