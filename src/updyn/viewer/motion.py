"""`Motion`: a body with the displacements of its nodes in mode shapes or operating shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError
from updyn.modal.shapes import Shapes
from updyn.settings import FIGURES
from updyn.viewer.bodies import entries_of, model_body, motions, sensor_body
from updyn.viewer.scene import Body, Entries

__all__ = [
    "Motion",
    "amplitudes",
    "check_moves",
    "deviations_of",
    "motion_of",
    "rotations_of",
]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A body and the displacements of its nodes.

    Attributes
    ----------
    body : Body
        The model if all its nodes with DOFs move, else the measured nodes with the lines between.
    shapes : ndarray of complex, shape (s, n, 3)
        Displacements in global components.
    """

    body: Body
    shapes: ComplexArray

    def largest(self, shape: int) -> tuple[float, float]:
        """Return the largest displacement in a period of the nodes, and of the rims of discs."""
        size, real = amplitudes(self.shapes[shape]), self.body.real
        return float(size[:real].max(initial=0.0)), float(size[real:].max(initial=0.0))


def amplitudes(u: ComplexArray) -> RealArray:
    """Return the largest length of Re(u exp(i theta)) over theta, of vectors of shape (n, 3)."""
    square = np.sum(np.abs(u) ** 2, axis=1)
    return np.asarray(np.sqrt(0.5 * (square + np.abs(np.sum(u**2, axis=1)))))


def motion_of(shapes: Shapes) -> Motion:
    """Return the structure with the displacements of its nodes in each shape."""
    model, dofs = shapes.model, shapes.modes.dofs
    if model is not None and np.isin(model.dofs.nodes, dofs.nodes).all():
        body = model_body(model)
    else:
        body = sensor_body(shapes.geometry, (str(dof) for dof in dofs))
    entries = entries_of(body, shapes.geometry, dofs)
    return Motion(body, motions(body, entries, shapes.modes.shapes).astype(np.complex128))


def rotations_of(shapes: Shapes, body: Body) -> ComplexArray:
    """Return the rotation vectors of the nodes in global components, shape (s, n, 3)."""
    dofs, values = shapes.in_global_axes()
    out = np.zeros((len(shapes), len(body.nodes), 3), dtype=np.complex128)
    place = {node: at for at, node in enumerate(body.nodes[: body.real].tolist())}
    for node, axis, row in zip(dofs.nodes.tolist(), dofs.axes.tolist(), values, strict=True):
        if axis >= 3 and node in place:
            out[:, place[node], axis - 3] = row
    return out


def deviations_of(shapes: Shapes, body: Body) -> RealArray | None:
    """Return standard deviations of displacements, shape (s, n, 3); None if unknown.

    Those of oblique directions are combined as if they were independent.
    """
    std = shapes.modes.std_shapes
    if std is None:
        return None
    entries = entries_of(body, shapes.geometry, shapes.modes.dofs)
    squares = Entries(entries.dof, entries.node, entries.vector**2)
    return np.asarray(np.sqrt(motions(body, squares, std**2)))


def check_moves(shapes: Shapes, motion: Motion) -> None:
    """Raise a `DataError` if a shape moves no node that can be drawn."""
    rotates = shapes.modes.dofs.axes >= 3
    size = float(np.linalg.norm(np.ptp(motion.body.xyz, axis=0))) or 1.0
    for number, title in enumerate(shapes.titles()):
        rotation = np.abs(shapes.modes.shapes[rotates, number]).max(initial=0.0)
        if max(motion.largest(number)) <= FIGURES.still_share * size * rotation:
            raise DataError(
                f"{title}: has no translations to draw, only rotations of nodes; leave it out by"
                " select"
            )
