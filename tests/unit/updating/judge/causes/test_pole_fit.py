"""A pole beside the model, fitted to few of many lines first."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.judge.causes.pole_fit import Pole, _count_represented_lines, fit_pole
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.problem import FRFPart


def test_the_lines_that_are_kept_stand_for_all():
    """Few lines stand for themselves; of many, those about the pole are the densest."""
    pole = Pole(10.0, 0.02, np.ones(1), np.ones(1))
    few = np.linspace(1.0, 20.0, 100)
    assert (_count_represented_lines(few, pole) == 1.0).all()
    many = np.linspace(1.0, 20.0, 4001)
    count = _count_represented_lines(many, pole)
    about = np.abs(many / 10.0 - 1.0) < 0.1
    assert count[about].sum() == about.sum()
    assert count[~about].sum() == pytest.approx((~about).sum())
    assert count[about].max() < count[~about].max()
    assert 100 < (count > 0).sum() <= 240


@pytest.mark.parametrize("lines", [120, 900])
def test_the_pole_that_was_put_in_is_found(chain12, chain12_true, add_noise, lines):
    """Beside a model whose stiffnesses are off by 2 %, with 1 % of noise."""
    freq = np.linspace(0.6, 22.0, lines)
    clean = updyn.response(chain12_true, freq, ["2:X", "7:X", "12:X"], ["12:X", "5:X"])
    level = np.abs(clean.values).max()
    true = Pole(9.3, 0.02, level * np.array([0.01, -0.02, 0.005 + 0.002j]), np.array([1.0, -0.7]))
    frf = add_noise(
        replace(clean, values=clean.values + true.contribution(clean)),
        np.random.default_rng(2),
        0.01,
    )
    frf = replace(frf, variance=Stated(0.01, 1e-3).variance(frf.values, frf))
    rng = np.random.default_rng(5)
    start = chain12_true.scaled(
        {name: {"stiffness": rng.uniform(0.98, 1.02)} for name in chain12_true.groups}
    )
    part = FRFPart.build(start, frf, updyn.parameters(start, stiffness="all"))
    begin = Pole(9.35, 0.03, true.a * 0.8, true.b)
    found = fit_pole(part, part.coordinates.start, begin)
    assert found.frequency == pytest.approx(9.3, rel=1e-3)
    assert found.loss == pytest.approx(0.02, rel=0.1)
    outer = np.outer(found.a, found.b)
    assert np.abs(outer - np.outer(true.a, true.b)).max() < 0.1 * np.abs(true.a).max()
