"""`Scene`: what a viewer shows, as arrays. Nothing here knows a model or a result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.errors import InputError
from updyn.style import STATES

__all__ = [
    "ROLES",
    "STYLES",
    "Arrow",
    "Body",
    "Colouring",
    "Entries",
    "Layer",
    "ModeRow",
    "ModeShapes",
    "OperatingLayer",
    "OperatingShapes",
    "Reference",
    "Scene",
]

_Real = NDArray[np.float64]
_Whole = NDArray[np.intp]

#: Colours of layers: the three of an update, one of a model outside an update, and one of others.
ROLES = (*STATES.values(), "plain", "third")
#: How a layer is drawn: with faces in the colours of the groups, as lines, or as nodes with lines.
STYLES = ("surface", "wire", "dots")


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Nodes with the lines, faces and points between them.

    Attributes
    ----------
    name : str
        Such as ``"model"`` or ``"test"``.
    nodes : ndarray of int, shape (n,)
        Node numbers. Those of the rims of discs, which stand last, are the numbers of the nodes
        that the discs are about.
    xyz : ndarray of float, shape (n, 3)
        Positions in m.
    lines : ndarray of int, shape (m, 2)
        Ends, as positions among the nodes; so are the next two.
    line_group : ndarray of int, shape (m,)
        Positions in `groups`; -1: none. So are the next two.
    faces : ndarray of int, shape (k, 3)
        Corners of triangles.
    face_group : ndarray of int, shape (k,)
        Groups of the triangles.
    points : ndarray of int, shape (p,)
        Nodes that are drawn as squares: lumped masses, springs to the ground.
    point_group : ndarray of int, shape (p,)
        Groups of the squares.
    groups : tuple of str
        Names.
    real : int
        How many of the nodes are not on the rim of a disc.
    disc : float
        Radius of the discs in m; they show the rotation of nodes that have no translation.
    """

    name: str
    nodes: NDArray[np.int64]
    xyz: _Real
    lines: _Whole
    line_group: _Whole
    faces: _Whole
    face_group: _Whole
    points: _Whole
    point_group: _Whole
    groups: tuple[str, ...]
    real: int
    disc: float = 0.0

    def __post_init__(self) -> None:
        n = len(self.nodes)
        if self.xyz.shape != (n, 3):
            raise InputError(f"viewer: {n} nodes at positions of shape {self.xyz.shape}")
        for what, at, group, size in (
            ("lines", self.lines, self.line_group, 2),
            ("faces", self.faces, self.face_group, 3),
        ):
            if at.shape != (len(group), size):
                raise InputError(
                    f"viewer: {what} of shape {at.shape} with {len(group)} groups; expected"
                    f" ({len(group)}, {size})"
                )
        if self.points.shape != self.point_group.shape:
            raise InputError(
                f"viewer: {len(self.points)} points with {len(self.point_group)} groups"
            )
        for what, at in (("line", self.lines), ("face", self.faces), ("point", self.points)):
            if at.size and not (at.min() >= 0 and at.max() < n):
                raise InputError(f"viewer: a {what} ends at node {at.max()} of {n}, from 0")
        for groups in (self.line_group, self.face_group, self.point_group):
            if groups.size and not (groups.min() >= -1 and groups.max() < len(self.groups)):
                raise InputError(f"viewer: group {groups.max()} of {len(self.groups)}, from 0")


@dataclass(frozen=True, slots=True, eq=False)
class Colouring:
    """A colour for each group of the first body.

    Attributes
    ----------
    name, unit : str
        What the colours mean; the unit may be empty.
    steps : sequence of (str, str)
        Colour and text of each step of the legend. Colours are names of variables of
        ``viewer.css`` without their ``--v-``: ``less-4`` to ``more-4``, ``seq-0`` to ``seq-7``,
        ``same``, ``none``.
    step_of_group : sequence of int
        Step of each group; -1: ``none``.
    texts : sequence of str
        What is said of each group when one of its nodes is picked.
    by_row : sequence of (sequence of int, sequence of str)
        Steps and texts in their place for each row of the modes, where they differ by mode.
    """

    name: str
    unit: str
    steps: Sequence[tuple[str, str]]
    step_of_group: Sequence[int]
    texts: Sequence[str]
    by_row: Sequence[tuple[Sequence[int], Sequence[str]]] = ()

    def __post_init__(self) -> None:
        groups = len(self.step_of_group)
        for steps, texts in [(self.step_of_group, self.texts), *self.by_row]:
            if not len(steps) == len(texts) == groups:
                raise InputError(
                    f"viewer: colouring {self.name!r} has {len(steps)} steps and {len(texts)}"
                    f" texts; expected one for each of {groups} groups"
                )
            wrong = [step for step in steps if not -1 <= step < len(self.steps)]
            if wrong:
                raise InputError(
                    f"viewer: colouring {self.name!r} has step {wrong[0]} of {len(self.steps)},"
                    " from 0"
                )


