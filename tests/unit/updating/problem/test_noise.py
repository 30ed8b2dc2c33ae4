"""Noise models: conventions by simulation, estimates by recovery, choices and refusals."""

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from updyn.updating.fit.method import correlation_length
from updyn.updating.problem.noise import (
    ASSUMED,
    Assumed,
    Estimated,
    EstimatedByChannel,
    Stated,
    Variance,
    choose_noise,
    level_by_unit,
)

RNG = np.random.default_rng


def circular(rng, shape):
    """Complex Gaussian with E|z|^2 = 1: half the variance in each part."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def frf(values, **kwargs):
    values = np.asarray(values)
    n_f, n_i, n_j = values.shape
    rows, columns = [f"{i + 1}:X" for i in range(n_i)], [f"{j + 1}:X" for j in range(n_j)]
    return updyn.FRF(1.0 + np.arange(n_f), values, rows, columns, "receptance", **kwargs)


@pytest.fixture(scope="module")
def H():
    """Magnitudes over three decades, random phase."""
    rng = RNG(4)
    return 10 ** rng.uniform(-6, -3, (400, 3, 2)) * np.exp(
        2j * np.pi * rng.uniform(size=(400, 3, 2))
    )


def test_stated_variance_is_that_of_simulated_noise(H):
    model, rng = Stated(0.05, 0.02), RNG(0)
    rms = np.sqrt(np.mean(np.abs(H) ** 2))
    draws = [
        np.abs(0.05 * np.abs(H) * circular(rng, H.shape) + 0.02 * rms * circular(rng, H.shape)) ** 2
        for _ in range(400)
    ]
    variance = model.variance(H, frf(H))
    assert np.mean(draws, axis=0) / variance == pytest.approx(np.ones(H.shape), abs=0.35)
    assert np.mean(np.array(draws) / variance) == pytest.approx(1.0, abs=0.01)


def test_weights_of_real_and_imaginary_part_give_chi_square_of_one(H):
    """Residuals times sqrt(2 / E|dH|^2) have unit variance in each part: the convention that methods rely on."""
    model, rng = Stated(0.03, 0.0), RNG(1)
    noisy = H * (1 + 0.03 * circular(rng, H.shape))
    whitened = np.sqrt(2.0 / model.variance(H, frf(noisy))) * (H - noisy)
    assert np.var(whitened.real) == pytest.approx(1.0, abs=0.06)
    assert np.var(whitened.imag) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(
    ("relative", "floor"),
    [(0.05, 0.0), (0.0, 0.01), (0.03, 0.003), (0.003, 0.02), (1e-4, 0.0), (0.3, 0.0)],
)
def test_estimate_recovers_the_noise(H, relative, floor):
    """Both parts within a few per cent where they show; a part that does not show stays below what would show."""
    rng, rms = RNG(2), np.sqrt(np.mean(np.abs(H) ** 2))
    noisy = H + relative * np.abs(H) * circular(rng, H.shape) + floor * rms * circular(rng, H.shape)
    found = Estimated().refit(H, frf(noisy), 0)
    level = np.sqrt(np.mean(np.abs(noisy) ** 2)) / rms
    if relative:
        assert found.relative == pytest.approx(relative, rel=0.05)
    else:
        assert found.relative < 0.2 * floor
    if floor:
        assert found.floor * level == pytest.approx(floor, rel=0.05)
    else:
        assert found.floor < 0.01 * relative
    assert found.figures() == {"relative": found.relative, "floor": found.floor}


def test_a_large_part_of_the_data_below_the_floor_leaves_both_numbers_to_be_found():
    """Magnitudes over seven decades: three of four values are below the floor."""
    rng = RNG(5)
    H = np.geomspace(1.0, 1e-7, 400)[:, None, None] * np.exp(2j * np.pi * rng.random((400, 3, 1)))
    rms = np.sqrt(np.mean(np.abs(H) ** 2))
    noisy = H + 0.01 * (np.abs(H) * circular(rng, H.shape) + rms * circular(rng, H.shape))
    found = Estimated().refit(H, frf(noisy), 0)
    assert found.relative == pytest.approx(0.01, rel=0.15)
    assert found.floor == pytest.approx(0.01, rel=0.05)


def test_no_estimate_of_relative_noise_exceeds_the_response(H):
    """A model that misses the data by far says nothing of noise above 100 %."""
    assert Estimated().refit(H, frf(50.0 * H), 0).relative == 1.0


def test_channels_that_symmetry_forbids_say_nothing_of_the_noise(H):
    """Half of the values are zero in model and data; the noise of the others is what it is."""
    seen = H * np.array([1.0, 1.0, 0.0])[:, None]
    noisy = seen * (1 + 0.05 * circular(RNG(3), H.shape))
    found = Estimated().refit(seen, frf(noisy), 0)
    assert found.relative == pytest.approx(0.05, rel=0.05)
    by_channel = EstimatedByChannel().refit(seen, frf(noisy), 0)
    assert by_channel.relative[:2] == pytest.approx([0.05, 0.05], rel=0.08)
    assert np.isfinite(by_channel.variance(seen, frf(noisy))).all()


def test_few_numbers_give_one_scale_and_say_so():
    """Ten values and three unknowns leave 17: one level, at the middle ratio; 40 values leave two.

    There relative noise and floor are alike at the geometric mean of the loudest and the quietest.
    """
    rng = RNG(6)
    H = rng.standard_normal((40, 1, 1)) + 1j * rng.standard_normal((40, 1, 1))
    noisy = H * (1 + 0.02 * circular(rng, H.shape))
    few = Estimated().refit(H[:10], frf(noisy[:10]), 3)
    size, rms = np.abs(H[:10]), np.sqrt(np.mean(np.abs(noisy[:10]) ** 2))
    middle = rms / np.sqrt(size.min() * size.max())
    assert few.relative / few.floor == pytest.approx(middle)
    assert few.figures()["degrees_of_freedom"] == 17
    # The scale makes chi-square, over the spare numbers, one.
    whitened = np.abs(noisy[:10] - H[:10]) ** 2 * 2.0 / few.variance(H[:10], frf(noisy[:10]))
    assert np.sum(whitened) == pytest.approx(17.0)
    many = few.refit(H, frf(noisy), 3)
    assert "degrees_of_freedom" not in many.figures()
    assert many.relative / many.floor > 4.0 * middle


def test_estimate_allows_for_the_unknowns_that_were_fitted(H):
    """100 fitted unknowns take 100 of the 4800 real residuals: the estimate grows by sqrt(4800 / 4700)."""
    noisy = H * (1 + 0.05 * circular(RNG(3), H.shape))
    none, many = (Estimated().refit(H, frf(noisy), n).relative for n in (0, 100))
    assert many / none == pytest.approx(np.sqrt(4800 / 4700), rel=1e-3)


def test_as_many_unknowns_as_numbers_leave_nothing_to_estimate_from():
    """They fit any noise exactly; a residual of zero is then no sign of good data."""
    values = np.ones((2, 1, 1), dtype=complex)
    assert isinstance(Estimated().refit(values, frf(values), 3), Estimated)
    for n in (4, 9):
        found = Estimated().refit(values, frf(values), n)
        assert isinstance(found, Assumed)
        assert found.figures() == ASSUMED
        assert found.refit(values, frf(values), n) is found
        assert "assumed" in found.kind


def test_estimate_from_exact_data_is_at_rounding(H):
    found = Estimated().refit(H, frf(H), 4)
    assert found.relative < 1e-11
    assert np.isfinite(found.variance(H, frf(H))).all()
    assert (found.variance(H, frf(H)) > 0).all()


def test_variance_with_the_data_is_used_as_it_is(H):
    variance = np.abs(H) ** 2 * 1e-4
    data = frf(H, variance=variance, coherence=np.full(H.shape, 0.5))
    model = choose_noise(None, data)
    assert isinstance(model, Variance)
    assert model.variance(H, data) == pytest.approx(variance, rel=1e-12)
    assert choose_noise("coherence", data).kind == "coherence"
    assert isinstance(choose_noise("estimated", data), Estimated)
    assert model.refit(H, data, 3) is model
    assert model.figures() == {}


def test_floor_is_a_share_of_the_data_of_the_same_unit():
    """Translations of 1e-3 m/N beside rotations of 10 rad/N: each has its own rms."""
    values = np.array([[[1e-3], [10.0]], [[3e-3], [30.0]]])
    data = updyn.FRF([1.0, 2.0], values, ["1:X", "1:RZ"], ["2:X"], "receptance")
    level = level_by_unit(data)
    assert level[0, :, 0] == pytest.approx([np.sqrt(5) * 1e-3, np.sqrt(5) * 10], rel=1e-12)
    v = Stated(0.0, 0.1).variance(values, data)
    assert v[:, :, 0] == pytest.approx(np.tile([0.05e-6, 5.0], (2, 1)), rel=1e-9)


def test_level_of_one_unit_is_shared_and_never_zero():
    values = np.array([[[1.0], [7.0], [0.0]]])
    data = updyn.FRF([1.0], values, ["1:X", "2:Y", "3:RX"], ["9:X"], "receptance")
    assert level_by_unit(data)[0, :2, 0] == pytest.approx([5.0, 5.0])
    assert level_by_unit(data)[0, 2, 0] > 0


# -- choices ---------------------------------------------------------------------------------------------------------
def test_choices(H):
    assert isinstance(choose_noise(None, frf(H)), Estimated)
    assert choose_noise({"relative": 0.05}, frf(H)) == Stated(0.05, 0.0)
    assert choose_noise({"floor": 1}, frf(H)) == Stated(0.0, 1.0)
    assert Stated(0.05, 0.0).scale_known


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ({"relativ": 0.05}, r"noise: no key 'relativ'; .*relative"),
        ({"relative": -0.1}, r"noise: relative = -0.1; expected a number of at least 0"),
        ({"relative": "5 %"}, r"noise: relative = '5 %'; expected a number"),
        ({"relative": True}, r"noise: relative = True; expected a number"),
        ({"floor": float("nan")}, r"noise: floor = nan; expected a number"),
        ({}, r"relative and floor are both 0"),
        ("coherense", r"noise 'coherense': .*coherence.*, or a table with relative and floor"),
        ("coherence", r"noise 'coherence': the data carry no coherence"),
        ("variance", r"noise 'variance': the data carry no variance"),
    ],
)
def test_refusals(H, noise, message):
    with pytest.raises(OptionError, match=message):
        choose_noise(noise, frf(H))


# -- correlation from line to line -----------------------------------------------------------------------------------
def test_correlation_length_of_independent_noise_is_one():
    """The first lag is within two standard deviations in 97.7 % of draws."""
    lengths = [correlation_length(circular(RNG(seed), (200, 2, 1))) for seed in range(200)]
    assert np.mean(np.array(lengths) == 1.0) > 0.95
    assert max(lengths) < 1.5


@pytest.mark.parametrize("rho", [0.5, 0.8])
def test_correlation_length_of_a_first_order_process(rho):
    """(1 + rho) / (1 - rho)."""
    rng, n = RNG(6), 4000
    e = circular(rng, (n, 4, 2))
    x = np.empty_like(e)
    x[0] = e[0]
    for i in range(1, n):
        x[i] = rho * x[i - 1] + np.sqrt(1 - rho**2) * e[i]
    assert correlation_length(x) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)


def test_correlation_length_of_nothing_and_of_little():
    assert correlation_length(np.zeros((20, 1, 1), dtype=complex)) == 1.0
    assert correlation_length(np.ones((3, 1, 1), dtype=complex)) == 1.0
    assert correlation_length(np.ones((1, 5, 5), dtype=complex)) == 1.0
