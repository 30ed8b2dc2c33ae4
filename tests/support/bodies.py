"""What structures are held against: rigid motions, static deflections, turned copies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.sparse.linalg import spsolve

import updyn
from updyn.elements.structure import Beam, PointMass, Spring


def rigid_motions(model: updyn.Model) -> np.ndarray:
    """Unit translations along and rotations about the axes through the origin, shape (N, 6)."""
    out = np.zeros((model.n_dofs, 6))
    xyz = model.geometry.position(model.dofs.nodes)
    for row, (axis, r) in enumerate(zip(model.dofs.axes, xyz, strict=True)):
        out[row, axis] = 1.0
        if axis < 3:
            out[row, 3:] = np.cross(np.eye(3), r)[:, axis]
    return out


def rigid_inertia(model: updyn.Model) -> np.ndarray:
    """Mass matrix of the whole as a rigid body about the origin, shape (6, 6)."""
    R = rigid_motions(model)
    return R.T @ (model.mass @ R)


def strain_of_rigid_motions(model: updyn.Model) -> float:
    """Largest force on a rigid motion, over the stiffness that could resist it."""
    R = rigid_motions(model)
    K = model.stiffness
    return float((abs(K @ R) / (abs(K) @ abs(R)).max(axis=0)).max())


def deflection(model: updyn.Model, forces: dict[str, float]) -> dict[str, float]:
    """Static answer to forces (N, N m) by DOF."""
    f = np.zeros(model.n_dofs)
    for label, value in forces.items():
        f[model.dofs.match([label]).index[0]] = value
    return dict(zip(model.dofs.labels, spsolve(model.stiffness.tocsc(), f), strict=True))


def rotation(seed: int = 0) -> np.ndarray:
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return Q * np.linalg.det(Q)


def turned(part: object, Q: np.ndarray) -> object:
    """The part with all that it says in global components turned by Q."""
    if isinstance(part, Beam) and part.orientation is not None:
        return replace(part, orientation=Q @ part.orientation)
    if isinstance(part, Spring) and not isinstance(part.axes, str):
        return replace(part, axes=(np.eye(3)[:2] if part.axes is None else part.axes) @ Q.T)
    if isinstance(part, PointMass):
        return replace(part, inertia=Q @ part.inertia @ Q.T, offset=Q @ part.offset)
    return part
