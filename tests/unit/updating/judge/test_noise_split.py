"""Covariance over the ratios of relative noise and floor, against integrals computed elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.updating.judge.noise_split import covariance_over_ratios
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem

STIFFNESS, MASS, LOSS = 1e4, 1.0, 0.05
FREQ = np.array([8.0, 12.0, 15.0, 16.5, 20.0, 26.0])


def receptance(k=STIFFNESS, loss=LOSS) -> np.ndarray:
    """Of one mass on a spring."""
    return 1.0 / (k * (1.0 + 1j * loss) - (2.0 * np.pi * FREQ) ** 2 * MASS)


def noisy(relative, floor, seed) -> FRF:
    H = receptance()
    sigma = np.hypot(relative * np.abs(H), floor * np.sqrt(np.mean(np.abs(H) ** 2)))
    draw = np.random.default_rng(seed).standard_normal((2, len(H))) * np.sqrt(0.5)
    H = H + sigma * (draw[0] + 1j * draw[1])
    return FRF(FREQ, H[:, None, None], ["1:X"], ["1:X"], "receptance")


def model() -> Model:
    K, M = np.array([[STIFFNESS]]), np.array([[MASS]])
    return Model.from_groups({"spring": Group(K, M, loss_factor=LOSS)}, ["1:X"])


def unknowns() -> ParameterSet:
    return updyn.parameters(model(), stiffness=["spring"], loss_factor=["spring"])


def test_it_is_the_largest_over_ratios_of_a_likelihood_of_at_least_1_over_e():
    """By normal equations; the restricted likelihood is the integral over both unknowns."""
    frf = noisy(0.02, 0.01, 1)
    part = FRFPart.build(model(), frf, unknowns())
    x = part.coordinates.start
    found = covariance_over_ratios(Problem.of([part]), x, [1.0], np.eye(2))
    H, level = receptance(), np.sqrt(np.mean(np.abs(frf.values) ** 2))
    dk = -(H**2) * STIFFNESS * (1.0 + 1j * LOSS)
    de = -(H**2) * STIFFNESS * 1j
    J = np.stack([np.r_[dk.real, dk.imag], np.r_[de.real, de.imag]], axis=1)
    r = frf.values[:, 0, 0] - H
    r = np.r_[r.real, r.imag]
    size = np.abs(np.r_[H, H])
    low, high = -np.log(size.max() / level), -np.log(size.min() / level)
    weights, errors = [], []
    for ratio in np.exp(np.linspace(low - np.log(10.0), high + np.log(10.0), 41)):
        w = 1.0 / ((ratio * size) ** 2 + level**2)
        A = J.T @ (w[:, None] * J)
        step = np.linalg.solve(A, J.T @ (w * r))
        S = float(w @ (r - J @ step) ** 2)
        weights.append(np.sqrt(np.prod(w) / np.linalg.det(A)) * S ** (-5.0))
        errors.append(S / 10.0 * np.linalg.solve(A, np.eye(2)) + np.outer(step, step))
    weights, errors = np.array(weights), np.array(errors)
    admissible = errors[weights >= np.exp(-1.0) * weights.max()]
    assert 3 < len(admissible) < 41
    assert np.diag(found) == pytest.approx(admissible[:, [0, 1], [0, 1]].max(axis=0), rel=1e-6)
    best = errors[np.argmax(weights)]
    correlation = best[0, 1] / np.sqrt(best[0, 0] * best[1, 1])
    assert found[0, 1] / np.sqrt(found[0, 0] * found[1, 1]) == pytest.approx(correlation)


def test_it_is_none_without_spare_numbers():
    frf = noisy(0.02, 0.0, 0).select(lines=FREQ[:1])
    part = FRFPart.build(model(), frf, unknowns())
    assert (
        covariance_over_ratios(Problem.of([part]), part.coordinates.start, [1.0], np.eye(2)) is None
    )


def test_intervals_from_six_lines_cover_whatever_the_noise():
    """Two unknowns, noise that is all relative, mixed, or all floor.

    50 draws of each: the standard error of a coverage of 95 % is 1.5 %.
    """
    inside = []
    truth = {"spring.stiffness": 1.0, "spring.loss_factor": LOSS}
    for relative, floor in ((0.02, 0.0), (0.01, 0.01), (0.0, 0.02)):
        for seed in range(50):
            result = updyn.update(model(), noisy(relative, floor, seed), unknowns(), starts=0)
            assert result.noise["degrees_of_freedom"] == 10
            spans = result.intervals()
            inside += [spans[k][0] <= v <= spans[k][1] for k, v in truth.items()]
    assert 0.92 <= np.mean(inside) <= 0.995
