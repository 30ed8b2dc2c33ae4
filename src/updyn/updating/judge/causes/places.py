"""Where a sensor may stand instead of where its label says."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from updyn.dofs import Dof
from updyn.updating.problem.problem import Part

__all__ = ["mistaken"]

#: Most places for one sensor.
_MOST = 40


def mistaken(part: Part) -> Iterator[tuple[Dof, Dof]]:
    """Yield each response with the places that it may be mistaken for."""
    dofs = part.solver.system.dofs
    measured = {str(abs(dof)) for dof in part.frf.responses}
    of_node: dict[int, list[int]] = {}
    # A reduced model answers at some DOFs only.
    for i in part.solver.others(part.rows[:0]).tolist():
        of_node.setdefault(dofs[i].node, []).append(i)
    known = {i for one in of_node.values() for i in one}
    for dof in part.frf.responses:
        own, turns = of_node[dof.node], dof.direction.startswith("R")
        near = [i for i in own if dofs[i].direction.startswith("R") == turns]
        beside = [i for i in _beside(part, own) if i in known]
        near += [i for i in beside if dofs[i].direction == dof.direction]
        for i in near[:_MOST]:
            place = abs(dofs[i])
            if str(place) not in measured:
                yield dof, place


def _beside(part: Part, own: list[int]) -> list[int]:
    """Return the DOFs of other nodes that are coupled with those of a node, nearest in number."""
    coupled: set[int] = set()
    for i in own:
        coupled.update(part.solver.coupled(i).tolist())
    return sorted(coupled - set(own), key=lambda i: int(np.abs(i - own[0])))
