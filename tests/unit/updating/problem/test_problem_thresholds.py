"""Thresholds of data, noise and lines by value: a case just within each, and one just beyond."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

import updyn
from updyn.updating.problem import lines
from updyn.updating.problem.modal import _subspace_mac
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
            upper=np.array([2.0, 1.0, 1.0]), is_factor=np.array([True, False, False])
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
