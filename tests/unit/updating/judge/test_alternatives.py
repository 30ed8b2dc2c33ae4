"""Other answers of a fit: what they differ in, and the sensor that tells them apart."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.updating.fit.method import Fit, Rival
from updyn.updating.judge.alternatives import (
    Alternative,
    find_alternatives,
    find_differences,
    select_distinct,
)
from updyn.updating.problem.problem import FRFPart, Problem

FREQ = np.linspace(2.0, 45.0, 15)  # no more lines than are compared


def beam(left: float, right: float) -> updyn.Model:
    """Five masses in a row between two walls; only the springs to the walls are unknown."""
    n, outer, inner = 5, np.zeros((2, 5, 5)), np.zeros((5, 5))
    outer[0, 0, 0], outer[1, 4, 4] = left, right
    for i in range(n - 1):
        inner[i : i + 2, i : i + 2] += 4e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "left": updyn.Group(outer[0], np.zeros((n, n)), loss_factor=0.02),
        "row": updyn.Group(inner, np.eye(n), loss_factor=0.02),
        "right": updyn.Group(outer[1], np.zeros((n, n)), loss_factor=0.02),
    }
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def fitted(start: updyn.Model, responses: list[str], rivals: tuple[Rival, ...]) -> tuple:
    """A problem with a fit at factors 1.5 and 0.7, and its rivals."""
    true = start.scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    frf = updyn.response(true, FREQ, responses, ["3:X"])
    unknowns = updyn.parameters(start, stiffness=["left", "right"])
    problem = Problem.of([FRFPart.build(start, frf, unknowns)])
    fit = Fit(np.log([1.5, 0.7]), "converged", np.eye(2), rivals=rivals)
    return problem, fit


def test_sensor_and_difference_are_those_of_the_frfs_of_both_answers():
    start = beam(3e4, 3e4)
    problem, fit = fitted(start, ["3:X"], (Rival(np.log([0.7, 1.5]), 0.5),))
    (found,) = find_alternatives(problem, fit)
    assert found.values == pytest.approx({"left.stiffness": 0.7, "right.stiffness": 1.5})
    assert found.odds == pytest.approx(np.exp(0.5))
    places = ["1:X", "2:X", "4:X", "5:X"]
    here, there = (
        updyn.response(beam(3e4 * a, 3e4 * b), FREQ, places, ["3:X"]).values[:, :, 0]
        for a, b in ((1.5, 0.7), (0.7, 1.5))
    )
    apart = np.median(np.abs(here - there) / np.maximum(np.abs(here), np.abs(there)), axis=0)
    assert found.difference == pytest.approx(apart.max(), rel=1e-9)
    # a structure and its mirror image: places that face each other see the same difference
    assert apart[places.index(found.sensor)] == pytest.approx(apart.max(), rel=1e-9)


def test_no_sensor_is_named_where_none_would_see_a_difference():
    start = beam(3e4, 3e4)
    near = Rival(np.log([1.5001, 0.7001]), 0.0)
    (found,) = find_alternatives(*fitted(start, ["3:X"], (near,)))
    assert found.sensor == ""
    assert 0.0 < found.difference < 0.1


def test_no_sensor_is_named_where_all_places_have_one():
    start = beam(3e4, 3e4)
    everywhere = [f"{i + 1}:X" for i in range(5)]
    (found,) = find_alternatives(*fitted(start, everywhere, (Rival(np.log([0.7, 1.5]), 0.0),)))
    assert (found.sensor, found.difference) == ("", 0.0)


def test_a_fit_without_rivals_has_no_other_answers():
    assert find_alternatives(*fitted(beam(3e4, 3e4), ["3:X"], ())) == ()


VALUES = {"a.mass": 1.0, "b.mass": 2.0, "c.mass": 3.0}
STD = {"a.mass": 0.1, "b.mass": 0.01, "c.mass": np.inf}


def other(**changes: float) -> Alternative:
    return Alternative(VALUES | {f"{name}.mass": value for name, value in changes.items()}, 1.0)


def test_unknowns_that_differ_by_more_than_three_standard_deviations_are_listed():
    found = find_differences(VALUES, STD, [other(a=1.4, b=2.1, c=90.0), other(a=0.8)])
    # b differs by 10 standard deviations, a by 6; c is not determined
    assert found == [("b.mass", [2.0, 2.1, 2.0]), ("a.mass", [1.0, 1.4, 0.8])]
    assert find_differences(VALUES, STD, [other(a=1.2, b=2.02)]) == []
    assert find_differences(VALUES, STD, []) == []


def test_answers_within_the_standard_deviations_are_no_others():
    near, far = other(a=1.2), other(a=1.4)
    assert select_distinct(VALUES, STD, [near, far]) == (far,)


# -- thresholds ------------------------------------------------------------------------------------
@pytest.mark.parametrize(("value", "named"), [(1.29, []), (1.31, ["a"])])
def test_answers_differ_from_three_standard_deviations(value, named):
    found = find_differences({"a": 1.0}, {"a": 0.1}, [Alternative({"a": value}, 1.0)])
    assert [name for name, _ in found] == named


@pytest.mark.parametrize(("difference", "sensor"), [(0.09, ""), (0.11, "1:X")])
def test_a_sensor_distinguishes_answers_from_a_tenth(monkeypatch, difference, sensor):
    monkeypatch.setattr(
        "updyn.updating.judge.alternatives._find_largest_difference",
        lambda *about: (difference, "1:X"),
    )
    problem, fit = fitted(beam(3e4, 3e4), ["3:X"], (Rival(np.log([0.7, 1.5]), 0.5),))
    assert find_alternatives(problem, fit)[0].sensor == sensor
