"""Tests of structures that differ: a joint estimate names the difference."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import updyn
from updyn.updating.judge.between_tests import _explain_by_step, describe_separable_share
from updyn.updating.problem.local import Local

NOISE = {"relative": 0.01}
LINES = np.linspace(5.0, 30.0, 60)


def two_masses(stiffness: float = 1.0, mass: float = 1.0) -> updyn.Model:
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    groups = {
        "springs": updyn.Group(K, loss_factor=0.03),
        "masses": updyn.Group(mass=np.diag([1.0, mass])),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    return model.scaled({"springs": {"stiffness": stiffness}})


def measure(model: updyn.Model, name: str, seed: int) -> updyn.Test:
    frf = updyn.response(model, LINES, ["1:X", "2:X"], ["2:X"])
    draw = np.random.default_rng(seed).standard_normal((2, *frf.values.shape))
    values = frf.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1]) / np.sqrt(2.0))
    noisy = updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)
    return updyn.Test(two_masses(), noisy, name=name, noise=NOISE)


@pytest.mark.parametrize(
    ("structures", "differ"),
    [
        ((two_masses(0.97), two_masses(1.03)), True),
        ((two_masses(mass=1.5), two_masses(mass=1.5)), False),
    ],
)
def test_specimens_that_differ_are_named_and_a_common_error_is_not(structures, differ) -> None:
    tests = [measure(model, f"test {i}", i) for i, model in enumerate(structures)]
    unknowns = updyn.parameters(two_masses(), stiffness="all", loss_factor="all")
    result = updyn.update_jointly(tests, unknowns, starts=0)
    assert ("updyn.update_population" in result.first.message) == differ


def test_the_share_is_that_of_a_linear_fit() -> None:
    rng = np.random.default_rng(0)
    R, q = np.triu(rng.standard_normal((3, 3))) + 3.0 * np.eye(3), 0.1 * rng.standard_normal(3)
    fitted = least_squares(lambda d: R @ d + q, np.zeros(3))
    found = _explain_by_step(Local(1.0, R, q))
    assert found == pytest.approx(q @ q - 2.0 * fitted.cost, rel=1e-9)


def test_a_step_beyond_the_linear_range_explains_nothing() -> None:
    for step, explained in ((0.69, 0.69**2), (0.71, 0.0)):
        local = Local(1.0, np.eye(1), np.array([step]))
        assert _explain_by_step(local) == pytest.approx(explained)


def test_half_of_the_misfit_is_named() -> None:
    assert describe_separable_share(0.49) == ""
    assert "51 %" in describe_separable_share(0.51)
