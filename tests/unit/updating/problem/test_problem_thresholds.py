"""Thresholds of data, noise and lines by value: a case just within each, and one just beyond."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_t

import updyn
from updyn.updating.problem import lines
from updyn.updating.problem.modal import ModalTarget, Pairs, _subspace_mac
from updyn.updating.problem.noise import Stated, estimated, known
from updyn.updating.problem.noise.estimated import Estimated, EstimatedByChannel
from updyn.updating.problem.noise.known import SmoothVariance, smooth_variance
from updyn.updating.problem.noise.modes import _estimate_size
from updyn.updating.problem.noise.robust import Robust
from updyn.updating.problem.noise.size import size_p_value
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.problem.problem import FRFPart


def frf_of(values: np.ndarray) -> updyn.FRF:
    """FRFs of shape (n_f, n_i) from one force."""
    responses = [f"{i + 1}:X" for i in range(values.shape[1])]
    return updyn.FRF(
        np.arange(1.0, len(values) + 1.0), values[:, :, None], responses, ["1:X"], "receptance"
    )


def noisy(n: int, channels: int = 1) -> tuple[np.ndarray, updyn.FRF]:
    """The FRFs of a model, shape (n, channels, 1), and data with 10 % of noise."""
    rng = np.random.default_rng(0)
    H = np.exp(rng.normal(size=(n, channels)))
    noise = rng.normal(size=(n, channels)) + 1j * rng.normal(size=(n, channels))
    return H[:, :, None].astype(complex), frf_of(H * (1.0 + 0.1 * noise))


@pytest.mark.parametrize(("n_parameters", "spare"), [(11, 29), (10, None)])
def test_thirty_degrees_of_freedom_determine_two_numbers(n_parameters, spare):
    assert Estimated().refit(*noisy(20), n_parameters).spare == spare


@pytest.mark.parametrize(("n", "kind"), [(24, Estimated), (25, EstimatedByChannel)])
def test_the_noise_of_a_sensor_takes_twenty_five_values(n, kind):
    assert type(EstimatedByChannel().refit(*noisy(n, 2), 0)) is kind


def test_the_noise_level_has_the_errors_of_sixteen_lines():
    p = [float(size_p_value(60.0, count, 40.0, 4)) for count in (31.0, 32.0, 33.0)]
    assert p[0] != p[1] == p[2]


@pytest.mark.parametrize(("probability", "is_added"), [(0.051, False), (0.049, True)])
def test_a_residual_contradicts_stated_deviations_at_five_percent(probability, is_added):
    r = np.full(10, np.sqrt(chi2.isf(probability, 10) / 10.0))
    size = _estimate_size(r, np.ones(10), 10.0, 0.1)
    assert (size > 1e-8) == is_added
    if is_added:
        assert np.sum(r**2 / (1.0 + size**2)) == pytest.approx(10.0)


def test_the_typical_deviation_counts_as_two_residuals():
    size = _estimate_size(np.full(6, 0.3), np.zeros(6), 6.0, 0.1)
    assert size == pytest.approx(np.sqrt((6 * 0.3**2 + 2 * 0.1**2) / 8))


@pytest.mark.parametrize(("outliers", "is_reported"), [(9, False), (10, True)])
def test_a_channel_with_half_of_its_values_off_is_reported(outliers, is_reported):
    H = np.ones((20, 4, 1), dtype=complex)
    frf = frf_of(np.where(np.arange(20)[:, None] < outliers, [1.0, 1.0, 1.0, 2.0], 1.0) + 0.01j)
    found = Robust(Estimated(relative=0.01, floor=0.0)).refit(H, frf, 0)
    assert bool(found.outliers["down_weighted_channels"]) == is_reported


def smoothed(ratio: float) -> SmoothVariance:
    """A constant variance with one line that exceeds it, from 24 averages."""
    variance = np.ones((60, 1))
    variance[30] = ratio
    return smooth_variance(variance, np.zeros((60, 1)), 24)


@pytest.mark.parametrize(("ratio", "is_kept"), [(9.0, False), (11.0, True)])
def test_a_line_with_ten_times_the_variance_keeps_it(ratio, is_kept):
    at = smoothed(ratio).at(np.zeros((60, 1)))
    assert (float(at[30, 0]) > 0.9 * ratio) == is_kept
    assert (float(at[29, 0]) < 1.2) == is_kept


@pytest.mark.parametrize(("count", "is_exchanged"), [(4, True), (5, False)])
def test_up_to_two_lines_for_each_unknown_are_exchanged(monkeypatch, count, is_exchanged):
    calls = []
    monkeypatch.setattr(
        lines, "exchange_items", lambda *about: calls.append(1) or np.array(about[2])
    )
    rows = np.random.default_rng(0).normal(size=(10, 2))
    lines._maximise_determinant(np.einsum("fp,fq->fpq", rows, rows), count)
    assert bool(calls) == is_exchanged


def test_lines_are_chosen_for_a_loss_factor_of_two_percent():
    coordinates = SimpleNamespace(
        start=np.array([0.3, 0.01, 0.03]),
        to_x=lambda values: values,
        parameters=SimpleNamespace(
            upper=np.array([2.0, 1.0, 1.0]), is_damping=np.array([False, True, True])
        ),
    )
    found = lines._design_point(SimpleNamespace(coordinates=coordinates))
    assert found == pytest.approx([0.3, 0.02, 0.03])


@pytest.mark.parametrize(
    ("work", "is_distributed", "is_long"),
    [(4.9e8, False, False), (5.1e8, True, False), (4.9e10, True, False), (5.1e10, True, True)],
)
def test_large_evaluations_are_distributed(monkeypatch, work, is_distributed, is_long):
    monkeypatch.setattr(FRFPart, "work", property(lambda self: work))
    part = FRFPart.__new__(FRFPart)
    assert (part.is_distributed, part.is_long) == (is_distributed, is_long)


@pytest.mark.parametrize(("number", "more"), [(40, ""), (41, "... and 1 more")])
def test_forty_unknowns_are_printed(number, more):
    items = tuple(Parameter(f"p{i}", "stiffness", 1.0, 0.1, 10.0) for i in range(number))
    assert repr(ParameterSet(items)).partition("p39.stiffness")[2].partition("\n")[2] == more


@pytest.mark.parametrize(("difference", "mac"), [(1e-10, 0.0), (1e-8, 1.0)])
def test_nearly_equal_shapes_span_one_direction(difference, mac):
    """The MAC with the difference of two shapes."""
    span = np.array([[1.0, 1.0], [0.0, difference]])
    found = _subspace_mac(np.array([[0.0], [1.0]]), span)
    assert found == pytest.approx(mac, abs=1e-6)


@pytest.mark.parametrize(("n", "has_floor"), [(19, False), (20, True)])
def test_the_floor_of_the_lines_takes_twenty_of_them(monkeypatch, n, has_floor):
    """The scatter has Student's distribution of one degree of freedom."""
    tails = []

    def fit(size, level, squared, freedoms):
        tails.append(freedoms)
        return 0.0, 1.0

    monkeypatch.setattr(estimated, "fit_two_numbers", fit)
    assert (estimated.estimate_floors(noisy(n)[1])[0] > 0.0) == has_floor
    assert tails == ([1.0] if has_floor else [])


