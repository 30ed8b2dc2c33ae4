"""A reduced model about an estimate, so that judging a large one takes less than fitting it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.affine import State
from updyn.dynamics.reduction import Reduction
from updyn.errors import SolverError
from updyn.updating.problem.problem import Part

__all__ = ["DOFS", "Nearby"]

_Vector = NDArray[np.float64]

#: Smaller models are judged as they are.
DOFS = 400
#: Error at the estimate, as a share of the largest receptance of a line; and the number of lines
#: whose fields choose among the vectors of the basis.
_ACCURACY, _LINES = 1e-4, 24
#: Root of the share of the energy of fields that may be dropped where it holds about many states.
_DROPPED = 1e-3


@dataclass(slots=True, eq=False)
class Nearby:
    """A part with a reduced model about a point.

    Attributes
    ----------
    part : Part
        With the reduced model.
    reduction : Reduction
        Its basis, not compressed.
    """

    part: Part
    reduction: Reduction

    @classmethod
    def of(cls, part: Part, x: _Vector) -> Nearby | None:
        """Return the reduced model of a part about a point; None where it would not pay.

        Parameters
        ----------
        part : Part
            Model and data.
        x : ndarray of float, shape (n,)
            The point.

        Returns
        -------
        Nearby or None
            None for a small model, one that is reduced already, or that cannot be reduced.
        """
        solver, freq = part.solver, part.frf.freq
        if solver.tier != "sparse" or solver.system.n <= DOFS:
            return None
        reduction = Reduction(
            solver.system,
            part.rows,
            part.columns,
            (float(freq[0]), float(freq[-1])),
            solver.backend,
            _ACCURACY,
            poll=part.session.check,
        )
        state = part.state(x)
        try:
            reduction.build(state)
            whole = reduction.basis.leading(reduction.basis.size)
            reduction.compress(state, freq[:: -(-len(freq) // _LINES)])
        except (SolverError, np.linalg.LinAlgError):
            return None
        reduced = replace(part, solver=reduction.solver("reduced, judged"))
        reduction.basis = whole  # what further states add is orthogonal to it as it was built
        return cls(reduced, reduction)

    def holding(self, states: Sequence[State]) -> Part:
        """Return the part with a basis that holds about further states of its model, too.

        Parameters
        ----------
        states : sequence of State
            At least one, the first that of the point. One that cannot be solved adds nothing.
        """
        self.reduction.extend(states)
        freq = self.part.frf.freq
        self.reduction.compress_around(states, freq, _DROPPED)
        return replace(self.part, solver=self.reduction.solver("reduced, judged again"))
