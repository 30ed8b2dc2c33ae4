"""Alternative places of a sensor or a force whose label may be wrong."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from updyn.dofs import Dof
from updyn.frf import TRANSMISSIBILITY
from updyn.updating.judge.causes.settings import CAUSE_CANDIDATES
from updyn.updating.problem.problem import FRFPart

__all__ = ["iter_force_places", "iter_sensor_places", "list_all_places", "list_labels"]


def iter_sensor_places(part: FRFPart) -> Iterator[tuple[Dof, Dof]]:
    """Yield each response with each of its alternative places."""
    known = _KnownDofs.of(part)
    measured = {str(abs(dof)) for dof in part.frf.responses}
    for dof in part.frf.responses:
        for place in known.find_near(dof)[: CAUSE_CANDIDATES.most_places]:
            if str(place) not in measured:
                yield dof, place


def iter_force_places(part: FRFPart) -> Iterator[tuple[Dof, Dof]]:
    """Yield each reference with each of the alternative places of its force."""
    # These are near places, as for sensors, and the measured DOFs, whose labels are easily
    # confused.
    if part.frf.quantity == TRANSMISSIBILITY:
        return
    known = _KnownDofs.of(part)
    taken = {str(abs(dof)) for dof in part.frf.references}
    measured = [abs(dof) for dof in part.frf.responses]
    for dof in part.frf.references:
        same_kind = [one for one in measured if _is_rotation(one) == _is_rotation(dof)]
        places = dict.fromkeys(
            [
                *known.find_near(dof)[: CAUSE_CANDIDATES.most_places],
                *same_kind[: CAUSE_CANDIDATES.most_places],
            ]
        )
        for place in places:
            if str(place) not in taken:
                yield dof, place


def list_all_places(part: FRFPart) -> list[str]:
    """Return all alternative places of sensors and forces."""
    return list_labels([*iter_sensor_places(part), *iter_force_places(part)])


def list_labels(pairs: Iterable[tuple[Dof, Dof]]) -> list[str]:
    """Return the labels of alternative places without duplicates."""
    return list(dict.fromkeys(str(place) for _, place in pairs))


@dataclass(frozen=True, slots=True, eq=False)
class _KnownDofs:
    """DOFs of a part by node at which its model, maybe a reduced one, can be evaluated."""

    part: FRFPart
    of_node: dict[int, list[int]]
    all_dofs: frozenset[int]

    @classmethod
    def of(cls, part: FRFPart) -> _KnownDofs:
        dofs = part.solver.system.dofs
        of_node: dict[int, list[int]] = {}
        all_dofs = part.solver.other_dofs(part.rows[:0]).tolist()
        for i in all_dofs:
            of_node.setdefault(dofs[i].node, []).append(i)
        return cls(part, of_node, frozenset(all_dofs))

    def find_near(self, dof: Dof) -> list[Dof]:
        """Return the other directions of a node, then the same direction of coupled nodes."""
        dofs, node_dofs = self.part.solver.system.dofs, self.of_node[dof.node]
        near = [i for i in node_dofs if _is_rotation(dofs[i]) == _is_rotation(dof)]
        coupled = [i for i in _find_coupled_dofs(self.part, node_dofs) if i in self.all_dofs]
        near += [i for i in coupled if dofs[i].direction == dof.direction]
        return [abs(dofs[i]) for i in near]


def _is_rotation(dof: Dof) -> bool:
    return dof.direction.startswith("R")


def _find_coupled_dofs(part: FRFPart, node_dofs: list[int]) -> list[int]:
    """Return the DOFs of other nodes coupled to those of a node, nearest in number first."""
    coupled: set[int] = set()
    for i in node_dofs:
        coupled.update(part.solver.coupled_dofs(i).tolist())
    return sorted(coupled - set(node_dofs), key=lambda i: int(np.abs(i - node_dofs[0])))
