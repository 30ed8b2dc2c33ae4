"""Probabilities of angles and shrunk similarities, against simulated errors."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.acceptance.similarity import probability_between, probability_of_angle, shrink


def test_a_tangent_of_one_dimension_is_normal() -> None:
    for r, limit in ((0.3, 0.2), (0.3, 0.3), (0.2, 0.3)):
        found = probability_of_angle(np.array([r]), np.array([[0.1]]), limit)
        assert found == pytest.approx(probability_between(r, 0.1, limit), abs=0.02)


def test_errors_across_raise_the_probability() -> None:
    r = np.zeros(9)
    r[0] = 0.35
    alone = probability_of_angle(r, 0.1 * np.eye(9)[:, :1], 0.333)
    across = probability_of_angle(r, 0.1 * np.eye(9), 0.333)
    # |r|^2 = 0.1225 has 0.08 from errors across: the true tangent is about 0.2.
    assert alone < 0.5
    assert across > 0.8


def test_small_errors_decide_by_value() -> None:
    r = np.array([0.3, 0.0])
    for limit, expected in ((0.2999, 0.0), (0.3001, 1.0)):
        assert probability_of_angle(r, 1e-6 * np.eye(2), limit) == pytest.approx(expected)
        assert probability_of_angle(r, 1e-4 * np.eye(2), limit) == pytest.approx(
            0.1587 if expected == 0.0 else 0.8413, abs=0.002
        )
        assert probability_of_angle(r, np.zeros((2, 1)), limit) == expected
    assert np.isnan(probability_of_angle(r, np.full((2, 1), np.nan), 0.3))
    assert probability_of_angle(np.zeros(2), 0.1 * np.eye(2), 0.3) == pytest.approx(1.0)


def test_probabilities_of_angles_are_calibrated() -> None:
    """Over structures with uniform tangents, the stated probabilities are the shares that pass."""
    rng, stated, met = np.random.default_rng(3), [], []
    for _ in range(4000):
        true = np.zeros(8)
        true[0] = rng.uniform(0.0, 0.8)
        measured = true + 0.1 * rng.normal(size=8)
        stated.append(probability_of_angle(measured, 0.1 * np.eye(8), 1.0 / 3.0))
        met.append(true[0] <= 1.0 / 3.0)
    stated, met = np.array(stated), np.array(met)
    for low in (0.0, 0.2, 0.4, 0.6, 0.8):
        inside = (stated >= low) & (stated < low + 0.2)
        assert met[inside].mean() == pytest.approx(stated[inside].mean(), abs=0.13), low


def test_shrunk_values_are_those_of_equal_variances() -> None:
    values, std = np.array([0.1, -0.2, 0.3, 0.2, -0.1, 0.0]), np.full(6, 0.1)
    # James & Stein: B = (n - 2) sigma^2 / S times (n - 2) / n; S = 0.19, n = 6.
    share = 4.0 / 6.0 * 0.01 * 4.0 / 0.19
    found, deviation = shrink(values, std)
    assert found == pytest.approx((1.0 - share) * values)
    assert deviation**2 == pytest.approx(0.01 * (1.0 - share) + 2.0 / 3.0 * (share * values) ** 2)


@pytest.mark.parametrize(("n", "changes"), [(3, False), (4, True), (7, True)])
def test_few_values_are_not_shrunk(n: int, changes: bool) -> None:
    values, std = np.full(n, 0.2), np.full(n, 0.1)
    assert (shrink(values, std)[0] != values).all() == changes


def test_unknown_errors_are_not_shrunk() -> None:
    values, std = np.full(5, 0.2), np.full(5, np.nan)
    assert (shrink(values, std)[0] == values).all()
