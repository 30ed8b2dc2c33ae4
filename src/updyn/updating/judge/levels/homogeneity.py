"""Test of homogeneity: FRFs of a linear structure are equal at all levels.

K. Worden & G. R. Tomlinson, Nonlinearity in Structural Dynamics (2001), section 2.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError
from updyn.frf import FRF
from updyn.updating.judge.levels.settings import LEVEL_TEST
from updyn.updating.problem.noise import NoiseChoice, choose_noise
from updyn.updating.problem.noise.known import SmoothVariance, smooth_variance
from updyn.updating.problem.noise.neighbours import estimate_scatter
from updyn.updating.problem.noise.settings import LINE_SCATTER

__all__ = [
    "combine_probabilities",
    "line_probabilities",
    "residual_variances",
    "scatter_variance",
    "start_variance",
    "stated_variance",
]


def stated_variance(frf: FRF, noise: NoiseChoice) -> RealArray | None:
    """Return E|dH|^2, shape (n_f, n_i, n_j), of the data or stated; None if it is not known."""
    model = choose_noise(noise, frf)
    return None if model.source == "estimated" else model.initial_variance(frf)


def scatter_variance(frf: FRF) -> RealArray:
    """Return E|dH|^2, shape (n_f, n_i, n_j), estimated from the scatter of neighbouring lines."""
    return _scatter_law(frf).at(np.abs(frf.values))


def _scatter_law(frf: FRF) -> SmoothVariance:
    if len(frf.freq) < LINE_SCATTER.least_lines:
        raise DataError(
            f"noise: {len(frf.freq)} lines do not determine it; expected at least"
            f" {LINE_SCATTER.least_lines}, a variance, a coherence, or noise="
        )
    freedom = LINE_SCATTER.window_lines - LINE_SCATTER.polynomial_degree - 1
    return smooth_variance(estimate_scatter(frf), np.abs(frf.values), freedom)


def start_variance(frf: FRF, scatter: RealArray) -> RealArray:
    """Return a variance without the curvature of resonances, to fit modes before it is known."""
    floor = np.median(scatter, axis=0)
    return np.asarray(floor + (LEVEL_TEST.start_noise * np.abs(frf.values)) ** 2)


def residual_variances(
    tests: Sequence[FRF], residual: ComplexArray
) -> tuple[list[RealArray], RealArray]:
    """Return E|dH|^2 of each test, from the residual of a fit of modes to the first.

    Also returns the degrees of freedom, shape (n_f, n_i, n_j), of these variances.

    Neighbouring lines scatter by the curvature of resonances, too; the scatter is used for channels
    where it is less than the residual. Other tests have at least the noise of the first, whose
    force is the smallest, relative to |H|, and more if their lines scatter more.
    """
    first = tests[0]
    size = np.abs(first.values)
    of_fit, of_scatter = smooth_variance(np.abs(residual) ** 2, size, 1), _scatter_law(first)
    is_better = of_fit.at(size).mean(axis=0) < of_scatter.at(size).mean(axis=0)
    law = SmoothVariance(
        np.where(is_better, of_fit.floor, of_scatter.floor),
        np.where(is_better, of_fit.relative, of_scatter.relative),
    )
    variances = [law.at(size)]
    for test in tests[1:]:
        least, scatter = law.at(np.abs(test.values)), _scatter_law(test)
        ratio = np.median(scatter.at(np.abs(test.values)) / least, axis=0)
        variances.append(np.maximum(np.maximum(ratio, 1.0) * least, scatter.floor))
    return variances, _count_freedoms(law.relative * size**2 / variances[0])


def _count_freedoms(share: RealArray) -> RealArray:
    """Return the degrees of freedom of a smoothed variance with a share of relative noise.

    Lines determine the relative noise where it exceeds the floor, which may be few of a resonance,
    and the floor elsewhere.
    """
    from scipy.ndimage import uniform_filter1d

    width = int(LEVEL_TEST.noise_freedoms / 2.0)
    parts = (share, 1.0 - share)
    lines = [part * width * uniform_filter1d(part, width, axis=0) for part in parts]
    return np.asarray(np.maximum(2.0 * sum(lines), 1.0))


def line_probabilities(
    tests: Sequence[FRF], variances: Sequence[RealArray], freedoms: RealArray
) -> RealArray:
    """Return the probability of differences as large by noise, shape (n_f, n_i, n_j).

    `freedoms` are the degrees of freedom of the variances, of the same shape.
    """
    from scipy.special import fdtrc  # slow to import and rarely needed

    weights = 1.0 / np.array(variances)
    values = np.array([test.values for test in tests])
    mean = np.sum(weights * values, axis=0) / np.sum(weights, axis=0)
    freedom = 2.0 * (len(tests) - 1)
    squares = 2.0 * np.sum(weights * np.abs(values - mean) ** 2, axis=0)
    return np.asarray(fdtrc(freedom, freedoms, squares / freedom))


def combine_probabilities(lines: RealArray) -> float:
    """Return the probability that any channel deviates as much at two adjacent lines.

    Two lines, as one alone may be an outlier. The bound (Bonferroni) holds for correlated channels
    and lines.
    """
    pairs = np.maximum(lines[:-1], lines[1:])
    return float(min(1.0, pairs.size * pairs.min(initial=1.0)))
