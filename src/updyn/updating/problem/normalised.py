"""Derivatives of FRFs with limited norms, for tests of rank."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.updating.problem.modal import ModalError
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LineResidual, ResidualSet, noise_weights

__all__ = ["NormalisedDerivatives", "make_normalised_residual"]


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedDerivatives(LineResidual):
    """Rows d ln H / dx, normalised to a norm of at most 1; the residual is 0.

    On a resonance d ln H / dx is as large as 1 / loss factor. A test of rank compares singular
    values, so such a line would hide all others. Scaling a row does not change the null space.
    `weight` is 1 for the values that are used, else 0.
    """

    weight: RealArray
    name: str = "normalised"

    @property
    def cache_key(self) -> object:
        """The weights."""
        return self.weight

    def on(self, part: FRFPart, lines: slice) -> Self:
        """Return the residual with the weights of a block of lines."""
        return replace(self, weight=self.weight[lines])

    def block(self, part: FRFPart, x: RealArray, lines: slice) -> tuple[ComplexArray, ComplexArray]:
        """Return zeros and derivatives at a block of lines; `weight` is of the same block."""
        block = part.block(x, lines)
        assert block.dH is not None
        weight = np.where(block.H != 0.0, self.weight, 0.0)
        slope = block.dH / np.where(block.H != 0.0, block.H, 1.0)
        norm = np.sqrt(np.sum(np.abs(slope) ** 2, axis=0))
        return np.zeros_like(block.H), slope * (weight / np.maximum(norm, 1.0))


def make_normalised_residual(
    problem: Problem, noises: Sequence[NoiseModel]
) -> ResidualSet[NormalisedDerivatives]:
    """Return the rows of all values that are neither rounding error nor of infinite variance."""
    errors = []
    for part, noise in zip(problem.parts, noises, strict=True):
        without = np.where(np.isfinite(noise.initial_variance(part.frf)), 0.0, np.inf)
        errors.append(NormalisedDerivatives(noise_weights(part.frf.values, without, part.frf)))
    modal = tuple(ModalError(part.noise.in_units_of_frequency()) for part in problem.modal)
    return ResidualSet(tuple(errors), modal)
