"""The nonlinear element of a model in the loop of a servo."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats
from numpy.testing import assert_allclose

import updyn
from updyn.control.ports import Port
from updyn.elements.drivetrain import Inertia, Motor, Shaft, drivetrain
from updyn.errors import ModelError, OptionError

PARTS = [Motor("motor", 1, inertia=1.0), Inertia("load", 2, value=4.0)]
STIFFNESS, GAP = 4.0 * (2.0 * np.pi * 10.0) ** 2, 1e-3  # 10 Hz with the rotor locked


def make_plant(model: updyn.Model, port: Port) -> updyn.Plant:
    return updyn.plant(
        model,
        ["1:RZ", port],
        [Port.at("1:RZ", "speed"), "2:RZ", port],
        (0.5, 60.0),
        quantity=["mobility", "receptance", "receptance"],
    )


def test_an_element_gives_the_limit_cycle_of_an_opened_mesh_with_a_gap() -> None:
    shaft = drivetrain([*PARTS, Shaft("mesh", 1, 2, stiffness=STIFFNESS)])
    by_group = updyn.opened(shaft, "mesh", "2:RZ")
    element = updyn.Backlash(STIFFNESS, GAP)
    loose = drivetrain(PARTS).with_elements({"mesh": (element, ["2:RZ", "1:RZ"])})
    by_element = updyn.open_element(loose, "mesh")
    assert by_element.element == by_group.backlash(GAP)
    assert dict(by_element.port.weights) == pytest.approx(dict(by_group.port.weights))
    controller = updyn.Controller(60.0, ti=0.05, kv=16.0)
    at = {"torque": "1:RZ", "velocity": "speed", "position": "2:RZ"}
    cycles = [
        updyn.limit_cycles(make_plant(one.model, one.port), controller, element, "gap", **at)
        for one in (by_group, by_element)
    ]
    assert len(cycles[0]) > 0
    for one, other in zip(*cycles, strict=True):
        assert_allclose(
            [other.frequency, other.amplitude], [one.frequency, one.amplitude], rtol=1e-6
        )


def test_other_elements_stay() -> None:
    friction = updyn.CoulombFriction(0.3, transition=1e-3)
    elements = {"mesh": (updyn.Backlash(1e3, GAP), ["2:RZ", "1:RZ"]), "seal": (friction, "1:RZ")}
    model = drivetrain(PARTS).with_elements(elements)
    found = updyn.open_element(model, "mesh", name="play")
    assert list(found.model.nonlinear) == ["seal"]
    assert (found.port.name, found.element) == ("play", updyn.Backlash(1e3, GAP))


def loose_drive() -> updyn.Model:
    element = updyn.Backlash(STIFFNESS, GAP)
    return drivetrain(PARTS).with_elements({"mesh": (element, ["2:RZ", "1:RZ"])})


def test_intervals_of_a_cycle_follow_from_members() -> None:
    """The amplitude of a cycle is proportional to the gap, its frequency does not depend on it."""
    mesh = updyn.open_element(loose_drive(), "mesh")
    plant, controller = make_plant(mesh.model, mesh.port), updyn.Controller(60.0, ti=0.05, kv=16.0)
    at = {"torque": "1:RZ", "velocity": "speed", "position": "2:RZ"}
    z = 0.02 * np.random.default_rng(1).standard_normal(12)
    members = [(plant, updyn.Backlash(STIFFNESS, GAP * factor)) for factor in np.exp(z)]
    options = {"members": members, **at}
    for cycle in updyn.limit_cycles(plant, controller, mesh.element, "gap", **options):
        width = scipy.stats.t.ppf(0.975, 12) * np.sqrt(np.mean(z**2))
        expected = cycle.amplitude * np.exp([-width, width])
        assert_allclose(cycle.amplitude_interval, expected, rtol=1e-6)
        assert_allclose(cycle.frequency_interval, cycle.frequency, rtol=1e-6)
        assert cycle.share == 1.0
        assert "(95 %: " in str(cycle)
    # With a softer mesh, the loop is unstable and has no cycle.
    members = [members[0], (plant, updyn.Backlash(0.5 * STIFFNESS, GAP))]
    options = {"members": members, **at}
    (half,) = updyn.limit_cycles(plant, controller, mesh.element, "gap", **options)
    assert half.share == 0.5
    assert "(50 % of the members have it)" in str(half)


def test_members_are_draws_from_the_covariance() -> None:
    model = loose_drive()
    freq, ends = np.linspace(4.0, 30.0, 40), ["1:RZ", "2:RZ"]
    held = model.with_element("bearing", ["1:RZ"], stiffness=50.0, loss_factor=0.05)
    test = updyn.response(held, freq, ends, ends[:1], level=400.0).frf
    unknowns = updyn.parameters(held, nonlinear=["mesh.gap", "mesh.stiffness"])
    result = updyn.update(held, test, unknowns, noise={"relative": 0.01}, starts=0)
    mesh = updyn.open_element(result, "mesh", n=200)
    gap = np.log([one.element.gap for one in mesh.members])
    std = result.std["mesh.gap"] / result.values["mesh.gap"]
    assert np.std(gap) == pytest.approx(std, rel=0.15)
    assert np.mean(gap) == pytest.approx(np.log(mesh.element.gap), abs=0.3 * std)
    few = updyn.open_element(result, "mesh", n=3)
    assert [one.element for one in few.members] == [one.element for one in mesh.members[:3]]
    with pytest.raises(OptionError, match="members need an update"):
        updyn.open_element(model, "mesh", n=3)
    with pytest.raises(OptionError, match="n = -1; expected a number of members from 0 up"):
        updyn.open_element(result, "mesh", n=-1)


def test_what_cannot_be_opened() -> None:
    model = drivetrain(PARTS)
    with pytest.raises(ModelError, match="'mesh': not in the model; there is none"):
        updyn.open_element(model, "mesh")
    model = model.with_elements({"mesh": (updyn.Backlash(1e3, GAP), ["2:RZ", "1:RZ"])})
    with pytest.raises(ModelError, match=r"'mush': not in the model.*mesh"):
        updyn.open_element(model, "mush")
    with pytest.raises(OptionError, match="expected a Model or an UpdateResult, found str"):
        updyn.open_element("model.h5", "mesh")
