"""A symmetric structure that is measured on its axis: its mirror image fits as well, and it is found and said."""

from __future__ import annotations

import numpy as np
import pytest

import updyn

FREQ = np.linspace(2.0, 60.0, 60)
TRUE = {"left.stiffness": 1.5, "right.stiffness": 0.7}
IMAGE = {"left.stiffness": 0.7, "right.stiffness": 1.5}


def between_walls() -> updyn.Model:
    """Three masses in a row between two springs to the walls that are alike by design."""
    ends, inner = np.zeros((2, 3, 3)), np.zeros((3, 3))
    ends[0, 0, 0] = ends[1, 2, 2] = 2e4
    for i in range(2):
        inner[i : i + 2, i : i + 2] += 4e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "left": updyn.Group(ends[0], np.zeros((3, 3)), loss_factor=0.02),
        "row": updyn.Group(inner, np.eye(3), loss_factor=0.01),
        "right": updyn.Group(ends[1], np.zeros((3, 3)), loss_factor=0.02),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"], title="between walls")


def measured(responses: list[str], seed: int) -> updyn.FRF:
    """What the sensors read of unlike springs, with a force on the axis and 1 % noise."""
    true = between_walls().scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    clean = updyn.response(true, FREQ, responses, ["2:X"])
    draw = np.random.default_rng(seed).standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1]) / np.sqrt(2.0))
    return updyn.FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)


def update(frf: updyn.FRF) -> updyn.UpdateResult:
    start = between_walls()
    return updyn.update(start, frf, updyn.parameters(start, stiffness=["left", "right"]))


def deviations(values: dict[str, float], truth: dict[str, float], std: dict[str, float]) -> float:
    return max(abs(values[name] - truth[name]) / std[name] for name in truth)


@pytest.fixture(scope="module", params=[0, 1, 2])
def on_the_axis(request: pytest.FixtureRequest) -> updyn.UpdateResult:
    return update(measured(["2:X"], request.param))


def test_the_status_says_that_the_answer_is_one_of_two(on_the_axis):
    assert on_the_axis.status == "not-identifiable"
    assert not on_the_axis.ok
    # near each answer the data determine both springs
    assert on_the_axis.identifiability.complete
    assert "2 answers fit the data equally well" in on_the_axis.message
    for name in TRUE:
        assert name in on_the_axis.message


def test_truth_and_mirror_image_are_the_two_answers(on_the_axis):
    (other,) = on_the_axis.alternatives
    answers = [on_the_axis.values, other.values]
    if answers[0]["left.stiffness"] < 1.0:
        answers.reverse()
    # The standard deviations of the two springs change places with their values.
    widest = dict.fromkeys(TRUE, max(on_the_axis.std.values()))
    for values, expected in zip(answers, (TRUE, IMAGE), strict=True):
        assert deviations(values, expected, widest) < 3.0
    assert other.odds == pytest.approx(1.0, abs=1e-3)


def test_the_remedy_names_a_sensor_off_the_axis_and_it_settles_the_matter(on_the_axis):
    (other,) = on_the_axis.alternatives
    assert other.sensor in ("1:X", "3:X")
    assert on_the_axis.remedy.startswith(f"A sensor at {other.sensor} would distinguish them")
    there = update(measured(["2:X", other.sensor], seed=7))
    assert there.status == "converged"
    assert there.alternatives == ()
    assert deviations(there.values, TRUE, there.std) < 3.0


def test_a_spring_that_is_known_settles_it_too():
    """The other cure that is named: one of the unknowns held at its value."""
    start = between_walls().scaled({"left": {"stiffness": 1.5}})
    found = updyn.update(start, measured(["2:X"], 0), updyn.parameters(start, stiffness="right"))
    assert found.status == "converged"
    assert deviations(found.values, {"right.stiffness": 0.7}, found.std) < 3.0


def test_an_unknown_that_nothing_sees_is_said_beside_the_two_answers():
    """A mass apart from the others, on a spring of its own: the data determine two of three unknowns."""
    groups = {}
    for name, group in between_walls().groups.items():
        K, M = np.zeros((2, 4, 4))
        K[:3, :3], M[:3, :3] = group.stiffness.toarray(), group.mass.toarray()
        groups[name] = updyn.Group(K, M, group.loss_factor)
    groups["aside"] = updyn.Group(np.diag([0.0, 0.0, 0.0, 3e4]), np.diag([0.0, 0.0, 0.0, 1.0]))
    start = updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X", "4:X"])
    unknowns = updyn.parameters(start, stiffness=["left", "right", "aside"])
    found = updyn.update(start, measured(["2:X"], 0), unknowns)
    assert (found.status, found.identifiability.rank) == ("not-identifiable", 2)
    (other,) = found.alternatives
    assert other.values["left.stiffness"] == pytest.approx(
        found.values["right.stiffness"], rel=1e-3
    )
    # both causes are named, and what helps against each
    assert "the data determine only 2 of 3 unknowns: aside.stiffness" in found.message
    assert "2 answers fit the data equally well" in found.message
    assert f"A sensor at {other.sensor} would distinguish them" in found.remedy
    assert found.identifiability.advice in found.remedy


def test_several_tests_that_leave_the_answer_open_together_say_it():
    start = between_walls()
    tests = [updyn.Test(start, measured(["2:X"], i), name) for i, name in enumerate("ab")]
    unknowns = updyn.parameters(start, stiffness=["left", "right"])
    found = updyn.update_jointly(tests, unknowns)
    assert found.status == "not-identifiable"
    (other,) = found.alternatives
    widest = dict.fromkeys(TRUE, max(found.std.values()))
    image = IMAGE if found.values["left.stiffness"] > 1.0 else TRUE
    assert deviations(other.values, image, widest) < 3.0
