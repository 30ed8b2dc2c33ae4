"""Intervals without the error of the model are marked, if the residual shows one."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from uncertain_cases import noisy, springs
from updyn.model import Group, Model
from updyn.store.uncertainty import read_uncertainty, write_uncertainty

LINES = np.linspace(1.0, 12.0, 60)
REMARK = "These intervals include noise only."


def model(link: float = 0.0) -> Model:
    """Three masses in a row, with a link from the support to the third that the start lacks."""
    groups = {
        "base": Group(springs((0, 1, 1000.0), n=3), np.diag([1.0, 0, 0]), loss_factor=0.03),
        "top": Group(
            springs((1, 2, 600.0), (2, 3, 800.0), n=3), np.diag([0, 1.0, 0.7]), loss_factor=0.05
        ),
    }
    if link:
        groups["link"] = Group(springs((0, 3, link), n=3), None)
    return Model.from_groups(groups, ["1:X", "2:X", "3:X"])


def fitted(link: float) -> updyn.UpdateResult:
    sensors = ["1:X", "2:X", "3:X"]
    measured = noisy(updyn.response(model(link), LINES, sensors, ["1:X"]), 3, 0.01)
    unknowns = updyn.parameters(model(), stiffness="all", loss_factor="all")
    return updyn.update(model(), measured, unknowns, noise={"relative": 0.01}, starts=0)


@pytest.fixture(scope="module")
def wrong() -> updyn.UpdateResult:
    result = fitted(20.0)
    assert result.noise["model_error"] > 0.5
    return result


def test_profiles(wrong, tmp_path) -> None:
    profiles = updyn.profile(wrong, ["base.stiffness"], starts=0)
    assert profiles.model_error == wrong.noise["model_error"]
    assert REMARK in profiles.summary()
    write_uncertainty(profiles, tmp_path / "uncertainty.nc")
    assert read_uncertainty(tmp_path / "uncertainty.nc").message == profiles.message
    one = profiles["base.stiffness"]
    # The update, whose deviation includes the error, is the wider of the two.
    assert one.upper - one.lower < 0.5 * 4.0 * wrong.std["base.stiffness"]


@pytest.mark.parametrize("kind", ["parametric", "residual"])
def test_bootstrap(wrong, kind) -> None:
    assert REMARK in updyn.bootstrap(wrong, n=2, kind=kind).message


def test_sampling(wrong) -> None:
    pytest.importorskip("emcee")
    assert REMARK in updyn.sample(wrong, n=10, seed=0, starts=0, max_evaluations=4000).message


def test_a_model_without_error_has_no_remark() -> None:
    result = fitted(0.0)
    assert "model_error" not in result.noise
    assert updyn.profile(result, ["base.stiffness"], starts=0).message == ""
    assert REMARK not in updyn.bootstrap(result, n=2).message
