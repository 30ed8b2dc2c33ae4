"""Dependence of FRFs on the level, against describing functions and linear structures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import updyn
from periodic_cases import M2, two_masses
from updyn.errors import DataError, OptionError
from updyn.updating.judge.levels.homogeneity import combine_probabilities, line_probabilities

FREQ = np.linspace(0.6, 4.5, 160)
LABELS = ["1:X", "2:X"]
MODEL = two_masses(loss_factor=0.04)


def noise_on(frf, seed, relative=0.01, floor=1e-3, common=0.0):
    """FRFs with noise relative to |H|, a floor, and noise that all responses have in common."""
    rng = np.random.default_rng(seed)

    def draw(*shape):
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2.0)

    H = frf.values
    rms = np.sqrt(np.mean(np.abs(H) ** 2))
    values = H * (1.0 + relative * draw(*H.shape)) + floor * rms * draw(*H.shape)
    return replace(frf, values=values * (1.0 + common * draw(len(H), 1, H.shape[2])))


def measure(element, levels, seed=0):
    model = MODEL.with_elements({"joint": (element, LABELS)})
    found = [updyn.response(model, FREQ, LABELS, ["2:X"], level=level).frf for level in levels]
    return [noise_on(frf, seed + i) for i, frf in enumerate(found)]


# -- modes ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("element", "trend"),
    [
        (updyn.CubicSpring(3e4), (1, 0)),
        (updyn.CubicSpring(-2e4), (-1, 0)),
        (updyn.JenkinsElement(40.0, 1.5), (-1, 1)),
        (updyn.QuadraticDamper(10.0), (0, 1)),
    ],
)
def test_poles_at_constant_amplitude_are_those_of_the_describing_function(element, trend):
    base, scale = updyn.Model.from_groups, (0.02, 0.06)
    omega0 = np.sqrt(300.0)
    tests, stiffness = [], []
    for level, amplitude in enumerate(scale, 1):
        N = complex(element.describing(amplitude, omega0))
        if element.quantity == "mobility":
            N = 1j * omega0 * complex(element.describing(amplitude * omega0, omega0))
        k = 300.0 * (1.0 + 0.04j) + N
        groups = {"k": updyn.Group([[k.real]], mass=[[1.0]], loss_factor=k.imag / k.real)}
        frf = updyn.response(base(groups, ["1:X"]), FREQ, ["1:X"], ["1:X"])
        tests.append(noise_on(frf, level, 1e-3, 1e-5).with_level(level))
        stiffness.append(k)
    (mode,) = updyn.detect_nonlinearity(tests).modes
    expected = np.array(stiffness) / (2 * np.pi) ** 2
    change, std = mode.pole[1] - mode.pole[0], mode.std[1]
    assert abs((change - np.diff(expected)[0]).real) < 4.0 * std.real
    assert abs((change - np.diff(expected)[0]).imag) < 4.0 * std.imag
    assert std.real < 0.02 * abs(np.diff(expected)[0])
    assert mode.trend == trend


@pytest.mark.parametrize(
    ("element", "levels", "typical"),
    [
        (updyn.CubicSpring(1e3), (0.3, 1.5), "a hardening spring or a gap"),
        (updyn.CubicSpring(-1e3), (0.3, 1.5), "softening spring"),
        (updyn.JenkinsElement(60.0, 1.0), (0.1, 0.6), "a joint that begins to slip"),
        (updyn.CoulombFriction(0.1, transition=0.02), (1.0, 4.0), "friction that slips"),
    ],
)
def test_elements_change_modes_as_expected(element, levels, typical):
    found = updyn.detect_nonlinearity(measure(element, levels))
    assert found.is_nonlinear
    assert any(typical in mode.typical for mode in found.modes)
    assert typical in found.statement


# -- linear structures ----------------------------------------------------------------------------
@pytest.mark.parametrize("common", [0.0, 0.03])
def test_linear_structures_are_linear(common):
    clean = updyn.response(MODEL, FREQ, LABELS, ["2:X"], "accelerance")
    for seed in range(3):
        tests = [noise_on(clean, 10 * seed + i, common=common).with_level(2.0**i) for i in range(3)]
        found = updyn.detect_nonlinearity(tests)
        assert not found.is_nonlinear
        assert "do not depend" in found.statement


def test_a_change_of_calibration_changes_no_mode():
    clean = updyn.response(MODEL, FREQ, LABELS, ["2:X"])
    one, two = (noise_on(clean, i).with_level(1.0 + i) for i in range(2))
    found = updyn.detect_nonlinearity([one, replace(two, values=1.2 * two.values)])
    assert found.is_nonlinear
    assert not any(mode.typical for mode in found.modes)
    assert "calibration" in found.statement


def test_a_single_outlier_is_no_dependence_on_the_level():
    clean = updyn.response(MODEL, FREQ, LABELS, ["2:X"])
    one, two = (noise_on(clean, i).with_level(1.0 + i) for i in range(2))
    values = two.values.copy()
    values[60] *= 2.0
    assert not updyn.detect_nonlinearity([one, replace(two, values=values)]).is_nonlinear


# -- lines ----------------------------------------------------------------------------------------
def test_line_probabilities_are_those_of_an_f_test():
    rng = np.random.default_rng(3)
    clean = updyn.response(MODEL, FREQ, LABELS, ["2:X"])
    values = rng.standard_normal((3, *clean.values.shape, 2)) @ [1.0, 1j]
    tests = [replace(clean, values=v) for v in values]
    variances = [np.full(clean.values.shape, 2.0)] * 3
    found = line_probabilities(tests, variances, np.full(clean.values.shape, 96.0))
    squares = np.sum(np.abs(values - values.mean(axis=0)) ** 2, axis=0)
    np.testing.assert_allclose(found, stats.f.sf(squares / 4.0, 4, 96), rtol=1e-9)
    assert abs(np.mean(found < 0.1) - 0.1) < 0.05


def test_two_adjacent_lines_decide():
    lines = np.full((10, 2, 1), 0.5)
    lines[3, 0] = 1e-9
    assert combine_probabilities(lines) == 1.0
    lines[4, 0] = 1e-6
    assert combine_probabilities(lines) == pytest.approx(18e-6)


def test_the_p_value_covers_lines_and_modes():
    found = updyn.detect_nonlinearity(measure(updyn.CubicSpring(1e3), (0.3, 1.0)))
    of_modes = [p for mode in found.modes for p in mode.p_values]
    both = min(len(of_modes) * min(of_modes), combine_probabilities(found.p_lines))
    assert found.p_value == pytest.approx(min(1.0, 2.0 * both))


# -- input ----------------------------------------------------------------------------------------
def test_stated_noise_is_used():
    clean = updyn.response(MODEL, FREQ, LABELS, ["2:X"])
    tests = [noise_on(clean, i).with_level(1.0 + i) for i in range(2)]
    assert updyn.detect_nonlinearity(tests, noise={"relative": 1e-4}).is_nonlinear
    assert not updyn.detect_nonlinearity(tests, noise={"relative": 0.05}).is_nonlinear


def test_one_level_shows_leaning_peaks_only():
    model = MODEL.with_elements({"joint": (updyn.CubicSpring(3e3), LABELS)})
    freq = np.linspace(0.6, 4.5, 500)
    frf = updyn.response(model, freq, LABELS, ["2:X"], level=1.0).frf
    found = updyn.detect_nonlinearity(noise_on(frf, 0))
    assert found.is_nonlinear
    assert "the stiffness depends on the level" in found.statement
    assert np.isnan(found.p_value)


def test_a_line_at_0_hz_is_left_out():
    clean = updyn.response(MODEL, np.append(0.0, FREQ), LABELS, ["2:X"])
    found = updyn.detect_nonlinearity([noise_on(clean, i).with_level(1.0 + i) for i in range(2)])
    assert found.freq[0] == FREQ[0]


def test_wrong_input_is_refused():
    frf = noise_on(updyn.response(MODEL, FREQ, LABELS, ["2:X"]), 0)
    one, two = frf.with_level(1.0), frf.with_level(2.0)
    cases = [
        ([frf, two], "test 1 has no level"),
        ([one, one], "level 1 N occurs twice"),
        ([one, two.select(responses=["1:X"])], "test 2: responses"),
        ([one, two.select(band=(1.0, 3.0))], "test 2: other lines"),
        ([], "expected at least one FRF"),
        ([one, M2], "test 2: expected an FRF, found ndarray"),
    ]
    for tests, message in cases:
        with pytest.raises(DataError, match=message):
            updyn.detect_nonlinearity(tests)
    with pytest.raises(OptionError, match="significance 2"):
        updyn.detect_nonlinearity([one, two], significance=2)
    short = [replace(one, freq=FREQ[:8], values=frf.values[:8], level=1.0 + i) for i in range(2)]
    with pytest.raises(DataError, match="8 lines do not determine"):
        updyn.detect_nonlinearity(short)
