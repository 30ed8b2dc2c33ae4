"""Unknowns that ended far from their start."""

import numpy as np
import pytest

import updyn
from updyn.updating.judge.distant import find_distant_unknowns


def unknowns(**options):
    K = np.array([[2.0, -1.0], [-1.0, 1.0]]) * 1e4
    group = updyn.Group(stiffness=K, mass=np.eye(2), loss_factor=0.02)
    model = updyn.Model.from_groups({"a": group}, ["1:X", "2:X"])
    return updyn.parameters(model, stiffness="a", mass="a", loss_factor="a", **options)


@pytest.mark.parametrize(
    ("value", "far"), [(3.3, False), (3.5, True), (1 / 3.3, False), (1 / 3.5, True)]
)
def test_without_a_prior_a_factor_of_three_and_a_half_is_far(value, far):
    found = find_distant_unknowns(
        unknowns(), {"a.stiffness": value, "a.mass": 1.0, "a.loss_factor": 0.3}
    )
    assert [one.name for one in found] == (["a.stiffness"] if far else [])


def test_a_prior_says_how_far_is_far():
    values = {"a.stiffness": 1.4, "a.mass": 3.0, "a.loss_factor": 0.02}
    options = {"prior_std": {"a.stiffness": 0.1, "a.mass": 1.0}}
    (found,) = find_distant_unknowns(unknowns(**options), values)
    assert found.deviations == pytest.approx(np.log(1.4) / 0.1)
    assert found.statement == "a.stiffness ended at 1.4 times its start"


def test_the_farthest_comes_first():
    values = {"a.stiffness": 4.0, "a.mass": 0.1, "a.loss_factor": 0.02}
    found = find_distant_unknowns(unknowns(), values)
    assert [one.name for one in found] == ["a.mass", "a.stiffness"]
    assert found[0].statement == "a.mass ended at 1/10 of its start"
