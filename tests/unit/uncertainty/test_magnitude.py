"""Limits of magnitudes, against the distributions of SciPy and random numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm, rayleigh, rice

from updyn.uncertainty.magnitude import magnitude_limits

ZERO = np.zeros(1)


@pytest.mark.parametrize("level", [0.6827, 0.95, 0.99])
def test_an_additive_error_gives_the_quantiles_of_rice(level) -> None:
    """For magnitudes of 0 to 60 standard deviations, to 2e-3 of one."""
    std, ratio = 0.25, np.linspace(0.0, 60.0, 999)
    low, high = magnitude_limits(std * ratio, np.full(999, std), np.zeros(999), level, None)
    tails = 0.5 - 0.5 * level, 0.5 + 0.5 * level
    assert np.abs(low / std - rice.ppf(tails[0], ratio)).max() < 2.2e-3
    assert np.abs(high / std - rice.ppf(tails[1], ratio)).max() < 2.2e-3


def test_a_value_of_zero_has_the_quantiles_of_rayleigh() -> None:
    low, high = magnitude_limits(ZERO, np.array([3.0]), ZERO, 0.95, None)
    assert low[0] == pytest.approx(rayleigh.ppf(0.025, scale=3.0), rel=1e-6)
    assert high[0] == pytest.approx(rayleigh.ppf(0.975, scale=3.0), rel=1e-6)


def test_a_relative_error_is_log_normal() -> None:
    low, high = magnitude_limits(np.array([2.0]), ZERO, np.array([0.3]), 0.95, None)
    assert high[0] == pytest.approx(2.0 * np.exp(norm.ppf(0.975) * 0.3))
    assert low[0] == pytest.approx(2.0 * np.exp(-norm.ppf(0.975) * 0.3))


def test_without_an_error_both_limits_are_the_magnitude() -> None:
    size = np.array([0.0, 2.0])
    low, high = magnitude_limits(size, np.zeros(2), np.zeros(2), 0.95, None)
    assert low.tolist() == high.tolist() == size.tolist()


@pytest.mark.parametrize("size", [0.0, 0.3, 1.0, 5.0])
def test_both_errors_together_cover_the_level(size) -> None:
    """Of random numbers with a factor of 20 % and an additive error of 1."""
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((3, 100_000))
    drawn = np.abs(size * np.exp(0.2 * normal[0]) + normal[1] + 1j * normal[2])
    one = np.ones(1)
    low, high = magnitude_limits(size * one, one, 0.2 * one, 0.95, None)
    assert np.mean((drawn > low) & (drawn < high)) == pytest.approx(0.95, abs=0.012)


def test_few_degrees_of_freedom_widen_by_the_quantile_of_student() -> None:
    size, std = np.array([1e3]), np.ones(1)
    low, high = magnitude_limits(size, std, ZERO, 0.95, 4)
    assert 0.5 * (high - low)[0] == pytest.approx(2.7764451, rel=1e-3)
