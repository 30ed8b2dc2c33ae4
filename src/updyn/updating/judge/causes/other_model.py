"""`CompiledVariant`: a variant of the model of a part, with a reduced model for trials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from updyn.arrays import RealArray
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.excitation import DrivenSolver
from updyn.dynamics.fields import LineSolver
from updyn.updating.judge.causes.reduced import TrialModels, choose_trial_models
from updyn.updating.problem.problem import FRFPart
from updyn.variants import Variant, build_variants

__all__ = ["CompiledVariant"]


@dataclass(slots=True, eq=False)
class CompiledVariant:
    """A variant of the model of a part, compiled and reduced at its first use."""

    part: FRFPart
    variant: Variant
    _variant_part: FRFPart | None = field(default=None, init=False)
    _trial_models: TrialModels | None = field(default=None, init=False)

    @property
    def variant_part(self) -> FRFPart:
        """The part with the whole variant; a `ModelError` if its elements cannot be computed."""
        if self._variant_part is None:
            model, part = self.variant.model(), self.part
            solver_now: Any = part.solver
            system = AffineSystem.compile(model)
            if isinstance(solver_now, DrivenSolver):
                highest = float(part.frf.freq[-1])
                system = solver_now.excitation.hold(system, highest)
                solver_now = solver_now.inner
            name = ", ".join([solver_now.variant, *self.variant.groups])
            solver = LineSolver(system, solver_now.tier, solver_now.backend, name)
            self._variant_part = replace(part.with_solver(solver), variants=build_variants(model))
        return self._variant_part

    @property
    def trial_models(self) -> TrialModels:
        """Source of the models for trials of the variant; a `SolverError` if it is singular."""
        if self._trial_models is None:
            self._trial_models = choose_trial_models(self.variant_part)
        return self._trial_models

    def replace_model(self, part: FRFPart) -> FRFPart:
        """Return a part of the same model with the whole variant."""
        # The terms equal those of the unchanged model, so the unknowns remain valid.
        return replace(part, solver=self.variant_part.solver, variants=self.variant_part.variants)

    def prepare_part(self, part: FRFPart, points: Sequence[RealArray]) -> FRFPart:
        """Return a part of the same model with the variant, valid at some points."""
        return self.trial_models.prepare_part(self.replace_model(part), points)
