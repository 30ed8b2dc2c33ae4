"""Rank where one value outweighs all others: a line on a resonance without damping to speak of."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.updating.problem.noise import Stated
from updyn.updating.problem.normalised import make_normalised_residual
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import LogError

LOSS = 1e-9


def chain(stiffness, masses) -> updyn.Model:
    """Masses on springs, one after the other from the ground; springs by name, in N/m."""
    n, groups = len(masses), {}
    for i, (name, k) in enumerate(stiffness.items()):
        K = np.zeros((n, n))
        at = min(i, n - 1)
        K[at, at] = k
        if at:
            K[at - 1, at - 1], K[at, at - 1], K[at - 1, at] = k, -k, -k
        groups[name] = updyn.Group(K, np.zeros((n, n)), loss_factor=LOSS)
    groups["masses"] = updyn.Group(np.zeros((n, n)), np.diag(masses))
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def springs(model: updyn.Model):
    return updyn.parameters(model, stiffness=[name for name in model.groups if name != "masses"])


@pytest.fixture
def model() -> updyn.Model:
    return chain({"a": 1e4, "b": 2e4, "c": 1.5e4, "d": 1e4}, [1.0, 2.0, 1.0, 1.5])


def measured(model: updyn.Model) -> updyn.FRF:
    first, *_, last = updyn.modes(model, model.n_dofs).frequency
    freq = np.sort([*np.linspace(0.3 * first, 1.2 * last, 30), first])
    return updyn.response(model, freq, ["1:X", "3:X"], ["1:X"])


def test_a_line_on_a_resonance_leaves_the_other_unknowns_determined(model):
    """One line is 1e9 times as sensitive as the others, and they tell the four springs apart."""
    data = measured(model)
    level = np.abs(data.values[:, 0, 0])
    assert level.max() > 1e6 * np.median(level)
    result = updyn.update(model, data, springs(model), starts=0)
    assert result.identifiability.rank == result.identifiability.n_parameters
    assert result.status == "converged"
    assert max(result.std.values()) < 1e-3


def test_what_no_line_tells_apart_stays_open():
    """Two springs that hold the last mass side by side: their sum is all that can be known."""
    model = chain({"a": 1e4, "b": 2e4, "c": 1.5e4, "left": 4e3, "right": 6e3}, [1.0, 2.0, 1.0, 1.5])
    result = updyn.update(model, measured(model), springs(model), starts=0)
    assert result.status == "not-identifiable"
    (direction,) = result.identifiability.null_directions
    assert set(direction) == {"left.stiffness", "right.stiffness"}
    assert [name for name, std in result.std.items() if np.isinf(std)] == [
        "left.stiffness",
        "right.stiffness",
    ]


def test_rows_are_those_of_the_log_error_and_none_is_longer_than_one(model):
    data = measured(model)
    part = FRFPart.build(model, data, springs(model))
    lines, x = slice(0, len(data.freq)), part.coordinates.start
    (own,) = make_normalised_residual(Problem.of([part]), [Stated(0.01, 0.0)]).errors
    r, rows = own.block(part, x, lines)
    _, slopes = LogError().block(part, x, lines)
    length = np.linalg.norm(slopes, axis=0)
    assert length.max() > 1e6
    assert length.min() < 1.0
    assert rows == pytest.approx(slopes / np.maximum(length, 1.0), rel=1e-12)
    assert not r.any()


class Blind(Stated):
    """Noise that hides two lines of a sensor."""

    def initial_variance(self, frf: updyn.FRF) -> np.ndarray:
        variance = self.variance(frf.values, frf)
        variance[3:5, 1] = np.inf
        return variance


def test_values_that_do_not_count_have_no_rows(model):
    part = FRFPart.build(model, measured(model), springs(model))
    (own,) = make_normalised_residual(Problem.of([part]), [Blind(0.01, 0.0)]).errors
    assert np.argwhere(own.weight == 0.0).tolist() == [[3, 1, 0], [4, 1, 0]]
    lines = slice(2, 6)
    _, rows = own.on(part, lines).block(part, part.coordinates.start, lines)
    assert not rows[:, 1:3, 1].any()
    assert rows[:, 0].any(axis=0).all()
