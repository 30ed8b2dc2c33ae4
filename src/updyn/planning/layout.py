"""Search for the layout with the largest score, of sensors and forces in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.planning.information import PairInformation
from updyn.planning.settings import LAYOUT_SEARCH
from updyn.updating.problem.optimal_design import DesignScore, exchange_items, select_greedily

__all__ = ["Layout", "OverPoints", "best_layout"]


@dataclass(frozen=True, slots=True)
class Layout:
    """Selected candidates by index: responses (rows) and references (columns)."""

    rows: tuple[int, ...]
    columns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OverPoints(DesignScore):
    """Mean of a score over the points of the parameters."""

    base: DesignScore

    def score(self, information: RealArray) -> RealArray:
        """Return the mean score of each design, of information of shape (..., n_points, n, n)."""
        return np.asarray(self.base.score(information).mean(axis=-1))


def best_layout(
    information: PairInformation, n_rows: int, n_columns: int, criterion: DesignScore
) -> Layout:
    """Return responses and references with the largest score of their information."""
    # References are selected greedily as if all responses were measured, starting with each of the
    # best separate ones; responses are then selected greedily for them. Both are exchanged in turn
    # while the score increases.
    all_rows = range(information.shape[0])
    alone = information.of_references(all_rows)
    firsts = np.argsort(-criterion.score(alone + information.before), kind="stable")
    firsts = firsts[: LAYOUT_SEARCH.starts]
    best, highest = Layout((), ()), -np.inf
    for first in firsts.tolist():
        total = information.before + alone[first]
        columns = [first, *_select_further(alone, total, [first], n_columns - 1, criterion)]
        found = _improve_layout(information, columns, n_rows, criterion)
        score = float(criterion.score(information.of_layout(found.rows, found.columns)))
        if score > highest:
            best, highest = found, score
    return best


def _select_further(
    items: RealArray, total: RealArray, chosen: Sequence[int], count: int, criterion: DesignScore
) -> list[int]:
    left = np.setdiff1d(np.arange(len(items)), chosen)
    order, _ = select_greedily(items[left], total, count, criterion)
    return [int(i) for i in left[order]]


def _improve_layout(
    information: PairInformation, columns: list[int], n_rows: int, criterion: DesignScore
) -> Layout:
    """Return the layout from some references by greedy selection and exchange."""
    items = information.of_responses(columns)
    rows, _ = select_greedily(items, information.before, n_rows, criterion)
    while True:  # each exchange increases the score, so the loop ends
        before = Layout(tuple(rows), tuple(columns))
        items = information.of_responses(columns)
        rows = exchange_items(items, information.of_layout(rows, columns), rows, criterion)
        items = information.of_references(rows)
        columns = exchange_items(items, information.of_layout(rows, columns), columns, criterion)
        if before == Layout(tuple(rows), tuple(columns)):
            return before
