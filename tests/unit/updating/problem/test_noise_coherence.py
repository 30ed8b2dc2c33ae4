"""Noise from coherence: spectra are averaged as an analyser does, noise at the output and all."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from updyn.updating.problem.noise import Coherence, Estimated, Variance, choose_noise
from updyn.updating.problem.noise.known import smooth_variance

RNG = np.random.default_rng


def circular(rng, shape):
    """Complex Gaussian with E|z|^2 = 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def measured(clean, rng, n, noise, random=False):
    """H1 and ordinary coherence from n averages, E|N|^2 = n noise at the output; the force is of size 1 or Gaussian."""
    H = clean.values
    shape = (n, len(H), 1, H.shape[2])
    F = circular(rng, shape) if random else np.exp(2j * np.pi * rng.uniform(size=shape))
    Y = H * F + np.sqrt(n * noise) * circular(rng, (n, *H.shape))
    xx, xy, yy = (abs(F) ** 2).sum(0), (Y * F.conj()).sum(0), (abs(Y) ** 2).sum(0)
    gamma2 = np.minimum(abs(xy) ** 2 / (xx * yy), 1.0)
    return updyn.FRF(
        clean.freq,
        xy / xx,
        clean.responses,
        clean.references,
        "receptance",
        coherence=gamma2,
        averages=n,
    )


def plain(values, **kwargs):
    values = np.asarray(values)
    rows, columns = ([f"{i + 1}:X" for i in range(n)] for n in values.shape[1:])
    return updyn.FRF(1.0 + np.arange(len(values)), values, rows, columns, "receptance", **kwargs)


@pytest.fixture(scope="module")
def deep():
    """Resonances and antiresonances over four decades, 400 lines, two channels."""
    f = np.linspace(0.0, 1.0, 400)
    H = sum(1.0 / (f0**2 - f**2 + 0.01j * f0**2) for f0 in (0.2, 0.5, 0.8))
    return plain(np.stack([H, 0.3 * H], axis=1)[:, :, None])


# -- one line: the theory --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("random", [False, True], ids=["periodic", "random"])
@pytest.mark.parametrize(("n", "noise"), [(3, 4.0), (10, 1.0), (40, 1e-3)])
def test_the_pair_of_value_and_coherence_gives_the_variance_without_bias(n, noise, random):
    """|H_X|^2 (1 - g2) / (g2 (n - 1)), deep in the noise and far above it; the error of H_X is independent of it."""
    clean = plain(np.full((1, 100, 200), 0.7 - 0.4j))
    data = measured(clean, RNG(5), n, noise, random)
    H, g2 = data.values, data.coherence
    estimate = np.abs(H) ** 2 * (1 - g2) / (g2 * (n - 1))
    squared = np.abs(H - clean.values) ** 2
    expected = noise * (n / (n - 1) if random else 1.0)  # E 1 / Gamma(n) = 1 / (n - 1)
    assert squared.mean() == pytest.approx(
        expected, rel=(0.1 if n == 3 else 0.05) if random else 0.03
    )
    assert estimate.mean() == pytest.approx(
        expected, rel=(0.1 if n == 3 else 0.05) if random else 0.03
    )
    if not random:
        assert abs(np.corrcoef(squared.ravel(), estimate.ravel())[0, 1]) < 0.03


# -- many lines: steady weights --------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", [2, 3, 10, 30, 100])
@pytest.mark.parametrize("kind", ["floor", "relative", "both", "tilted"])
def test_variance_is_right_on_peaks_and_in_antiresonances(deep, n, kind):
    size, level = np.abs(deep.values), np.sqrt(np.mean(np.abs(deep.values) ** 2))
    noise = {
        "floor": np.full(size.shape, (0.02 * level) ** 2),
        "relative": (0.05 * size) ** 2,
        "both": (0.01 * level) ** 2 + (0.05 * size) ** 2,
        "tilted": (0.02 * level) ** 2 * np.geomspace(30.0, 0.3, 400)[:, None, None],
    }[kind]
    squared, inverse = [], []
    for seed in range(6):
        data = measured(deep, RNG(seed), n, noise)
        v = choose_noise(None, data).variance(deep.values, data)
        squared.append(np.abs(data.values - deep.values) ** 2 / v)
        inverse.append(noise / v)
    assert np.mean(squared) == pytest.approx(1.0, abs=0.12 if n == 2 else 0.06)
    mean = np.mean(inverse, axis=0)
    low, high = size < np.quantile(size, 0.1), size > np.quantile(size, 0.9)
    for part in (low, high):  # by itself, not only on the whole
        assert mean[part].mean() == pytest.approx(1.0, abs=0.3 if n < 10 else 0.15)


def test_a_line_with_hum_keeps_its_own_variance(deep):
    noise = np.full(deep.values.shape, 1e-3)
    noise[150] *= 400.0
    data = measured(deep, RNG(0), 10, noise)
    v = choose_noise(None, data).variance(deep.values, data) / 1e-3
    assert v[150] == pytest.approx(np.full((2, 1), 400.0), rel=0.9)
    assert v[[147, 148, 149, 151, 152, 153]].max() < 2.0


def test_a_dropped_sensor_does_not_spoil_its_neighbours(deep):
    data = measured(deep, RNG(0), 10, np.full(deep.values.shape, 1e-3))
    gamma2 = data.coherence.copy()
    gamma2[200] = 0.0
    broken = plain(data.values, coherence=gamma2, averages=10)
    v, whole = (choose_noise(None, d).variance(deep.values, d) for d in (broken, data))
    assert (v[200] > 1e3 * whole[200]).all()
    kept = np.delete(np.arange(400), 200)
    assert v[kept] == pytest.approx(whole[kept], rel=0.3)


