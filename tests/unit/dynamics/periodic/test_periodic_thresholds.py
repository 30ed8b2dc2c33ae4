"""Thresholds of periodic responses: a case just inside and just outside of each."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.dynamics.periodic import response, stability
from updyn.errors import UpdynWarning


@pytest.mark.parametrize(("truncation", "warned"), [(0.019, False), (0.021, True)])
def test_a_truncation_above_a_fiftieth_is_warned_of(truncation, warned):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        response._warn_of_truncation(np.ones(1), np.full((1, 1), truncation), 7)
    assert [one.category for one in caught] == [UpdynWarning] * warned


@pytest.mark.parametrize(("winding", "count"), [(1.09, 1), (1.11, 2)])
def test_a_winding_is_a_whole_number_to_a_tenth(monkeypatch, winding, count):
    """Otherwise more harmonics follow, with which it is 2."""
    windings = iter([winding, 2.0])
    monkeypatch.setattr(stability, "_find_poles", lambda *_: np.zeros(0, dtype=complex))
    monkeypatch.setattr(stability, "_Determinant", lambda *_: None)
    monkeypatch.setattr(stability, "_wind", lambda *_: next(windings))
    transfer, fourier = SimpleNamespace(rational=()), SimpleNamespace(harmonics=np.array([0, 1]))
    balance = SimpleNamespace(transfer=transfer, fourier=fourier)
    found = SimpleNamespace(jacobian=np.eye(1), omega=1.0)
    assert stability.count_unstable(balance, found) == count


class Determinant:
    """A phase that is proportional to frequency."""

    omega, is_held = 10.0, False

    def __init__(self, slope):
        self.slope, self.asked = slope, []

    def phase(self, nu):
        self.asked.append(nu)
        return self.slope * nu


def test_points_are_a_half_width_from_a_pole():
    determinant = Determinant(0.0)
    stability._wind(determinant, np.array([-0.1 + 2j]), 1.0)
    (nu,) = determinant.asked
    for point in (1.9, 2.1):
        assert np.isclose(nu, point, rtol=0.0, atol=1e-12).any()
    assert len(nu) == 9 + 2


@pytest.mark.parametrize(("turn", "rounds"), [(1.19, 1), (1.21, 2)])
def test_points_are_added_where_the_phase_turns(turn, rounds):
    determinant = Determinant(turn / (5.0 / 8))
    stability._wind(determinant, np.zeros(0, dtype=complex), 1.0)
    assert len(determinant.asked) == rounds


@dataclass(frozen=True)
class Rational:
    """One mode with unit residue at -0.1 + 2i."""

    theta: np.ndarray
    rows = columns = np.ones((1, 1))
    power = 1

    def poles(self):
        return np.full(len(self.theta), -0.1 + 2j), np.arange(len(self.theta))


@pytest.mark.parametrize(("stiffness", "kept"), [(0.09, 0), (0.11, 1)])
def test_elements_move_a_mode_from_a_loop_gain_of_one(stiffness, kept):
    """The gain is stiffness over half width."""
    transfer = SimpleNamespace(rational=Rational(np.ones(1)))
    balance = SimpleNamespace(transfer=transfer, n_elements=1)
    force = SimpleNamespace(stiffness=sp.csr_array([[stiffness]]), damping=np.zeros(1))
    found = SimpleNamespace(omega=1.0, period=[force])
    assert len(stability._find_poles(balance, found)) == 2 * kept
