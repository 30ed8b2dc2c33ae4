"""The problem of tests at the start of their unknowns, with its noise models and reduced models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.fields import FieldSolver
from updyn.dynamics.settings import REDUCTION
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.fit.reducing import Reducing, are_modes_reduced, is_reduced
from updyn.updating.problem.data import Test, leave_out_undefined_line
from updyn.updating.problem.lines import restrict_to_lines
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.noise.modes import choose_modal_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["ReducedStart", "build_start_problem"]


@dataclass(frozen=True, eq=False)  # no slots, for the cached properties
class ReducedStart:
    """The reduced model for all channels and lines of FRFs, built at its first use.

    It is accurate at the start of the unknowns only.
    """

    model: Model
    frf: FRF
    parameters: ParameterSet
    backend: str | None = None

    @cached_property
    def part(self) -> FRFPart:
        """The part with the whole model, without calibration factors."""
        frf = leave_out_undefined_line(Test(self.model, self.frf)).frf
        part = FRFPart.build(self.model, frf, self.parameters, backend=self.backend)
        return replace(part, as_read=False)

    @cached_property
    def solver(self) -> FieldSolver:
        """The solver of the reduced model; SolverError if the model cannot be solved."""
        return _reduce_at_start(self.part)

    def respond(self, freq: RealArray) -> FRF:
        """Return the FRF of the model in the channels and quantity of the data, at lines in Hz."""
        frf = self.part.frf.with_level(None)
        blank = np.zeros((len(freq), *frf.values.shape[1:]))
        frf = replace(frf, freq=freq, values=blank, coherence=None, variance=None, averages=None)
        part = replace(self.part.with_solver(self.solver), frf=frf)
        values = part.responses(part.coordinates.start)
        return replace(frf, values=values, source="model, reduced")


def build_start_problem(
    tests: Sequence[Test],
    parameters: ParameterSet,
    known: Mapping[str, NoiseModel] = MappingProxyType({}),
    starts: Mapping[str, ReducedStart] = MappingProxyType({}),
) -> tuple[Problem, list[NoiseModel]]:
    """Return the problem of tests, and the noise models of those with FRFs.

    `known` are noise models by test name; others are chosen. Models are reduced by the rule of an
    update, with the reduced models in `starts` where they are known.
    """
    parts, modal, noises, lines = [], [], [], []
    for test in map(leave_out_undefined_line, tests):
        if isinstance(test.data, ModeSet):
            noise = choose_modal_noise(test.noise)
            reduced = are_modes_reduced(None, test.model.n_dofs)
            modal.append(
                ModalPart.build(
                    test.model, test.data, parameters, noise, name=test.name, reduced=reduced
                )
            )
            continue
        parts.append(FRFPart.build(test.model, test.data, parameters, name=test.name))
        noises.append(known.get(test.name) or choose_noise(test.noise, test.data))
        lines.append(test.lines)
    solved = _reduce_large(parts, starts)
    parts = [restrict_to_lines(*one) for one in zip(solved, lines, strict=True)]
    return Problem.of(parts, modal), noises


def _reduce_large(
    parts: Sequence[FRFPart], starts: Mapping[str, ReducedStart]
) -> Sequence[FRFPart]:
    """Return the parts with reduced models if these take less time."""
    if not all(part.forward.is_linear for part in parts):
        return parts
    largest = max((part.solver.system.n for part in parts), default=0)
    if not is_reduced(None, largest, sum(len(part.frf.freq) for part in parts)):
        return parts
    return [part.with_solver(_find_reduced_solver(part, starts)) for part in parts]


def _find_reduced_solver(part: FRFPart, starts: Mapping[str, ReducedStart]) -> FieldSolver:
    if part.name in starts:
        return starts[part.name].solver
    return _reduce_at_start(part)


def _reduce_at_start(part: FRFPart) -> FieldSolver:
    """Return the solver of a reduced model at the start, with the accuracy of an update."""
    reducing = Reducing(Problem.of([part]), REDUCTION.accuracy)
    reducing.begin()
    (solver,) = reducing.start_solvers
    return solver
