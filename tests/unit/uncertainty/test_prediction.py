"""Bands of prediction: by the delta method, from draws, at DOFs never measured; and how often they are right."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from uncertain_cases import (
    LINES,
    fit_lower,
    in_series,
    noisy,
    one_spring,
    springs,
    two_masses,
    ungrounded_chain,
)
from updyn.errors import DataError, DofError, OptionError
from updyn.uncertainty.prediction import _select_draws


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    return fit_lower(0)


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_it_is_the_delta_method_in_closed_form() -> None:
    """H = 1 / (kappa k): d ln H = -d ln kappa."""
    result = one_spring(floor=0.1)
    band = updyn.predict(result, [0.5, 7.0], ["1:X"], ["1:X"])
    value = 1 / (50 * result.values["spring.stiffness"])
    spread = result.std["spring.stiffness"] / result.values["spring.stiffness"]
    np.testing.assert_allclose(band.frf.values[:, 0, 0], [value, value], rtol=1e-12)
    np.testing.assert_allclose(band.std_real, value * spread, rtol=1e-9)
    np.testing.assert_allclose(band.std_imag, 0.0, atol=1e-12 * value)
    np.testing.assert_allclose(band.upper, value * np.exp(1.959964 * spread), rtol=1e-6)
    np.testing.assert_allclose(band.lower, value * np.exp(-1.959964 * spread), rtol=1e-6)
    np.testing.assert_allclose(band.phase_upper - band.phase_lower, 0.0, atol=1e-6)


@pytest.mark.filterwarnings("ignore:.*the model has no mass")
def test_the_quantile_is_that_of_student_if_the_noise_is_estimated_from_few_numbers() -> None:
    result = one_spring(floor=0.1)
    few = replace(result, noise={**result.noise, "degrees_of_freedom": 4})
    wide = [updyn.predict(r, [0.5], ["1:X"], ["1:X"]) for r in (result, few)]
    ratio = np.log(wide[1].upper / wide[1].lower) / np.log(wide[0].upper / wide[0].lower)
    np.testing.assert_allclose(ratio, 2.7764451 / 1.959964, rtol=1e-6)


def test_phase_and_magnitude_follow_what_the_unknowns_do(result) -> None:
    """Against differences: each unknown moved by its own share of the covariance's root."""
    band = updyn.predict(
        result, LINES[::4], ["2:X"], ["1:X"], quantity="accelerance", level=0.6826895
    )
    names = result.parameters.names
    root = np.linalg.cholesky(result.covariance)
    here = np.array([result.values[n] for n in names])
    h, log = 1e-3, []
    for column in root.T:
        ends = []
        for side in (h, -h):
            model = result.parameters.apply(result.start, here + side * column)
            ends.append(
                updyn.response(model, LINES[::4], ["2:X"], ["1:X"], quantity="accelerance").values
            )
        log.append(np.log(ends[0] / ends[1]) / (2 * h))
    spread = np.sqrt(np.sum(np.real(log) ** 2, axis=0))
    turn = np.sqrt(np.sum(np.imag(log) ** 2, axis=0))
    np.testing.assert_allclose(np.log(band.upper / np.abs(band.frf.values)), spread, rtol=1e-4)
    np.testing.assert_allclose(band.phase_upper - np.angle(band.frf.values), turn, rtol=1e-4)


