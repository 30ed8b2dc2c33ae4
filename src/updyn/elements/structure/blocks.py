"""From parts to element matrices: blocks of elements that are alike, in the DOFs of their nodes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from updyn.elements.structure.parts import Beam, Part, PointMass, Shell, Solid, Spring, Truss
from updyn.elements.structure.pyfe import beam_matrices, truss_matrices
from updyn.elements.structure.shells import shell_matrices
from updyn.elements.structure.solids import inside_out, solid_matrices
from updyn.errors import ModelError

__all__ = ["Blocks", "Nodes", "blocks_of", "touch"]

_ENTRIES = 1_000_000  # of the matrices that are held at once
_NOISE = 1e-12  # of the largest: what a rotation leaves where there is nothing
_TRANSLATIONS, _ALL = (0, 1, 2), (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True, slots=True, eq=False)
class Nodes:
    """Node numbers, shape (n,), with their positions in m, shape (n, 3)."""

    numbers: NDArray[np.int64]
    xyz: NDArray[np.float64]
    _order: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_order", np.argsort(self.numbers))

    def find(self, what: str, wanted: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the positions in the table of node numbers, of any shape.

        Raises
        ------
        ModelError
            If one is not there; the nearest are named.
        """
        at = np.searchsorted(self.numbers, wanted, sorter=self._order)
        found = self._order[np.minimum(at, len(self._order) - 1)]
        missing = np.asarray(wanted)[self.numbers[found] != wanted]
        if missing.size:
            near = self.numbers[
                np.argsort(np.abs(self.numbers - missing.flat[0]), kind="stable")[:3]
            ]
            raise ModelError(
                f"{what}: node {missing.flat[0]} is not among the {len(self.numbers)} nodes; "
                f"nearest: {', '.join(str(n) for n in near)}"
            )
        return np.asarray(found)


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Matrices of m elements of k nodes.

    Attributes
    ----------
    nodes : ndarray of int, shape (m, k)
        Positions in the table of nodes.
    axes : tuple of int
        Directions of each node, of 0 to 5; d of them.
    K, M, C : ndarray of float, shape (m, k d, k d), or None
        Stiffness (N/m), mass (kg), viscous damping (N s/m).
    """

    nodes: NDArray[np.intp]
    axes: tuple[int, ...]
    K: NDArray[np.float64] | None = None
    M: NDArray[np.float64] | None = None
    C: NDArray[np.float64] | None = None

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which DOFs have anything at all, shape (m, k, d)."""
        diagonals = [
            np.einsum("mii->mi", A) != 0 for A in (self.K, self.M, self.C) if A is not None
        ]
        return np.asarray(np.logical_or.reduce(diagonals)).reshape(
            *self.nodes.shape, len(self.axes)
        )


