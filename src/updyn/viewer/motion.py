"""`Motion`: a body with the displacements of its nodes in mode shapes or operating shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError
from updyn.modal.shapes import Shapes
from updyn.settings import FIGURES
from updyn.viewer.bodies import entries_of, model_body, motions, sensor_body
from updyn.viewer.scene import Body

__all__ = ["Motion", "motion_of"]


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
    """Return the motion of the structure of some shapes.

    A `DataError` is raised if a shape moves no node that can be drawn.
    """
    model, dofs = shapes.model, shapes.modes.dofs
    is_whole = model is not None and np.isin(model.dofs.nodes, dofs.nodes).all()
    body = (
        model_body(model)
        if is_whole and model is not None
        else sensor_body(shapes.geometry, (str(dof) for dof in dofs))
    )
    entries = entries_of(body, shapes.geometry, dofs)
    found = Motion(body, motions(body, entries, shapes.modes.shapes).astype(np.complex128))
    size = float(np.linalg.norm(np.ptp(body.xyz, axis=0))) or 1.0
    for number, title in enumerate(shapes.titles()):
        rotation = np.abs(shapes.modes.shapes[dofs.axes >= 3, number]).max(initial=0.0)
        if max(found.largest(number)) <= FIGURES.still_share * size * rotation:
            raise DataError(
                f"{title}: has no translations to draw, only rotations of nodes; leave it out by"
                " select"
            )
    return found
