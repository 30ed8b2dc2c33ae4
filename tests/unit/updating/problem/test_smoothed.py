"""Log error of smoothed FRFs, against a smoothing written out by hand."""

import numpy as np
import pytest

import updyn
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import _BIAS, _CLEAR
from updyn.updating.problem.smoothed import SmoothedLogError, _window

FREQ = np.array([0.0, 1.5, 2.0, 3.0, 4.5, 5.0, 8.0, 11.0, 18.0])
ACTIVE = FREQ[1:]
X = np.array([0.1, 0.06, -0.2, 0.15])
FLOOR = 0.02


@pytest.fixture
def make(chain12):
    """A test at given lines with a known variance, two sensors and two forces, one turned round."""

    def made(freq, quantity="receptance", floor=FLOOR):
        true = chain12.scaled(
            {"part1": {"stiffness": 0.9, "loss_factor": 0.05}, "part3": {"mass": 1.2}}
        )
        data = updyn.response(true, freq, ["2:X", "5:-X"], ["5:X", "12:X"], quantity)
        rms = np.sqrt(np.mean(np.abs(data.values) ** 2))
        variance = np.full(data.values.shape, (floor * rms) ** 2)
        data = updyn.FRF(
            freq, data.values, data.responses, data.references, quantity, variance=variance
        )
        unknowns = updyn.parameters(
            chain12, stiffness=["part1", "part2"], mass=["part3"], loss_factor=["part1"]
        )
        return Part.build(chain12, data, unknowns)

    return made


def smoothing(freq, width):
    """The weights, one by one: Gaussian in ln f, times the part of ln f that a line stands for."""
    at = [np.log(f) if f > 0 else np.log(0.5 * min(g for g in freq if g > 0)) for f in freq]
    S = np.zeros((len(at), len(at)))
    share = np.gradient(at)
    for i, here in enumerate(at):
        for j, there in enumerate(at):
            S[i, j] = share[j] * np.exp(-((there - here) ** 2) / (2 * width**2))
        S[i] /= sum(S[i])
    return S


def by_hand(part, x, width):
    S, data = smoothing(part.frf.freq, width), part.frf
    H, measured = (np.einsum("fg,gij->fij", S, v) for v in (part.responses(x), data.values))
    variance = np.einsum("fg,gij->fij", S**2, data.variance)
    own = np.maximum(np.abs(measured) ** 2 - _BIAS * variance, 0.0)  # without what noise adds
    weight = np.sqrt(own / (own + variance / _CLEAR**2))
    return weight * (np.log(np.abs(H / measured)) + 1j * np.angle(H / measured))


@pytest.mark.parametrize("width", [0.5, 0.05])
@pytest.mark.parametrize("freq", [FREQ, ACTIVE], ids=["with 0 Hz", "without"])
def test_residual_is_that_of_the_definition(make, freq, width):
    part = make(freq)
    r, _ = SmoothedLogError(width).block(part, X, slice(0, len(freq)))
    assert r == pytest.approx(by_hand(part, X, width), rel=1e-9, abs=1e-12)
    cost = SmoothedLogError(width).local(Problem.of([part]), X).cost
    assert cost == pytest.approx(0.5 * np.sum(np.abs(r) ** 2), rel=1e-10)


@pytest.mark.parametrize("width", [0.5, 0.05])
@pytest.mark.parametrize("freq", [FREQ, ACTIVE], ids=["with 0 Hz", "without"])
def test_derivatives_equal_central_differences(make, freq, width):
    part, step = make(freq), 1e-5
    _, J = SmoothedLogError(width).block(part, X, slice(0, len(freq)))
    for i in range(len(X)):
        e = step * np.eye(len(X))[i]
        expected = (by_hand(part, X + e, width) - by_hand(part, X - e, width)) / (2 * step)
        assert J[i] == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("width", [1e-4, 0.05, 0.5, 5.0])
def test_truth_is_a_zero_at_any_width(make, width):
    part = make(FREQ)
    truth = part.coordinates.to_x(np.array([0.9, 0.05, 1.0, 1.2]))
    local = SmoothedLogError(width).local(Problem.of([part]), truth)
    assert local.cost < 1e-20
    assert SmoothedLogError(width).local(Problem.of([part]), X).cost > 1e-3


def test_narrow_window_leaves_the_frfs_as_they_are(make):
    """Far narrower than the lines are apart: the log error itself."""
    part = make(ACTIVE, floor=0.0)
    r, _ = SmoothedLogError(1e-3).block(part, X, slice(0, len(ACTIVE)))
    assert r == pytest.approx(np.log(part.responses(X) / part.frf.values), rel=1e-10)


def test_zero_hertz_without_motion_weighs_nothing(make):
    """Accelerance at rest is zero; smoothed over its neighbours it is not, on either side alike."""
    part = make(FREQ, "accelerance")
    for width in (1e-3, 0.5):
        r, J = SmoothedLogError(width).block(part, X, slice(0, len(FREQ)))
        assert np.isfinite(r).all()
        assert np.isfinite(J).all()
    narrow, J = SmoothedLogError(1e-3).block(part, X, slice(0, len(FREQ)))
    assert (narrow[0] == 0).all()
    assert (J[:, 0] == 0).all()


@pytest.mark.parametrize("width", [0.05, 0.15, 0.5])
def test_rows_of_the_window_add_up_to_one(width):
    freq = np.sort(np.random.default_rng(0).uniform(0.5, 40.0, 50))
    for lines in (freq, np.concatenate([[0.0], freq]), freq[:2], freq[:1], np.array([0.0])):
        window = _window(lines, width)
        assert window.sum(axis=1) == pytest.approx(np.ones(len(lines)), rel=1e-12)
        assert (window >= 0).all()


def test_window_is_one_of_log_frequency():
    """Hz or kHz are the same; geometric lines have one window for all, as wide as stated."""
    freq, width = np.geomspace(1.0, 100.0, 401), 0.1
    window = _window(freq, width)
    assert window == pytest.approx(_window(1000.0 * freq, width), rel=1e-9, abs=1e-15)
    row = window[200]
    assert row[150:251] == pytest.approx(window[220, 170:271], rel=1e-9)
    off = np.log(freq / freq[200])
    assert row @ off == pytest.approx(0.0, abs=1e-12)
    assert np.sqrt(row @ off**2) == pytest.approx(width, rel=1e-6)


def test_dense_lines_do_not_outweigh_sparse_ones():
    """ln f is smoothed to itself, away from the ends, although lines stand ten times as close above."""
    log = np.concatenate([np.arange(-2.0, 0.0, 0.02), np.arange(0.0, 2.0, 0.002)])
    smooth = _window(np.exp(log), 0.15) @ log
    inner = np.abs(log) < 1.0
    assert smooth[inner] == pytest.approx(log[inner], abs=0.15 * 0.02)


def test_wide_windows_are_told_apart_in_memory(make):
    part = make(ACTIVE)
    costs = [SmoothedLogError(w).local(Problem.of([part]), X).cost for w in (0.5, 0.15, 0.5)]
    assert costs[0] == costs[2]
    assert costs[0] != pytest.approx(costs[1], rel=1e-3)
