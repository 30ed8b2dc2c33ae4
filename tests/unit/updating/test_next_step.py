"""The next step after an update: the lines that a remedy quotes, or those that its status calls for."""

from __future__ import annotations

import dataclasses
import tomllib

import pytest

import updyn
from report_case import realistic
from updyn.demos import chain
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.next_step import choose_next_step, read_step, split_sentences


def test_the_setting_of_a_fault_is_taken_out_of_its_remedy():
    step = read_step(read_fault("swapped:7:X,2:X").remedy)
    assert step.advice == "Check this. If it is confirmed, write:"
    assert tomllib.loads(step.lines) == {"repair": ["swapped:7:X,2:X"]}
    assert step.place == "under [test] of the job"
    assert step.remark == ""


def test_words_after_the_setting_are_kept():
    step = read_step(read_fault("mains=50").remedy)
    assert tomllib.loads(step.lines) == {"repair": ["mains=50"]}
    assert step.advice == "Omit these lines:"
    assert step.remark == "Before the next test, check cables and grounding"


def test_a_table_that_frees_an_unknown_is_toml():
    text = (
        "Free PBAR 2.mass if it can be wrong, and run again: [[parameter]] with"
        ' groups = ["PBAR 2"] and quantity = "mass".'
    )
    step = read_step(text)
    expected = {"parameter": [{"groups": ["PBAR 2"], "quantity": "mass"}]}
    assert tomllib.loads(step.lines) == expected
    assert step.advice == "Free PBAR 2.mass if it can be wrong, and run again:"


def test_nested_arrays_of_a_table_are_kept():
    text = (
        'Add it: [[damping]] with groups = "hub", loss_factor = 0.021 and'
        " loss_table = [[5.0, 50.0], [1.0, 2.5]] in the job, or Model.with_damping in Python."
    )
    (found,) = tomllib.loads(read_step(text).lines)["damping"]
    assert found == {
        "groups": "hub",
        "loss_factor": 0.021,
        "loss_table": [[5.0, 50.0], [1.0, 2.5]],
    }


def test_statements_of_python_are_lines():
    text = (
        'Add a spring: model = model.with_element("spring 1:Z", ["1:Z"], stiffness=1e4);'
        ' unknowns += updyn.parameters(model, stiffness="spring 1:Z")'
    )
    step = read_step(text)
    compile(step.lines, "step", "exec")
    assert step.lines.count("\n") == 1
    assert step.place == "in Python"


@pytest.mark.parametrize(
    "text",
    [
        'Free the leakage as a window: repair = ["window-damping=..."].',
        "Check units, calibration and labels; look at the channels with the lowest FRAC.",
    ],
)
def test_a_placeholder_and_plain_advice_give_no_lines(text):
    assert read_step(text) == dataclasses.replace(read_step(""), advice=text)


def test_sentences_end_before_a_capital():
    text = "Omit 5 % of 1.5 Hz, e.g. here. Then check it. Done."
    assert split_sentences(text) == ["Omit 5 % of 1.5 Hz, e.g. here.", "Then check it.", "Done."]


@pytest.fixture(scope="module")
def fitted():
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    return updyn.update(model, frf, unknowns, starts=0)


def test_a_fit_without_held_out_data_holds_a_response_out(fitted):
    (label,) = tomllib.loads(choose_next_step(fitted).lines)["validation"]
    assert label in fitted.fitted_responses
    model, frf = chain.build(), chain.measure()
    again = updyn.update(model, frf, fitted.parameters, starts=0, validation=[label])
    assert again.trust.validated.asked
    assert choose_next_step(again).lines == 'model = updyn.read_model("model.h5")'
    both = updyn.JointResult({"locked": again, "free": again})
    assert choose_next_step(both).lines == 'model = updyn.read_model("locked/model.h5")'


def test_an_option_that_ended_the_fit_is_doubled():
    limited = realistic(
        status="max-iterations", remedy="Raise max_iterations.", options={"max_iterations": 50}
    )
    assert tomllib.loads(choose_next_step(limited).lines) == {"max_iterations": 100}


def test_unknowns_that_are_not_determined_need_another_test():
    result = realistic()
    step = choose_next_step(result)
    plan = tomllib.loads(step.lines)["plan"]
    assert plan["n_sensors"] == len(result.data.responses) + 1
    assert plan["band"] == [result.data.freq[0], result.data.freq[-1]]
    assert step.advice == result.remedy


@pytest.mark.parametrize("status", ["failed", "stalled", "not-credible", "stopped"])
def test_every_end_has_a_step_with_lines(status):
    step = choose_next_step(realistic(status=status, remedy=""))
    assert step.lines.startswith("updyn ")
    assert step.advice


def test_advice_on_a_usable_result_is_kept(fitted):
    advice = "Check whether a sensor was moved."
    step = choose_next_step(dataclasses.replace(fitted, remedy=advice))
    assert (step.advice, step.lines) == (advice, "updyn check job.toml")
