"""`Scene`: the content of a viewer as plain arrays, independent of models and results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.arrays import ComplexArray, IndexArray, IntArray, RealArray
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
    "Scale",
    "Scene",
]


#: Colours of layers: the three states of an update, a model outside an update, and others.
ROLES = (*STATES.values(), "plain", "third")
#: Styles of layers: faces in the colours of the groups, lines, nodes with lines, or dashed grey
#: lines that are hidden at first.
STYLES = ("surface", "wire", "dots", "ghost")


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Nodes with the lines, faces and points between them.

    Attributes
    ----------
    name : str
        Name such as ``"model"`` or ``"test"``.
    nodes : ndarray of int, shape (n,)
        Node numbers. Nodes on the rims of discs come last and have the number of the node at the
        centre of the disc.
    xyz : ndarray of float, shape (n, 3)
        Positions in m.
    lines : ndarray of int, shape (m, 2)
        Ends of the lines, as positions in `nodes`.
    line_group : ndarray of int, shape (m,)
        Groups of the lines, as positions in `groups`; -1 for none.
    faces : ndarray of int, shape (k, 3)
        Corners of triangles, as positions in `nodes`.
    face_group : ndarray of int, shape (k,)
        Groups of the triangles, as positions in `groups`; -1 for none.
    points : ndarray of int, shape (p,)
        Nodes drawn as squares (lumped masses, springs to the ground), as positions in `nodes`.
    point_group : ndarray of int, shape (p,)
        Groups of the squares, as positions in `groups`; -1 for none.
    groups : tuple of str
        Names of the groups.
    real : int
        Number of nodes that are not on the rim of a disc.
    disc : float
        Radius of the discs in m. Discs show the rotation of nodes without translations.
    """

    name: str
    nodes: IntArray
    xyz: RealArray
    lines: IndexArray
    line_group: IndexArray
    faces: IndexArray
    face_group: IndexArray
    points: IndexArray
    point_group: IndexArray
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
class Scale:
    """A continuous colour scale, with the place of each group.

    Attributes
    ----------
    colours : sequence of str
        Colours at even distances from 0 to 1, by the names that steps of a `Colouring` have.
    ticks : sequence of (float, str)
        Place from 0 to 1 and text of each tick of the legend.
    of_group : sequence of float
        Place of each group from 0 to 1; nan for groups whose colour is that of their step.
    by_row : sequence of (sequence of float)
        Places for each row of the modes, if they depend on the mode.
    """

    colours: Sequence[str]
    ticks: Sequence[tuple[float, str]]
    of_group: Sequence[float]
    by_row: Sequence[Sequence[float]] = ()

    def __post_init__(self) -> None:
        ticks = [place for place, _ in self.ticks]
        for places in (ticks, self.of_group, *self.by_row):
            wrong = [place for place in places if not (np.isnan(place) or 0.0 <= place <= 1.0)]
            if wrong:
                raise InputError(f"viewer: place {wrong[0]:g} on a colour scale; expected 0 to 1")


@dataclass(frozen=True, slots=True, eq=False)
class Colouring:
    """A colour for each group of the first body.

    Attributes
    ----------
    name, unit : str
        Quantity shown by the colours, and its unit, which may be empty.
    steps : sequence of (str, str)
        Colour and text of each step of the legend. Colours are names of variables of ``viewer.css``
        without their ``--v-``: ``less-4`` to ``more-4``, ``seq-0`` to ``seq-7``, ``same``,
        ``none``.
    step_of_group : sequence of int
        Step of each group; -1 for ``none``.
    texts : sequence of str
        Text about each group, shown when one of its nodes is selected.
    by_row : sequence of (sequence of int, sequence of str)
        Steps and texts for each row of the modes, if they depend on the mode.
    scale : Scale, optional
        Continuous colours, which replace the steps of the groups that have a place on the scale.
    labels : sequence of str
        Label of each group in the picture; empty for none.
    """

    name: str
    unit: str
    steps: Sequence[tuple[str, str]]
    step_of_group: Sequence[int]
    texts: Sequence[str]
    by_row: Sequence[tuple[Sequence[int], Sequence[str]]] = ()
    scale: Scale | None = None
    labels: Sequence[str] = ()

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
        places = [] if self.scale is None else [self.scale.of_group, *self.scale.by_row]
        for what, given in (("labels", [self.labels] if self.labels else []), ("places", places)):
            for one in given:
                if len(one) != groups:
                    raise InputError(
                        f"viewer: colouring {self.name!r} has {len(one)} {what}; expected one for"
                        f" each of {groups} groups"
                    )


