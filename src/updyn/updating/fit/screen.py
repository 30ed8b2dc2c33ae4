"""`Screen`: which points may fit as well as an answer, told from few lines.

What the lines leave only adds up, so that a few of them show that a point is far off. Most points
that are looked at beside an answer are, by so much that one line in ten is enough.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, zip_longest
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from updyn.errors import SolverError
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import Each

__all__ = ["Screen"]

_Vector = NDArray[np.float64]

#: Fewest lines of a part that are looked at first, with as many values as there are unknowns.
_TOGETHER = 4
#: A point is far off that leaves this many times what the answer does. Where the size of the noise
#: is not known, its log-likelihood is then lower by a half for each measured number.
_FAR = math.e
#: Share of the points that each piece leaves where they are only ranked.
_RANKED = 0.25
#: Few data count as so many values.
_FEWEST = 50


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """Some lines of a part.

    Attributes
    ----------
    part : Part
        On these lines.
    H : ndarray of complex, shape (n_f, n_i, n_j)
        The model's there, of the answer.
    weight : ndarray of float, shape (n_f, n_i, n_j)
        Inverse standard deviations of the data.
    """

    part: Part
    H: NDArray[np.complex128]
    weight: NDArray[np.float64]

    def left_at(self, x: _Vector) -> float:
        """Return the sum of squares that x leaves; inf where the model cannot be solved."""
        try:
            return self.left(self.part.responses(x))
        except SolverError:
            return np.inf

    def left(self, H: NDArray[np.complex128]) -> float:
        """Return the sum of squares that a model leaves, in variances of the data.

        Noise that grows with the response is taken as that of the larger of both models.
        """
        larger = np.maximum(np.abs(H), np.abs(self.H))
        share = np.divide(np.abs(self.H), larger, out=np.ones(H.shape), where=larger > 0.0)
        return float(np.sum(np.abs((H - self.part.frf.values) * self.weight * share) ** 2))


@dataclass(frozen=True, slots=True, eq=False)
class Screen:
    """Tells points that are far off from those that may fit as well as an answer.

    Attributes
    ----------
    pieces : tuple
        The lines: a few, twice as many others, and so on, each of them spread over the band.
    most : float
        Sum of squares beyond which a point is far off.
    """

    pieces: tuple[_Piece, ...]
    most: float

    @classmethod
    def of(
        cls, problem: Problem, x: _Vector, noises: Sequence[NoiseModel], residual: Each
    ) -> Screen:
        """Return the screen about an answer.

        Parameters
        ----------
        problem : Problem
            What was fitted.
        x : ndarray of float, shape (n,)
            The answer.
        noises : sequence of NoiseModel
            The noise of its last descent, of each part.
        residual : Each
            The residual, whitened by it.
        """
        if any(noise.heavy_tails for noise in noises):
            return cls((), np.inf)  # a few lines say nothing of the rest
        pieces = [
            list(_pieces(part, residual.of(i).weight / np.sqrt(2.0), x))
            for i, part in enumerate(problem.parts)
        ]
        left = sum(piece.left(piece.H) for own in pieces for piece in own)
        most = _FAR * max(left, float(problem.n_values), _FEWEST)
        by_turns = chain.from_iterable(zip_longest(*pieces))
        return cls(tuple(piece for piece in by_turns if piece is not None), most)

    def promising(self, points: Sequence[_Vector], number: int) -> list[_Vector]:
        """Return the points that leave least, best first, without those that are far off.

        After each piece the worse half of the points is left out, until so many are left.

        Parameters
        ----------
        points : sequence of ndarray of float, shape (n,)
            The points.
        number : int
            How many of them are enough.
        """
        kept = [(0.0, x) for x in points]
        for piece in self.pieces:
            summed = [(left + piece.left_at(x), x) for left, x in kept]
            near = [one for one in summed if one[0] <= self.most]
            near.sort(key=itemgetter(0))
            kept = near[: max(number, -(-len(near) // 2))]
            if len(kept) <= number:
                break
        return [x for _, x in kept]

    def ranked(
        self, points: Sequence[_Vector], distances: Sequence[float], number: int
    ) -> list[_Vector]:
        """Return the points that leave least for their distance from the answer, best first.

        For points at which the model is off by more than the noise, so that none is far off for
        what it leaves. As more lines say little more, three quarters are left out after each piece.
        (Measured and left out: what a point leaves alone, by which those that the data hardly tell
        from the answer come first; over the square of the distance, by which the farthest do.)

        Parameters
        ----------
        points : sequence of ndarray of float, shape (n,)
            The points.
        distances : sequence of float
            Of each, in standard deviations of the data.
        number : int
            How many of them are enough.
        """
        tiny = np.finfo(float).tiny
        kept = [(0.0, max(far, tiny), x) for far, x in zip(distances, points, strict=True)]
        for piece in self.pieces:
            summed = [(left + piece.left_at(x), far, x) for left, far, x in kept]
            summed.sort(key=lambda one: one[0] / one[1])
            kept = summed[: max(number, math.ceil(_RANKED * len(summed)))]
            if len(kept) <= number:
                break
        return [x for _, _, x in kept[:number]]


def _pieces(part: Part, weight: NDArray[np.float64], x: _Vector) -> Iterator[_Piece]:
    """Yield the lines of a part: a few of them, twice as many others, and so on."""
    H, freq = part.responses(x), part.frf.freq
    few = max(_TOGETHER, -(-part.n // H[0].size))
    # As points are left out, the work stays about the same.
    ends = few * (2 ** np.arange(1, int(np.log2(len(freq) / few + 1.0)) + 1) - 1)
    for some in np.split(_spread(len(freq)), ends):
        if len(some):
            own = np.sort(some)
            yield _Piece(replace(part, frf=part.frf.select(lines=freq[own])), H[own], weight[own])


def _spread(number: int) -> NDArray[np.intp]:
    """Return 0 ... number - 1 in an order of which every run is spread over them: bits reversed."""
    bits = int(number - 1).bit_length()
    order = np.zeros(1, dtype=np.intp)
    for bit in range(bits):
        order = np.concatenate([order, order + (1 << (bits - 1 - bit))])
    return order[order < number]
