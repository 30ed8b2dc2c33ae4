"""Update of a free gear train with a gap in a mesh and friction at the motor, at three levels."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.control.backlash_demo import predict_cycles
from updyn.demos import loose_train

EVERY = 4


@pytest.fixture(scope="module")
def result() -> updyn.JointResult:
    """Fit of every fourth line, from a start off by a quarter, gap and friction by 2.5."""
    rng, tests = np.random.default_rng(4), []
    for level in loose_train.LEVELS:
        with warnings.catch_warnings():
            # At a few lines, higher harmonics are a tenth of the twist; data and model neglect them.
            warnings.simplefilter("ignore", updyn.UpdynWarning)
            frf = loose_train.measure(level, rng)
        lines = slice(None, None, EVERY)
        level_at_lines = frf.level[lines]
        tests.append(
            replace(frf, freq=frf.freq[lines], values=frf.values[lines], level=level_at_lines)
        )
    start = loose_train.starting_model()
    names = [name for name in start.groups if name != "unit 2"]
    elements = ["mesh.stiffness", "mesh.gap", "motor.level"]
    unknowns = updyn.parameters(start, stiffness=names, loss_factor=names, nonlinear=elements)
    return updyn.update(start, tests, unknowns, noise={"relative": 0.01, "floor": 0.001})


def test_gap_friction_and_groups_are_recovered(result: updyn.JointResult) -> None:
    assert result.status == "converged"
    true = loose_train.true_values()
    assert set(true) == set(result.values)
    off = [(result.values[name] - value) / result.std[name] for name, value in true.items()]
    assert np.sqrt(np.mean(np.square(off))) < 1.6
    assert np.abs(off).max() < 3.5
    assert result.std["mesh.gap"] < 0.01 * result.values["mesh.gap"]
    assert result.std["motor.level"] < 0.01 * result.values["motor.level"]


def test_the_true_limit_cycle_is_within_the_predicted_interval(result: updyn.JointResult) -> None:
    (found,) = predict_cycles(result, n=20)
    (true,) = predict_cycles(loose_train.true_model())
    low, high = found.amplitude_interval
    assert low < true.amplitude < high
    assert high / low < 1.2
    low, high = found.frequency_interval
    assert low < true.frequency < high
    assert high / low < 1.05
