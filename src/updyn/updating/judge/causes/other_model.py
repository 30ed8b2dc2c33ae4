"""`OtherModel`: a compiled variant of the model of a part, and its reduced model for trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver
from updyn.updating.judge.causes.reduced import Stage, stage_of
from updyn.updating.problem.problem import Part
from updyn.variants import Variant, variants_of

__all__ = ["OtherModel"]


@dataclass(slots=True, eq=False)
class OtherModel:
    """A variant of the model of a part, compiled and reduced at its first use.

    Parameters
    ----------
    part : Part
        The part with its whole, unchanged model.
    variant : Variant
        Variant of the model.
    """

    part: Part
    variant: Variant
    _own: Part | None = field(default=None, init=False)
    _stage: Stage | None = field(default=None, init=False)

    @property
    def own(self) -> Part:
        """The part with the whole variant.

        Raises
        ------
        ModelError
            If the elements of the variant cannot be computed.
        """
        if self._own is None:
            model = self.variant.model()
            now: Any = self.part.solver
            name = ", ".join([now.variant, *self.variant.groups])
            solver = LineSolver(AffineSystem.compile(model), now.tier, now.backend, name)
            self._own = replace(self.part, solver=solver, variants=variants_of(model))
        return self._own

    @property
    def stage(self) -> Stage:
        """Source of the models for trials of the variant.

        Raises
        ------
        SolverError
            If the variant is to be reduced and cannot be solved.
        """
        if self._stage is None:
            self._stage = stage_of(self.own)
        return self._stage

    def instead(self, part: Part) -> Part:
        """Return a part of the same model with the whole variant."""
        # The terms equal those of the unchanged model, so the unknowns remain valid.
        return replace(part, solver=self.own.solver, variants=self.own.variants)

    def near(self, part: Part, points: Sequence[NDArray[np.float64]]) -> Part:
        """Return a part of the same model with the variant, valid at some points."""
        return self.stage.near(self.instead(part), points)
