"""Reduced models about an estimate, with which large models are assessed at low cost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.affine import State
from updyn.dynamics.reduction import Reduction
from updyn.errors import SolverError
from updyn.updating.judge.settings import EFFORT, NEARBY_MODEL
from updyn.updating.problem.problem import FRFPart

__all__ = ["ReducedPart"]


@dataclass(slots=True, eq=False)
class ReducedPart:
    """A part with a reduced model about a point, and its reduction with the uncompressed basis."""

    part: FRFPart
    reduction: Reduction

    @classmethod
    def of(cls, part: FRFPart, x: RealArray) -> ReducedPart | None:
        """Return the reduced model of a part about x; None if small, reduced or not reducible."""
        solver, freq = part.solver, part.frf.freq
        if solver.tier != "sparse" or solver.system.n <= EFFORT.small_model_dofs:
            return None
        reduction = Reduction(
            solver.system,
            *part.receptance_dofs,
            (float(freq[0]), float(freq[-1])),
            solver.backend,
            NEARBY_MODEL.accuracy,
            poll=part.session.check,
        )
        state = part.state(x)
        try:
            reduction.build(state)
            whole = reduction.basis.take_leading(reduction.basis.size)
            reduction.compress(state, freq[:: -(-len(freq) // NEARBY_MODEL.basis_lines)])
        except (SolverError, np.linalg.LinAlgError):
            return None
        reduced = part.with_solver(reduction.solver("reduced, judged"))
        reduction.basis = whole  # further states are orthogonalised against the full basis
        return cls(reduced, reduction)

    def extend_basis(self, states: Sequence[State]) -> FRFPart:
        """Return the part with a basis that is accurate about further states of its model, too."""
        # The first state must be that of the point. States that cannot be solved are ignored.
        self.reduction.extend(states)
        freq = self.part.frf.freq
        self.reduction.compress_around(states, freq, NEARBY_MODEL.dropped_energy_root)
        return self.part.with_solver(self.reduction.solver("reduced, judged again"))
