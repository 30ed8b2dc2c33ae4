"""Plans that are stopped, resumed, and spread over workers: the same to the last bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.demos import chain
from updyn.errors import OptionError, StoppedError
from updyn.planning.information import Candidates
from updyn.planning.options import find_noise
from updyn.planning.settings import CANDIDATE_REDUCTION, SCREENING
from updyn.store.planning import plan_to_json
from updyn.updating.problem.settings import EVALUATION

HOW = {"n_sensors": 3, "n_references": 2, "lines": 20, "robust": 2, "compare": True}
BANDS = [(1.0, 40.0), (1.0, 20.0)]


@pytest.fixture(scope="module")
def model():
    return chain.build().scaled({"part2": {"stiffness": 1.3}})


def planned(model, **changed):
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    return updyn.plan(model, unknowns, None, **(HOW | {"band": BANDS} | changed))


def content(plan):
    """All figures of a plan, to the last bit."""
    return plan_to_json(plan), plan.variance.tobytes()


class Stopping:
    """A callback that asks to stop at its n-th call, and at all later ones."""

    def __init__(self, at):
        self.at, self.calls, self.lines = at, 0, 0

    def __call__(self, progress):
        self.calls += 1
        self.lines = progress.lines_done
        return self.calls >= self.at


@pytest.fixture(params=["whole", "reduced", "screened"])
def way(request, monkeypatch):
    """Each way to a layout, on a small model."""
    if request.param != "whole":
        override(monkeypatch, CANDIDATE_REDUCTION, most_exact_dofs=5)
    if request.param == "screened":
        override(monkeypatch, SCREENING, most_pairs=50)
        override(monkeypatch, SCREENING, least_responses=8, least_references=5)
        override(monkeypatch, SCREENING, kept_per_selected=1)
    return request.param


def test_a_stopped_plan_resumed_is_the_same(model, way, tmp_path):
    whole = Stopping(np.inf)
    expected = content(planned(model, callback=whole))
    assert bool(expected[0]["screened"]) == (way == "screened")
    for at in np.unique(np.geomspace(1, whole.calls, 6).astype(int)):
        path = tmp_path / f"{at}.journal"
        halt = Stopping(at)
        with pytest.raises(StoppedError, match="no layout is selected"):
            planned(model, callback=halt, checkpoint=path)
        assert halt.calls == at
        resumed = Stopping(np.inf)
        found = planned(model, callback=resumed, checkpoint=path, resume=True)
        assert content(found) == expected
    assert resumed.lines < 0.7 * whole.lines  # those of the starts are not solved again


def test_workers_do_not_change_a_plan(model, way, monkeypatch):
    expected = content(planned(model))
    override(monkeypatch, EVALUATION, distributed_work=0.0)
    assert content(planned(model, engine=2)) == expected


def test_comparison_may_be_added_on_resuming(model, tmp_path):
    path = tmp_path / "plan.journal"
    planned(model, compare=False, checkpoint=path)
    found = planned(model, checkpoint=path, resume=True)
    assert content(found) == content(planned(model))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"lines": 41}, "the options differ (lines)"),
        ({"robust": 3}, "the options differ (draws)"),
        ({"seed": 1}, "the options differ (draws)"),
        ({"n_sensors": 2}, "the options differ (n_sensors)"),
        ({"criterion": "a-optimal"}, "the options differ (criterion)"),
        ({"noise": {"relative": 0.1}}, "the options differ (noise)"),
        ({"reference_candidates": ["3:X", "4:X"]}, "the options differ (reference_candidates)"),
    ],
)
def test_another_plan_is_not_resumed(model, tmp_path, changed, said):
    path = tmp_path / "plan.journal"
    with pytest.raises(StoppedError):
        planned(model, callback=Stopping(1), checkpoint=path)
    with pytest.raises(OptionError) as caught:
        planned(model, checkpoint=path, resume=True, **changed)
    assert said in str(caught.value)


def test_resuming_needs_a_checkpoint(model):
    with pytest.raises(OptionError, match="expected the path of a checkpoint"):
        planned(model, resume=True)


def test_nothing_to_resume_is_said(model, tmp_path):
    with pytest.warns(updyn.UpdynWarning, match="nothing to resume"):
        planned(model, checkpoint=tmp_path / "plan.journal", resume=True)


def test_channels_below_the_error_of_a_reduced_model_say_nothing(model):
    """The weakest channels have an infinite level of the noise, all others a common one."""
    unknowns = updyn.parameters(model, stiffness="all")
    freq = np.linspace(1.0, 8.0, 30)
    found = Candidates.compile(
        model, unknowns, model.dofs, model.dofs, freq, "receptance", find_noise(None)
    )
    labels = model.dofs.labels
    H = updyn.response(model, freq, labels, labels, quantity="receptance").values
    share = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    share /= share.max()
    error = 1.001 * float(np.quantile(share, 0.2))
    level = replace(found, error=error).with_level().level
    assert np.array_equal(np.isinf(level), share <= error)
    assert len(np.unique(level[share > error])) == 1
