"""Advice that works: what it says would determine the unknowns does so when it is followed."""

import re

import numpy as np
import pytest

import updyn
from updyn.updating.judge.advice import advise
from updyn.updating.judge.identifiability import analyse_identifiability
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError
from updyn.updating.update import identifiability

FOUR = [f"{i}:RZ" for i in range(1, 5)]
HZ = 2 * np.pi


def everything(model):
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


def gear_train_identifiability(model, omega, responses=FOUR, relative=1e-6):
    data = updyn.response(model, np.sort(omega) / HZ, responses, ["2:RZ"])
    return identifiability(model, data, everything(model), noise={"relative": relative})


def test_line_and_sensor_that_are_advised_cure_the_gear_train(gear_train):
    omega = np.array([10.0, 20.0, 50.0, 100.0])
    before = gear_train_identifiability(gear_train, omega)
    assert before.rank == 17
    line = re.search(r"Adding a line near ([\d.]+) Hz would determine all unknowns", before.advice)
    sensor = re.search(r"Adding a sensor at (\S+) would determine all unknowns", before.advice)
    assert gear_train_identifiability(gear_train, np.append(omega, HZ * float(line[1]))).rank == 18
    assert gear_train_identifiability(gear_train, omega, [*FOUR, sensor[1]]).rank == 18


def test_advice_under_noise_does_not_promise_too_much(gear_train):
    """At 5 % noise no single line gives four lines what 18 unknowns need; the advice must know."""
    omega = np.array([10.0, 20.0, 50.0, 100.0])
    found = gear_train_identifiability(gear_train, omega, relative=0.05)
    assert found.rank < 17
    for f in np.geomspace(0.7 * 10 / HZ, 1.5 * 100 / HZ, 12):
        assert (
            gear_train_identifiability(gear_train, np.append(omega, HZ * f), relative=0.05).rank
            < 18
        )
    assert found.advice.startswith(
        "No single further line or sensor on this model would determine all unknowns. Less"
    )
    assert f"Fix {18 - found.rank} of the unknowns" in found.advice


def springs_in_series(measured_middle=False):
    """Ground - a - 1 - b - 2, all mass at 2: only the series stiffness is seen unless DOF 1 is measured."""
    ka, kb = 3000.0, 1500.0
    a = updyn.Group([[ka, 0.0], [0.0, 0.0]], loss_factor=0.02)
    b = updyn.Group([[kb, -kb], [-kb, kb]], [[0.0, 0.0], [0.0, 2.0]], loss_factor=0.02)
    model = updyn.Model.from_groups({"a": a, "b": b}, ["1:X", "2:X"])
    responses = ["1:X", "2:X"] if measured_middle else ["2:X"]
    data = updyn.response(model, np.linspace(1.0, 6.0, 12), responses, ["2:X"])
    return model, data, updyn.parameters(model, stiffness="all")


def test_springs_in_series_are_cured_by_a_sensor_between_them_and_by_no_line():
    model, data, unknowns = springs_in_series()
    found = identifiability(model, data, unknowns, noise={"relative": 0.01})
    assert found.rank == 1
    # 1/k = 1/ka + 1/kb stays while d ln ka / ka = - d ln kb / kb: weights as ka to -kb, here 1 to
    # -0.5.
    (direction,) = found.null_directions
    assert direction["a.stiffness"] == pytest.approx(1.0)
    assert direction["b.stiffness"] == pytest.approx(-0.5, rel=1e-6)
    assert "Adding a sensor at 1:X would determine all unknowns" in found.advice
    assert "Adding a line" not in found.advice
    model, data, unknowns = springs_in_series(measured_middle=True)
    assert identifiability(model, data, unknowns, noise={"relative": 0.01}).rank == 2


def test_of_a_static_test_the_sensor_is_advised_at_its_only_line():
    """At 0 Hz the receptance at 2 is 1/ka + 1/kb; that at 1 by a force at 2 is 1/ka."""
    model, _, unknowns = springs_in_series()
    data = updyn.response(model, [0.0], ["2:X"], ["2:X"])
    found = identifiability(model, data, unknowns, noise={"relative": 0.01})
    assert found.rank == 1
    assert "Adding a sensor at 1:X would determine all unknowns" in found.advice
    data = updyn.response(model, [0.0], ["1:X", "2:X"], ["2:X"])
    assert identifiability(model, data, unknowns, noise={"relative": 0.01}).rank == 2


