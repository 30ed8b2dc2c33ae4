"""The model for trials of faults: the model itself, or a reduced one that is valid at all trials.

The basis is made once from a few points about the start, each solved at another frequency. It is
enriched at points of decisions until its error there is certified. The remaining error counts as
noise of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.reduction import Reduction, VectorsPerState
from updyn.frf import TRANSMISSIBILITY
from updyn.updating.fit.search import scatter_points
from updyn.updating.judge.causes.evidence import compute_spread, scale_stiffness
from updyn.updating.judge.causes.holding import (
    ModelSupports,
    SolverWithSupports,
    list_ground_springs,
)
from updyn.updating.judge.causes.places import list_all_places
from updyn.updating.judge.causes.settings import CAUSE_MODEL
from updyn.updating.problem.problem import FRFPart

__all__ = ["ReducedModels", "TrialModels", "WholeModel", "choose_trial_models"]


class TrialModels(Protocol):
    """Source of the models for trials."""

    def prepare_part(self, part: FRFPart, points: Sequence[RealArray]) -> FRFPart:
        """Return the part with a model that is valid at some points."""


@dataclass(frozen=True, slots=True)
class WholeModel:
    """The model itself."""

    def prepare_part(self, part: FRFPart, points: Sequence[RealArray]) -> FRFPart:
        """Return the part itself."""
        return part


@dataclass(slots=True, eq=False)
class ReducedModels:
    """A reduced model of a part about its start."""

    part: FRFPart
    _reduction: Reduction = field(init=False)
    _certified: list[RealArray] = field(default_factory=list, init=False)
    _error: RealArray = field(init=False)
    _supports: ModelSupports = field(init=False)
    _solver: FieldSolver = field(init=False)

    def __post_init__(self) -> None:
        part, freq = self.part, self.part.frf.freq
        places = list_all_places(part)
        near = np.zeros(0, dtype=np.intp)
        if places:
            near = np.unique(part.solver.system.dofs.match(places).index)
        self._reduction = Reduction(
            part.solver.system,
            *part.receptance_dofs,
            (float(freq[0]), float(freq[-1])),
            part.solver.backend,
            CAUSE_MODEL.accuracy,
            near,
            part.session.check,
        )
        points, samples = (_scatter_starts(part, CAUSE_MODEL.points, seed) for seed in (0, 1))
        # A support may not hold the structure at all.
        home, springs = part.coordinates.start, list_ground_springs(part)
        levels = CAUSE_MODEL.loose
        loose = [scale_stiffness(part, home, one, level) for one in springs for level in levels]
        across = VectorsPerState(
            CAUSE_MODEL.shifts, CAUSE_MODEL.depth, CAUSE_MODEL.combinations, lossy=False
        )
        self._reduction.build_around([part.state(x) for x in points] + loose, across=across)
        states = [part.state(x) for x in samples] + loose
        self._reduction.compress_around(states, freq, CAUSE_MODEL.dropped, CAUSE_MODEL.most_vectors)
        self._error = np.zeros(part.frf.values.shape)
        self._supports = ModelSupports.of(part.solver.system)
        self._solver = self._make_solver("reduced, causes")

    def prepare_part(self, part: FRFPart, points: Sequence[RealArray]) -> FRFPart:
        """Return the part with the reduced model, enriched at points without a certificate.

        The error of the reduced model is added to the variance of the data of `part`.
        """
        for x in points:
            if not any(np.abs(x - known).max() < CAUSE_MODEL.near for known in self._certified):
                self._enrich(x)
        frf = part.frf
        if frf.values.shape == self._error.shape and frf.variance is not None:
            factor = np.abs(frf.s[:, None, None]) ** frf.power
            frf = replace(frf, variance=frf.variance + (factor * self._error) ** 2)
        return replace(part.with_solver(self._solver), frf=frf)

    def _enrich(self, x: RealArray) -> None:
        certificate = self._reduction.certify(self.part.state(x), self.part.frf.freq)
        if self.part.frf.quantity != TRANSMISSIBILITY:  # errors are those of receptances
            self._error = np.maximum(self._error, certificate.errors)
        self._certified.append(x)
        self._solver = self._make_solver(f"reduced, causes {len(self._certified)}")

    def _make_solver(self, label: str) -> FieldSolver:
        label = f"{label} of {self.part.solver.label}"
        return SolverWithSupports.from_solver(self._reduction.solver(label), self._supports)


def _scatter_starts(part: FRFPart, number: int, seed: int) -> list[RealArray]:
    """Return the start, and points about it within the spread of the unknowns."""
    coordinates = part.coordinates
    factor, spread = ~coordinates.parameters.is_damping, compute_spread(part)
    lowest = np.where(factor, coordinates.start - spread, 0.0)
    highest = np.where(
        factor,
        coordinates.start + spread,
        np.minimum(coordinates.start + spread, CAUSE_MODEL.most_loss),
    )
    middle, half = 0.5 * (lowest + highest), 0.5 * (highest - lowest)
    return [
        coordinates.start,
        *np.clip(scatter_points(middle, half, number - 1, seed), *coordinates.bounds),
    ]


def choose_trial_models(part: FRFPart) -> TrialModels:
    """Return the source of the models for trials of a part, by the size of its model."""
    if part.solver.system.n <= CAUSE_MODEL.largest_whole:
        return WholeModel()
    return ReducedModels(part)