def test_undetermined_springs_do_not_change_the_unit_of_a_damping_rate() -> None:
    """Its coordinate depends on the lines; the band at a line does not depend on the other lines."""
    groups = {
        "lower": updyn.Group(springs((0, 1, 900.0), n=2)),
        "upper": updyn.Group(springs((1, 2, 900.0), n=2), np.diag([0.0, 1.0]), mass_damping=0.5),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    frf = noisy(updyn.response(model, LINES, ["2:X"], ["2:X"]), 0, 0.03)
    unknowns = updyn.parameters(model, stiffness="all", mass_damping=["upper"])
    result = updyn.update(model, frf, unknowns, noise={"relative": 0.03}, starts=0)
    assert not np.isfinite(result.covariance).all()
    near, far = (updyn.predict(result, lines, ["2:X"], ["2:X"]) for lines in ([3.4], [3.4, 3000.0]))
    assert np.isfinite(near.std_imag).all()
    np.testing.assert_allclose(near.std_imag[0], far.std_imag[0], rtol=1e-9)


def test_the_truth_lies_within_as_often_as_said() -> None:
    """At the mass that was never measured, in 95 % of lines and draws, and a new measurement in its own band."""
    truth = updyn.response(two_masses(), LINES, ["2:X"], ["1:X"])
    again = updyn.response(two_masses(), LINES, ["1:X"], ["1:X"])
    covered, measured = [], []
    for seed in range(40):
        result = fit_lower(seed)
        covered.append(updyn.predict(result, LINES, ["2:X"], ["1:X"]).covers(truth).mean())
        band = updyn.predict(result, LINES, ["1:X"], ["1:X"], noise=True)
        measured.append(band.covers(noisy(again, 1000 + seed, 0.03)).mean())
    assert np.mean(covered) == pytest.approx(0.95, abs=0.035)
    assert np.mean(measured) == pytest.approx(0.95, abs=0.02)


@pytest.mark.usefixtures("no_causes")
def test_a_band_covers_an_error_of_the_model_where_nothing_was_measured() -> None:
    """A chain without a spring to ground: 95 % at two further masses, in a narrow band."""
    model, clean, unknowns = ungrounded_chain()
    freq, held, shares, widths = clean.freq, ["2:X", "5:X"], [], []
    for seed in range(6):
        frf = noisy(clean, seed, 0.01)
        fitted = frf.select(responses=["1:X", "3:X", "4:X", "6:X"])
        result = updyn.update(model, fitted, unknowns, noise={"relative": 0.01}, starts=0)
        assert result.noise["model_error"] > 0.2
        band = updyn.predict(result, freq, held, ["6:X"], noise=True)
        shares.append(band.covers(frf.select(responses=held)).mean())
        misfit = np.abs(clean.select(responses=held).values / band.frf.values)
        widths.append(
            np.median(np.log(band.upper / band.lower)) / np.median(np.abs(np.log(misfit)))
        )
    assert 0.9 < np.mean(shares) <= 0.99
    # A normal error of known size has a 95 % band of 5.8 times its median magnitude.
    assert np.median(widths) < 15.0


@pytest.mark.usefixtures("no_causes")
def test_two_tests_of_one_structure_share_the_error_of_its_model() -> None:
    """Half of the lines each: the bands are about those of one test with all lines."""
    model, clean, unknowns = ungrounded_chain()
    frf = noisy(clean, 0, 0.01).select(responses=["1:X", "3:X", "4:X", "6:X"])
    noise = {"relative": 0.01}
    halves = [
        updyn.Test(model, frf.select(lines=frf.freq[i::2]), name, noise=noise)
        for i, name in enumerate("ab")
    ]
    joint = updyn.update_jointly(halves, unknowns, starts=0)
    single = updyn.update(model, frf, unknowns, noise=noise, starts=0)
    ask = (frf.freq, ["2:X", "5:X"], ["6:X"])
    bands = [updyn.predict(joint, *ask, test=name) for name in "ab"]
    np.testing.assert_allclose(bands[0].upper, bands[1].upper, rtol=1e-6)
    whole = updyn.predict(single, *ask)
    ratio = np.log(bands[0].upper / bands[0].lower) / np.log(whole.upper / whole.lower)
    assert np.median(ratio) == pytest.approx(1.0, rel=0.3)


def test_draws_give_the_band_of_laplace_where_that_is_right(result) -> None:
    draws = updyn.bootstrap(result, 150)
    one, other = (updyn.predict(s, LINES[::3], ["1:X", "2:X"], ["1:X"]) for s in (result, draws))
    np.testing.assert_allclose(other.frf.values, one.frf.values)
    ratio = np.log(other.upper / other.lower) / np.log(one.upper / one.lower)
    assert np.median(ratio) == pytest.approx(1.0, abs=0.2)
    turn = (other.phase_upper - other.phase_lower) / (one.phase_upper - one.phase_lower)
    assert np.median(turn) == pytest.approx(1.0, abs=0.2)
    assert np.median(other.std_real / one.std_real) == pytest.approx(1.0, abs=0.15)
    assert (other.source, one.source) == ("bootstrap", "Laplace")
    with_noise = updyn.predict(draws, LINES[::3], ["1:X", "2:X"], ["1:X"], noise=True)
    assert np.median(with_noise.std_real / np.abs(one.frf.values)) == pytest.approx(
        0.03 / np.sqrt(2), rel=0.2
    )


def test_what_is_open_has_no_band_only_where_it_moves() -> None:
    """Two springs in a row: the end is known, the DOF between them is anywhere."""
    band = updyn.predict(in_series(), LINES, ["2:X", "1:X"], ["2:X"])
    assert (band.upper[:, 0] / band.lower[:, 0] < 1.2).all()
    assert np.isinf(band.upper[:, 1]).all()
    assert (band.lower[:, 1] == 0.0).all()
    assert np.isinf(band.std_real[:, 1]).all()
    np.testing.assert_allclose(band.phase_upper[:, 1] - band.phase_lower[:, 1], 2 * np.pi)


def test_noise_with_a_floor_takes_the_level_of_its_unit() -> None:
    result = fit_lower(0, {"relative": 0.0, "floor": 0.05})
    plain, more = (updyn.predict(result, LINES, ["2:X"], ["1:X"], noise=n) for n in (False, True))
    level = np.sqrt(np.mean(np.abs(result.frf.values) ** 2))
    added = np.sqrt(more.std_real**2 - plain.std_real**2)
    size = np.sqrt(max(result.noise["chi_square"], 1.0))
    np.testing.assert_allclose(added, 0.05 * level * size / np.sqrt(2), rtol=1e-6)
    assert "of a measurement" in repr(more)
    with pytest.raises(OptionError, match="predict that quantity"):
        updyn.predict(result, LINES, ["2:X"], ["1:X"], noise=True, quantity="mobility")


def test_of_several_tests_one_answers() -> None:
    one = fit_lower(0)
    tests = [
        updyn.Test(one.start, fit_lower(seed).frf, str(seed), noise={"relative": 0.03})
        for seed in (0, 1)
    ]
    joint = updyn.update_jointly(tests, one.parameters, starts=0)
    band = updyn.predict(joint, LINES, ["2:X"], ["1:X"], test="1")
    alone = updyn.predict(one, LINES, ["2:X"], ["1:X"])
    ratio = np.log(band.upper / band.lower) / np.log(alone.upper / alone.lower)
    assert np.median(ratio) == pytest.approx(1 / np.sqrt(2), rel=0.15)
    with pytest.raises(OptionError, match="which test's model"):
        updyn.predict(joint, LINES, ["2:X"], ["1:X"])


def test_what_cannot_be_predicted_is_refused(result) -> None:
    ask = (LINES, ["2:X"], ["1:X"])
    with pytest.raises(OptionError, match="level = 95"):
        updyn.predict(result, *ask, level=95)
    with pytest.raises(DofError, match="3:X"):
        updyn.predict(result, LINES, ["3:X"], ["1:X"])
    with pytest.raises(OptionError, match="one test only"):
        updyn.predict(result, *ask, test="a")
    with pytest.raises(OptionError, match="expected the result of an update or draws, found Model"):
        updyn.predict(result.start, *ask)
    with pytest.raises(OptionError, match="give them their update first"):
        updyn.predict(replace(updyn.bootstrap(result, 2), result=None), *ask)
    given = replace(result.frf, variance=np.full(result.frf.values.shape, 1e-12))
    known = updyn.update(result.start, given, result.parameters, starts=0)
    with pytest.raises(OptionError, match="known at the measured values only"):
        updyn.predict(known, *ask, noise=True)
    band = updyn.predict(result, *ask)
    with pytest.raises(DataError, match="the band is about receptance"):
        band.covers(updyn.response(two_masses(), *ask, quantity="mobility"))


@pytest.mark.parametrize(("n_draws", "n_selected"), [(900, 900), (1000, 1000), (2000, 1000)])
def test_bands_are_made_of_at_most_a_thousand_draws(n_draws, n_selected) -> None:
    part = SimpleNamespace(coordinates=SimpleNamespace(to_x=lambda values: values))
    draws = SimpleNamespace(values=np.arange(2.0 * n_draws).reshape(n_draws, 2))
    selected = _select_draws(draws, part)
    assert len(selected) == n_selected
    assert selected[[0, -1], 0].tolist() == [0.0, 2.0 * n_draws - 2.0]
