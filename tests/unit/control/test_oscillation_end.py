"""Thresholds of limit cycles: a case just inside and just outside of each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nonlinear_plants import one_inertia
from updyn.control.nonlinear.nonlinearity import find_doubt
from updyn.control.nonlinear.settled import judge_end
from updyn.control.nonlinear.simulate import simulate
from updyn.errors import OptionError
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.friction import CoulombFriction


def end_of(time, z):
    """Classify a series whose last contact is at its end."""
    return judge_end(time, z, time[-1:], half=0.0)


@pytest.mark.parametrize(("growth", "verdict"), [(1.0e-3, "limit cycle"), (1.5e-3, "grows")])
def test_amplitudes_within_a_hundredth_are_a_limit_cycle(growth, verdict):
    """The last nine periods of 25 differ by 0.8 or by 1.2 %."""
    t = np.linspace(0.0, 25.0, 25001)
    assert end_of(t, (1.0 + growth * t) * np.sin(2 * np.pi * t)).verdict == verdict


@pytest.mark.parametrize(
    ("duration", "verdict", "periods"), [(15.5, "limit cycle", 5), (12.5, "not settled", 0)]
)
def test_five_periods_in_the_last_two_fifths_are_a_limit_cycle(duration, verdict, periods):
    t = np.linspace(0.0, duration, 20001)
    found = end_of(t, np.sin(2 * np.pi * t))
    assert (found.verdict, found.periods) == (verdict, periods)


@pytest.mark.parametrize(("size", "verdict"), [(0.35, "decays"), (0.45, "not settled")])
def test_an_oscillation_has_decayed_below_a_fifth(size, verdict):
    """Ranges of the quarters of the end, `size`, as a share of the whole range of 2."""
    t = np.linspace(0.0, 10.0, 10001)
    end = size * np.cos(0.5 * np.pi * (t - 6.0)) * (1.0 - 1e-3 * (t - 6.0))
    assert end_of(t, np.where(t < 6.0, np.sin(2 * np.pi * t), end)).verdict == verdict


def test_backlash_is_doubtful_below_two_half_gaps():
    law = Backlash(stiffness=1.0, gap=2.0)
    assert "1.9 half gaps" in find_doubt(law, 1.9, 0.0)
    assert find_doubt(law, 2.1, 0.9) == ""


def test_friction_is_doubtful_above_three_tenths_of_a_third_harmonic():
    law = CoulombFriction(1.0)
    assert "0.31 of a third harmonic" in find_doubt(law, 1.0, 0.31)
    assert find_doubt(law, 1.0, 0.29) == ""


def test_a_simulation_has_400_steps_or_40_in_a_period():
    plant, law = one_inertia(), CoulombFriction(0.5)
    slow = simulate(plant, None, law, 1.0, "drag", start=[0.0, 9.0])
    assert len(slow.time) == 401
    oscillator = replace(plant, A=np.array([[0.0, 1.0], [-((2 * np.pi) ** 2), 0.0]]))
    run = simulate(oscillator, None, law, 20.0, "drag", start=[100.0, 0.0])
    assert 0.99 < np.median(np.diff(run.time)) * 40.0 < 1.01


def test_a_simulation_has_at_most_two_million_steps():
    with pytest.raises(OptionError, match=r"2\.1e\+06 steps.*at most 2e\+06"):
        simulate(one_inertia(), None, CoulombFriction(0.5), 2.1, "drag", step=1e-6)
