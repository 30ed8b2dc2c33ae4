"""Rounding in the model's answer: found where an analytic answer says that it is there, and nowhere else."""

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.updating.judge.rounding import _n_checked_lines, find_worst_rounding
from updyn.updating.problem.problem import FRFPart

FREQ = np.linspace(0.02, 0.2, 15)
ETA = 0.03


def stiff_pair(link, soft=1.0):
    """Two masses of 1 kg, tied by a link far stiffer than the spring of 1 N/m that holds them."""
    ends = np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "soft": Group(soft * np.diag([1.0, 0.0]), np.diag([1.0, 1.0]), loss_factor=ETA),
        "link": Group(np.pi * link * ends),
    }
    return Model.from_groups(groups, ["1:X", "2:X"])


def as_one(freq):
    """The answer of both masses as one, which it is to about one over the stiffness of the link."""
    return 1.0 / (1.0 + 1j * ETA - 2.0 * (2.0 * np.pi * freq) ** 2)


def measured(relative=0.0, seed=0):
    draw = np.random.default_rng(seed).standard_normal((2, len(FREQ), 2, 1))
    values = as_one(FREQ)[:, None, None] * (
        1.0 + relative * (draw[0] + 1j * draw[1]) / np.sqrt(2.0)
    )
    return FRF(FREQ, values, ["1:X", "2:X"], ["2:X"], "receptance")


def found(link, relative=0.0, soft=1.0):
    model = stiff_pair(link, soft)
    problem = FRFPart.build(model, measured(relative), updyn.parameters(model, stiffness=["soft"]))
    x = problem.coordinates.to_x(np.array([1.0 / soft]))
    return find_worst_rounding([problem], x)


@pytest.mark.parametrize("link", [1e9, 3e9, 1e10])
def test_the_share_is_of_the_size_of_the_true_error(link):
    answer = updyn.response(stiff_pair(link), FREQ[[0, 7, 14]], ["1:X", "2:X"], ["2:X"]).values
    error = np.abs(answer / as_one(FREQ[[0, 7, 14]])[:, None, None] - 1.0).max()
    rounding = found(link)
    assert rounding is not None
    assert 0.05 < rounding.share / error < 20.0


def test_a_motion_that_all_but_cancels():
    """Two springs at right angles, 45 degrees off: what one pushes across, the other takes back."""
    across, k, share = np.array([[1.0, 1.0], [1.0, 1.0]]), 1e6 / 3, 1e-11
    groups = {
        "body": Group(mass=np.eye(2)),
        "one": Group(k * across, loss_factor=ETA),
        "other": Group(k * (1 - share) * np.array([[1.0, -1.0], [-1.0, 1.0]]), loss_factor=ETA),
    }
    model, freq = Model.from_groups(groups, ["1:X", "1:Y"]), np.linspace(50.0, 250.0, 9)
    computed = updyn.response(model, freq, ["1:X", "1:Y"], ["1:X"])
    direct = k * (2 - share) * (1 + 1j * ETA) - (2 * np.pi * freq) ** 2
    coupling = k * share * (1 + 1j * ETA)
    exact = (
        np.stack([direct, -coupling + 0 * direct], axis=1)[:, :, None]
        / (direct**2 - coupling**2)[:, None, None]
    )
    error = np.abs(computed.values / exact - 1.0).max(axis=(0, 2))
    assert error[0] < 1e-12
    problem = FRFPart.build(model, computed, updyn.parameters(model, stiffness=["one"]))
    rounding = find_worst_rounding([problem], np.zeros(1))
    assert (rounding.response, rounding.reference) == ("1:Y", "1:X")
    assert 0.05 < rounding.share / error[1] < 20.0


def test_nothing_is_said_of_ordinary_models_and_of_data_that_are_noisier():
    assert found(1e5) is None
    assert found(1e10) is not None
    assert found(1e10, relative=0.05) is None


def test_a_fit_says_so_instead_of_blaming_the_model():
    start = stiff_pair(1e10, soft=0.7)
    result = updyn.update(
        start, measured(), updyn.parameters(start, stiffness=["soft"], loss_factor=["soft"])
    )
    assert "only accurate to" in result.message
    assert "cannot explain" not in result.message
    assert "Leave out such channels" in result.remedy
    assert result.adequacy is None


# -- thresholds ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("n_dofs", "n_lines", "n_checked"),
    [
        (390, 30, 3),
        (410, 30, 1),
        (410, 39, 1),
        (410, 41, 2),
        (410, 900, 3),
        (19_000, 900, 3),
        (21_000, 900, 1),
    ],
)
def test_fewer_lines_of_large_models_are_checked(n_dofs, n_lines, n_checked):
    system = SimpleNamespace(n=n_dofs)
    part = SimpleNamespace(solver=SimpleNamespace(system=system), n_lines=n_lines)
    assert _n_checked_lines(part) == n_checked


@pytest.mark.parametrize(
    ("share", "misfit", "is_reported"),
    [(0.9e-6, 0.0, False), (1.1e-6, 0.0, True), (0.009, 0.1, False), (0.011, 0.1, True)],
)
def test_rounding_is_reported_from_a_millionth_and_a_tenth_of_the_misfit(
    monkeypatch, share, misfit, is_reported
):
    monkeypatch.setattr(
        "updyn.updating.judge.rounding._relative_rounding",
        lambda part, x, freq: np.full((len(freq), 2, 1), share),
    )
    model = stiff_pair(10.0)
    exact = updyn.response(model, FREQ, ["1:X", "2:X"], ["2:X"])
    frf = FRF(FREQ, exact.values * (1.0 + misfit), exact.responses, exact.references, "receptance")
    part = FRFPart.build(model, frf, updyn.parameters(model, stiffness=["soft"]))
    assert (find_worst_rounding([part], np.zeros(1)) is not None) is is_reported
