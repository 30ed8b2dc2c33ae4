"""Constraints between DOFs, and models joined by common DOFs, by a transformation u = T q.

All ties together give u = T q, and each group's matrix A becomes T^T A T, so the model remains a
sum of its groups (Cook, Malkus, Plesha & Witt, Concepts and Applications of Finite Element
Analysis, 4th ed. 2002, section 13.2).
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from updyn.arrays import IndexArray, RealArray
from updyn.dofs import DIRECTIONS, Dof, DofSet, whole_numbers
from updyn.elements.checks import check_node_number, check_vector, set_fields
from updyn.elements.settings import ELEMENT
from updyn.errors import ModelError, suggest
from updyn.geometry import Geometry
from updyn.model import Group, Matrix, Model
from updyn.settings import MESSAGES

__all__ = [
    "Equation",
    "RigidLink",
    "about_axis",
    "along_axis",
    "constrain",
    "join",
    "rigid_link",
]

_LARGEST = sys.float_info.max  # integers may be larger
_TRANSLATIONS = ("X", "Y", "Z")
_ROTATIONS = ("RX", "RY", "RZ")


@dataclass(frozen=True, slots=True)
class Equation:
    """One DOF as a combination of others: u_dof = sum of coefficient times u_other.

    Parameters
    ----------
    dof : str or Dof
        The dependent DOF; it is eliminated from the model.
    terms : mapping of str or Dof to float
        Coefficients by DOF; empty for a fixed DOF. Signs of labels ("3:-X") are applied.

    Raises
    ------
    DofError
        If a label cannot be read.
    ModelError
        If a coefficient is not a finite number, or a DOF occurs twice.
    """

    dof: Dof
    terms: Mapping[Dof, float]

    def __init__(self, dof: str | Dof, terms: Mapping[str, float] | Mapping[Dof, float]) -> None:
        signed = Dof.parse(dof)
        dependent = abs(signed)
        read: dict[Dof, float] = {}
        for label, coefficient in terms.items():
            signed_other = Dof.parse(label)
            other = abs(signed_other)
            if not isinstance(coefficient, int | float | np.number) or isinstance(
                coefficient, bool
            ):
                raise ModelError(
                    f"equation of {dependent}: coefficient {coefficient!r} of {signed_other};"
                    " expected a number"
                )
            if not abs(coefficient) <= _LARGEST:
                raise ModelError(
                    f"equation of {dependent}: coefficient {coefficient!r} of {signed_other} is not"
                    " finite"
                )
            if other in read or other == dependent:
                raise ModelError(f"equation of {dependent}: {other} occurs twice")
            read[other] = float(coefficient) * signed_other.sign * signed.sign
        object.__setattr__(self, "dof", dependent)
        object.__setattr__(self, "terms", read)

    def __str__(self) -> str:
        terms = " ".join(f"{c:+.6g} {dof}" for dof, c in self.terms.items())
        return f"{self.dof} = {terms or '0'}"


@dataclass(frozen=True, slots=True, eq=False)
class RigidLink:
    """Nodes that move rigidly with another; their DOFs are eliminated.

    Parameters
    ----------
    master : int
        The independent node.
    slaves : array_like of int, shape (m,)
        The dependent nodes.
    directions : iterable of str, optional
        Dependent DOFs of the slaves; by default all that they have (X, Y, Z for solids and
        trusses).

    Raises
    ------
    ModelError
        If a node is not a whole number, or a direction is unknown.
    """

    master: int
    slaves: Any
    directions: Any = None

    def __post_init__(self) -> None:
        what = f"rigid link of node {self.master!r}"
        slaves = np.atleast_1d(whole_numbers(self.slaves, f"{what}: slaves", ModelError))
        if slaves.ndim != 1 or not slaves.size:
            raise ModelError(f"{what}: slaves {self.slaves!r}; expected at least one node number")
        set_fields(self, master=check_node_number(what, "master", self.master), slaves=slaves)
        if self.directions is not None:
            wanted = self.directions
            if isinstance(wanted, str):
                wanted = wanted.split()
            if not isinstance(wanted, Iterable):
                raise ModelError(
                    f"{what}: directions {wanted!r}; expected some of {' '.join(DIRECTIONS)}"
                )
            wanted = tuple(wanted)
            for name in wanted:
                if name not in DIRECTIONS:
                    raise ModelError(
                        f"{what}: direction {name!r}; {suggest(str(name), DIRECTIONS)}"
                    )
            set_fields(self, directions=wanted)


def constrain(
    model: Model, equations: Iterable[Equation] = (), grounded: Iterable[str | Dof] = ()
) -> Model:
    """Tie DOFs to each other, and fix DOFs.

    Parameters
    ----------
    model : Model
        The free model.
    equations : iterable of Equation
        Ties; a DOF on the right may itself be tied by another equation.
    grounded : iterable of str or Dof
        Fixed DOFs; they are eliminated.

    Returns
    -------
    Model
        The model on the remaining DOFs, in their order, with the same groups: T^T A T of each
        matrix. A group with only fixed DOFs is kept, with zero matrices.

    Raises
    ------
    ModelError
        If a DOF is tied twice, tied and fixed, or in a loop of ties, or no DOF remains.
    DofError
        If a DOF is not in the model.
    """
    ties = _index_by_dof(equations)
    for dof in map(abs, DofSet(grounded)):
        if dof in ties:
            raise ModelError(f"DOF {dof} is held and tied ({ties[dof]}); only one of them can be")
        ties[dof] = Equation(dof, {})
    if not ties:
        return model
    model.refuse_nonlinear("constrain")
    T, remaining = _transformation(model.dofs, list(ties.values()))
    if not len(remaining):
        raise ModelError("every DOF of the model is fixed or tied: the model has no free DOF")
    groups = {name: _transform_group(group, T) for name, group in model.groups.items()}
    return Model(groups, model.dofs[remaining], model.geometry, model.title)


def _index_by_dof(equations: Iterable[Equation]) -> dict[Dof, Equation]:
    out: dict[Dof, Equation] = {}
    for equation in equations:
        if not isinstance(equation, Equation):
            raise ModelError(f"expected an Equation, found {type(equation).__name__}")
        if equation.dof in out:
            raise ModelError(f"DOF {equation.dof} is tied twice: {out[equation.dof]}; {equation}")
        out[equation.dof] = equation
    return out


def _transformation(dofs: DofSet, ties: Sequence[Equation]) -> tuple[Matrix, IndexArray]:
    """Return T, shape (N, q), and the remaining DOFs, shape (q,)."""
    n = len(dofs)
    dependent = dofs.match([tie.dof for tie in ties], "held or tied DOF").index
    rows: list[int] = []
    terms: list[Dof] = []
    values: list[float] = []
    for row, tie in zip(dependent.tolist(), ties, strict=True):
        rows += [row] * len(tie.terms)
        terms += tie.terms.keys()
        values += tie.terms.values()
    distinct = list(dict.fromkeys(terms))
    place = dict(zip(distinct, dofs.match(distinct, "DOF of an equation").index, strict=True))
    columns = np.array([place[dof] for dof in terms], dtype=np.intp)
    tied = np.zeros(n, dtype=np.bool_)
    tied[dependent] = True
    free = np.flatnonzero(~tied)
    tie_matrix = sp.csr_array((values, (np.array(rows, dtype=np.intp), columns)), shape=(n, n))
    tie_matrix.eliminate_zeros()
    _check_no_loop(tie_matrix[dependent][:, dependent], ties)
    T = tie_matrix + sp.csr_array((np.ones(len(free)), (free, free)), shape=(n, n))
    while tied[T.indices].any():  # each product halves the length of the chains
        T = sp.csr_array(T @ T)
        T.eliminate_zeros()
    return sp.csr_array(T[:, free]), free


def _check_no_loop(among_ties: Matrix, ties: Sequence[Equation]) -> None:
    count, component = connected_components(among_ties, directed=True, connection="strong")
    if count < len(ties):
        looped = np.flatnonzero(component == np.argmax(np.bincount(component)))
        shown = "; ".join(str(ties[i]) for i in looped[: MESSAGES.listed_items])
        raise ModelError(f"the equations run in a loop: {shown}")


def _transform_group(group: Group, T: Matrix) -> Group:
    def change(A: Matrix) -> Matrix:
        B = T.T @ A @ T
        return 0.5 * (B + B.T)  # rounding makes the two halves of the products differ

    return group.transformed(change, T)


def rigid_link(
    geometry: Geometry, master: int, slaves: Iterable[int], directions: Iterable[str] = DIRECTIONS
) -> list[Equation]:
    """Return the equations of nodes that move rigidly with another.

    Parameters
    ----------
    geometry : Geometry
        Positions of the nodes in m. Rotated displacement directions are not supported.
    master : int
        The independent node; all six of its DOFs must be in the model.
    slaves : iterable of int
        The dependent nodes.
    directions : iterable of str
        Dependent DOFs of the slaves; by default all six. Nodes of solids have X, Y, Z only.

    Returns
    -------
    list of Equation
        u_slave = u_master + theta_master x r, theta_slave = theta_master, r from master to slave
        (small rotations).

    Raises
    ------
    InputError
        If a node has no position.
    ModelError
        If a direction is unknown, or the master is a slave.
    """
    wanted = tuple(directions)
    for name in wanted:
        if name not in DIRECTIONS:
            raise ModelError(
                f"rigid link of node {master}: direction {name!r}; {suggest(str(name), DIRECTIONS)}"
            )
    if geometry.axes is not None:
        raise ModelError(
            "rigid link: the geometry has nodes with displacement directions of their own"
        )
    followers = list(slaves)
    if master in followers:
        raise ModelError(f"rigid link: node {master} cannot follow itself")
    (start,) = geometry.position([master])
    out = []
    for node, (rx, ry, rz) in zip(followers, geometry.position(followers) - start, strict=True):
        by_rotation = {
            "X": {"RY": rz, "RZ": -ry},
            "Y": {"RX": -rz, "RZ": rx},
            "Z": {"RX": ry, "RY": -rx},
        }
        for name in wanted:
            terms = {f"{master}:{name}": 1.0}
            for rotation, arm in by_rotation.get(name, {}).items():
                if arm != 0.0:
                    terms[f"{master}:{rotation}"] = arm
            out.append(Equation(f"{node}:{name}", terms))
    return out


def along_axis(dof: str | Dof, node: int, axis: ArrayLike) -> Equation:
    """Return the equation that makes a DOF the translation of a node along an axis.

    Parameters
    ----------
    dof : str or Dof
        The dependent DOF.
    node : int
        Node of the structure.
    axis : array_like of float, shape (3,)
        Direction in the displacement system of the node; any length.

    Returns
    -------
    Equation
        u_dof = a . (u_X, u_Y, u_Z), a of length 1.

    Raises
    ------
    ModelError
        If the axis is not three finite numbers, or zero.
    """
    return _combine_directions(dof, node, axis, _TRANSLATIONS)


def about_axis(dof: str | Dof, node: int, axis: ArrayLike) -> Equation:
    """Return the equation that makes a DOF the rotation of a node about an axis.

    Parameters
    ----------
    dof, node, axis
        As for `along_axis`.

    Returns
    -------
    Equation
        u_dof = a . (theta_X, theta_Y, theta_Z), a of length 1.

    Raises
    ------
    ModelError
        If the axis is not three finite numbers, or zero.
    """
    return _combine_directions(dof, node, axis, _ROTATIONS)


def _combine_directions(
    dof: str | Dof, node: int, axis: ArrayLike, names: tuple[str, ...]
) -> Equation:
    along = check_vector(f"equation of {dof}", "axis", axis)
    unit = along / np.linalg.norm(along)
    terms = {}
    for name, component in zip(names, unit.tolist(), strict=True):
        if component != 0.0:
            terms[f"{node}:{name}"] = component
    return Equation(dof, terms)


def join(models: Iterable[Model], title: str = "") -> Model:
    """Join models into one: DOFs of the same label are the same DOF.

    Parameters
    ----------
    models : iterable of Model
        The models. Group names must differ.
    title : str
        Title, for documentation.

    Returns
    -------
    Model
        All groups, on the union of the DOFs in order of first appearance.

    Raises
    ------
    ModelError
        If there is no model, two models share a group name, or a node has two positions.
    """
    parts = list(models)
    if not parts:
        raise ModelError("join: there is no model")
    names: dict[str, int] = {}
    for number, part in enumerate(parts, 1):
        part.refuse_nonlinear(f"join, model {number}")
        for name in part.groups:
            if name in names:
                raise ModelError(
                    f"join: models {names[name]} and {number} both have a group {name!r}; rename"
                    " one of them"
                )
            names[name] = number
    labels = DofSet(dict.fromkeys(dof for part in parts for dof in part.dofs))
    groups: dict[str, Group] = {}
    for part in parts:
        n = part.n_dofs
        at = labels.match(part.dofs).index
        P = sp.csr_array((np.ones(n), (np.arange(n), at)), shape=(n, len(labels)))
        for name, group in part.groups.items():
            groups[name] = _transform_group(group, P)
    geometries = [part.geometry for part in parts if part.geometry is not None]
    return Model(groups, labels, _joined_geometry(geometries), title)


def _joined_geometry(parts: Sequence[Geometry]) -> Geometry | None:
    if not parts:
        return None
    nodes = np.concatenate([geometry.nodes for geometry in parts])
    xyz = np.concatenate([geometry.xyz for geometry in parts])
    axes = np.concatenate([_axes(geometry) for geometry in parts])
    _, first, place = np.unique(nodes, return_index=True, return_inverse=True)
    size = max(float(np.ptp(xyz, axis=0).max()), 1e-300)
    differs = np.abs(xyz - xyz[first][place]).max(axis=1) > ELEMENT.rounding * size
    differs |= np.abs(axes - axes[first][place]).max(axis=(1, 2)) > ELEMENT.rounding
    if differs.any():
        i = int(np.argmax(differs))
        raise ModelError(
            f"join: node {nodes[i]} is at {xyz[first][place][i]} in one model, {xyz[i]} in another"
        )
    lines = np.unique(np.concatenate([np.sort(g.lines, axis=1) for g in parts]), axis=0)
    faces = np.unique(np.concatenate([g.faces for g in parts]), axis=0)
    order = np.sort(first)
    if all(geometry.axes is None for geometry in parts):
        return Geometry(nodes[order], xyz[order], lines, faces=faces)
    return Geometry(nodes[order], xyz[order], lines, axes[order], faces)


def _axes(geometry: Geometry) -> RealArray:
    """Return the displacement directions of all nodes, shape (n, 3, 3)."""
    if geometry.axes is None:
        return np.tile(np.eye(3), (len(geometry.nodes), 1, 1))
    return geometry.axes
