"""The nonlinear element of a model in the loop of a servo."""

from __future__ import annotations

import numpy as np
import pytest
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


def test_what_cannot_be_opened() -> None:
    model = drivetrain(PARTS)
    with pytest.raises(ModelError, match="'mesh': not in the model; there is none"):
        updyn.open_element(model, "mesh")
    model = model.with_elements({"mesh": (updyn.Backlash(1e3, GAP), ["2:RZ", "1:RZ"])})
    with pytest.raises(ModelError, match=r"'mush': not in the model.*mesh"):
        updyn.open_element(model, "mush")
    with pytest.raises(OptionError, match="expected a Model or an UpdateResult, found str"):
        updyn.open_element("model.h5", "mesh")
