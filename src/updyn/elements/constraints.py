"""Joining models and tying their DOFs together: one sparse transformation u = T q of every group.

A tie is an `Equation`: one DOF moves as a fixed combination of others (a rigid link, a gear of
fixed ratio, a multi-point constraint). With all of them u = T q, and each group's matrix A becomes
T^T A T, so that the model stays a sum of its groups (Cook, Malkus, Plesha & Witt, Concepts and
Applications of Finite Element Analysis, 4th ed. 2002, section 13.2).
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from updyn.dofs import DIRECTIONS, Dof, DofSet, whole_numbers
from updyn.elements.checks import node_number, store
from updyn.errors import ModelError, suggest
from updyn.geometry import Geometry
from updyn.model import Group, Matrix, Model

__all__ = [
    "Equation",
    "RigidLink",
    "about_axis",
    "along_axis",
    "constrain",
    "join",
    "rigid_link",
]

_LARGEST = sys.float_info.max  # a whole number may be larger
_SHOWN = 6  # equations of a loop that are named
_TRANSLATIONS, _ROTATIONS = ("X", "Y", "Z"), ("RX", "RY", "RZ")


@dataclass(frozen=True, slots=True)
class Equation:
    """One DOF as a combination of others: u_dof = sum of coefficient times u_other.

    Parameters
    ----------
    dof : str or Dof
        The dependent DOF; it vanishes from the model.
    terms : mapping of str or Dof to float
        Coefficients by DOF; empty: the DOF is held. Signs of labels ("3:-X") count.

    Raises
    ------
    DofError
        If a label cannot be read.
    ModelError
        If a coefficient is not a finite number, or a DOF stands twice.
    """

    dof: Dof
    terms: Mapping[Dof, float]

    def __init__(self, dof: str | Dof, terms: Mapping[str, float] | Mapping[Dof, float]) -> None:
        own = Dof.parse(dof)
        positive = own if own.sign > 0 else -own
        seen: dict[Dof, float] = {}
        for label, coefficient in terms.items():
            other = Dof.parse(label)
            if isinstance(coefficient, bool) or not isinstance(
                coefficient, int | float | np.number
            ):
                raise ModelError(
                    f"equation of {positive}: coefficient {coefficient!r} of {other}; expected a"
                    " number"
                )
            if not abs(coefficient) <= _LARGEST:
                raise ModelError(
                    f"equation of {positive}: coefficient {coefficient!r} of {other} is not finite"
                )
            plain = other if other.sign > 0 else -other
            if plain in seen or plain == positive:
                raise ModelError(f"equation of {positive}: {plain} stands twice")
            seen[plain] = float(coefficient) * other.sign * own.sign
        object.__setattr__(self, "dof", positive)
        object.__setattr__(self, "terms", seen)

    def __str__(self) -> str:
        return f"{self.dof} = " + (" ".join(f"{c:+.6g} {d}" for d, c in self.terms.items()) or "0")


@dataclass(frozen=True, slots=True, eq=False)
class RigidLink:
    """Nodes that move rigidly with another; their own DOFs vanish.

    Parameters
    ----------
    master : int
        The node that leads.
    slaves : array_like of int, shape (m,)
        The nodes that follow.
    directions : iterable of str, optional
        Which of their DOFs follow. None: all that they have (of solids and trusses X, Y, Z).

    Raises
    ------
    ModelError
        If a node is not a whole number, or a direction is not known.
    """

    master: int
    slaves: Any
    directions: Any = None

    def __post_init__(self) -> None:
        what = f"rigid link of node {self.master!r}"
        slaves = np.atleast_1d(whole_numbers(self.slaves, f"{what}: slaves", ModelError))
        if slaves.ndim != 1 or not slaves.size:
            raise ModelError(f"{what}: slaves {self.slaves!r}; expected at least one node number")
        store(self, master=node_number(what, "master", self.master), slaves=slaves)
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
            store(self, directions=wanted)


def constrain(
    model: Model, equations: Iterable[Equation] = (), grounded: Iterable[str | Dof] = ()
) -> Model:
    """Tie DOFs to each other, and hold some.

    Parameters
    ----------
    model : Model
        The free model.
    equations : iterable of Equation
        Ties; a DOF on the right may itself be tied by another equation.
    grounded : iterable of str or Dof
        DOFs that are held; they vanish.

    Returns
    -------
    Model
        The model on the DOFs that are left, in their order, with the same groups: T^T A T of each
        matrix. A group none of whose matrices moves any more is left as zero matrices, so that its
        name stays known.

    Raises
    ------
    ModelError
        If a DOF is tied twice, tied and held, or by a loop; or no DOF is left.
    DofError
        If a DOF is not in the model.
    """
    ties = {e.dof: e for e in _once(equations)}
    held = DofSet(grounded)
    for dof in held:
        plain = dof if dof.sign > 0 else -dof
        if plain in ties:
            raise ModelError(
                f"DOF {plain} is held and tied ({ties[plain]}); only one of them can be"
            )
        ties[plain] = Equation(plain, {})
    if not ties:
        return model
    T, left = _transformation(model.dofs, list(ties.values()))
    if not len(left):
        raise ModelError("every DOF of the model is held or tied: nothing is left to move")
    groups = {name: _moved(group, T) for name, group in model.groups.items()}
    return Model(groups, model.dofs[left], model.geometry, model.title)


def _once(equations: Iterable[Equation]) -> list[Equation]:
    seen: dict[Dof, Equation] = {}
    for equation in equations:
        if not isinstance(equation, Equation):
            raise ModelError(f"expected an Equation, found {type(equation).__name__}")
        if equation.dof in seen:
            raise ModelError(f"DOF {equation.dof} is tied twice: {seen[equation.dof]}; {equation}")
        seen[equation.dof] = equation
    return list(seen.values())


def _transformation(dofs: DofSet, ties: Sequence[Equation]) -> tuple[Matrix, NDArray[np.intp]]:
    """Return T, shape (N, q), and the DOFs that are left, shape (q,)."""
    n = len(dofs)
    own = dofs.match([t.dof for t in ties], "held or tied DOF").index
    owner = np.repeat(np.arange(len(ties)), [len(t.terms) for t in ties])
    others = dofs.match([*dict.fromkeys(d for t in ties for d in t.terms)], "DOF of an equation")
    place = dict(
        zip(dict.fromkeys(d for t in ties for d in t.terms), others.index.tolist(), strict=True)
    )
    columns = np.array([place[d] for t in ties for d in t.terms], dtype=np.intp)
    values = np.array([c for t in ties for c in t.terms.values()])
    tied = np.zeros(n, dtype=np.bool_)
    tied[own] = True
    free = np.flatnonzero(~tied)
    tie = sp.csr_array((values, (own[owner], columns)), shape=(n, n))
    tie.eliminate_zeros()
    T = tie + sp.csr_array((np.ones(len(free)), (free, free)), shape=(n, n))
    among = tie[own][:, own]
    count, component = connected_components(among, directed=True, connection="strong")
    if count < len(ties):
        looped = np.flatnonzero(component == np.argmax(np.bincount(component)))
        raise ModelError(
            "the equations run in a loop: " + "; ".join(str(ties[i]) for i in looped[:_SHOWN])
        )
    while tied[T.indices].any():  # each product halves the chains that are left
        T = sp.csr_array(T @ T)
        T.eliminate_zeros()
    return sp.csr_array(T[:, free]), free


def _moved(group: Group, T: Matrix) -> Group:
    def moved(A: Matrix | None) -> Matrix | None:
        if A is None:
            return None
        B = T.T @ A @ T
        return 0.5 * (B + B.T)  # the products round the two halves differently

    return group.with_matrices(moved(group.stiffness), moved(group.mass), moved(group.viscous))


def rigid_link(
    geometry: Geometry, master: int, slaves: Iterable[int], directions: Iterable[str] = DIRECTIONS
) -> list[Equation]:
    """Return equations that carry nodes rigidly with another.

    Parameters
    ----------
    geometry : Geometry
        Where the nodes stand, in m. Rotated displacement directions are not supported.
    master : int
        The node that leads; all six of its DOFs have to be in the model.
    slaves : iterable of int
        The nodes that follow.
    directions : iterable of str
        Which of their DOFs follow; all six if nothing is said. Solid nodes have X, Y, Z only.

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
        If a direction is not known, or a node follows itself.
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
    out = []
    (start,) = geometry.position([master])
    for node, (rx, ry, rz) in zip(followers, geometry.position(followers) - start, strict=True):
        turned = {
            "X": {"RY": rz, "RZ": -ry},
            "Y": {"RX": -rz, "RZ": rx},
            "Z": {"RX": ry, "RY": -rx},
        }
        for name in wanted:
            arms = {f"{master}:{r}": arm for r, arm in turned.get(name, {}).items() if arm != 0.0}
            out.append(Equation(f"{node}:{name}", {f"{master}:{name}": 1.0, **arms}))
    return out


