"""Thresholds of the search for a model error by value: a case just within each, and one beyond."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.updating.judge import localise
from updyn.updating.judge.discrepancy import _choose_dofs
from updyn.updating.judge.localise import localise_error
from updyn.updating.problem.parameters import Parameter

QUANTITY = Parameter("part", "stiffness", 1.0, 0.1, 10.0)


def suspects_of(monkeypatch, gains, shares=()) -> tuple[tuple, int]:
    """Return the suspects that explain these shares, and how many of these gains are confirmed."""
    confirmed = []

    def explain(problem, x, residual, whitened, excess, promising, *about):
        confirmed.extend(promising)
        return [(QUANTITY, share, 0.0, True) for share in shares]

    for name, value in {
        "_replace_by_reduced": (None, ()),
        "_compute_energies": {},
        "_choose_quantities": [],
        "_compute_scores": [SimpleNamespace(gain=gain) for gain in gains],
        "_work_limit": 1.0,
    }.items():
        monkeypatch.setattr(localise, name, lambda *about, v=value: v)
    monkeypatch.setattr(localise, "_explain_residual", explain)
    return localise_error(None, np.zeros(1), None, [], 0.0), len(confirmed)


@pytest.mark.parametrize(("gain", "number"), [(11.9, 0), (12.1, 1)])
def test_a_suspect_gains_twelve(monkeypatch, gain, number):
    assert suspects_of(monkeypatch, [gain])[1] == number


@pytest.mark.parametrize(("gain", "number"), [(19.9, 1), (20.1, 2)])
def test_a_suspect_gains_a_tenth_of_the_largest_gain(monkeypatch, gain, number):
    assert suspects_of(monkeypatch, [200.0, gain])[1] == number


@pytest.mark.parametrize(("share", "number"), [(0.09, 0), (0.11, 1)])
def test_a_suspect_explains_a_tenth_of_the_residual(monkeypatch, share, number):
    assert len(suspects_of(monkeypatch, [200.0], [share])[0]) == number


def test_a_quantity_is_wrong_by_a_factor_of_thirty_at_most(monkeypatch):
    problem = SimpleNamespace(parts=[], coordinates=SimpleNamespace(parameters=[]))
    monkeypatch.setattr(localise, "_choose_sensors", lambda *about: [])
    (found,) = localise._choose_quantities(problem, None, {("part", "mass"): 1.0})
    assert (found.lower, found.upper) == pytest.approx((1.0 / 30.0, 30.0))


@pytest.mark.parametrize(("step", "expected"), [(0.49, 0.49), (-0.6, -0.5)])
def test_the_end_of_a_short_fit_is_expected_within_a_half(monkeypatch, step, expected):
    far = np.full(1, 9.0)
    wide = SimpleNamespace(coordinates=SimpleNamespace(bounds=(-far, far)))
    monkeypatch.setattr(localise, "_add_unknowns", lambda *about: (wide, np.zeros(1)))
    score = SimpleNamespace(parameter=QUANTITY, step=step)
    assert localise._expected_end(None, None, score)[1] == pytest.approx([expected])


@pytest.mark.parametrize(("n_parts", "number"), [(1, 15), (2, 8)])
def test_sixteen_dofs_have_local_changes(n_parts, number):
    """Every seventh of a hundred; the DOFs of two tests are the same."""
    dofs = SimpleNamespace(labels=[f"{i}:X" for i in range(100)])
    solver = SimpleNamespace(system=SimpleNamespace(dofs=dofs), other_dofs=lambda known: range(100))
    part = SimpleNamespace(solver=solver, receptance_dofs=([0], [1]))
    for found in _choose_dofs(SimpleNamespace(parts=[part] * n_parts)):
        assert len(found) == number
