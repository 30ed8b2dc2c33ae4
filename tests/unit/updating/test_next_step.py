"""Next step after an update: the lines of its first remedy, or those that its status calls for."""

from __future__ import annotations

import dataclasses
import tomllib

import pytest

import updyn
from report_case import realistic
from updyn.demos import chain
from updyn.remedy import Remedy
from updyn.updating.next_step import choose_next_step


@pytest.fixture(scope="module")
def fitted():
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    return updyn.update(model, frf, unknowns, starts=0)


def read_setting(step):
    (line,) = step.lines
    return tomllib.loads(line)


def test_a_fit_without_held_out_data_holds_a_response_out(fitted):
    (label,) = read_setting(choose_next_step(fitted))["validation"]
    assert label in fitted.fitted_responses
    model, frf = chain.build(), chain.measure()
    again = updyn.update(model, frf, fitted.parameters, starts=0, validation=[label])
    assert again.trust.validated.asked
    assert choose_next_step(again).lines == ('model = updyn.read_model("model.h5")',)
    both = updyn.JointResult({"locked": again, "free": again})
    assert choose_next_step(both).lines == ('model = updyn.read_model("locked/model.h5")',)


def test_the_step_limit_that_ended_a_fit_is_doubled(fitted):
    model, frf = chain.build(), chain.measure()
    limited = updyn.update(model, frf, fitted.parameters, starts=0, max_iterations=2)
    assert limited.status == "max-iterations"
    step = choose_next_step(limited)
    assert read_setting(step) == {"max_iterations": 4}
    assert step.place == "under [method] of the job"
    assert limited.remedy.startswith("Raise max_iterations")


@pytest.mark.parametrize("method", ["equation-error", "reduced-frf"])
def test_a_biased_method_names_the_setting_of_the_better_one(fitted, method):
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="all")
    result = updyn.update(model, frf, unknowns, method=method)
    step = next(step for step in result.steps if "maximum likelihood" in str(step).lower())
    assert read_setting(step) == {"name": "maximum-likelihood"}
    assert step.place == "under [method] of the job"


def test_the_lines_of_the_first_step_are_chosen():
    steps = (Remedy.repair("Omit it:", "mains=50", "Then check cables."), Remedy("Look."))
    assert choose_next_step(realistic(steps=steps)) is steps[0]


def test_unknowns_that_are_not_determined_need_another_test():
    result = realistic()
    step = choose_next_step(result)
    plan = tomllib.loads("\n".join(step.lines))["plan"]
    assert plan["n_sensors"] == len(result.data.responses) + 1
    assert plan["band"] == [result.data.freq[0], result.data.freq[-1]]
    assert step.advice == result.remedy


def test_lines_belong_to_their_advice():
    """A plan of a test does not follow advice on the model."""
    step = choose_next_step(realistic(steps=(Remedy("Compare model and test first."),)))
    assert (step.advice, step.lines) == ("Compare model and test first.", ("updyn check job.toml",))


@pytest.mark.parametrize("status", ["failed", "stalled", "not-credible", "stopped"])
def test_every_end_has_a_step_with_lines(status):
    step = choose_next_step(realistic(status=status, steps=()))
    assert step.lines[0].startswith("updyn ")
    assert step.advice


def test_advice_on_a_usable_result_is_kept(fitted):
    advice = "Check whether a sensor was moved."
    step = choose_next_step(dataclasses.replace(fitted, steps=(Remedy(advice),)))
    assert (step.advice, step.lines) == (advice, ("updyn check job.toml",))
