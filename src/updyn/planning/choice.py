"""`Choice`: the layout selected by a criterion in a band, in the order of gains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.dofs import DofSet
from updyn.errors import DataError
from updyn.planning.criteria import CRITERIA, Criterion, Planning, volume_score
from updyn.planning.layout import Layout
from updyn.planning.options import Band
from updyn.planning.result import RivalLayout, Worth
from updyn.planning.settings import PLANNING
from updyn.updating.problem.optimal_design import DesignScore, select_greedily

__all__ = ["Choice"]


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The layout selected by a criterion in a band (Hz): candidates, the largest gain first."""

    band: Band
    planning: Planning
    score: DesignScore
    rows: list[int]
    columns: list[int]
    row_gain: tuple[float, ...]
    column_gain: tuple[float, ...]

    @classmethod
    def sort_by_gain(
        cls, band: Band, planning: Planning, layout: Layout, rule: Criterion
    ) -> Choice:
        """Return a layout in the order of gains."""
        information, score = planning.information, rule.score(planning)
        before = np.broadcast_to(information.before, information.points_shape)
        rows, row_gain = _sort_by_gain(
            information.of_responses(layout.columns), before, layout.rows, score
        )
        columns, column_gain = _sort_by_gain(
            information.of_references(layout.rows), before, layout.columns, score
        )
        return cls(band, planning, score, rows, columns, row_gain, column_gain)

    @property
    def total(self) -> RealArray:
        """Information of the layout, shape (n_points, n, n)."""
        return self.planning.information.of_layout(self.rows, self.columns)

    @property
    def radius(self) -> float:
        """Geometric mean of the semi-axes of its confidence ellipsoid (`Plan.radius`)."""
        return self._compute_radius(self.total)

    def _compute_radius(self, information: RealArray) -> float:
        score = float(volume_score(self.planning).score(information))
        scale = self.planning.information.scale[list(self.planning.wanted)]
        return float(np.exp(-0.5 * score - np.mean(np.log(scale))))

    def gain(self, more: RealArray, less: RealArray) -> float:
        """Return the relative decrease of all standard deviations with more information."""
        return _compute_gain(self.score, more, less)

    def further_responses(self) -> tuple[Worth, ...]:
        """Return the next best responses."""
        items = self.planning.information.of_responses(self.columns)
        return self._rank_further(items, self.rows, self.planning.candidates.responses)

    def further_references(self) -> tuple[Worth, ...]:
        """Return the next best references."""
        items = self.planning.information.of_references(self.rows)
        return self._rank_further(items, self.columns, self.planning.candidates.references)

    def _rank_further(
        self, items: RealArray, chosen: Sequence[int], names: DofSet
    ) -> tuple[Worth, ...]:
        remaining = np.setdiff1d(np.arange(len(items)), chosen)
        count = min(PLANNING.further_items, len(remaining))
        order, _ = select_greedily(items[remaining], self.total, count, self.score)
        gains = _accumulate_gains(items[remaining[order]], self.total, self.score)
        labels = names[remaining[order]].labels
        return tuple(Worth(label, gain) for label, gain in zip(labels, gains, strict=True))

    def rivals(self, criterion: str) -> Iterator[RivalLayout]:
        """Yield the layouts of all criteria except one."""
        information, candidates = self.planning.information, self.planning.candidates
        for name in CRITERIA:
            if name == criterion:
                continue
            rule = CRITERIA[name]()
            try:
                layout = rule.choose(self.planning, len(self.rows), len(self.columns))
            except DataError as error:
                yield RivalLayout(name, (), (), float("nan"), str(error))
                continue
            radius = self._compute_radius(information.of_layout(layout.rows, layout.columns))
            responses = candidates.responses[list(layout.rows)].labels
            references = candidates.references[list(layout.columns)].labels
            yield RivalLayout(name, tuple(responses), tuple(references), radius / self.radius)


def _sort_by_gain(
    items: RealArray, before: RealArray, chosen: Sequence[int], score: DesignScore
) -> tuple[list[int], tuple[float, ...]]:
    """Return selected items in the order of gains, and the gains."""
    at = np.array(chosen, dtype=np.intp)
    order, _ = select_greedily(items[at], before, len(at), score)
    return at[order].tolist(), tuple(_accumulate_gains(items[at[order]], before, score))


def _accumulate_gains(items: RealArray, total: RealArray, score: DesignScore) -> Iterator[float]:
    """Yield the gain of each item after the previous ones."""
    for item in items:
        yield _compute_gain(score, total + item, total)
        total = total + item


def _compute_gain(score: DesignScore, more: RealArray, less: RealArray) -> float:
    rise = float(score.score(more) - score.score(less))
    return float(-np.expm1(-0.5 * rise))