def test_unknown_that_nothing_sees_is_named_and_no_measurement_promised():
    """A part without connection to any force cannot be cured by lines or sensors."""
    a = updyn.Group(np.diag([900.0, 0.0]), np.diag([1.0, 0.0]), loss_factor=0.05)
    b = updyn.Group(np.diag([0.0, 500.0]), np.diag([0.0, 1.0]), loss_factor=0.05)
    model = updyn.Model.from_groups({"a": a, "b": b}, ["1:X", "2:X"])
    data = updyn.response(model, np.linspace(1.0, 9.0, 9), ["1:X"], ["1:X"])
    found = identifiability(
        model, data, updyn.parameters(model, stiffness="all"), noise={"relative": 0.001}
    )
    assert found.rank == 1
    assert found.null_directions == [{"b.stiffness": 1.0}]
    assert found.advice.startswith(
        "The data do not depend on b.stiffness. No single further line or sensor"
    )
    assert ". Fix 1 of the unknowns in the undetermined combination at known values" in found.advice


def test_accuracy_that_the_cure_needs_is_said(gear_train):
    found = gear_train_identifiability(gear_train, np.array([10.0, 20.0, 50.0, 100.0]))
    shares = [
        float(v) for v in re.findall(r"to 10 % if it is measured to ([\d.e-]+) %", found.advice)
    ]
    assert shares
    assert all(0 < s < 10 for s in shares)


def test_unknowns_that_are_hard_to_tell_apart(gear_train):
    """Full rank, but a collinearity index above 15: advice names the least certain."""
    data = updyn.response(gear_train, np.geomspace(5, 900, 20) / HZ, FOUR, ["2:RZ"])
    unknowns = everything(gear_train)
    problem = FRFPart.build(gear_train, data, unknowns)
    x = problem.coordinates.to_x(unknowns.start)
    local = OutputError(np.sqrt(2.0) / (0.01 * np.abs(data.values))).local(Problem.of([problem]), x)
    analysis = analyse_identifiability(local.R, unknowns.names)
    assert analysis.report.complete
    assert analysis.report.collinearity > 15
    worst = unknowns.names[int(np.argmax(np.diag(analysis.covariance)))]
    text = advise(analysis, Problem.of([problem]), x)
    assert "hard to distinguish" in text
    assert f"{worst} is the least certain" in text
    well = updyn.parameters(gear_train, stiffness=["unit 2"])
    problem = FRFPart.build(gear_train, data, well)
    local = OutputError(np.sqrt(2.0) / (0.01 * np.abs(data.values))).local(
        Problem.of([problem]), np.zeros(1)
    )
    assert (
        advise(analyse_identifiability(local.R, well.names), Problem.of([problem]), np.zeros(1))
        == ""
    )


# -- thresholds ------------------------------------------------------------------------------------
def advise_with(monkeypatch, change, noise=0.0):
    """Return the advice if the best line has a change, and no sensor has any."""
    place = "updyn.updating.judge.advice._find_best_"
    monkeypatch.setattr(f"{place}line", lambda *about: ("3 Hz", change))
    monkeypatch.setattr(f"{place}sensor", lambda *about: None)
    problem = Problem.of([FRFPart.build(*springs_in_series())])
    analysis = analyse_identifiability(np.array([[10.0, 10.0]]), ["a", "b"])
    return advise(analysis, problem, np.zeros(2), noise)


@pytest.mark.parametrize(("change", "is_advised"), [(0.9e-6, False), (1.1e-6, True)])
def test_a_line_is_advised_from_a_change_of_a_millionth(monkeypatch, change, is_advised):
    assert ("Adding a line near 3 Hz" in advise_with(monkeypatch, change)) is is_advised


@pytest.mark.parametrize(("noise", "is_advised"), [(0.9e-3, False), (1.1e-3, True)])
def test_less_noise_is_advised_from_a_thousandth(monkeypatch, noise, is_advised):
    assert ("Less noise" in advise_with(monkeypatch, 0.0, noise)) is is_advised
