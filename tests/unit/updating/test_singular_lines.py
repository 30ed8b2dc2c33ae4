"""Undamped models at their natural frequencies: the same verdict whatever the kernel of BLAS rounds."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.errors import SolverError, UpdynWarning
from updyn.model import Group, Model

pytestmark = pytest.mark.kernels

N = 24
#: Steps of a double beside the computed natural frequency.
STEPS = (0, 1, -1, 2, -3, 8, -16)


@pytest.fixture(scope="module")
def chain() -> Model:
    """Two halves of a chain fixed at both ends, symmetric: every second mode has a node in the middle."""
    groups = {}
    for number, first in enumerate((0, N // 2), 1):
        K, M = np.zeros((N - 1, N - 1)), np.zeros((N - 1, N - 1))
        for spring in range(first, first + N // 2):
            for a, b in ((spring - 1, spring - 1), (spring, spring)):
                if 0 <= a < N - 1:
                    K[a, b] += 1e6
                    M[a, b] += 0.5
            if 0 < spring < N - 1:
                K[spring - 1, spring] -= 1e6
                K[spring, spring - 1] -= 1e6
        groups[f"half {number}"] = Group(K, M)
    return Model.from_groups(groups, [f"{i}:X" for i in range(1, N)])


@pytest.mark.parametrize("tier", ["dense", "sparse"])
@pytest.mark.parametrize("force", ["3:X", f"{N // 2}:X"])
def test_a_natural_frequency_is_refused_and_a_line_beside_it_is_not(chain, tier, force):
    """The force in the middle excites every second mode not at all; the answer would be rounding, too."""
    for frequency in updyn.modes(chain, 8).frequency:
        for steps in STEPS:
            line = [frequency + steps * np.spacing(frequency)]
            with pytest.raises(SolverError, match="a natural frequency without damping"):
                updyn.response(chain, line, ["5:X"], [force], tier=tier)
        beside = updyn.response(chain, [frequency * (1 + 1e-6)], ["5:X"], [force], tier=tier)
        assert np.isfinite(beside.values).all()


def test_the_first_singular_line_is_named(chain):
    first, second = updyn.modes(chain, 2).frequency
    with pytest.raises(SolverError, match=f"singular at {first:g} Hz"):
        updyn.response(chain, [0.5 * first, first, second], ["5:X"], ["3:X"])


@pytest.mark.parametrize("tier", ["dense", "sparse"])
@pytest.mark.parametrize("method", ["maximum-likelihood", "log", "equation-error"])
def test_a_fit_whose_start_is_singular_at_a_line_begins_beside_it(chain, tier, method):
    true = chain.scaled({"half 1": {"stiffness": 0.8}, "half 2": {"mass": 1.1}})
    low = updyn.modes(chain, 3).frequency
    data = updyn.response(true, [0.6 * low[0], low[0], low[1], low[2]], ["3:X", "5:X"], ["3:X"])
    unknowns = updyn.parameters(chain, stiffness=["half 1"], mass=["half 2"])
    with pytest.warns(UpdynWarning, match=f"singular at {low[0]:g} Hz") as warned:
        found = updyn.update(chain, data, unknowns, method=method, tier=tier)
    assert len(warned) == 1
    assert found.status == "converged"
    assert found.values == pytest.approx({"half 1.stiffness": 0.8, "half 2.mass": 1.1}, rel=1e-6)
    assert found.parameters == unknowns


def test_priors_stay_at_the_start_that_was_given(chain):
    """A prior that is much surer than the data: the estimate is its centre."""
    low = updyn.modes(chain, 1).frequency
    true = chain.scaled({"half 1": {"stiffness": 0.8}})
    data = updyn.response(true, [0.5 * low[0], low[0]], ["3:X"], ["3:X"])
    unknowns = updyn.parameters(chain, stiffness=["half 1"], prior_std={"half 1.stiffness": 1e-9})
    with pytest.warns(UpdynWarning, match="The fit starts"):
        found = updyn.update(chain, data, unknowns, noise={"relative": 0.01})
    assert found.values["half 1.stiffness"] == pytest.approx(1.0, abs=1e-6)


def test_a_line_that_no_unknown_moves_is_an_error():
    K = np.diag([1e6, 4e6, 0.0]) + 1e6 * np.array([[1, -1, 0], [-1, 1, 0], [0, 0, 0]])
    apart = np.diag([0.0, 0.0, 3e6])
    groups = {
        "joined": Group(K, np.diag([1.0, 1.0, 0.0])),
        "apart": Group(apart, np.diag([0.0, 0.0, 1.0])),
    }
    model = Model.from_groups(groups, ["1:X", "2:X", "3:X"])
    hit = np.sqrt(3e6) / (2 * np.pi)
    data = updyn.response(model, [0.5 * hit, 0.9 * hit], ["1:X"], ["1:X"])
    data = updyn.FRF([0.5 * hit, hit], data.values, data.responses, data.references, data.quantity)
    unknowns = updyn.parameters(model, stiffness=["joined"])
    with pytest.raises(SolverError, match=f"singular at {hit:g} Hz.*Omit the line"):
        updyn.update(model, data, unknowns)
