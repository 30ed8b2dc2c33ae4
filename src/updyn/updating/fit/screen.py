"""`Screen`: selection, from few lines, of points that may fit as well as an answer.

The sum of squares over lines only grows, so one line in ten excludes most points.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, zip_longest
from operator import itemgetter

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.errors import SolverError
from updyn.updating.fit.settings import SCREEN
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputErrorSet

__all__ = ["Screen"]


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Some lines of a part, the model's FRFs at the answer, and the inverse std of the data."""

    part: FRFPart
    H: ComplexArray
    weight: RealArray

    def squared_error_at(self, x: RealArray) -> float:
        """Return the sum of squared residuals at x; inf if the model cannot be solved."""
        try:
            return self.squared_error(self.part.responses(x))
        except SolverError:
            return np.inf

    def squared_error(self, H: ComplexArray) -> float:
        """Return the sum of squared residuals of a model, in variances of the data."""
        # If noise grows with the response, that of the larger response of both models is used.
        larger = np.maximum(np.abs(H), np.abs(self.H))
        share = np.divide(np.abs(self.H), larger, out=np.ones(H.shape), where=larger > 0.0)
        return float(np.sum(np.abs((H - self.part.frf.values) * self.weight * share) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """Separates points that are far off from those that may fit as well as an answer.

    `pieces` are sets of lines: a few, twice as many others, and so on, each spread over the band. A
    point is far off if its sum of squares is above `limit`.
    """

    pieces: tuple[_Piece, ...]
    limit: float

    @classmethod
    def of(
        cls, problem: Problem, x: RealArray, noises: Sequence[NoiseModel], residual: OutputErrorSet
    ) -> Screen:
        """Return the screen of answer x, from the noise and whitened residual of its descent."""
        if any(noise.heavy_tails for noise in noises):
            return cls((), np.inf)  # a few lines are not representative
        pieces = [
            list(_split_lines(part, residual.of(i).weight / np.sqrt(2.0), x))
            for i, part in enumerate(problem.parts)
        ]
        total = sum(
            piece.squared_error(piece.H) for pieces_of_part in pieces for piece in pieces_of_part
        )
        limit = SCREEN.far_ratio * max(total, float(problem.n_values), SCREEN.least_values)
        by_turns = chain.from_iterable(zip_longest(*pieces))
        return cls(tuple(piece for piece in by_turns if piece is not None), limit)

    def select_best(self, points: Sequence[RealArray], number: int) -> list[RealArray]:
        """Return the `number` points of least sum of squares that are not far off, best first."""
        kept = [(0.0, x) for x in points]
        for piece in self.pieces:
            summed = [(squares + piece.squared_error_at(x), x) for squares, x in kept]
            near = [one for one in summed if one[0] <= self.limit]
            near.sort(key=itemgetter(0))
            kept = near[: max(number, -(-len(near) // 2))]
            if len(kept) <= number:
                break
        return [x for _, x in kept]

    def rank(
        self, points: Sequence[RealArray], distances: Sequence[float], number: int
    ) -> list[RealArray]:
        """Return the points of least sum of squares over distance from the answer, best first."""
        # For points at which the error of the model exceeds the noise, so none can be rejected by
        # its sum of squares. (Measured and rejected: the sum of squares alone, which prefers
        # points that the data hardly distinguish from the answer; over the squared distance, which
        # prefers the farthest points.)
        tiny = np.finfo(float).tiny
        kept = [(0.0, max(far, tiny), x) for far, x in zip(distances, points, strict=True)]
        for piece in self.pieces:
            summed = [(squares + piece.squared_error_at(x), far, x) for squares, far, x in kept]
            summed.sort(key=lambda one: one[0] / one[1])
            kept = summed[: max(number, math.ceil(SCREEN.kept_share * len(summed)))]
            if len(kept) <= number:
                break
        return [x for _, _, x in kept[:number]]


def _split_lines(part: FRFPart, weight: RealArray, x: RealArray) -> Iterator[_Piece]:
    """Yield the lines of a part: a few of them, twice as many others, and so on."""
    H, freq = part.responses(x), part.frf.freq
    few = max(SCREEN.first_lines, -(-part.n // H[0].size))
    # The number of points halves with each piece, so the work of each piece is about the same.
    ends = few * (2 ** np.arange(1, int(np.log2(len(freq) / few + 1.0)) + 1) - 1)
    for some in np.split(_order_bit_reversed(len(freq)), ends):
        if len(some):
            lines = np.sort(some)
            yield _Piece(
                replace(part, frf=part.frf.select(lines=freq[lines])), H[lines], weight[lines]
            )


def _order_bit_reversed(number: int) -> IndexArray:
    """Return 0 ... number - 1 in bit-reversed order, in which every run spans the range."""
    bits = int(number - 1).bit_length()
    order = np.zeros(1, dtype=np.intp)
    for bit in range(bits):
        order = np.concatenate([order, order + (1 << (bits - 1 - bit))])
    return order[order < number]
