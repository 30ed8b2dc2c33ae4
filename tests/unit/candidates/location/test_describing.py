"""Elements fitted by their describing functions."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.candidates.location.describing import choose_parameters, fit_element
from updyn.candidates.location.kinds import KINDS
from updyn.candidates.location.motion import SineMotion
from updyn.candidates.location.place import MeasuredElement

JOINT = updyn.IwanJoint(1.0, 500.0, -0.5, 0.5)


def fit(constant: complex, *, in_parallel: bool):
    """Fit a joint to the force of `JOINT` and a constant stiffness, from 1 % to twice its slip."""
    group = updyn.Group(1000.0 * np.eye(1), np.eye(1))
    model = updyn.Model.from_groups({"spring": group}, ["1:X"])
    amplitude = np.geomspace(2e-5, 4e-3, 60).reshape(3, 20, 1)
    motion = SineMotion(amplitude, np.linspace(10.0, 60.0, 20))
    force = motion.describe(JOINT) + constant
    measured = MeasuredElement(force, 0.5 * np.ones(force.shape), amplitude, 1e-3 * np.ones(20))
    start = updyn.IwanJoint(0.5, 800.0, -0.3, 1.0)
    unknowns = choose_parameters(model, "joint", KINDS["iwan"], start, ["1:X"])
    found = fit_element(measured, start, unknowns, motion, in_parallel=in_parallel)
    assert found is not None
    return found


@pytest.mark.parametrize("constant", [0.0, 300.0 + 20.0j, -200.0 - 10.0j])
def test_an_element_is_found_in_parallel_with_a_constant_stiffness(constant):
    joint, misfit = fit(constant, in_parallel=True)
    assert misfit < 1e-3
    assert joint.slip_force == pytest.approx(JOINT.slip_force, rel=1e-3)
    assert joint.stiffness == pytest.approx(JOINT.stiffness, rel=1e-3)
    assert (joint.chi, joint.beta) == pytest.approx((JOINT.chi, JOINT.beta), rel=1e-2)


def test_a_constant_stiffness_is_taken_for_that_of_an_element_without_it():
    joint, misfit = fit(300.0 + 20.0j, in_parallel=False)
    assert misfit > 1.0
    assert joint.stiffness > 1.2 * JOINT.stiffness
