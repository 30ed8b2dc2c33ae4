"""What each noise model knows before a fit, and how likely it calls the data after one."""

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

import updyn
from updyn.updating.problem.noise import (
    Assumed,
    Coherence,
    Estimated,
    EstimatedByChannel,
    Robust,
    Stated,
    Variance,
    choose_noise,
)
from updyn.updating.problem.noise.settings import ROBUST_NOISE

FREQ = 1.0 + np.arange(60.0)
SHAPE = (60, 2, 1)


def circular(seed, shape=SHAPE):
    rng = np.random.default_rng(seed)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def frf(values, **kwargs):
    return updyn.FRF(FREQ, values, ["1:X", "2:X"], ["1:X"], "receptance", **kwargs)


@pytest.fixture(scope="module")
def H():
    """Two responses that fall smoothly over a decade and a half."""
    return (3.0 / FREQ)[:, None, None] * np.exp(1j * FREQ / 10)[:, None, None] * np.ones(SHAPE)


@pytest.fixture(scope="module")
def rms(H):
    return np.sqrt(np.mean(np.abs(H) ** 2))


@pytest.fixture(scope="module")
def noisy(H, rms):
    return H + 0.05 * np.abs(H) * circular(0) + 0.02 * rms * circular(1)


# -- before a fit ----------------------------------------------------------------------------------
@pytest.mark.parametrize("model", [Stated(0.05, 0.02), Assumed(0.05, 0.02)], ids=lambda m: m.kind)
def test_stated_noise_is_known_beforehand_from_the_measured_levels(noisy, model):
    level = np.sqrt(np.mean(np.abs(noisy) ** 2))
    expected = (0.05 * np.abs(noisy)) ** 2 + (0.02 * level) ** 2
    assert model.initial_variance(frf(noisy)) == pytest.approx(expected, rel=1e-12)


def test_variance_is_known_beforehand_as_it_came(noisy):
    variance = np.random.default_rng(3).uniform(1e-4, 2e-4, SHAPE)
    found = Variance().initial_variance(frf(noisy, variance=variance))
    assert found == pytest.approx(variance, rel=1e-12)


def test_coherence_is_known_beforehand(H):
    """Noise of 10 % at any line: gamma^2 = 1 / (1 + 0.01 (n - 1))."""
    n = 20
    data = frf(H, coherence=np.full(SHAPE, 1 / (1 + 0.01 * (n - 1))), averages=n)
    model = choose_noise(None, data)
    assert isinstance(model, Coherence)
    # Smoothed over 48 degrees of freedom, for a mean inverse of one: 48 / 47.
    assert model.initial_variance(data) == pytest.approx(0.01 * np.abs(H) ** 2, rel=0.05)


@pytest.mark.parametrize("kind", [Estimated, EstimatedByChannel])
def test_estimated_noise_is_known_beforehand_by_its_floor_alone(H, noisy, rms, kind):
    """What is relative is not told from the shape of resonances between the lines."""
    data = frf(noisy)
    found = kind.of_data(data).initial_variance(data)
    assert found.shape == SHAPE
    assert np.ptp(found) == pytest.approx(0.0, abs=1e-12 * found.max())
    assert np.sqrt(found[0, 0, 0]) == pytest.approx(0.02 * rms, rel=0.35)


@pytest.mark.parametrize("kind", [Estimated, EstimatedByChannel])
def test_before_any_line_is_seen_nothing_is_known(noisy, kind):
    found = kind().initial_variance(frf(noisy))
    assert np.sqrt(found.max() / np.mean(np.abs(noisy) ** 2)) < 1e-11
    assert (found > 0).all()


def test_floor_known_beforehand_is_in_the_unit_of_each_channel(noisy):
    """A rotation in units a million times larger has a floor a million times larger."""
    values = noisy * np.array([1.0, 1e6])[:, None]
    data = updyn.FRF(FREQ, values, ["1:X", "2:RZ"], ["1:X"], "receptance")
    found = Estimated.of_data(data).initial_variance(data)
    levels = np.mean(np.abs(values) ** 2, axis=0)
    assert found[0, 1, 0] / found[0, 0, 0] == pytest.approx(levels[1, 0] / levels[0, 0])


@pytest.mark.parametrize("base", [Stated(0.05, 0.02), Estimated(common_floor=0.02)])
def test_robust_noise_is_known_beforehand_as_its_bulk_is(noisy, base):
    data = frf(noisy)
    assert (Robust(base).initial_variance(data) == base.initial_variance(data)).all()