def blocks_of(part: Part, nodes: Nodes) -> Iterator[Blocks]:
    """Yield the matrices of a part, some thousand elements at once.

    Raises
    ------
    ModelError
        If a node is not known or an element has no size.
    """
    if isinstance(part, Spring):
        yield _spring(part, nodes)
    elif isinstance(part, PointMass):
        yield _point_mass(part, nodes)
    else:
        what = describe(part)
        at = nodes.find(what, part.connectivity)
        step = max(_ENTRIES // (at.shape[1] * len(_axes_of(part))) ** 2, 1)
        for start in range(0, len(at), step):
            some = slice(start, start + step)
            batch = replace(
                part, connectivity=part.connectivity[some]
            )  # so that errors name the right element
            yield _elements(what, batch, at[some], nodes.xyz[at[some]])


def touch(part: Part, nodes: Nodes, touched: NDArray[np.bool_]) -> None:
    """Mark the DOFs that a part touches in `touched`, shape (n, 6)."""
    if isinstance(part, Spring | PointMass):
        (block,) = blocks_of(part, nodes)
        touched[block.nodes[0]] |= block.used[0]
    else:
        touched[
            np.unique(nodes.find(describe(part), part.connectivity))[:, None], _axes_of(part)
        ] = True


def _axes_of(part: Beam | Truss | Shell | Solid) -> tuple[int, ...]:
    return _TRANSLATIONS if isinstance(part, Truss | Solid) else _ALL


def describe(part: Part) -> str:
    """Return how an error calls a part."""
    return f"{type(part).__name__.lower()} {part.name!r}"


def _elements(
    what: str, part: Beam | Truss | Shell | Solid, at: NDArray[np.intp], xyz: NDArray[np.float64]
) -> Blocks:
    if isinstance(part, Solid):
        bad = inside_out(xyz)
        if bad is not None:
            raise ModelError(
                f"{what}: the element of nodes {part.connectivity[bad].tolist()} is turned inside"
                " out or has no volume: its nodes are not in order, or it is too distorted"
            )
        K, M = solid_matrices(xyz, part.E, part.nu, part.rho, part.lumped)
    elif isinstance(part, Shell):
        K, M = shell_matrices(part, xyz)
    else:
        _check_length(what, part, xyz)
        K, M = beam_matrices(part, xyz) if isinstance(part, Beam) else truss_matrices(part, xyz)
    return Blocks(at, _axes_of(part), K, M if part.rho else None)


def _check_length(what: str, part: Beam | Truss, ends: NDArray[np.float64]) -> None:
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    if not length.all():
        nodes = part.connectivity[int(np.argmin(length))].tolist()
        raise ModelError(f"{what}: the element of nodes {nodes} has no length: its nodes coincide")


# -- springs and masses ------------------------------------------------------------------------------------
def _spring(part: Spring, nodes: Nodes) -> Blocks:
    what = f"spring {part.name!r}"
    ends = [part.first] if part.second is None else [part.first, part.second]
    at = nodes.find(what, np.array(ends))
    xyz = nodes.xyz[at]
    R = _axes(what, part, xyz)
    middle = xyz.mean(axis=0)
    signs = (1.0,) if part.second is None else (-1.0, 1.0)
    # Elongation and turn at the middle, along local axes, from the twelve DOFs of the ends.
    G = np.hstack([s * _turned(R) @ _carried(middle - x) for s, x in zip(signs, xyz, strict=True)])
    G[np.abs(G) < _NOISE * np.abs(G).max()] = 0.0

    def matrix(six: NDArray[np.float64]) -> NDArray[np.float64] | None:
        return (G.T @ (six[:, None] * G))[None] if six.any() else None

    return Blocks(at[None], _ALL, matrix(part.stiffness), C=matrix(part.viscous))


def _axes(what: str, part: Spring, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the local axes as rows, shape (3, 3)."""
    if part.axes is None:
        return np.eye(3)
    if isinstance(part.axes, str):
        x = xyz[1] - xyz[0]
        if not x.any():
            raise ModelError(f"{what}: axes 'line', but its nodes coincide")
        v = np.eye(3)[int(np.argmin(np.abs(x)))]
    else:
        x, v = part.axes
    x = x / np.linalg.norm(x)
    z = np.cross(x, v)
    z = z / np.linalg.norm(z)
    return np.array([x, np.cross(z, x), z])


def _turned(R: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.kron(np.eye(2), R), dtype=np.float64)


def _carried(arm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the motion of the end of a rigid arm from that of its start, shape (6, 6): u + theta x arm, theta."""
    out = np.eye(6)
    out[:3, 3:] = -_cross_matrix(arm)
    return out


def _cross_matrix(a: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def _point_mass(part: PointMass, nodes: Nodes) -> Blocks:
    at = nodes.find(f"mass {part.name!r}", np.array([[part.node]]))
    own = np.zeros((6, 6))
    own[:3, :3], own[3:, 3:] = part.mass * np.eye(3), part.inertia
    T = _carried(part.offset)
    return Blocks(at, _ALL, M=(T.T @ own @ T)[None])
