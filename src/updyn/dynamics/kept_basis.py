"""The final basis of an update, kept as the start of further reduced models."""

from __future__ import annotations

from dataclasses import dataclass

from updyn.arrays import RealArray
from updyn.dynamics.affine import State
from updyn.dynamics.basis import Basis
from updyn.dynamics.reduction import Reduction
from updyn.dynamics.settings import REDUCTION
from updyn.model import Model

__all__ = ["KeptBasis", "begin_reduction"]


@dataclass(frozen=True, slots=True, eq=False)
class KeptBasis:
    """An immutable basis of a model, and the band in Hz in which it misses no mode.

    It stays in this process: a pickle or a copy of it is None.
    """

    model: Model
    basis: Basis
    band: tuple[float, float]

    @classmethod
    def of(cls, model: Model, reduction: Reduction) -> KeptBasis | None:
        """Return the basis of a reduction, or None if it needs more than 1 GiB."""
        basis = reduction.basis
        if 8 * basis.system.n * basis.size > REDUCTION.kept_bytes:
            return None
        return cls(model, basis.take_leading(basis.size), reduction.band)

    def is_valid_for(self, model: Model, band: tuple[float, float]) -> bool:
        """Return whether it belongs to this model object, and its band contains `band`."""
        return self.model is model and self.band[0] <= band[0] and band[1] <= self.band[1]

    def __reduce__(self) -> tuple[object, tuple[()]]:
        return _restore_nothing, ()


def begin_reduction(
    reduction: Reduction,
    model: Model,
    kept: KeptBasis | None,
    state: State,
    freq: RealArray,
) -> None:
    """Begin a reduction with the kept basis if it serves, or else with a new one."""
    # The kept basis is compressed, because other sensors and a single state need fewer vectors.
    if kept is not None and kept.is_valid_for(model, reduction.band):
        reduction.basis = kept.basis.take_leading(kept.basis.size)
    else:
        reduction.build(state)
    reduction.compress(state, freq)


def _restore_nothing() -> None:
    """Return None: the unpickled value of a basis."""
