"""Noise with outliers: they are told apart and reported, clean data lose little, error bars stay honest."""

import numpy as np
import pytest
import scipy.stats

import updyn
from updyn.errors import OptionError
from updyn.updating.problem.noise import Coherence, Estimated, Robust, Stated, choose_noise
from updyn.updating.problem.noise.estimated import fit_two_numbers

RNG = np.random.default_rng
ROBUST = {"robust": "student-t"}


def circular(rng, shape):
    """Complex Gaussian with E|z|^2 = 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def frf(values, **kwargs):
    n_f, n_i, n_j = np.shape(values)
    rows, columns = [f"{i + 1}:X" for i in range(n_i)], [f"{j + 1}:X" for j in range(n_j)]
    return updyn.FRF(1.0 + np.arange(n_f), values, rows, columns, "receptance", **kwargs)


@pytest.fixture(scope="module")
def H():
    rng = RNG(4)
    return 10 ** rng.uniform(-6, -3, (400, 3, 2)) * np.exp(
        2j * np.pi * rng.uniform(size=(400, 3, 2))
    )


def disturbed(H, relative, bad, seed=0):
    """Relative noise, 30 times as much on some lines."""
    e = relative * circular(RNG(seed), H.shape)
    e[bad] *= 30.0
    return H * (1 + e)


# -- the model -------------------------------------------------------------------------------------------------------
def test_the_bulk_sets_the_level_and_outliers_are_named(H):
    bad = np.arange(10, 400, 20)
    data = frf(disturbed(H, 0.02, bad))
    plain, robust = (choose_noise(noise, data).refit(H, data, 0) for noise in (None, ROBUST))
    assert plain.relative > 0.1
    found = robust.figures()
    assert found["relative"] == pytest.approx(0.02, rel=0.06)
    assert found["down_weighted_lines"] == list(data.freq[bad])
    assert found["down_weighted_channels"] == []
    assert found["down_weighted"] == pytest.approx(0.05, abs=0.003)


def test_a_channel_that_is_off_is_named(H):
    off = H * (1 + 0.02 * circular(RNG(0), H.shape))
    off[:, 1, 0] *= 3.0
    robust = choose_noise({"relative": 0.02, **ROBUST}, frf(off)).refit(H, frf(off), 0)
    assert robust.figures()["down_weighted_channels"] == ["2:X / 1:X"]
    assert robust.figures()["down_weighted_lines"] == []
    assert robust.figures()["chi_square"] == pytest.approx(
        1.0, abs=0.45
    )  # of the bulk: a sixth of it lies outside


def test_clean_data_have_no_outliers_and_the_level_of_the_plain_model(H):
    data = frf(H * (1 + 0.05 * circular(RNG(0), H.shape)))
    for noise, level in ((ROBUST, 0.05), ({"relative": 0.05, **ROBUST}, 0.05)):
        found = choose_noise(noise, data).refit(H, data, 0).figures()
        assert found["down_weighted"] < 2e-3
        assert found["relative"] == pytest.approx(level, rel=0.04)
        assert found["chi_square"] == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.2])
def test_weights_give_the_spread_of_a_weighted_mean(share):
    """The simplest fit, one real unknown in H = x: its spread over draws is what the weights say, to their accuracy."""
    n, draws, rng = 200, 800, RNG(1)
    x, said = [], []
    for _ in range(draws):
        e = (
            0.01
            * circular(rng, (n, 1, 1))
            * np.where(rng.uniform(size=(n, 1, 1)) < share, 30.0, 1.0)
        )
        data, mean = frf(1.0 + e), 1.0
        noise = choose_noise({"relative": 0.01, **ROBUST}, data)
        for _ in range(5):
            model = np.full((n, 1, 1), mean + 0j)
            weight = 1.0 / noise.refit(model, data, 0).variance(model, data)
            mean = float(np.sum(weight * data.values.real) / np.sum(weight))
        x.append(mean)
        said.append(1.0 / np.sqrt(2.0 * np.sum(weight)))
    assert np.mean(said) == pytest.approx(np.std(x), rel=0.08)
    if share == 0.0:  # 7 % of efficiency, as the asymptotic figure says
        assert np.var(x) == pytest.approx(1.07 * 0.01**2 / (2 * n), rel=0.15)
    if share == 0.05:
        assert np.std(x) < 1.15 * 0.01 / np.sqrt(2 * n)  # a plain mean: 6.8


def test_without_a_level_the_bulk_gives_one(H):
    """Coherence without averages says the shape only."""
    bad = np.arange(10, 400, 20)
    data = frf(disturbed(H, 0.02, bad), coherence=np.full(H.shape, 0.5))
    robust = choose_noise(ROBUST, data)
    assert isinstance(robust.base, Coherence)
    assert robust.scale_known
    seen = robust.refit(H, data, 0)
    kept = np.setdiff1d(np.arange(400), bad)
    assert np.median(seen.variance(H, data)[kept] / np.abs(H[kept]) ** 2) == pytest.approx(
        0.02**2, rel=0.15
    )
    assert seen.figures()["down_weighted_lines"] == list(data.freq[bad])


def test_no_residual_no_outliers():
    values = np.ones((2, 1, 1), dtype=complex)
    found = choose_noise(ROBUST, frf(values)).refit(values, frf(values), 4)
    assert found.weight is None
    assert "assumed" in found.kind
    exact = choose_noise(ROBUST, frf(np.ones((9, 1, 1)))).refit(
        np.ones((9, 1, 1), complex), frf(np.ones((9, 1, 1))), 1
    )
    assert np.isfinite(exact.variance(np.ones((9, 1, 1), complex), frf(np.ones((9, 1, 1))))).all()


# -- choices ---------------------------------------------------------------------------------------------------------
def test_choices(H):
    data = frf(H, coherence=np.full(H.shape, 0.9), averages=5)
    assert isinstance(choose_noise(ROBUST, data).base, Coherence)
    assert isinstance(choose_noise({"source": "estimated", **ROBUST}, data).base, Estimated)
    assert isinstance(choose_noise({"source": "estimated"}, data), Estimated)
    assert isinstance(choose_noise({"relative": 0.1, **ROBUST}, data).base, Stated)
    assert isinstance(choose_noise({"relative": 0.1, **ROBUST}, data), Robust)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ({"robust": "students-t"}, r"robust = 'students-t'; .*student-t"),
        ({"robust": 3}, r"robust = 3; .*student-t"),
        ({"relative": 0.1, "source": "coherence"}, r"give one of the two"),
        ({"source": "coherense"}, r"noise 'coherense': .*coherence"),
        ({"relative": 0.0, "robust": "student-t"}, r"relative and floor are both 0"),
        ({"robst": "student-t"}, r"no key 'robst'; .*robust"),
    ],
)
def test_refusals(H, noise, message):
    with pytest.raises(OptionError, match=message):
        choose_noise(noise, frf(H))


# -- fits ------------------------------------------------------------------------------------------------------------
def fitted(task, noise, hit, draws):
    start, clean, unknowns, truth = task
    errors, stds, lines = [], [], []
    for seed in range(draws):
        rng = RNG(seed)
        bad = rng.choice(len(clean.freq), 3, replace=False) if hit else []
        e = 0.02 * circular(rng, clean.values.shape)
        e[bad] *= 30.0
        values = clean.values * (1 + e)
        data = updyn.FRF(clean.freq, values, clean.responses, clean.references, "receptance")
        result = updyn.update(start, data, unknowns, noise=noise, starts=0)
        assert result.status == "converged", result.message
        errors.append(np.array(list(result.values.values())) - truth)
        stds.append(np.array(list(result.std.values())))
        lines.append(set(result.noise.get("down_weighted_lines", ())) == set(clean.freq[bad]))
    return np.array(errors), np.array(stds), lines


@pytest.mark.parametrize("noise", [{}, {"relative": 0.02}], ids=["estimated", "stated"])
def test_outlier_lines_do_not_spoil_the_fit(chain12_task, noise):
    """One line in twenty has 30 times the noise."""
    draws = 6
    clean, clean_std, _ = fitted(chain12_task, {**noise, **ROBUST}, False, draws)
    plain, _, _ = fitted(chain12_task, noise or None, True, 2)
    robust, std, named = fitted(chain12_task, {**noise, **ROBUST}, True, draws)
    assert (np.abs(plain) > 10 * std[:2]).any()
    assert (np.abs(robust) < 4 * std).all()
    assert (np.abs(clean) < 4 * clean_std).all()
    assert all(named)
    rms = [np.sqrt(np.mean((e / clean_std[: len(e)]) ** 2)) for e in (plain, robust, clean)]
    assert rms[0] > 4 * rms[1]
    assert rms[1] < 1.3 * rms[2]
    assert np.median(std / clean_std) == pytest.approx(
        1.03, abs=0.06
    )  # a twentieth of the data is gone
    # On clean data at most 10 % of efficiency: standard deviations of the plain fit are at most 5 %
    # smaller.
    _, plain_std, _ = fitted(chain12_task, noise or None, False, 2)
    assert np.median(clean_std[:2] / plain_std) < 1.06


def test_the_record_says_what_was_down_weighted(chain12_task):
    start, clean, unknowns, _ = chain12_task
    values = clean.values * (1 + 0.02 * circular(RNG(0), clean.values.shape))
    values[17] *= 5.0
    data = updyn.FRF(clean.freq, values, clean.responses, clean.references, "receptance")
    result = updyn.update(start, data, unknowns, noise=ROBUST, starts=0)
    assert result.noise["robust"] == "student-t"
    assert result.noise["down_weighted_lines"] == [clean.freq[17]]
    assert result.noise["chi_square"] == 1.0
    assert result.noise["down_weighted"] == pytest.approx(1 / 60, abs=1e-3)


@pytest.mark.parametrize("tails", [2.0, 5.0])
def test_two_numbers_are_the_most_likely_ones(tails):
    """A fine grid finds no likelier pair, by Student's density of scipy."""
    rng = np.random.default_rng(4)
    size, level = np.exp(rng.normal(0.0, 1.5, 200)), np.ones(200)
    std = np.hypot(0.02 * size, 0.005 * level)
    squared = std**2 * rng.exponential(size=200) * np.where(rng.random(200) < 0.05, 100.0, 1.0)

    def cost(relative, floor):
        # Two real values with `tails` degrees of freedom, each of half the variance.
        variance = (relative * size) ** 2 + (floor * level) ** 2
        plane = scipy.stats.multivariate_t(shape=np.eye(2), df=tails)
        radius = np.sqrt(2.0 * squared / variance)
        return np.mean(np.log(variance) - plane.logpdf(np.stack([radius, 0.0 * radius], axis=1)))

    found = fit_two_numbers(size, level, squared, tails)
    steps = np.exp(np.linspace(-0.3, 0.3, 13))
    least = min(cost(found[0] * a, found[1] * b) for a in steps for b in steps)
    assert cost(*found) == pytest.approx(least, abs=1e-12)
