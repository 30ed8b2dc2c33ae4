"""What is predicted of held-out data, against draws of the posterior and the noise."""

import numpy as np
import pytest

import updyn
from updyn.updating.fit.start_problem import build_start_problem
from updyn.updating.judge.held_out import predictive_figures
from updyn.updating.problem.data import Test
from updyn.updating.problem.noise import EstimatedByChannel, Stated

NOISE = Stated(0.02, 0.01)


@pytest.fixture(scope="module")
def part():
    """A chain of three masses, its data those of the model, at two sensors."""
    group = {"m": updyn.Group(mass=np.diag([1.0, 1.5, 0.8]))}
    for i, k in enumerate((2e4, 1.5e4, 1e4)):
        v = np.zeros(3)
        v[i] = 1.0
        v[i - 1 : i] = -1.0
        group[f"s{i}"] = updyn.Group(k * np.outer(v, v), loss_factor=0.03)
    model = updyn.Model.from_groups(group, ["1:X", "2:X", "3:X"])
    frf = updyn.response(model, np.linspace(5.0, 30.0, 40), ["2:X", "3:X"], ["1:X"], "accelerance")
    unknowns = updyn.parameters(model, stiffness="s*")
    problem, _ = build_start_problem([Test(model, frf)], unknowns)
    return problem.parts[0]


def test_the_predicted_residual_is_that_of_draws(part):
    """Of small deviations; 400 draws know the rms to 2 %."""
    x, covariance = part.coordinates.start, np.diag([1e-4, 4e-4, 1e-4])
    found = predictive_figures(part, x, covariance, NOISE)
    rng = np.random.default_rng(5)
    H = part.responses(x)
    squared = np.zeros(H.shape)
    for _ in range(400):
        drawn = part.responses(x + 1e-2 * rng.normal(size=3) * np.sqrt(np.diag(covariance)))
        squared += np.abs(drawn - H) ** 2 / 400 * 1e4
    squared += NOISE.variance(H, part.frf)
    share = np.mean(squared, axis=0) / np.mean(np.abs(H) ** 2, axis=0)
    assert found["residual_expected"] == pytest.approx(np.sqrt(np.median(share)), rel=0.1)
    assert found["residual_deviations"] < 1e-10  # the data are those of the model


def test_noise_of_twice_the_size_has_twice_the_deviations(part):
    rng = np.random.default_rng(6)
    x = part.coordinates.start
    H = part.responses(x)
    z = (rng.normal(size=H.shape) + 1j * rng.normal(size=H.shape)) / np.sqrt(2.0)
    noisy = H + 2.0 * z * np.sqrt(NOISE.variance(H, part.frf))
    frf = updyn.FRF(part.frf.freq, noisy, part.frf.responses, part.frf.references, "accelerance")
    of_noise = part.with_data(frf)
    found = predictive_figures(of_noise, x, np.zeros((3, 3)), NOISE)
    assert found["residual_deviations"] == pytest.approx(2.0, rel=0.1)
    scaled = predictive_figures(of_noise, x, np.zeros((3, 3)), NOISE, 4.0)
    assert scaled["residual_deviations"] == pytest.approx(1.0, rel=0.1)
    assert scaled["residual_expected"] == pytest.approx(2.0 * found["residual_expected"], rel=0.01)


def test_what_hangs_on_an_open_unknown_is_not_predicted(part):
    covariance = np.diag([1e-6, np.inf, 1e-6])
    found = predictive_figures(part, part.coordinates.start, covariance, NOISE)
    assert found == {"residual_expected": 1.0, "residual_deviations": 0.0}


def test_a_sensor_that_was_not_fitted_has_the_noise_of_a_typical_one(part):
    own = EstimatedByChannel(
        relative=np.array([0.01, 0.02, 0.3]),
        floor=np.array([0.0, 0.01, 0.02]),
        names=("5:X", "6:X", "7:X"),
        held=True,
    )
    x, known = part.coordinates.start, np.zeros((3, 3))
    assert predictive_figures(part, x, known, own) == predictive_figures(part, x, known, NOISE)
