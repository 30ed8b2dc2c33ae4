"""`ModalReduction`: the reduced model of a test with modes, and its evaluations.

Evaluations depend, within the certified error, on the basis at their time. Those that changed the
basis are therefore repeated when a resumed run reads them from its checkpoint; all results are then
the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Self

import numpy as np

from updyn.dynamics.affine import AffineSystem
from updyn.modal.reduced import ReducedModes
from updyn.modal.sensitivity import RealModes
from updyn.modal.settings import MODE_REDUCTION
from updyn.sensitivity import Unknowns
from updyn.updating.problem.session import Record, Session, digest

if TYPE_CHECKING:
    from updyn.updating.problem.modal import Pairs

__all__ = ["ModalReduction"]


@dataclass(slots=True, eq=False)
class ModalReduction:
    """The reduced model for the modes of a test.

    `error` is the largest relative difference of a paired frequency from that of the full model, at
    the end of the fit; None before.
    """

    modes: ReducedModes
    error: float | None = None
    _version: int = field(default=0, init=False)
    _changes: set[bytes] = field(default_factory=set, init=False)

    @classmethod
    def of(cls, system: AffineSystem, unknowns: Unknowns, backend: str, *, shapes: bool) -> Self:
        """Return the reduction of a compiled model; `shapes`: for measured shapes."""
        accuracy = MODE_REDUCTION.accuracy_of_shapes if shapes else MODE_REDUCTION.accuracy
        return cls(ReducedModes(system, unknowns, accuracy, backend, for_shapes=shapes))

    def recall(
        self, session: Session, key: Sequence[object], compute: Callable[[], Record]
    ) -> Record:
        """Return the result for a key from the cache of a session, or compute and store it."""
        at = digest(self._extend(key))

        def compute_with_changes() -> Record:
            before = self.modes.n_changes
            record = compute()
            self._changes.add(at)
            return *record, np.array(self.modes.n_changes - before)

        *record, changes = session.recall(self._extend(key), compute_with_changes)
        if changes and at not in self._changes:
            compute_with_changes()
        return tuple(record)

    def has(self, session: Session, key: Sequence[object]) -> bool:
        """Return whether a result is in the cache of a session."""
        return session.has(self._extend(key))

    def _extend(self, key: Sequence[object]) -> list[object]:
        return [*key, f"reduced {self._version}"]

    def confirm(self, pairs: Pairs, full: RealModes) -> bool:
        """Return whether the modes up to the last paired one are those of the full model."""
        # If not, the modes of the full model are added to the basis.
        number = pairs.n_used
        error = 0.5 * np.abs(np.log(pairs.modes.value[:number] / full.value[:number]))
        self.error = float(error[np.unique(pairs.which)].max())
        if (error <= MODE_REDUCTION.frequency_error + 0.5 * full.rounding[:number]).all():
            return True
        self.modes.add(full)
        self._version += 1
        return False

    @property
    def record(self) -> dict[str, float | int | str]:
        """Record for the result."""
        return {
            "tier": "reduced",
            "backend": self.modes.backend,
            "basis": self.modes.size,
            "factorisations": self.modes.factorisations,
            "frequency error": "not checked where the fit ended"
            if self.error is None
            else self.error,
        }
