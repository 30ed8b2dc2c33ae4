"""`KeptBasis`: the basis with which an update ended, where further reduced models begin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.affine import State
from updyn.dynamics.basis import Basis
from updyn.dynamics.reduction import Reduction
from updyn.model import Model

__all__ = ["KeptBasis", "begin"]

#: The largest basis that is kept, in bytes. One of 150,000 DOFs and 334 vectors takes 0.4e9.
_LARGEST = 1 << 30


@dataclass(frozen=True, slots=True, eq=False)
class KeptBasis:
    """A basis of a model, and the band in which none of its modes is missing.

    It is never changed: what begins with it does not depend on what has begun with it before. It is
    memory of this process: a pickle or a copy of it is None.

    Attributes
    ----------
    model : Model
        What it is of.
    basis : Basis
        Its vectors take 8 bytes a DOF each.
    band : (float, float)
        In Hz.
    """

    model: Model
    basis: Basis
    band: tuple[float, float]

    @classmethod
    def of(cls, model: Model, reduction: Reduction) -> KeptBasis | None:
        """Return the basis of a reduction as it is; None of more than 1 GiB."""
        basis = reduction.basis
        if 8 * basis.system.n * basis.size > _LARGEST:
            return None
        return cls(model, basis.leading(basis.size), reduction.band)

    def serves(self, model: Model, band: tuple[float, float]) -> bool:
        """Return whether it is of this very model, and its band holds another one."""
        return self.model is model and self.band[0] <= band[0] and band[1] <= self.band[1]

    def __reduce__(self) -> tuple[object, tuple[()]]:
        return _nothing, ()


def begin(
    reduction: Reduction,
    model: Model,
    kept: KeptBasis | None,
    state: State,
    freq: NDArray[np.float64],
) -> None:
    """Begin a reduction: with what it needs of a basis that is kept, or else of a new one.

    Other sensors, and one state alone, need fewer vectors; what they lack the reduction asks the
    full model, as of a new basis.

    Parameters
    ----------
    reduction : Reduction
        Without a basis yet.
    model : Model
        What it is of.
    kept : KeptBasis or None
        Of this model or another one.
    state : State
        Of the model.
    freq : ndarray of float, shape (n_f,)
        All lines that matter, in Hz.

    Raises
    ------
    SolverError
        If the model cannot be solved at the state.
    """
    if kept is not None and kept.serves(model, reduction.band):
        reduction.basis = kept.basis.leading(kept.basis.size)
    else:
        reduction.build(state)
    reduction.compress(state, freq)


def _nothing() -> None:
    """Return what a pickle of a basis is read as."""
