"""The search for the layout with the largest score: sensors and forces in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.planning.information import PairInformation
from updyn.updating.problem.optimal_design import DesignScore, exchanged, greedy

__all__ = ["Layout", "OverPoints", "best_layout"]

_Real = NDArray[np.float64]

#: References that the search starts from, the best of their own.
_STARTS = 6
#: Rounds of exchange of responses, then references.
_ROUNDS = 10


@dataclass(frozen=True, slots=True)
class Layout:
    """Chosen candidates, by position.

    Attributes
    ----------
    rows, columns : tuple of int
        Responses and references.
    """

    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OverPoints(DesignScore):
    """Mean of a score over the points of the unknowns.

    Parameters
    ----------
    base : DesignScore
        The score at one point.
    """

    base: DesignScore

    def score(self, information: _Real) -> _Real:
        """Return the mean score of each design, of information of shape (..., n_points, n, n)."""
        return np.asarray(self.base.score(information).mean(axis=-1))


def best_layout(
    information: PairInformation, n_rows: int, n_columns: int, criterion: DesignScore
) -> Layout:
    """Choose responses and references with the largest score of their information.

    References are chosen greedily as if all responses were measured, beginning with each of those
    that are best alone; responses are then chosen for them greedily. Both are exchanged in turn
    while the score rises.

    Parameters
    ----------
    information : PairInformation
        Of all pairs.
    n_rows, n_columns : int
        How many responses and references.
    criterion : DesignScore
        The score of the information at all points.

    Returns
    -------
    Layout
    """
    all_rows = range(information.shape[0])
    alone = information.of_references(all_rows)
    firsts = np.argsort(-criterion.score(alone + information.before), kind="stable")[:_STARTS]
    best, highest = Layout((), ()), -np.inf
    for first in firsts.tolist():
        total = information.before + alone[first]
        columns = [first, *_further(alone, total, [first], n_columns - 1, criterion)]
        found = _improved(information, columns, n_rows, criterion)
        score = float(criterion.score(information.of_layout(found.rows, found.columns)))
        if score > highest:
            best, highest = found, score
    return best


def _further(
    items: _Real, total: _Real, chosen: Sequence[int], count: int, criterion: DesignScore
) -> list[int]:
    """Choose further items greedily."""
    left = np.setdiff1d(np.arange(len(items)), chosen)
    order, _ = greedy(items[left], total, count, criterion)
    return [int(i) for i in left[order]]


def _improved(
    information: PairInformation, columns: list[int], n_rows: int, criterion: DesignScore
) -> Layout:
    """Return the layout that greedy choice and exchange reach from some references."""
    items = information.of_responses(columns)
    rows, _ = greedy(items, information.before, n_rows, criterion)
    for _ in range(_ROUNDS):
        before = Layout(tuple(rows), tuple(columns))
        items = information.of_responses(columns)
        rows = exchanged(items, information.of_layout(rows, columns), rows, criterion)
        items = information.of_references(rows)
        columns = exchanged(items, information.of_layout(rows, columns), columns, criterion)
        if before == Layout(tuple(rows), tuple(columns)):
            break
    return Layout(tuple(rows), tuple(columns))