def test_ten_averages_are_assumed(monkeypatch):
    monkeypatch.setattr(known, "smooth_variance", lambda variance, size, freedom: freedom)
    frf = noisy(9)[1]
    assert known._smooth_coherence(replace(frf, coherence=np.full(frf.values.shape, 0.9))) == 9


@pytest.mark.parametrize(("freedom", "width"), [(4, 13), (48, 7)])
def test_a_smoothed_variance_has_forty_eight_degrees_of_freedom(monkeypatch, freedom, width):
    """An odd number of lines; outliers are searched for in seven at least."""
    widths = []
    ones = np.ones((1000, 1, 1))

    def fit(variance, size, freedom, width):
        widths.append(width)
        return ones, ones

    monkeypatch.setattr(known, "_fit_two_parts", fit)
    smooth_variance(ones, ones, freedom)
    assert widths == [width]


def test_noise_has_eight_knots_along_the_lines(monkeypatch):
    knots = []
    hat_functions = known._hat_functions

    def make(n_f, number):
        knots.append(number)
        return hat_functions(n_f, number)

    monkeypatch.setattr(known, "_hat_functions", make)
    ones = np.ones((1000, 1, 1))
    known._fit_two_parts(ones, ones, 48, 7)
    assert knots == [8]


def test_robust_noise_has_the_density_of_five_degrees_of_freedom():
    """Of the real and the imaginary part together."""
    frf = frf_of(np.full((1, 1), 1.3 + 0.4j))
    noise = Robust(Stated(0.1, 0.0))
    density = multivariate_t(np.zeros(2), 0.5 * 0.1**2 * np.eye(2), df=5)
    misfits = [
        noise.negative_log_likelihood(np.full((1, 1, 1), H), frf) for H in (1.0, np.exp(0.1j))
    ]
    residuals = [frf.values[0, 0, 0] - H for H in (1.0, np.exp(0.1j))]
    expected = [-density.logpdf([r.real, r.imag]) for r in residuals]
    assert np.diff(misfits) == pytest.approx(np.diff(expected))


