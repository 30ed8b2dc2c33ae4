"""What holds a model to the ground."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from updyn.dofs import DIRECTIONS
from updyn.dynamics.affine import Term
from updyn.updating.judge.causes.evidence import spread_of
from updyn.updating.problem.problem import Part

__all__ = ["ground_springs", "is_free"]

#: Force of a rigid translation, as a share of the largest stiffness, that rounding leaves.
_ROUNDING = 1e-6
#: Spread of the logarithm of a stiffness below which it is taken as known.
_KNOWN = 0.1


def is_free(part: Part) -> bool:
    """Return whether nothing holds the model against a translation in which it is measured.

    Models of rotations alone, whose rigid motion depends on gear ratios, are taken as held; so are
    reduced ones, whose coordinates are not those of nodes.
    """
    if part.solver.tier == "reduced":
        return False
    measured = {dof.direction for dof in part.frf.responses} - {"RX", "RY", "RZ"}
    return any(not any(_force(part, term, d) for term in _springs(part)) for d in measured)


def ground_springs(part: Part) -> list[str]:
    """Return the groups of springs between single nodes and the ground, of known stiffness.

    They stand among the unknowns of the part with a narrow prior. In a reduced model, whose
    coordinates are not those of nodes, none is found.
    """
    if part.solver.tier == "reduced":
        return []
    own = part.coordinates.parameters
    spread = dict(zip(own.names, spread_of(part), strict=True))
    found = []
    for term in _springs(part):
        name = f"{term.group}.stiffness"
        if spread.get(name, _KNOWN) < _KNOWN and _is_to_ground(part, term):
            found.append(term.group)
    return found


def _springs(part: Part) -> list[Term]:
    terms = part.solver.system.terms
    return [term for term in terms if term.quantity == "stiffness" and term.data.any()]


def _is_to_ground(part: Part, term: Term) -> bool:
    """Return whether a stiffness couples no two nodes, and resists translations."""
    nodes = part.solver.system.dofs.nodes[term.rows]
    K = sp.coo_matrix(term.local)
    between = nodes[K.row] != nodes[K.col]
    if np.abs(K.data[between]).max(initial=0.0) > _ROUNDING * np.abs(term.data).max():
        return False
    return any(_force(part, term, d) for d in ("X", "Y", "Z"))


def _force(part: Part, term: Term, direction: str) -> bool:
    """Return whether a stiffness resists a rigid translation of the whole model."""
    axis = DIRECTIONS.index(direction)
    moved = (part.solver.system.dofs.axes[term.rows] == axis).astype(float)
    return bool(np.abs(term.local @ moved).max() > _ROUNDING * np.abs(term.data).max())
