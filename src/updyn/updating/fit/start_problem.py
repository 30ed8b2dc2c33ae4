"""The problem of tests at the start of their unknowns, with its noise models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from updyn.dynamics.settings import REDUCTION
from updyn.modal import ModeSet
from updyn.updating.fit.reducing import Reducing, are_modes_reduced, is_reduced
from updyn.updating.problem.data import Test, leave_out_undefined_line
from updyn.updating.problem.lines import restrict_to_lines
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.noise.modes import choose_modal_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["build_start_problem"]


def build_start_problem(
    tests: Sequence[Test],
    parameters: ParameterSet,
    known: Mapping[str, NoiseModel] = MappingProxyType({}),
) -> tuple[Problem, list[NoiseModel]]:
    """Return the problem of tests, and the noise models of those with FRFs.

    `known` are noise models by test name; others are chosen. Models are reduced by the rule of an
    update; a reduced model is accurate at the start only.
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
    parts = [restrict_to_lines(*one) for one in zip(_reduce_large(parts), lines, strict=True)]
    return Problem.of(parts, modal), noises


def _reduce_large(parts: list[FRFPart]) -> Sequence[FRFPart]:
    """Return the parts with reduced models if these take less time."""
    if not all(part.forward.is_linear for part in parts):
        return parts
    largest = max((part.solver.system.n for part in parts), default=0)
    if not is_reduced(None, largest, sum(len(part.frf.freq) for part in parts)):
        return parts
    exact = Problem.of(parts)
    reducing = Reducing(exact, REDUCTION.accuracy)
    reducing.begin()
    return reducing.with_reduced_models(exact).parts