@dataclass(frozen=True, slots=True, eq=False)
class Arrow:
    """A sensor or a force at a node of the first body.

    Attributes
    ----------
    kind : str
        ``"sensor"`` or ``"force"``.
    node : int
        Position among the nodes.
    vector : ndarray of float, shape (3,)
        Direction, of length 1; of a rotation or a torque its axis.
    rotation : bool
        Whether it is one.
    label : str
        The DOF.
    """

    kind: str
    node: int
    vector: _Real
    rotation: bool
    label: str


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Mode shapes of one state of the structure.

    Attributes
    ----------
    name : str
        Such as ``"updated"``.
    role : str
        Its colour, one of `ROLES`.
    style : str
        One of `STYLES`; ``"surface"`` is for the first body only.
    body : int
        Which of the bodies of the scene it moves.
    shapes : ndarray of float or complex, shape (s, n, 3)
        Displacements of its nodes in global components, in a unit that all layers of a row share.
    """

    name: str
    role: str
    style: str
    body: int
    shapes: NDArray[np.generic]

    def __post_init__(self) -> None:
        _check_look(self.role, self.style, self.name)


@dataclass(frozen=True, slots=True)
class ModeRow:
    """The shapes that are shown together.

    Attributes
    ----------
    label : str
        What is shown.
    members : tuple of int
        For each layer, which of its shapes; -1: it has none.
    """

    label: str
    members: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ModeShapes:
    """Modes of several states, paired.

    Attributes
    ----------
    layers : sequence of Layer
        The states.
    rows : sequence of ModeRow
        The pairs.
    """

    layers: Sequence[Layer]
    rows: Sequence[ModeRow]


@dataclass(frozen=True, slots=True, eq=False)
class Entries:
    """How the nodes of a body move with the channels that measure them, in sparse form.

    Attributes
    ----------
    dof : ndarray of int, shape (e,)
        Channel of each entry.
    node : ndarray of int, shape (e,)
        Node that it moves.
    vector : ndarray of float, shape (e, 3)
        Displacement of the node for one unit of the channel.
    """

    dof: _Whole
    node: _Whole
    vector: _Real


@dataclass(frozen=True, slots=True, eq=False)
class OperatingLayer:
    """FRFs of one state to one reference.

    Attributes
    ----------
    name, role, style : str
        As of `Layer`.
    values : ndarray of complex, shape (n_f, d)
        FRFs, channel by channel.
    """

    name: str
    role: str
    style: str
    values: NDArray[np.complex128]

    def __post_init__(self) -> None:
        _check_look(self.role, self.style, self.name)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A force, and what moves under it.

    Attributes
    ----------
    name : str
        Its DOF.
    layers : sequence of OperatingLayer
        The states; of each reference the same.
    """

    name: str
    layers: Sequence[OperatingLayer]


@dataclass(frozen=True, slots=True, eq=False)
class OperatingShapes:
    """Operating deflection shapes along the frequency.

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    quantity, unit : str
        Of the FRFs.
    body : int
        Which of the bodies of the scene moves.
    entries : Entries
        How it moves with the channels.
    references : sequence of Reference
        At least one.
    """

    freq: _Real
    quantity: str
    unit: str
    body: int
    entries: Entries
    references: Sequence[Reference]

    def __post_init__(self) -> None:
        for reference in self.references:
            for layer in reference.layers:
                if len(layer.values) != len(self.freq):
                    raise InputError(
                        f"viewer: {len(layer.values)} lines of {layer.name!r} at {reference.name};"
                        f" expected {len(self.freq)}"
                    )


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What a viewer shows.

    Attributes
    ----------
    bodies : sequence of Body
        The structure first; others carry shapes that are known at other nodes, as of a test.
    title : str
        For pictures that are saved.
    colourings : sequence of Colouring
        The first is shown first.
    arrows : sequence of Arrow
        Sensors and forces on the first body.
    modes : ModeShapes, optional
        Mode shapes.
    operating : OperatingShapes, optional
        Operating deflection shapes.
    notes : tuple of str
        What is left out, in sentences for the page around.

    Raises
    ------
    InputError
        If a part names a body, a node, a group or a shape that is not there.
    """

    bodies: Sequence[Body]
    title: str = ""
    colourings: Sequence[Colouring] = ()
    arrows: Sequence[Arrow] = ()
    modes: ModeShapes | None = None
    operating: OperatingShapes | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.bodies:
            raise InputError("viewer: a scene without a body; expected one at least")
        for colouring in self.colourings:
            if len(colouring.step_of_group) != len(self.bodies[0].groups):
                raise InputError(
                    f"viewer: colouring {colouring.name!r} has {len(colouring.step_of_group)}"
                    f" groups; the body has {len(self.bodies[0].groups)}"
                )
        for arrow in self.arrows:
            if not 0 <= arrow.node < self.bodies[0].real:
                raise InputError(
                    f"viewer: {arrow.kind} {arrow.label} at node {arrow.node} of"
                    f" {self.bodies[0].real}, from 0"
                )
        if self.modes is not None:
            _check_modes(self.modes, self.bodies)
        if self.operating is not None and self.operating.body >= len(self.bodies):
            raise InputError(
                f"viewer: operating shapes of body {self.operating.body}; there are"
                f" {len(self.bodies)}, from 0"
            )


def _check_look(role: str, style: str, name: str) -> None:
    for what, given, known in (("role", role, ROLES), ("style", style, STYLES)):
        if given not in known:
            raise InputError(
                f"viewer: {what} {given!r} of layer {name!r}; expected one of {', '.join(known)}"
            )


def _check_modes(modes: ModeShapes, bodies: Sequence[Body]) -> None:
    for layer in modes.layers:
        if not 0 <= layer.body < len(bodies):
            raise InputError(
                f"viewer: layer {layer.name!r} moves body {layer.body} of {len(bodies)}, from 0"
            )
        n = len(bodies[layer.body].nodes)
        if layer.shapes.shape[1:] != (n, 3):
            raise InputError(
                f"viewer: shapes of layer {layer.name!r} of shape {layer.shapes.shape}; expected"
                f" (s, {n}, 3)"
            )
    for row in modes.rows:
        sizes = [len(layer.shapes) for layer in modes.layers]
        if len(row.members) != len(sizes) or any(
            not -1 <= member < size for member, size in zip(row.members, sizes, strict=True)
        ):
            raise InputError(
                f"viewer: row {row.label!r} has members {row.members}; the layers have {sizes}"
                " shapes"
            )
