"""Minima that are kept."""

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.uncertainty.likelihood import Point
from updyn.uncertainty.minima import _random_starts, find_minima
from updyn.updating.problem.local import Local


def point(x, cost):
    return Point(np.array([x]), Local(cost, np.array([[10.0]]), np.zeros(1)))


@pytest.mark.parametrize(
    ("x", "cost", "is_kept"),
    [
        # 6e-6 of the likelihood of the lowest.
        (2.0, 11.0, True),
        (2.0, 13.0, False),
        # A standard deviation from the lowest.
        (0.11, 0.0, True),
        (0.09, 0.0, False),
    ],
)
def test_minima_that_are_likely_and_apart_are_kept(monkeypatch, x, cost, is_kept):
    monkeypatch.setattr("updyn.uncertainty.minima._random_starts", lambda *about: iter([0]))
    monkeypatch.setattr("updyn.uncertainty.minima._exchange_parts", lambda *about: iter([]))
    other = point(x, cost)
    session = SimpleNamespace(map=lambda *about, spread: iter([other]))
    problem = SimpleNamespace(session=session, is_distributed=False)
    found = find_minima(SimpleNamespace(problem=problem), point(0.0, 0.0), None, 1, 0)
    assert (other in found) is is_kept


def test_random_starts_are_within_a_factor_of_e():
    """Every other one has a loss factor of 0.1 at least."""
    coordinates = SimpleNamespace(parameters=SimpleNamespace(is_damping=np.array([False, True])))
    likelihood = SimpleNamespace(
        bounds=(np.full(2, -9.0), np.full(2, 9.0)),
        problem=SimpleNamespace(coordinates=coordinates),
    )
    starts = [x for x, _ in _random_starts(likelihood, np.array([0.0, 0.02]), 40, 0)]
    assert 0.95 < np.abs(np.array(starts)[:, 0]).max() <= 1.0
    assert [float(x[1]) for x in starts] == [0.1, 0.02] * 20