def test_chosen_lines_have_the_variance_that_all_lines_gave_them(deep):
    data = measured(deep, RNG(0), 5, np.full(deep.values.shape, 1e-3))
    model, few = choose_noise(None, data), data.select(lines=data.freq[[3, 100, 399]])
    assert model.variance(few.values, few) == pytest.approx(
        model.variance(data.values, data)[[3, 100, 399]], rel=1e-12
    )
    elsewhere = plain(data.values[:20], coherence=data.coherence[:20], averages=5)
    other = updyn.FRF(
        elsewhere.freq + 0.5, elsewhere.values, elsewhere.responses, elsewhere.references, "receptance",
        coherence=elsewhere.coherence, averages=5,
    )  # fmt: skip
    assert model.variance(other.values, other) == pytest.approx(
        Coherence(True).variance(other.values, other)
    )


def test_variance_follows_the_models_size_where_the_noise_does(deep):
    data = plain(deep.values, coherence=np.full(deep.values.shape, 0.9), averages=10)
    model = choose_noise(None, data)
    once, twice = (model.variance(s * deep.values, data) for s in (1.0, 2.0))
    assert np.median(twice / once) == pytest.approx(4.0, rel=0.02)


def test_steady_of_what_is_steady_changes_nothing(deep):
    size = np.abs(deep.values)
    for v in (np.full(size.shape, 3.0), 0.2 * size**2, 3.0 + 0.2 * size**2):
        found = smooth_variance(v, size, 10_000).at(size)
        assert found == pytest.approx(v, rel=0.01)


# -- fits ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", [10, 30, 100])
def test_chi_square_is_one_and_errors_are_at_the_bound(chain12_task, n):
    """Noise of the output, 2 % of the rms after averaging: antiresonances drown. At the model's |H|: over 9."""
    start, clean, unknowns, truth = chain12_task
    noise = np.full(clean.values.shape, 4e-4 * np.mean(np.abs(clean.values) ** 2))
    exact = updyn.FRF(
        clean.freq, clean.values, clean.responses, clean.references, "receptance", variance=noise
    )
    bound = np.array(
        list(updyn.update(start, exact, unknowns.with_start(truth), starts=0).std.values())
    )
    chi, errors, inside = [], [], []
    for seed in range(8):
        result = updyn.update(start, measured(clean, RNG(seed), n, noise), unknowns, starts=0)
        chi.append(result.noise["chi_square"])
        error = np.array(list(result.values.values())) - truth
        errors.append(error / bound)
        inside.append(np.abs(error) < 1.96 * np.array(list(result.std.values())))
    freedom = 8 * (2 * clean.values.size - 12)
    assert np.mean(chi) == pytest.approx(1.0, abs=3 * np.sqrt(2.0 / freedom) + 0.02)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(
        1.0, abs=0.25
    )  # 96 numbers, not independent
    assert np.mean(inside) > 0.88


# -- choices ---------------------------------------------------------------------------------------------------------
def test_coherence_without_averages_knows_the_shape_only():
    values = np.ones((2, 1, 1), dtype=complex)
    data = plain(values, coherence=np.array([0.5, 0.8]).reshape(2, 1, 1))
    model = choose_noise(None, data)
    assert isinstance(model, Coherence)
    assert not model.scale_known
    v = model.variance(values, data).ravel()
    assert v[0] / v[1] == pytest.approx(1.0 / 0.25, rel=1e-3)
    counted = plain(values, coherence=np.array([0.5, 0.8]).reshape(2, 1, 1), averages=11)
    assert choose_noise(None, counted).scale_known
    # 1 / 10 for the variance, and 10 / 9 for the mean of its inverse
    assert choose_noise(None, counted).variance(values, counted).ravel()[0] == pytest.approx(
        1.0 / 9.0, rel=1e-3
    )


@pytest.mark.parametrize("coherence", [0.0, 1.0])
@pytest.mark.parametrize("averages", [2, 5, None])
def test_perfect_and_vanishing_coherence_keep_weights_finite(coherence, averages):
    values = np.ones((1, 1, 1), dtype=complex)
    data = plain(values, coherence=np.full((1, 1, 1), coherence), averages=averages)
    v = Coherence(True).variance(values, data)
    assert np.isfinite(v).all()
    assert (v > 0).all()


def test_coherence_that_was_filled_in_says_nothing():
    """A misfit of next to nothing would count as many times that noise."""
    data = plain(np.ones((3, 1, 1)), coherence=np.ones((3, 1, 1)), averages=5)
    assert isinstance(choose_noise(None, data), Estimated)
    with pytest.raises(OptionError, match="the coherence of the data is 1 for any noise"):
        choose_noise("coherence", data)
    told = np.array([1.0, 1.0, 0.999]).reshape(3, 1, 1)
    assert isinstance(choose_noise(None, replace(data, coherence=told)), Coherence)


def test_variance_that_was_filled_in_says_nothing():
    data = replace(plain(np.ones((3, 1, 1))), variance=np.zeros((3, 1, 1)))
    assert isinstance(choose_noise(None, data), Estimated)
    with pytest.raises(OptionError, match="the variance of the data is zero everywhere"):
        choose_noise("variance", data)
    told = np.array([0.0, 0.0, 1e-6]).reshape(3, 1, 1)
    assert isinstance(choose_noise(None, replace(data, variance=told)), Variance)


def test_coherence_of_one_average_says_nothing():
    data = plain(np.ones((3, 1, 1)), coherence=np.ones((3, 1, 1)), averages=1)
    assert isinstance(choose_noise(None, data), Estimated)
    with pytest.raises(OptionError, match="single average is 1 for any noise"):
        choose_noise("coherence", data)
