"""Noise of each sensor by itself: recovered, used only with data for it, worth it where one sensor is bad."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.problem.noise import (
    ASSUMED,
    Assumed,
    Estimated,
    EstimatedByChannel,
    Stated,
    choose_noise,
)

RNG = np.random.default_rng
BY_CHANNEL = "estimated-by-channel"


def noisy(clean, rng, relative, floor, factors):
    """Noise of each response `factors` times as large."""
    size = np.abs(clean.values)
    std = (
        np.hypot(relative * size, floor * np.sqrt(np.mean(size**2)))
        * np.array(factors)[:, None]
        / np.sqrt(2.0)
    )
    draw = rng.standard_normal((2, *size.shape))
    return replace(clean, values=clean.values + std * (draw[0] + 1j * draw[1]))


@pytest.fixture(scope="module")
def wide():
    rng = RNG(4)
    H = 10 ** rng.uniform(-6, -3, (400, 3, 2)) * np.exp(2j * np.pi * rng.uniform(size=(400, 3, 2)))
    return updyn.FRF(1.0 + np.arange(400), H, ["1:X", "2:X", "3:X"], ["1:X", "2:X"], "receptance")


@pytest.mark.parametrize("noise", [BY_CHANNEL, {"source": BY_CHANNEL, "robust": "student-t"}])
def test_numbers_of_each_sensor_are_recovered(wide, noise):
    data = noisy(wide, RNG(0), 0.02, 0.0, [1.0, 5.0, 0.5])
    found = choose_noise(noise, data).refit(wide.values, data, 0).figures()
    assert list(found["relative_by_channel"]) == list(wide.responses.labels)
    assert list(found["relative_by_channel"].values()) == pytest.approx([0.02, 0.1, 0.01], rel=0.08)
    assert max(found["floor_by_channel"].values()) < 1e-3
    floor = noisy(wide, RNG(0), 0.0, 0.01, [1.0, 5.0, 0.5])
    level = np.sqrt(np.mean(np.abs(floor.values) ** 2) / np.mean(np.abs(wide.values) ** 2))
    found = choose_noise(noise, floor).refit(wide.values, floor, 0).figures()["floor_by_channel"]
    assert list(found.values()) == pytest.approx(np.array([0.01, 0.05, 0.005]) / level, rel=0.08)


def test_too_few_values_of_a_sensor_are_taken_together(wide):
    few = noisy(wide, RNG(0), 0.02, 0.0, [1.0, 5.0, 0.5]).select(lines=wide.freq[:12])
    H = wide.values[:12]
    assert isinstance(choose_noise(BY_CHANNEL, few).refit(H, few, 0), Estimated)
    one = few.select(lines=few.freq[:1])
    assert isinstance(choose_noise(BY_CHANNEL, one).refit(H[:1], one, 12), Assumed)


def test_before_a_residual_was_seen_it_is_of_ordinary_size(wide):
    model = choose_noise(BY_CHANNEL, wide)
    assert isinstance(model, EstimatedByChannel)
    assert model.variance(wide.values, wide) == pytest.approx(
        Stated(**ASSUMED).variance(wide.values, wide)
    )
    assert model.figures() == {}


def test_it_helps_where_one_sensor_is_bad_and_costs_nothing_else(chain12_task):
    """One of five sensors has ten times the noise: errors are at the bound, not four times above it."""
    start, clean, unknowns, truth = chain12_task
    for factor, ratio in ((10.0, (2.5, 8.0)), (1.0, (0.9, 1.1))):
        factors = [1.0, factor, 1.0, 1.0, 1.0]
        variance = (0.01 * np.abs(clean.values) * np.array(factors)[:, None]) ** 2
        told = updyn.update(
            start, replace(clean, variance=variance), unknowns.with_start(truth), starts=0
        )
        bound = np.array(list(told.std.values()))
        rms, inside = {}, []
        for noise in ("estimated", BY_CHANNEL):
            off = []
            for seed in range(6):
                data = noisy(clean, RNG(seed), 0.01, 0.0, factors)
                result = updyn.update(start, data, unknowns, noise=noise, starts=0)
                off.append((np.array(list(result.values.values())) - truth) / bound)
                if noise == BY_CHANNEL:
                    inside.append(
                        np.abs(off[-1]) * bound < 1.96 * np.array(list(result.std.values()))
                    )
            rms[noise] = np.sqrt(np.mean(np.square(off)))
        assert rms[BY_CHANNEL] == pytest.approx(1.0, abs=0.2)
        assert ratio[0] < rms["estimated"] / rms[BY_CHANNEL] < ratio[1]
        assert np.mean(inside) > 0.88
        assert result.noise["chi_square"] == pytest.approx(1.0, abs=0.01)
