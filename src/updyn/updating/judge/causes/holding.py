"""Supports of a model: groups that hold it to the ground."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DIRECTIONS
from updyn.dynamics.affine import AffineSystem, Term
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.updating.judge.causes.evidence import compute_spread
from updyn.updating.judge.causes.settings import SUPPORT_FAULT
from updyn.updating.problem.problem import FRFPart

__all__ = ["ModelSupports", "SolverWithSupports", "is_free", "list_ground_springs"]

_TRANSLATIONS = frozenset("XYZ")


@dataclass(frozen=True, slots=True)
class ModelSupports:
    """Directions in which groups resist a rigid translation, and groups that couple no nodes."""

    directions_by_group: Mapping[str, frozenset[str]]
    uncoupled_groups: frozenset[str]

    @classmethod
    def of(cls, system: AffineSystem) -> ModelSupports:
        """Return the supports of a whole model."""
        stiff = [t for t in system.terms if t.quantity == "stiffness" and t.data.any()]
        return cls(
            {term.group: _find_resisted_directions(system, term) for term in stiff},
            frozenset(term.group for term in stiff if not _couples_nodes(system, term)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class SolverWithSupports(ReducedSolver):
    """A reduced model with the supports of its whole model, which its coordinates do not show."""

    supports: ModelSupports = field(kw_only=True)

    @classmethod
    def from_solver(cls, solver: ReducedSolver, supports: ModelSupports) -> SolverWithSupports:
        """Return a reduced model with the supports of the whole model."""
        known = {one.name: getattr(solver, one.name) for one in fields(solver) if one.init}
        return cls(**known, supports=supports)


def _find_supports(part: FRFPart) -> ModelSupports:
    """Return the supports of the model of a part; a plain reduced model is taken as held."""
    if isinstance(part.solver, SolverWithSupports):
        return part.solver.supports
    if part.solver.tier == "reduced":
        return ModelSupports({"": _TRANSLATIONS}, frozenset())
    return ModelSupports.of(part.solver.system)


def is_free(part: FRFPart) -> bool:
    """Return whether the model is free in a measured direction of translation."""
    # Models of rotations alone, whose rigid motion depends on gear ratios, are taken as held.
    measured = {dof.direction for dof in part.frf.responses} & _TRANSLATIONS
    return not measured <= frozenset().union(*_find_supports(part).directions_by_group.values())


def list_ground_springs(part: FRFPart) -> list[str]:
    """Return the groups of springs between single nodes and the ground, of known stiffness."""
    # They are among the unknowns of the part, with a narrow prior.
    parameters = part.coordinates.parameters
    spread = dict(zip(parameters.names, compute_spread(part), strict=True))
    supports = _find_supports(part)
    return [
        group
        for group, directions in supports.directions_by_group.items()
        if directions
        and group in supports.uncoupled_groups
        and spread.get(f"{group}.stiffness", SUPPORT_FAULT.known_std) < SUPPORT_FAULT.known_std
    ]


def _couples_nodes(system: AffineSystem, term: Term) -> bool:
    nodes = system.dofs.nodes[term.rows]
    K = sp.coo_matrix(term.local)
    between = nodes[K.row] != nodes[K.col]
    return bool(
        np.abs(K.data[between]).max(initial=0.0) > SUPPORT_FAULT.rounding * np.abs(term.data).max()
    )


def _find_resisted_directions(system: AffineSystem, term: Term) -> frozenset[str]:
    """Return the directions in which a stiffness resists a rigid translation of the whole model."""
    axes = system.dofs.axes[term.rows]
    is_moved = np.stack([axes == DIRECTIONS.index(d) for d in sorted(_TRANSLATIONS)], axis=1)
    force = np.abs(term.local @ is_moved.astype(float)).max(axis=0, initial=0.0)
    large = force > SUPPORT_FAULT.rounding * np.abs(term.data).max()
    return frozenset(d for d, one in zip(sorted(_TRANSLATIONS), large, strict=True) if one)
