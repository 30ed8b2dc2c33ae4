"""Lines that resolve resonances: against a fine sweep, and what they do at limits."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.dynamics.resonance_lines import even_lines, resonance_lines


def masses(n, loss_factor):
    """Masses in a row on springs, the first to the ground."""
    K = 1e4 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = 1e4
    group = updyn.Group(K, np.eye(n), loss_factor=loss_factor)
    return updyn.Model.from_groups({"all": group}, [f"{i + 1}:X" for i in range(n)])


def peaks(model, lines):
    return np.abs(updyn.response(model, lines, ["1:X"], ["1:X"]).values[:, 0, 0])


@pytest.mark.parametrize("loss_factor", [1e-2, 3e-4])
def test_every_resonance_is_resolved(loss_factor):
    """Its peak to a percent, as at the natural frequency, and lines on both of its flanks."""
    model = masses(6, loss_factor)
    found = updyn.modes(model, 6)
    lines = resonance_lines(model, 0.5, 40.0, 400)
    for frequency in found.frequency:
        near = lines[np.abs(lines / frequency - 1.0) < 5.0 * loss_factor]
        peak = peaks(model, [frequency])[0]
        assert peaks(model, near).max() >= 0.99 * peak
        half_power = near[np.abs(near / frequency - 1.0) <= 0.5 * loss_factor]
        assert (half_power < frequency).sum() >= 3
        assert (half_power > frequency).sum() >= 3


def test_lines_lie_in_the_band_ascending_and_within_the_limit():
    model = masses(30, 0.01)
    for limit in (60, 400):
        lines = resonance_lines(model, 3.0, 20.0, limit)
        assert 0 < len(lines) <= limit
        assert lines[0] >= 3.0
        assert lines[-1] <= 20.0
        assert (np.diff(lines) > 0).all()


@pytest.mark.parametrize(("limit", "found"), [(400, 96), (60, 60), (24, 24), (22, 20), (14, 12)])
def test_number_of_lines_for_six_modes(limit, found):
    """Sixteen for each mode, fewer for a small limit, but at least four for the lowest modes."""
    assert len(resonance_lines(masses(6, 0.01), 0.1, 100.0, limit)) == found


def test_lines_of_an_undamped_mode_are_those_of_a_small_loss_factor():
    lines = [resonance_lines(masses(1, loss), 0.1, 100.0, 40) for loss in (0.0, 1e-4, 2e-4)]
    np.testing.assert_array_equal(lines[0], lines[1])
    assert np.ptp(lines[2]) > 1.9 * np.ptp(lines[1])


def test_an_undamped_model_can_be_solved_at_its_lines():
    model = masses(5, 0.0)
    lines = resonance_lines(model, 0.5, 40.0, 200)
    assert np.isfinite(peaks(model, lines)).all()
    assert not np.isin(lines, updyn.modes(model, 5).frequency).any()


def test_without_modes_there_are_none():
    massless = updyn.Model.from_groups({"g": updyn.Group(np.eye(2))}, ["1:X", "2:X"])
    assert len(resonance_lines(massless, 1.0, 10.0, 100)) == 0
    assert len(resonance_lines(masses(3, 0.01), 1e3, 2e3, 100)) == 0


def test_even_lines_are_dense_at_both_ends():
    lines = even_lines(1.0, 1000.0, 400)
    assert (lines[0], lines[-1]) == (1.0, 1000.0)
    assert len(lines) <= 400
    assert np.diff(lines).max() < 5.1
    assert np.diff(np.log(lines)).max() < 0.036
