"""Rigid-body shapes of a free model, from the null space of its stiffness."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from updyn.arrays import RealArray
from updyn.dofs import DIRECTIONS, Dof
from updyn.dynamics import eigen
from updyn.dynamics.affine import AffineSystem
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.updating.judge.causes.holding import is_free
from updyn.updating.judge.causes.places import iter_sensor_places
from updyn.updating.judge.causes.settings import RIGID_BODY
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import Record

__all__ = ["RigidShapes"]

#: Largest number of rigid-body modes of one body.
_MOST = 6


@dataclass(frozen=True, slots=True, eq=False)
class RigidShapes:
    """Rigid-body shapes (N, r) of a model, from its geometry; lowest elastic frequency in Hz."""

    part: FRFPart
    shapes: RealArray
    elastic: float

    @classmethod
    def of(cls, part: FRFPart) -> RigidShapes | None:
        """Return the shapes; None if the model is not free, or is reduced or cannot be solved."""
        turning = all(dof.direction.startswith("R") for dof in part.frf.responses)
        if part.solver.tier == "reduced" or not (turning or is_free(part)):
            return None

        def compute() -> Record:
            return _lowest(part.solver.system, part.state(part.coordinates.start).factor)

        with suppress(SolverError):
            value, shapes = part.recall("rigid-body shapes", part.coordinates.start, compute)
            rigid = value == 0.0
            if rigid.any() and not rigid.all() and rigid.sum() <= _MOST:
                elastic = float(np.sqrt(value[~rigid].min())) / (2.0 * np.pi)
                return cls(part, shapes[:, rigid], elastic)
        return None

    def at(self, dofs: Iterable[Dof]) -> RealArray:
        """Return the shapes at unsigned DOFs, shape (n, r)."""
        match = self.part.solver.system.dofs.match(dofs)
        return np.asarray(self.shapes[match.index] * match.sign[:, None])

    def has(self, dof: Dof) -> bool:
        """Return whether the model has a DOF."""
        dofs = self.part.solver.system.dofs
        same = (dofs.nodes == dof.node) & (dofs.axes == DIRECTIONS.index(dof.direction))
        return bool(same.any())

    def around(self, dofs: Sequence[Dof]) -> RealArray:
        """Return the shapes in three directions at the nodes of DOFs, shape (n, 3, r).

        0 for directions that the model lacks; directions of rotations for rotations.
        """
        out = np.zeros((len(dofs), 3, self.shapes.shape[1]))
        for i, dof in enumerate(dofs):
            for k, axis in enumerate("XYZ"):
                there = Dof(dof.node, dof.direction[:-1] + axis)
                if self.has(there):
                    out[i, k] = self.at([there])[0]
        return out

    def list_near(self, frf: FRF, dof: Dof) -> list[Dof]:
        """Return the places near a response of the data that are not measured."""
        pairs = iter_sensor_places(self.part.with_data(frf))
        return [place for own, place in pairs if abs(own) == dof]


def _lowest(system: AffineSystem, factor: RealArray) -> Record:
    """Return the lowest eigenvalues in 1/s2, exactly 0 for rigid-body modes, and the shapes."""
    K, M = (_sum(system, quantity, factor) for quantity in ("stiffness", "mass"))
    value, shapes = eigen.real_pairs(K, M, min(_MOST + 1, eigen.mass_rank(M)))
    energy = np.einsum("in,in->n", shapes, K @ shapes)
    absolute = np.einsum("in,in->n", np.abs(shapes), abs(K) @ np.abs(shapes))
    rounding = RIGID_BODY.rigid_energy * absolute
    return np.where(np.abs(energy) <= rounding, 0.0, np.maximum(value, 0.0)), shapes


def _sum(system: AffineSystem, quantity: str, factor: RealArray) -> sp.csr_matrix:
    own = np.array([term.quantity == quantity for term in system.terms])
    pattern = (system.real_values(factor * own), system.indices, system.indptr)
    matrix = sp.csr_matrix(pattern, shape=(system.n, system.n), copy=True)
    matrix.eliminate_zeros()
    return matrix