def along_axis(dof: str | Dof, node: int, axis: ArrayLike) -> Equation:
    """Return the equation of a DOF that is the translation of a node along an axis.

    Parameters
    ----------
    dof : str or Dof
        The dependent DOF.
    node : int
        Node of the structure.
    axis : array_like of float, shape (3,)
        Direction in the node's own system; any length.

    Returns
    -------
    Equation
        u_dof = a . (u_X, u_Y, u_Z), a of length 1.

    Raises
    ------
    ModelError
        If the axis is not three finite numbers, or zero.
    """
    return _combined(dof, node, axis, _TRANSLATIONS)


def about_axis(dof: str | Dof, node: int, axis: ArrayLike) -> Equation:
    """Return the equation of a DOF that is the rotation of a node about an axis, as a drive train on a structure.

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
    return _combined(dof, node, axis, _ROTATIONS)


def _combined(dof: str | Dof, node: int, axis: ArrayLike, names: tuple[str, ...]) -> Equation:
    try:
        vector = np.asarray(axis, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"axis of {dof}: {axis!r}; expected three numbers") from error
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ModelError(
            f"axis of {dof}: {axis!r}; expected three finite numbers that are not all 0"
        )
    unit = vector / np.linalg.norm(vector)
    return Equation(
        dof, {f"{node}:{name}": float(a) for name, a in zip(names, unit, strict=True) if a != 0.0}
    )


def join(models: Iterable[Model], title: str = "") -> Model:
    """Join models into one: what has the same label is the same DOF.

    Parameters
    ----------
    models : iterable of Model
        The parts. Group names have to differ.
    title : str
        For the record.

    Returns
    -------
    Model
        All groups on the DOFs of all, in the order of their first appearance.

    Raises
    ------
    ModelError
        If there is none, a group name stands in two of them, or a node has two positions.
    """
    parts = list(models)
    if not parts:
        raise ModelError("join: there is no model")
    names: dict[str, int] = {}
    for number, part in enumerate(parts, 1):
        for name in part.groups:
            if name in names:
                raise ModelError(
                    f"join: models {names[name]} and {number} both have a group {name!r}; rename"
                    " one of them"
                )
            names[name] = number
    labels = DofSet(dict.fromkeys(d for part in parts for d in part.dofs))
    groups: dict[str, Group] = {}
    for part in parts:
        at = labels.match(part.dofs).index
        P = sp.csr_array((np.ones(len(at)), (np.arange(len(at)), at)), shape=(len(at), len(labels)))
        groups |= {name: _moved(group, P) for name, group in part.groups.items()}
    return Model(
        groups, labels, _merged([p.geometry for p in parts if p.geometry is not None]), title
    )


def _merged(parts: Sequence[Geometry]) -> Geometry | None:
    if not parts:
        return None
    nodes = np.concatenate([g.nodes for g in parts])
    xyz = np.concatenate([g.xyz for g in parts])
    axes = np.concatenate(
        [np.tile(np.eye(3), (len(g.nodes), 1, 1)) if g.axes is None else g.axes for g in parts]
    )
    _, first, place = np.unique(nodes, return_index=True, return_inverse=True)
    off = np.abs(xyz - xyz[first][place]).max(axis=1) > 1e-9 * max(
        float(np.ptp(xyz, axis=0).max()), 1e-300
    )
    off |= np.abs(axes - axes[first][place]).max(axis=(1, 2)) > 1e-9
    if off.any():
        node = nodes[off][0]
        raise ModelError(
            f"join: node {node} stands at {xyz[first][place][off][0]} in one model, {xyz[off][0]}"
            " in another"
        )
    lines = np.unique(np.concatenate([np.sort(g.lines, axis=1) for g in parts]), axis=0)
    rotated = any(g.axes is not None for g in parts)
    order = np.sort(first)
    return Geometry(nodes[order], xyz[order], lines, axes[order] if rotated else None)
