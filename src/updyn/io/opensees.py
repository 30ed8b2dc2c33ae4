"""A model from a running OpenSees interpreter (openseespy), group by group.

OpenSees has no command that returns the contribution of an element, but the damping of an element
is alphaM times its mass plus betaK times its tangent stiffness (Element::getDamp). If all factors
except those of one group are zero, C of the integrator GimmeMCK is K or M of that group. The sum of
all groups has to equal the totals.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import scipy.sparse as sp

from updyn.arrays import IntArray, RealArray
from updyn.dofs import DofSet
from updyn.errors import ModelError, OptionError
from updyn.geometry import Geometry
from updyn.io.consistent_units import find_units
from updyn.io.settings import MATRIX_FILE
from updyn.model import Group, Model
from updyn.shapes import (
    HEXAHEDRON,
    LINE,
    QUADRANGLE,
    TETRAHEDRON,
    TRIANGLE,
    Shape,
    unique_edges,
    unique_faces,
)

__all__ = ["from_opensees"]

#: Direction of each degree of freedom of a node, by number of dimensions and of degrees of freedom.
_DIRECTIONS = {
    (1, 1): (0,),
    (2, 2): (0, 1),
    (2, 3): (0, 1, 5),
    (3, 3): (0, 1, 2),
    (3, 6): (0, 1, 2, 3, 4, 5),
}
#: Shapes by number of nodes and a part of the name of the type; other types are drawn as lines.
_SHAPES = (
    (3, ("tri", "shell"), TRIANGLE),
    (4, ("tetra",), TETRAHEDRON),
    (4, ("quad", "shell"), QUADRANGLE),
    (8, ("brick",), HEXAHEDRON),
)
_LINES = {2: LINE, 3: TRIANGLE, 4: QUADRANGLE, 8: HEXAHEDRON}
#: Commands that the OpenSees module must have.
_COMMANDS = ("getNodeTags", "printA", "setElementRayleighDampingFactors")


def from_opensees(
    ops: Any,
    groups: Mapping[str, Iterable[int]] | None = None,
    *,
    masses: Mapping[str, Iterable[int]] | None = None,
    unit: str = "m",
    loss_factor: float = 0.0,
    rayleigh: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
) -> Model:
    """Return the model that is loaded in OpenSees, in its present state.

    Nodes, elements, loads and displacements do not change. Analysis objects and eigenvectors are
    replaced, and the Rayleigh factors of all elements and nodes are set to `rayleigh` at the end,
    because OpenSees does not return their previous values.

    Parameters
    ----------
    ops : module
        ``openseespy.opensees`` with a model.
    groups : mapping of str to iterable of int, optional
        Element tags by group name; elements in no group are "remaining". By default one group for
        each type of element, with the name of the type in OpenSees.
    masses : mapping of str to iterable of int, optional
        Node tags by group name, for masses at nodes (command ``mass``); nodes in no group, by
        default all nodes, are "nodal mass".
    unit : {"m", "mm", "in"}
        Consistent units of the model by their unit of length: m-N-kg, mm-N-t, in-lbf, all with
        seconds.
    loss_factor : float
        Structural loss factor of every group with stiffness.
    rayleigh : (float, float, float, float)
        alphaM, betaK, betaKinit, betaKcomm, set at the end.

    Returns
    -------
    Model
        In SI, with the equations of the handler "Transformation": constrained degrees of freedom
        are condensed exactly. Damping of OpenSees (dashpots, previous Rayleigh factors) is the
        group "damping".

    Raises
    ------
    ModelError
        If there is no model, it is larger than 4000 equations, a degree of freedom is neither
        displacement nor rotation (pressures), K, M or C is unsymmetric, or groups do not add up
        because elements of several groups ignore Rayleigh damping (``zeroLength``, ``truss`` and
        others, unless created with ``'-doRayleigh', 1``).
    OptionError
        If an option is not valid.
    """
    units = find_units(unit)
    if not all(hasattr(ops, name) for name in _COMMANDS):
        raise OptionError(
            f"ops: expected the module openseespy.opensees (3.5 or later), found {ops!r}"
        )
    if len(rayleigh) != 4:
        raise OptionError(f"rayleigh={rayleigh!r}: expected alphaM, betaK, betaKinit, betaKcomm")
    elements = _groups_of_elements(ops, groups)
    at_nodes = _groups_of_masses(ops, masses)
    taken = set(elements) & {*at_nodes, "damping"}
    if taken or "damping" in at_nodes:
        raise OptionError(
            f"group {min(taken or {'damping'})!r} occurs twice: expected different names for"
            " groups of elements, of masses and 'damping'"
        )
    _check_free(ops)
    assembly = _OpenSeesAssembly(ops)
    dofs = _equation_dofs(ops, assembly.size)
    parts = _split_groups(ops, assembly, dofs, elements, at_nodes, rayleigh)
    out: dict[str, Group] = {}
    for name, found in parts.items():
        matrices = {}
        for what, matrix in found.items():
            if matrix.any():
                matrices[what] = units.to_si(sp.csr_array(matrix), dofs)
        if matrices:
            gamma = loss_factor if "stiffness" in matrices else 0.0
            out[name] = Group(**matrices, loss_factor=gamma)
    return Model.from_groups(out, dofs, geometry=_geometry(ops, units.length))


# -- groups and degrees of freedom --------------------------------------------------------------
def _groups_of_elements(
    ops: Any, groups: Mapping[str, Iterable[int]] | None
) -> dict[str, list[int]]:
    tags = list(map(int, ops.getEleTags() or []))
    if not tags:
        raise ModelError("OpenSees holds no element; build the model before this call")
    by_type: dict[str, list[int]] = {}
    for tag in tags:
        kind = str(ops.eleType(tag))
        if "UP" in kind:
            raise ModelError(
                f"element {tag} ({kind}) has pore pressures; expected only displacements and"
                " rotations"
            )
        by_type.setdefault(kind, []).append(tag)
    if groups is None:
        return by_type
    out = _check_groups(groups, set(tags), "element")
    rest = set(tags).difference(*out.values())
    if rest and "remaining" in out:
        raise OptionError(
            "groups: the name 'remaining' is reserved for elements in no group; choose another name"
        )
    if rest:
        out["remaining"] = sorted(rest)
    return out


def _groups_of_masses(ops: Any, masses: Mapping[str, Iterable[int]] | None) -> dict[str, list[int]]:
    nodes = set(map(int, ops.getNodeTags() or []))
    heavy = {node for node in nodes if any(ops.nodeMass(node))}
    out = {} if masses is None else _check_groups(masses, nodes, "node")
    for name, part in out.items():
        for node in part:
            if node not in heavy:
                raise OptionError(f"masses: {name!r}: node {node} has no mass (command mass)")
    rest = heavy.difference(*out.values())
    if rest:
        out["nodal mass"] = sorted(rest)
    return out


def _check_groups(
    groups: Mapping[str, Iterable[int]], existing: set[int], what: str
) -> dict[str, list[int]]:
    if not isinstance(groups, Mapping):
        raise OptionError(
            f"groups: expected a mapping of name to {what} tags, found {type(groups).__name__}"
        )
    out: dict[str, list[int]] = {}
    owner: dict[int, str] = {}
    for name, tags in groups.items():
        part = list(map(int, tags))
        if not part:
            raise OptionError(f"group {name!r} is empty; expected {what} tags")
        for tag in part:
            if tag not in existing:
                near = sorted(existing, key=lambda t: (abs(t - tag), t))[:3]
                raise OptionError(
                    f"group {name!r}: no {what} {tag}; nearest: {', '.join(map(str, near))}"
                )
            if owner.setdefault(tag, name) != name:
                raise OptionError(
                    f"{what} {tag} is in {owner[tag]!r} and in {name!r}; expected one group each"
                )
        out[str(name)] = sorted(set(part))
    return out


def _check_free(ops: Any) -> None:
    """Refuse a model without equations, because OpenSees would exit when it forms its matrices."""
    count = 0
    for node in ops.getNodeTags():
        count += int(ops.getNDF(int(node))[0])
    held: set[tuple[int, int]] = set()
    for node in map(int, ops.getFixedNodes() or []):
        held |= {(node, int(dof)) for dof in ops.getFixedDOFs(node)}
    for node in map(int, ops.getConstrainedNodes() or []):
        held |= {(node, int(dof)) for dof in ops.getConstrainedDOFs(node)}
    if len(held) >= count:
        raise ModelError("OpenSees has no equation to solve: every degree of freedom is fixed")


def _equation_dofs(ops: Any, size: int) -> DofSet:
    nodes = np.zeros(size, dtype=np.int64)
    axes = np.full(size, -1, dtype=np.int64)
    tied = set(map(int, ops.getConstrainedNodes() or []))
    for node in map(int, ops.getNodeTags()):
        dimensions = int(ops.getNDM(node)[0])
        count = int(ops.getNDF(node)[0])
        directions = _DIRECTIONS.get((dimensions, count))
        if directions is None:
            known = ", ".join(f"{f} in {d}D" for d, f in _DIRECTIONS)
            raise ModelError(
                f"node {node} has {count} degrees of freedom in {dimensions} dimensions; expected"
                f" displacements and rotations: {known}"
            )
        free = set(range(count))
        if node in tied:  # its equations come first, then those of the nodes it is tied to
            free -= {int(dof) - 1 for dof in ops.getConstrainedDOFs(node)}
        for number, equation in zip(sorted(free), map(int, ops.nodeDOFs(node)), strict=False):
            if equation < 0:
                continue
            if axes[equation] >= 0:
                raise ModelError(
                    f"equation {equation} belongs to nodes {nodes[equation]} and {node}"
                )
            nodes[equation] = node
            axes[equation] = directions[number]
    if (axes < 0).any():
        raise ModelError(
            f"equation {int(np.argmax(axes < 0))} belongs to no node (Lagrange multipliers?)"
        )
    return DofSet.from_arrays(nodes, axes)


def _geometry(ops: Any, length: float) -> Geometry:
    nodes = list(map(int, ops.getNodeTags()))
    xyz = np.zeros((len(nodes), 3))
    for i, node in enumerate(nodes):
        position = ops.nodeCoord(node)
        xyz[i, : len(position)] = position
    lines: list[tuple[Shape, IntArray]] = []
    faces: list[tuple[Shape, IntArray]] = []
    for tag in ops.getEleTags():
        ends = np.array([ops.eleNodes(tag)], dtype=np.int64)
        kind, count = str(ops.eleType(tag)).lower(), ends.shape[1]
        for n_nodes, parts, shape in _SHAPES:
            if count == n_nodes and any(part in kind for part in parts):
                faces.append((shape, ends))
                lines.append((shape, ends))
                break
        else:
            if count in _LINES:
                lines.append((_LINES[count], ends))
    return Geometry(nodes, xyz * length, unique_edges(lines), faces=unique_faces(faces))


# -- matrices -----------------------------------------------------------------------------------
class _OpenSeesAssembly:
    """K, M and C as formed by OpenSees."""

    def __init__(self, ops: Any) -> None:
        self._ops = ops
        ops.wipeAnalysis()
        ops.constraints("Transformation")
        ops.numberer("Plain")
        ops.system("FullGeneral")
        ops.algorithm("Linear")
        ops.integrator("GimmeMCK", 0.0, 0.0, 1.0)
        ops.analysis("Transient", "-noWarnings")
        # This sets up the equations without a time step; a failure to find modes of a free or tiny
        # model is irrelevant.
        with suppress(getattr(ops, "OpenSeesError", RuntimeError)):
            ops.eigen(1)
        self.size = int(ops.systemSize())
        if self.size < 1:
            raise ModelError("OpenSees set up no equation; see its output on the console")
        most = MATRIX_FILE.most_opensees_equations
        if self.size > most:
            raise ModelError(
                f"{self.size} equations; expected at most {most}, because OpenSees prints full"
                " matrices"
            )

    def form(self, mass: float, damping: float, stiffness: float, what: str) -> RealArray:
        """Return the sum of M, C and K with these factors, shape (N, N)."""
        self._ops.integrator("GimmeMCK", mass, damping, stiffness)
        A = np.array(self._ops.printA("-ret"), dtype=np.float64).reshape(self.size, self.size)
        if not np.isfinite(A).all():
            raise ModelError(f"{what} holds numbers that are not finite")
        if np.abs(A - A.T).max() > MATRIX_FILE.sum_tolerance * np.abs(A).max():
            raise ModelError(f"{what} is unsymmetric; expected a symmetric structure")
        return np.asarray(0.5 * (A + A.T))


@dataclass(frozen=True, slots=True)
class _Totals:
    """K, M of elements, and the damping of dashpots."""

    stiffness: RealArray
    mass: RealArray
    dashpots: RealArray


def _split_groups(
    ops: Any,
    assembly: _OpenSeesAssembly,
    dofs: DofSet,
    elements: Mapping[str, list[int]],
    at_nodes: Mapping[str, list[int]],
    rayleigh: Sequence[float],
) -> dict[str, dict[str, RealArray]]:
    """Return stiffness, mass and viscous damping by group, with the sum of OpenSees."""
    K = assembly.form(0.0, 0.0, 1.0, "stiffness")
    M = assembly.form(1.0, 0.0, 0.0, "mass")
    C = assembly.form(0.0, 1.0, 0.0, "damping")
    with _without_masses(ops, at_nodes) as put_back:
        total = _Totals(K, assembly.form(1.0, 0.0, 0.0, "mass"), C)
        points = {}
        for name, nodes in at_nodes.items():
            put_back(nodes)
            points[name] = {
                "mass": _remove_rounding(assembly.form(1.0, 0.0, 0.0, "mass") - total.mass, M)
            }
            put_back(nodes, 0.0)
    try:
        ops.rayleigh(0.0, 0.0, 0.0, 0.0)
        total = _Totals(K, total.mass, assembly.form(0.0, 1.0, 0.0, "damping"))
        parts = {
            name: _element_contribution(ops, assembly, total, tags)
            for name, tags in elements.items()
        }
        for what, whole in (("stiffness", K), ("mass", total.mass)):
            covered = sum(part[what] for part in parts.values())
            difference = _remove_rounding(whole - covered, whole, MATRIX_FILE.sum_tolerance)
            if difference.any():
                name = _undamped_group(ops, assembly, total, elements, what, difference, dofs)
                parts[name][what] = _remove_rounding(parts[name][what] + whole - covered, whole)
    finally:
        ops.rayleigh(*map(float, rayleigh))
    return {**parts, **points, "damping": {"viscous": C}}


@contextmanager
def _without_masses(ops: Any, at_nodes: Mapping[str, list[int]]) -> Iterator[Callable[..., None]]:
    """Remove the masses of nodes temporarily.

    Yields a function that restores the masses of some nodes, or removes them again with factor 0.
    """
    before = {}
    for node in chain.from_iterable(at_nodes.values()):
        before[node] = np.array(ops.nodeMass(node), dtype=np.float64)

    def set_masses(nodes: Iterable[int], factor: float = 1.0) -> None:
        for node in nodes:
            ops.mass(node, *(factor * before[node]).tolist())

    set_masses(before, 0.0)
    try:
        yield set_masses
    finally:
        set_masses(before)


def _element_contribution(
    ops: Any, assembly: _OpenSeesAssembly, total: _Totals, tags: Iterable[int]
) -> dict[str, RealArray]:
    """Return the contribution of elements to K and M, by means of their Rayleigh damping."""
    out = {}
    for what, factors in (("stiffness", (0.0, 1.0)), ("mass", (1.0, 0.0))):
        for tag in tags:
            ops.setElementRayleighDampingFactors(tag, *factors, 0.0, 0.0)
        grown = assembly.form(0.0, 1.0, 0.0, what) - total.dashpots
        out[what] = _remove_rounding(grown, getattr(total, what))
        for tag in tags:
            ops.setElementRayleighDampingFactors(tag, 0.0, 0.0, 0.0, 0.0)
    return out


def _undamped_group(
    ops: Any,
    assembly: _OpenSeesAssembly,
    total: _Totals,
    elements: Mapping[str, list[int]],
    what: str,
    difference: RealArray,
    dofs: DofSet,
) -> str:
    """Return the only group with elements without Rayleigh damping, which owns the difference."""
    quiet: dict[str, list[int]] = {}
    for name, tags in elements.items():
        by_type: dict[str, list[int]] = {}
        for tag in tags:
            by_type.setdefault(str(ops.eleType(tag)), []).append(tag)
        for same_type in by_type.values():
            if not any(
                matrix.any()
                for matrix in _element_contribution(ops, assembly, total, same_type).values()
            ):
                quiet.setdefault(name, []).extend(same_type)
    if len(quiet) == 1:
        return next(iter(quiet))
    i, j = map(int, np.unravel_index(np.argmax(np.abs(difference)), difference.shape))
    shown = []
    for name, tags in quiet.items():
        shown.append(f"{name!r}: {ops.eleType(tags[0])} {', '.join(map(str, tags[:3]))}")
    who = "; ".join(shown) or "some of a type"
    raise ModelError(
        f"the groups do not add up to the {what} of OpenSees: they differ by"
        f" {difference[i, j]:.3g} at {dofs[i]}, {dofs[j]}. Elements of several groups ignore"
        " Rayleigh damping, by which their matrices are computed"
        f" ({who}); create them with '-doRayleigh', 1"
    )


def _remove_rounding(matrix: RealArray, whole: RealArray, share: float | None = None) -> RealArray:
    """Return a difference without entries below a share of the largest of row and column."""
    share = MATRIX_FILE.entry_rounding if share is None else share
    scale = np.abs(whole).max(axis=1)
    is_rounding = np.abs(matrix) <= share * np.maximum(scale[:, None], scale[None, :])
    return np.where(is_rounding, 0.0, matrix)
