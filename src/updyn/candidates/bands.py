"""Predictive scores: the log density of bands that were held out of the fit in turn.

A band has lines of FRFs or, of measured modes, some with successive frequencies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.candidates.evidence import Prior, log_prediction
from updyn.candidates.weighted import WeightedProblem, count_items
from updyn.errors import SolverError

__all__ = ["divide_lines", "score_bands"]


def divide_lines(n_items: Sequence[int], count: int) -> list[list[IndexArray]]:
    """Return `count` contiguous bands of about equal numbers of lines or modes, each by part."""
    by_part = [np.array_split(np.arange(n), count) for n in n_items]
    return [list(band) for band in zip(*by_part, strict=True)]


def score_bands(
    data: WeightedProblem,
    x: RealArray,
    bands: Sequence[Sequence[IndexArray]],
    report: Callable[[int], None],
) -> tuple[RealArray, RealArray]:
    """Return the log density of each band by a fit to the others, (K,), and the fits, (K, n).

    A fit that leaves more than the noise widens its prediction by the same factor. `report` is
    called with the number of each band that is done.
    """
    prior = Prior.of(data.problem.coordinates)
    scores, estimates = [], []
    for number, band in enumerate(bands, 1):
        rest = [
            np.setdiff1d(np.arange(n), held)
            for n, held in zip(count_items(data.problem), band, strict=True)
        ]
        score, estimate = _score_band(data.select(rest), data.select(band), x, prior)
        scores.append(score)
        estimates.append(estimate)
        report(number)
    return np.array(scores), np.array(estimates)


def _score_band(
    fitted: WeightedProblem, held_out: WeightedProblem, x: RealArray, prior: Prior
) -> tuple[float, RealArray]:
    found = fitted.likelihood.descend(x)
    if found is None:
        raise SolverError("the model cannot be solved at the estimate")
    local = fitted.data(found.x)
    scale = max(2.0 * local.cost / max(fitted.problem.n_numbers - len(x), 1), 1.0)
    score = log_prediction(local, held_out.data(found.x), prior, scale)
    score += held_out.log_constant(found.x) - 0.5 * held_out.problem.n_numbers * np.log(scale)
    return float(score), found.x
