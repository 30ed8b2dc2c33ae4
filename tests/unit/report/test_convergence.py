"""Convergence: fits of a history, panels by stage, and iterations as the result counts them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pages_read import Page
from report_case import realistic
from updyn.report.convergence import cost_path, value_paths
from updyn.report.page import render
from updyn.updating.fit.monitor import Iteration, count_iterations


def steps(*entries):
    """Stage, cost and step of each entry; a negative step is one that was refused."""
    return tuple(
        Iteration(stage, number, cost, abs(step), 1.0, step >= 0, {"bay 2.stiffness": 1.0 + cost})
        for number, (stage, cost, step) in enumerate(entries)
    )


HISTORY = steps(
    ("search", 9.0, 0.0), ("search", 4.0, 0.5), ("search", 6.0, -0.4), ("search", 1.0, 0.2),
    ("search", 8.0, 0.0), ("search", 1.0, 0.9),
    ("fit", 70.0, 0.0), ("fit", 50.0, 0.1), ("fit", 60.0, 0.05), ("fit", 59.0, 0.01),
)  # fmt: skip


def test_iterations_are_the_steps_taken():
    assert count_iterations(HISTORY) == [0, 1, 1, 2, 2, 3, 3, 4, 5, 6]
    assert realistic(history=HISTORY).iterations == 6


def test_each_stage_has_a_panel_and_each_fit_a_line():
    """Costs of the search and of the fit have nothing to do with each other."""
    figure = cost_path(realistic(history=HISTORY))
    layout = figure["layout"]
    titles = [a["text"] for a in layout["annotations"]]
    assert titles == ["<b>search (2 fits)</b>", "<b>fit (2 fits)</b>"]
    search, refused, fit = figure["data"]
    assert (search["yaxis"], fit["yaxis"]) == ("y", "y2")
    assert search["x"] == [0, 1, 2, None, 0, 1, None]
    assert search["y"] == [9.0, 4.0, 1.0, None, 8.0, 1.0, None]
    assert (refused["name"], refused["x"], refused["y"]) == ("step rejected", [2], [6.0])
    # New weights raised the cost: another line begins.
    assert fit["x"] == [0, 1, None, 0, 1, None]
    assert fit["y"] == [70.0, 50.0, None, 60.0, 59.0, None]
    assert "iteration 6: cost 59" in fit["hovertemplate"].replace("%{text}", fit["text"][4])
    for domain in (layout["xaxis"]["domain"], layout["xaxis2"]["domain"]):
        assert 0.0 <= domain[0] < domain[1] <= 1.0
    # tick labels such as 0.8×10⁴, 45 of the 500 px that a printed figure has
    assert layout["xaxis2"]["domain"][0] - layout["xaxis"]["domain"][1] > 0.089


def test_no_line_of_the_cost_goes_up():
    figure = cost_path(realistic(history=HISTORY))
    for trace in figure["data"]:
        if trace["name"] == "step accepted":
            costs = np.array([np.nan if y is None else y for y in trace["y"]])
            assert not (np.diff(costs) > 0).any()


def test_costs_that_are_nearly_alike_have_a_linear_axis():
    close = steps(("fit", 471.2, 0.0), ("fit", 470.9, 0.1))
    assert "type" not in cost_path(realistic(history=close))["layout"]["yaxis"]
    far = steps(("fit", 471.2, 0.0), ("fit", 0.0, 0.1))
    figure = cost_path(realistic(history=far))
    assert figure["layout"]["yaxis"]["type"] == "log"
    assert figure["data"][0]["y"][1] == pytest.approx(47.12)  # zero stands at the foot


def test_an_axis_of_costs_that_differ_by_rounding_does_not_spell_that_out():
    same = steps(("fit", 4781.0, 0.0), ("fit", 4781.0 - 2e-4, 1e-9))
    low, high = cost_path(realistic(history=same))["layout"]["yaxis"]["range"]
    assert low < 4780.9998
    assert high > 4781.0
    assert high - low > 40.0


def entries(*given):
    """Stage, cost, step and value of each entry as a history."""
    return tuple(
        Iteration(stage, number, cost, step, 1.0, True, {"bay 2.stiffness": value})
        for number, (stage, cost, step, value) in enumerate(given)
    )


def led_to(answer):
    """Two tries of a search, a fit that goes on under new weights, and a look for other answers."""
    return entries(
        ("search", 9.0, 0.0, 1.0), ("search", 1.0, 0.5, 5.0 * answer),
        ("search", 8.0, 0.0, 1.5), ("search", 0.5, 0.9, 1.02 * answer),
        ("fit", 70.0, 0.0, 1.02 * answer), ("fit", 50.0, 0.1, 1.01 * answer),
        ("fit", 60.0, 0.0, 1.01 * answer), ("fit", 59.0, 0.01, answer),
        ("other answers", 99.0, 0.0, 20.0), ("other answers", 59.0, 0.1, answer),
    )  # fmt: skip


def test_paths_are_those_of_the_fits_that_led_to_the_answer():
    """Another try of the search and a look for other answers are not drawn; earlier weights are."""
    answer = realistic().values["bay 2.stiffness"]
    found = realistic(history=led_to(answer))
    (trace,) = value_paths(found, [found.parameters.items[0]])["data"]
    assert trace["x"] == [0, 1, None, 2, 3, None, 4, 5]
    drawn = [1.5, 1.02 * answer, None, 1.02 * answer, 1.01 * answer, None, 1.01 * answer, answer]
    assert trace["y"] == pytest.approx(drawn)


def test_a_path_begins_where_the_fit_does_not_at_its_last_weights():
    """New weights raise the cost at a step that the fit takes on its way: it is one path."""
    answer = realistic().values["bay 2.stiffness"]
    found = realistic(
        history=entries(
            ("fit", 70.0, 0.0, 1.0), ("fit", 50.0, 0.4, 0.9),
            ("fit", 60.0, 0.1, 0.95 * answer), ("fit", 59.0, 0.1, answer),
            ("fit", 99.0, 0.0, 4.0), ("fit", 80.0, 0.1, 3.0),
        )
    )  # fmt: skip
    figure = value_paths(found, [found.parameters.items[0]])
    (trace,) = figure["data"]
    assert trace["x"] == [0, 1, None, 2, 3]
    assert trace["y"] == pytest.approx([1.0, 0.9, None, 0.95 * answer, answer])
    assert figure["layout"]["xaxis"]["dtick"] == 1  # no half iterations


def test_the_costs_in_words_are_those_of_one_fit():
    """Costs under other weights, or of a look for other answers, cannot be compared with them."""
    answer = realistic().values["bay 2.stiffness"]
    words = Page(render(realistic(history=led_to(answer)))).words
    assert "In the fit that reached the result (fit) the cost went from 60 to 59." in words
    alone = entries(("fit", 70.0, 0.0, 1.0), ("fit", 50.0, 0.4, answer))
    assert "The cost went from 70 to 50." in Page(render(realistic(history=alone))).words


def test_steps_without_a_cost_are_left_out():
    odd = dataclasses.replace(HISTORY[2], cost=np.nan)
    assert cost_path(realistic(history=(*HISTORY[:2], odd, HISTORY[3])))["data"][0]["x"][:3] == [
        *(0, 1, 2)
    ]
    assert cost_path(realistic(history=(odd,))) is None


def test_the_page_counts_iterations_as_the_result_does():
    result = realistic(history=HISTORY)
    words = Page(render(result)).words
    assert f"After {result.iterations} iterations." in words
    assert "6 iterations (accepted steps, including the search), 1 step rejected." in words
