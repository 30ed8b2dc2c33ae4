"""Noise from the scatter of neighbouring lines, before any fit."""

import numpy as np
import pytest

import updyn
from updyn.updating.problem.noise import Estimated, EstimatedByChannel, level_by_unit
from updyn.updating.problem.noise.estimated import estimate_floors
from updyn.updating.problem.noise.neighbours import estimate_scatter
from updyn.updating.problem.noise.settings import LINE_SCATTER


def circular(seed, shape):
    """Complex Gaussian with E|z|^2 = 1."""
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def frf(freq, values):
    values = np.asarray(values, dtype=complex)
    rows, columns = ([f"{i + 1}:X" for i in range(n)] for n in values.shape[1:])
    return updyn.FRF(freq, values, rows, columns, "receptance")


def uneven(n):
    return 5.0 + np.cumsum(np.random.default_rng(2).uniform(0.2, 1.0, n))


def test_a_parabola_in_frequency_has_no_scatter():
    """On uneven lines, too, and at the ends of the band."""
    f = uneven(30)
    shape = (1.0 + 2.0j) - 0.3 * f + (0.02 - 0.01j) * f**2
    values = shape[:, None, None] * np.array([[1.0, 1j], [0.1, 3.0]])
    found = estimate_scatter(frf(f, values))
    assert found.shape == values.shape
    assert found.max() < 1e-24 * np.abs(values).max() ** 2


@pytest.mark.parametrize("freq", [uneven(6000), np.arange(1.0, 6001.0)], ids=["uneven", "even"])
def test_mean_scatter_of_white_noise_is_its_variance(freq):
    """Five values less three coefficients are 2 complex degrees of freedom: spread 1 / sqrt(2)."""
    found = estimate_scatter(frf(freq, 3.0 * circular(0, (6000, 2, 1))))
    assert found.mean() == pytest.approx(9.0, rel=0.05)
    assert found.std() / found.mean() == pytest.approx(2**-0.5, rel=0.1)


def test_scatter_of_a_window_by_numpy():
    f, values = uneven(9), circular(1, (9, 1, 1))
    found = estimate_scatter(frf(f, values))[:, 0, 0]
    for middle in range(2, 7):
        lines = slice(middle - 2, middle + 3)
        V = np.vander(f[lines], 3)
        left = values[lines, 0, 0] - V @ np.linalg.lstsq(V, values[lines, 0, 0], rcond=None)[0]
        assert found[middle] == pytest.approx(np.sum(np.abs(left) ** 2) / 2, rel=1e-8)
    assert found[:2].tolist() == [found[2]] * 2
    assert found[-2:].tolist() == [found[-3]] * 2


@pytest.mark.parametrize("n", [1, 2, 4])
def test_fewer_than_five_lines_say_nothing(n):
    data = frf(1.0 + np.arange(n), circular(2, (n, 2, 3)))
    assert (estimate_scatter(data) == np.zeros((n, 2, 3))).all()
    assert estimate_floors(data)[0] == 0.0


def test_few_lines_over_many_resonances_are_no_noise(gear_train):
    """The paper's eight lines, exact: the floor seemed to be a tenth of the rms."""
    freq = np.array([5.0, 10.0, 20.0, 30.0, 50.0, 75.0, 100.0, 150.0]) / (2 * np.pi)
    data = updyn.response(gear_train, freq, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    assert estimate_floors(data)[0] == 0.0


def smooth(n=600):
    """Four oscillators with loss factors of 5 to 10 %, at two sensors, over 1.2 decades."""
    f = np.linspace(2.0, 30.0, n)
    values = np.zeros((n, 2, 1), dtype=complex)
    for at, eta, shape in (
        (4.0, 0.1, (1.0, 0.5)),
        (9.0, 0.08, (0.7, -0.6)),
        (15.0, 0.06, (0.5, 0.9)),
        (24.0, 0.05, (0.4, -0.3)),
    ):
        values[:, :, 0] += np.array(shape) / (at**2 * (1 + 1j * eta) - f**2)[:, None]
    return f, values


@pytest.mark.parametrize("floor", [0.03, 0.01, 0.001])
@pytest.mark.parametrize("relative", [0.0, 0.01])
def test_floor_is_found_without_a_model(floor, relative):
    f, values = smooth()
    level = np.sqrt(np.mean(np.abs(values) ** 2))
    found = []
    for seed in range(5):
        noise = floor * level * circular(seed, values.shape)
        noise += relative * np.abs(values) * circular(seed + 100, values.shape)
        found.append(estimate_floors(frf(f, values + noise))[0])
    assert found == pytest.approx([floor] * 5, rel=0.2)
    assert np.mean(found) == pytest.approx(floor, rel=0.08)


def test_smooth_data_without_a_floor_have_a_tiny_one():
    """A hundredth of the relative noise, and of exact data next to nothing."""
    f, values = smooth()
    assert estimate_floors(frf(f, values))[0] < 1e-5
    noisy = values * (1 + 0.01 * circular(0, values.shape))
    assert estimate_floors(frf(f, noisy))[0] < 3e-4


def test_resonances_of_sparse_lines_are_no_floor():
    """Lines as far apart as resonances are wide scatter about any curve, but with the level."""
    f, values = smooth(60)
    assert estimate_floors(frf(f, values))[0] < 3e-3


# -- by sensor -------------------------------------------------------------------------------------
def with_floors(floors, seed=0, n=600):
    """Data of two sensors with a floor of each, as a share of the rms of all."""
    f, values = smooth(n)
    level = np.sqrt(np.mean(np.abs(values) ** 2))
    noise = 0.01 * np.abs(values) * circular(seed, values.shape)
    noise += level * np.array(floors)[:, None] * circular(seed + 100, values.shape)
    return frf(f, values + noise)


@pytest.mark.parametrize("floors", [(0.003, 0.03), (0.02, 0.001)])
def test_a_sensor_with_a_floor_of_its_own_has_its_own(floors):
    data = with_floors(floors)
    found = Estimated.of_data(data).initial_variance(data)[0, :, 0]
    level = np.sqrt(np.mean(np.abs(data.values) ** 2))
    assert np.sqrt(found) / level == pytest.approx(floors, rel=0.3)
    by_channel = EstimatedByChannel.of_data(data).initial_variance(data)
    assert (by_channel[0, :, 0] == found).all()


def test_sensors_with_one_floor_share_the_estimate_of_all():
    for seed in range(10):
        data = with_floors((0.01, 0.01), seed)
        assert Estimated.of_data(data).own_floors == ()


def test_own_floors_are_those_of_the_sensors_by_name():
    """Whatever other sensors are asked for along with them."""
    data = with_floors((0.003, 0.03))
    noise = Estimated.of_data(data)
    one = data.select(responses=[data.responses[1]])
    scale = (level_by_unit(one) / level_by_unit(data))[0, 0, 0]
    assert noise.initial_variance(one)[0, 0, 0] == pytest.approx(
        scale**2 * noise.initial_variance(data)[0, 1, 0]
    )


def test_the_odds_from_which_a_floor_is_a_sensors_own():
    """100 to 1, a fifth of the values counting: ln(100) in all."""
    unlike = [with_floors((0.01, 0.01 * factor)) for factor in (1.15, 3.0)]
    assert [bool(estimate_floors(one)[1]) for one in unlike] == [False, True]
    assert np.log(100.0) == pytest.approx(LINE_SCATTER.own_floor_log_odds)


def test_few_lines_have_no_floors_of_their_own():
    data = with_floors((0.003, 0.03), n=19)
    assert Estimated.of_data(data).own_floors == ()
