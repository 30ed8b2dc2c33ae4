"""What is left to gain where a fit ended, in the terms in which it counted data against priors."""

import re

import numpy as np

import updyn
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.ending import _recent_decrease


def test_where_a_correlated_residual_widens_deviations_a_fit_with_priors_is_still_at_its_minimum(
    chain12_true, add_noise
):
    exact = updyn.response(
        chain12_true, np.linspace(0.6, 22.0, 200), ["2:X", "7:X", "12:X"], ["5:X"], "accelerance"
    )
    data = add_noise(exact, np.random.default_rng(1), 0.01)
    wrong = chain12_true.scaled({"part3": {"stiffness": 0.9}})
    unknowns = updyn.parameters(
        wrong, stiffness=["part1", "part2", "part4"], prior_std={"stiffness": 0.01}
    )
    result = updyn.update(wrong, data, unknowns, starts=0)
    assert result.noise["inflation"] > 1.5
    left = re.search(r"could gain (\S+) standard", result.trust.converged.why)
    assert float(left[1]) < 0.1


# -- thresholds ------------------------------------------------------------------------------------
def test_the_recent_decrease_is_that_of_ten_steps_of_the_last_stage():
    def make_history(stage, n):
        return [Iteration(stage, i, 100.0 - i, 0.1, 1.0, accepted=True) for i in range(n)]

    assert _recent_decrease([*make_history("log", 30), *make_history("output", 30)]) == 10.0
    assert _recent_decrease([*make_history("log", 30), *make_history("output", 6)]) == 5.0
    assert _recent_decrease([]) == 0.0
