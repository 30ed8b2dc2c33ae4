"""Construction of a problem and its noise models from tests."""

from __future__ import annotations

from collections.abc import Sequence

from updyn.modal import ModeSet
from updyn.updating.problem.data import Test, leave_out_undefined_line
from updyn.updating.problem.lines import restrict_to_lines
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.noise.modes import choose_modal_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem

__all__ = ["build_problem"]


def build_problem(
    tests: Sequence[Test], parameters: ParameterSet
) -> tuple[Problem, list[NoiseModel]]:
    """Return the problem of tests, and the noise models of those with FRFs."""
    parts, modal, noises = [], [], []
    for test in map(leave_out_undefined_line, tests):
        if isinstance(test.data, ModeSet):
            noise = choose_modal_noise(test.noise)
            modal.append(ModalPart.build(test.model, test.data, parameters, noise, name=test.name))
            continue
        part = FRFPart.build(test.model, test.data, parameters, name=test.name)
        parts.append(restrict_to_lines(part, test.lines))
        noises.append(choose_noise(test.noise, test.data))
    return Problem.of(parts, modal), noises