@pytest.mark.parametrize(("stds", "is_reported"), [(4.7, False), (4.8, True)])
def test_a_value_beyond_four_point_seven_standard_deviations_has_a_small_weight(stds, is_reported):
    """Squares of the standardised value, of which the noise has one: (4.74)^2 = 22.5."""
    H = np.ones((9, 1, 1), dtype=complex)
    values = np.ones((9, 1))
    values[4] += 0.1 * stds
    found = Robust(Stated(0.1, 0.0)).refit(H, frf_of(values), 0)
    assert found.outliers["down_weighted"] == pytest.approx(is_reported / 9)


def test_lines_are_chosen_for_a_floor_of_a_hundredth(monkeypatch):
    """Of the rms of the data of a unit, which is 2 here."""
    floors = []

    def map_lines(function, items):
        floors.extend(floor for _, floor, _ in items)
        return [np.ones((3, 1, 1))]

    part = SimpleNamespace(
        frf=frf_of(np.full((3, 1), 2.0)),
        coordinates=SimpleNamespace(),
        partition=lambda: [None],
        map_lines=map_lines,
        recall=lambda name, x, compute, kind: compute(),
    )
    monkeypatch.setattr(lines, "_design_point", lambda part: None)
    lines._select_by_information(part, "", lambda information: information)
    assert np.ravel(floors[0]) == pytest.approx([0.02])


@pytest.mark.parametrize(("distance", "paired"), [(0.39, 0), (0.41, 1)])
def test_a_pair_weighs_mac_against_half_the_logarithm_of_the_frequency(distance, paired):
    """A mode with the same shape at another frequency, and one with a MAC of 0.8 at the same."""
    shapes = np.array([[1.0, np.sqrt(0.8)], [0.0, np.sqrt(0.2)]])
    modes = SimpleNamespace(value=np.exp([2.0 * distance, 0.0]), shapes=shapes)
    target = SimpleNamespace(
        value=np.ones(1),
        shapes=shapes[:, :1],
        has_shapes=True,
        can_distinguish_shapes=True,
        at_sensors=lambda shapes: shapes,
    )
    found = Pairs._assign(modes, np.ones(2, dtype=bool), target, [])
    assert found.which.tolist() == [paired]


def test_modes_are_compared_up_to_half_above_the_highest_measured_one():
    target = SimpleNamespace(frequency=np.array([3.0, 10.0]))
    assert ModalTarget.highest.fget(target) == pytest.approx(15.0)