@dataclass(frozen=True, slots=True, eq=False)
class Arrow:
    """A sensor or a force at a node of the first body.

    Attributes
    ----------
    kind : str
        ``"sensor"`` or ``"force"``.
    node : int
        Position in the nodes of the body.
    vector : ndarray of float, shape (3,)
        Unit vector of the direction, or of the axis of a rotation or torque.
    rotation : bool
        Whether it is a rotation or torque.
    label : str
        Label of the DOF.
    """

    kind: str
    node: int
    vector: RealArray
    rotation: bool
    label: str


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """Mode shapes of one state of the structure.

    Attributes
    ----------
    name : str
        Name such as ``"updated"``.
    role : str
        Colour, one of `ROLES`.
    style : str
        One of `STYLES`; ``"surface"`` is allowed for the first body only.
    body : int
        Position of the animated body in the scene.
    shapes : ndarray of float or complex, shape (s, n, 3)
        Displacements of its nodes in global components, in a unit common to all layers of a row.
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
    """Mode shapes that are shown together.

    Attributes
    ----------
    label : str
        Text of the row.
    members : tuple of int
        Number of the shape in each layer; -1 for none.
    """

    label: str
    members: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ModeShapes:
    """Paired modes of several states.

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
    """The linear map from measurement channels to displacements of a body's nodes, in sparse form.

    Attributes
    ----------
    dof : ndarray of int, shape (e,)
        Channel of each entry.
    node : ndarray of int, shape (e,)
        Node that the channel moves.
    vector : ndarray of float, shape (e, 3)
        Displacement of the node for a unit value of the channel.
    """

    dof: IndexArray
    node: IndexArray
    vector: RealArray


@dataclass(frozen=True, slots=True, eq=False)
class OperatingLayer:
    """FRFs of one state to one reference.

    Attributes
    ----------
    name, role, style : str
        As in `Layer`.
    values : ndarray of complex, shape (n_f, d)
        FRFs, one column per channel.
    """

    name: str
    role: str
    style: str
    values: ComplexArray

    def __post_init__(self) -> None:
        _check_look(self.role, self.style, self.name)


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """A force and the operating shapes that it excites.

    Attributes
    ----------
    name : str
        Label of its DOF.
    layers : sequence of OperatingLayer
        The states, the same for every reference.
    """

    name: str
    layers: Sequence[OperatingLayer]


@dataclass(frozen=True, slots=True, eq=False)
class OperatingShapes:
    """Operating deflection shapes over frequency.

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    quantity, unit : str
        Quantity and unit of the FRFs.
    body : int
        Position of the animated body in the scene.
    entries : Entries
        Map from channels to displacements.
    references : sequence of Reference
        At least one reference.
    """

    freq: RealArray
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
    """The content of a viewer.

    Attributes
    ----------
    bodies : sequence of Body
        The structure, followed by bodies for shapes known at other nodes, such as those of a test.
    title : str
        Title, used for saved pictures.
    colourings : sequence of Colouring
        Colourings; the first one is active at the start.
    arrows : sequence of Arrow
        Sensors and forces on the first body.
    modes : ModeShapes, optional
        Mode shapes.
    operating : OperatingShapes, optional
        Operating deflection shapes.
    notes : tuple of str
        Sentences about omitted items, for the surrounding page.

    Raises
    ------
    InputError
        If a part refers to a body, node, group or shape that does not exist.
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
