"""What an update says: verdict, table, what is not determined."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from updyn.frf import FRF
from updyn.model import Group, Model
from updyn.remedy import Remedy
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import Parameter, parameters
from updyn.updating.result import STATUSES, UpdateResult, interval


def step(number: int, accepted: bool) -> Iteration:
    return Iteration(
        "log", number, 1.0 / (number + 1), 0.1, 50.0, accepted, {"shaft.stiffness": 1.0}
    )


@pytest.fixture
def result() -> UpdateResult:
    start = Model.from_groups(
        {
            "shaft": Group(100 * np.eye(2), np.eye(2), loss_factor=0.01),
            "disc": Group(mass=np.eye(2)),
        },
        ["1:RZ", "2:RZ"],
    )
    unknowns = parameters(start, stiffness="shaft", mass="all", loss_factor="shaft")
    values = {
        "shaft.mass": 0.95,
        "shaft.stiffness": 1.234567,
        "shaft.loss_factor": 0.025,
        "disc.mass": 100.0,
    }
    return UpdateResult(
        status="not-identifiable",
        message="The fit converged, but one combination of unknowns is open.",
        steps=(Remedy("Fix one mass."),),
        method="maximum-likelihood",
        options={"max_iterations": 50},
        start=start,
        model=unknowns.apply(start, list(values.values())),
        data=FRF([1.0, 2.0], np.ones((2, 1, 1)), ["1:RZ"], ["1:RZ"], "receptance"),
        lines=np.array([1.0, 2.0]),
        fitted_responses=("1:RZ",),
        validation_responses=(),
        validation_band=None,
        parameters=unknowns,
        values=values,
        std={
            "shaft.mass": np.inf,
            "shaft.stiffness": 0.0123456,
            "shaft.loss_factor": 0.001,
            "disc.mass": np.inf,
        },
        covariance=np.diag([np.inf, 1e-4, 1e-6, np.inf]),
        at_bound={"disc.mass": "upper"},
        identifiability=Identifiability(
            rank=3,
            n_parameters=4,
            condition=np.inf,
            singular_values=(1.7, 1.0, 0.3, 0.0),
            null_directions=[{"disc.mass": -0.5, "shaft.mass": 1.0}],
            determined_directions=[{"shaft.mass": 0.5, "disc.mass": 1.0}],
            collinearity=np.inf,
            advice="Masses of shaft and disc act at the same DOFs.",
        ),
        history=(step(0, True), step(1, True), step(2, False), step(3, True)),
        noise={"kind": "estimated", "relative": 0.01},
        correlation={
            "before": {"frac_median": 0.5, "csac_mean": 0.61239},
            "after": {"frac_median": 0.99},
        },
        timing_s={"total": 0.1},
        versions={"updyn": "0"},
        title="Azimuth drive",
    )


SUMMARY = """\
Azimuth drive: not-identifiable after 2 iterations (maximum-likelihood). Not all unknowns determined.
The fit converged, but one combination of unknowns is open. Fix one mass.

unknown                            start         value         std  note
shaft.mass                             1          0.95           -  not determined by the data
shaft.stiffness                        1       1.23457      0.0123
shaft.loss_factor                   0.01         0.025       0.001
disc.mass                              1           100           -  at its upper bound; not determined by the data

The data determine 3 of 4 unknowns. Masses of shaft and disc act at the same DOFs.
  undetermined combination 1: +1 shaft.mass, -0.5 disc.mass
  of these, determined 1: +1 disc.mass, +0.5 shaft.mass

agreement                   before   after
FRAC, median over channels  0.5000  0.9900
CSAC, mean over lines       0.6124       -"""


def test_the_summary_word_by_word(result):
    assert result.summary() == SUMMARY


def test_a_summary_without_trouble(result):
    calm = dataclasses.replace(
        result,
        status="converged",
        message="The fit converged.",
        steps=(),
        title="",
        at_bound={},
        std=dict.fromkeys(result.values, 0.01),
        correlation={},
        identifiability=dataclasses.replace(
            result.identifiability, rank=4, null_directions=[], determined_directions=[], advice=""
        ),
    )
    lines = calm.summary().split("\n")
    assert lines[0] == "Update: converged after 2 iterations (maximum-likelihood). Converged."
    assert lines[1] == "The fit converged."
    assert lines[-1] == "The data determine 4 of 4 unknowns."
    assert "not determined" not in calm.summary()


def test_other_answers_are_listed_with_what_they_have_different(result):
    first = dict(result.values) | {"shaft.stiffness": 2.5}
    second = dict(result.values) | {"shaft.stiffness": 0.5, "shaft.loss_factor": 0.1}
    found = dataclasses.replace(
        result, alternatives=(Alternative(first, 1.0), Alternative(second, 2.0))
    )
    # the loss factor differs by 75 standard deviations, the stiffness by 60
    assert found.summary() == SUMMARY.replace(
        "\n\nagreement",
        "\n  answer 2 fits as well: shaft.stiffness 2.5"
        "\n  answer 3 fits as well: shaft.loss_factor 0.1, shaft.stiffness 0.5\n\nagreement",
    )


def test_iterations_counts_accepted_steps_after_the_start(result):
    assert result.iterations == 2
    assert dataclasses.replace(result, history=()).iterations == 0
    assert (
        repr(result)
        == "UpdateResult(not-identifiable, maximum-likelihood, 4 unknowns, 2 iterations)"
    )


@pytest.mark.parametrize("status", STATUSES)
def test_only_converged_is_ok(result, status):
    assert dataclasses.replace(result, status=status).ok == (status == "converged")


def test_complete(result):
    assert not result.identifiability.complete
    assert dataclasses.replace(result.identifiability, rank=4).complete


def test_a_result_cannot_be_changed(result):
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.status = "converged"
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.identifiability.rank = 4


def test_intervals_are_gaussian_or_student_s():
    """Quantiles of 97.5 %: 1.9600, and 2.5706 at five degrees of freedom (any table)."""
    factor = Parameter("a", "stiffness", 1.0, 0.1, 10.0)
    loss = Parameter("a", "loss_factor", 0.1, 0.0, 1.0)
    for freedom, wide in ((None, 1.959964), (5, 2.570582)):
        low, high = interval(loss, 0.1, 0.01, freedom=freedom)
        assert (low, high) == pytest.approx((0.1 - wide * 0.01, 0.1 + wide * 0.01))
        low, high = interval(factor, 2.0, 0.2, freedom=freedom)
        assert low * high == pytest.approx(4.0)
        assert np.log(high / 2.0) == pytest.approx(wide * 0.1)
