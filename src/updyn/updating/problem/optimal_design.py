"""Optimal design: selection of items (lines, sensors, forces) by the Fisher information of each.

Information (n, n) is scaled by that of all items and added over items; a greedy selection and
exchanges maximise a score of it (Fedorov, Theory of Optimal Experiments, 1972, chapter 3).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.problem.settings import OPTIMAL_DESIGN

__all__ = [
    "AOptimal",
    "DOptimal",
    "DesignScore",
    "exchange_items",
    "initial_information",
    "scale_information",
    "select_greedily",
]


class DesignScore(ABC):
    """Score of a design by its information; the largest is the best."""

    __slots__ = ()

    @property
    def has_diminishing_gains(self) -> bool:
        """Whether an item adds the less to the score, the more items a design has."""
        return False

    @abstractmethod
    def score(self, information: RealArray) -> RealArray:
        """Return the score of each design from its total information, shape (..., n, n)."""


@dataclass(frozen=True, slots=True)
class DOptimal(DesignScore):
    """log det of the information: small volume of the confidence ellipsoid.

    The fitted unknowns `others` are eliminated and do not count (D_s-optimality; Atkinson, Donev &
    Tobias, Optimum Experimental Designs, 2007, section 10.3).
    """

    others: tuple[int, ...] = ()

    @property
    def has_diminishing_gains(self) -> bool:
        """Whether all unknowns count: a log det of sums is submodular, a difference of two not."""
        return not self.others

    def score(self, information: RealArray) -> RealArray:
        """Return log det of the information, less that of `others` if there are any."""
        whole = np.linalg.slogdet(information)[1]
        if not self.others:
            return np.asarray(whole)
        at = list(self.others)
        return np.asarray(whole - np.linalg.slogdet(information[..., at, :][..., at])[1])


@dataclass(frozen=True, slots=True, eq=False)
class AOptimal(DesignScore):
    """Negative log of the mean variance of the unknowns `wanted`, each over that with all items."""

    wanted: list[int]
    least: RealArray

    @classmethod
    def of(cls, information: RealArray, wanted: Sequence[int]) -> AOptimal:
        """Return the score relative to the variances with `information`, such as of all items."""
        at = list(wanted)
        return cls(at, _variances(information, at))

    def score(self, information: RealArray) -> RealArray:
        """Return the negative logarithm of the mean relative variance."""
        return np.asarray(
            -np.log((_variances(information, self.wanted) / self.least).mean(axis=-1))
        )


def _variances(information: RealArray, wanted: list[int]) -> RealArray:
    """Return the variances of some unknowns, shape (..., n_wanted)."""
    unit = np.broadcast_to(np.eye(information.shape[-1]), information.shape)
    covariance = np.linalg.solve(information, unit)
    return np.asarray(np.einsum("...pp->...p", covariance)[..., wanted])


def scale_information(information: RealArray) -> tuple[RealArray, RealArray]:
    """Return items, shape (n_items, n, n), scaled by their sum, and the scale, shape (n,).

    The diagonal of the sum of the scaled items is 1; rows and columns are divided by the scale.
    """
    scale = np.sqrt(np.maximum(np.einsum("fpp->p", information), np.finfo(float).tiny))
    return information / scale[:, None] / scale, scale


def initial_information(n: int) -> RealArray:
    """Return the information of `n` scaled unknowns before the first item, shape (n, n)."""
    return OPTIMAL_DESIGN.initial_information * np.eye(n)


def select_greedily(
    information: RealArray, total: RealArray, count: int, criterion: DesignScore
) -> tuple[list[int], RealArray]:
    """Return items selected one by one by the largest score, and `total` with these added.

    `information`, shape (n_items, ..., n, n), must be scaled.
    """
    chosen: list[int] = []
    total = np.broadcast_to(total, information.shape[1:])
    bound = np.full(len(information), np.inf)
    for _ in range(count):
        best = _find_best(information, total, criterion, bound)
        chosen.append(best)
        bound[best] = -np.inf
        total = total + information[best]
    return chosen, total


def _find_best(
    information: RealArray, total: RealArray, criterion: DesignScore, bound: RealArray
) -> int:
    """Return the item with the largest score; `bound`, upper bounds of the gains, are lowered."""
    # If gains diminish, those of earlier rounds are bounds, and few items are scored again
    # (Minoux, Accelerated greedy algorithms, Lecture Notes Contr. Inf. Sci. 7 (1978) 234).
    remaining = np.flatnonzero(bound > -np.inf)
    step = len(remaining)
    if criterion.has_diminishing_gains:
        remaining = remaining[np.argsort(-bound[remaining], kind="stable")]
        step = OPTIMAL_DESIGN.scored_together
    before = criterion.score(np.broadcast_to(total, information.shape[1:]))
    best, gain = -1, -np.inf
    for start in range(0, len(remaining), step):
        at = remaining[start : start + step]
        if bound[at[0]] <= gain:
            break
        bound[at] = criterion.score(total + information[at]) - before
        first = int(np.argmax(bound[at]))
        if bound[at[first]] > gain:
            best, gain = int(at[first]), float(bound[at[first]])
    return best


def exchange_items(
    information: RealArray, total: RealArray, chosen: Sequence[int], criterion: DesignScore
) -> list[int]:
    """Exchange selected items for others, the best pair first, while the score increases."""
    # A new item has the position of the one that it replaces.
    chosen = list(chosen)
    for _ in range(OPTIMAL_DESIGN.most_exchanges):
        others = np.setdiff1d(np.arange(len(information)), chosen)
        if not others.size:
            break
        now = criterion.score(total)
        increases = [
            criterion.score(total - information[c] + information[others]) - now for c in chosen
        ]
        out, into = np.unravel_index(int(np.argmax(increases)), (len(chosen), len(others)))
        if increases[out][into] < OPTIMAL_DESIGN.least_increase:
            break
        total = total - information[chosen[out]] + information[others[into]]
        chosen[out] = int(others[into])
    return chosen
