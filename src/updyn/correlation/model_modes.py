"""`ModelModes`: the modes of a model for comparisons, computed once for several of them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import numpy as np

from updyn.correlation.settings import MODEL_MODES
from updyn.dynamics.excitation import hold_base
from updyn.dynamics.modes import Modes, complex_modes_of, modes_up_to
from updyn.errors import DataError, ModelError
from updyn.frf import FRF
from updyn.model import Model

__all__ = ["ModelModes"]


@dataclass(frozen=True, slots=True, eq=False)
class _Computed:
    """Modes up to a frequency in Hz, and the warnings of their computation."""

    modes: Modes
    highest: float
    warnings: tuple[Warning | str, ...] = ()


@dataclass(slots=True, eq=False)
class ModelModes:
    """The modes of a model, at most 400; a request up to a lower frequency computes none anew.

    Warnings of a computation are repeated for later requests. The methods raise DataError if the
    model has no mode in the range, ModelError or SolverError if modes cannot be computed.
    """

    model: Model
    _undamped: _Computed | None = field(default=None, init=False)
    _damped: _Computed | None = field(default=None, init=False)

    def hold_base(self, frf: FRF) -> tuple[ModelModes, FRF]:
        """Return the modes with the base fixed, and the data of the sensors off the base."""
        model, data = hold_base(self.model, frf)
        return self.replace_model(model), data

    def replace_model(self, model: Model) -> ModelModes:
        """Return the modes of a model; these modes if it is the same."""
        return self if model is self.model else ModelModes(model)

    def up_to(self, highest: float) -> Modes:
        """Return the undamped modes from 0 up to a frequency in Hz, and the next one."""
        known = self._undamped
        if known is None or known.highest < highest:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                modes = modes_up_to(self.model, highest, MODEL_MODES.most_modes)
            known = _Computed(modes, highest, tuple(one.message for one in caught))
            self._undamped = known
        for warning in known.warnings:
            warnings.warn(warning, stacklevel=3)
        number = int(np.searchsorted(known.modes.frequency, highest, side="right")) + 1
        return known.modes.select(np.arange(len(known.modes)) < number)

    def undamped(self, highest: float) -> Modes:
        """Return the real modes up to a frequency in Hz, without rigid-body modes."""
        return _select_elastic(self.up_to(highest), highest)

    def damped(self, highest: float) -> Modes:
        """Return the modes up to a frequency in Hz, without rigid-body modes.

        They are complex if the model is damped, has at most 5000 DOFs and no loss factor that
        depends on frequency; otherwise real, with loss factors by modal strain energy.
        """
        found = self.up_to(highest)
        if found.loss_factor.any() and self.model.n_dofs <= MODEL_MODES.most_complex_dofs:
            if self._damped is None or self._damped.highest < highest:
                self._damped = _Computed(self._compute_complex(found), highest)
            found = self._damped.modes
        return _select_elastic(found, highest)

    def _compute_complex(self, undamped: Modes) -> Modes:
        """Return the complex modes, or the undamped ones if complex modes cannot be computed."""
        try:
            return complex_modes_of(self.model, undamped)
        except ModelError:  # loss factors over frequency, or overdamped motions
            return undamped


def _select_elastic(found: Modes, highest: float) -> Modes:
    """Return the modes above 0 and up to a frequency."""
    kept = (found.frequency > 0) & (found.frequency <= highest)
    if not kept.any():
        raise DataError(f"the model has no mode above 0 and up to {highest:g} Hz")
    return found.select(kept)