# -- after a fit -----------------------------------------------------------------------------------
def gaussian(residual, variance):
    """Log density of complex Gaussian noise, as two real numbers of half the variance each."""
    std = np.sqrt(variance / 2)
    logs = scipy.stats.norm.logpdf(residual.real, scale=std)
    return np.sum(logs + scipy.stats.norm.logpdf(residual.imag, scale=std))


def student(residual, variance):
    """Log density of the bivariate t distribution with the scale matrix (v / 2) I."""
    total = 0.0
    for r, v in zip(residual.ravel(), variance.ravel(), strict=True):
        total += scipy.stats.multivariate_t.logpdf(
            [r.real, r.imag], shape=0.5 * v * np.eye(2), df=ROBUST_NOISE.freedoms
        )
    return total


def models(noisy):
    variance = (0.05 * np.abs(noisy)) ** 2 + 1e-6
    return [
        (Stated(0.05, 0.02), frf(noisy)),
        (Variance(), frf(noisy, variance=variance)),
        (Estimated(0.04, 0.01), frf(noisy)),
        (
            EstimatedByChannel(
                relative=np.array([0.05, 0.02]), floor=np.array([0.01, 0.03]), names=("1:X", "2:X")
            ),
            frf(noisy),
        ),
    ]


def candidates(H):
    return [H, 1.02 * H, H * np.exp(0.05j), np.roll(H, 1, axis=0)]


@pytest.mark.parametrize("number", range(4))
def test_likelihood_is_that_of_complex_gaussian_noise(H, noisy, number):
    """Up to one constant for all models H, whatever their variance."""
    model, data = models(noisy)[number]
    sums = [
        model.negative_log_likelihood(A, data) + gaussian(noisy - A, model.variance(A, data))
        for A in candidates(H)
    ]
    assert sums == pytest.approx([-noisy.size * np.log(np.pi)] * 4, rel=1e-9)


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_robust_likelihood_is_that_of_student(H, noisy, factor):
    data, model = frf(noisy), Robust(Stated(0.05, 0.02), factor=factor)
    sums = []
    for A in candidates(H):
        variance = factor * Stated(0.05, 0.02).variance(A, data)
        sums.append(model.negative_log_likelihood(A, data) + student(noisy - A, variance))
    # At r = 0 the bivariate density is 1 / (2 pi |Sigma|^(1/2)) = 1 / (pi v).
    assert sums == pytest.approx([-noisy.size * np.log(np.pi)] * 4, rel=1e-9)


def test_weights_of_outliers_do_not_change_the_likelihood(H, noisy):
    """They are the means to its maximum, not part of it."""
    data = frf(noisy)
    model = Robust(Stated(0.05, 0.02)).refit(H, data, 0)
    assert model.weight is not None
    plain = Robust(Stated(0.05, 0.02), factor=model.factor)
    assert model.negative_log_likelihood(H, data) == plain.negative_log_likelihood(H, data)


def test_noise_of_unknown_size_counts_with_the_size_that_suits_it_best(H, noisy):
    """Coherence without averages: the likelihood is greatest over one factor on the variance."""
    data = frf(noisy, coherence=np.full(SHAPE, 0.97))
    model = choose_noise("coherence", data)
    assert not model.scale_known
    sums = []
    for A in candidates(H):
        v = model.variance(A, data)

        def unlikely(log, A=A, v=v):
            return -gaussian(noisy - A, np.exp(log) * v)

        least = scipy.optimize.minimize_scalar(unlikely, bracket=(-1.0, 1.0), tol=1e-12)
        sums.append(model.negative_log_likelihood(A, data) - float(least.fun))
    # Where the factor is best, the mean of |r|^2 / v is 1: N in the exponent, and N ln pi.
    assert sums == pytest.approx([-noisy.size * (np.log(np.pi) + 1.0)] * 4, rel=1e-9)


def test_a_factor_on_noise_of_unknown_size_changes_no_comparison(H, noisy):
    """The same coherence from other averages that are not known orders the models alike."""
    weak, strong = (frf(noisy, coherence=np.full(SHAPE, g)) for g in (0.99, 0.9))
    differences = []
    for data in (weak, strong):
        model = choose_noise("coherence", data)
        found = [model.negative_log_likelihood(A, data) for A in candidates(H)]
        differences.append(np.diff(found))
    assert differences[0] == pytest.approx(differences[1], rel=1e-2)
