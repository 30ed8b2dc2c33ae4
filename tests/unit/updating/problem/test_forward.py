"""Responses of models with nonlinear elements in an update, and their derivatives."""

import functools
import pickle
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, ModelError
from updyn.updating.problem.periodic_forward import EquivalentForward
from updyn.updating.problem.problem import FRFPart

FREQ = np.array([8.3, 9.6, 14.0, 25.7])
ELEMENTS = {
    "cubic": (updyn.CubicSpring(1e8), 1.0),
    "softening": (updyn.CubicSpring(-3e7), 1.0),
    "polynomial": (updyn.PolynomialSpring({1: 2e3, 3: 1e8, 5: 1e12}), 1.0),
    "backlash": (updyn.Backlash(1e4, 3e-4, offset=2e-5), 1.0),
    "jenkins": (updyn.JenkinsElement(5e3, 2.0), 3.0),
    "iwan": (updyn.IwanJoint(4.0, 5e3, -0.4, 0.3), 3.0),
    "friction": (updyn.CoulombFriction(0.5, transition=0.05), 3.0),
    "damper": (updyn.QuadraticDamper(30.0), 3.0),
}


def build(element) -> updyn.Model:
    first, second = 1e4 * np.diag([1.0, 0.0]), 1e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "base": updyn.Group(first, loss_factor=0.03),
        "arm": updyn.Group(second, np.diag([0.0, 1.0]), viscous=1e-4 * second),
        "block": updyn.Group(mass=np.diag([1.0, 0.0])),
    }
    linear = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    return linear.with_elements({"joint": (element, ["1:X", "2:X"])})


@functools.cache
def measure(name: str) -> updyn.FRF:
    element, F = ELEMENTS[name]
    ends = ["1:X", "2:-X"], ["2:-X", "1:X"]
    return updyn.response(build(element), FREQ, *ends, "accelerance", level=F, samples=256).frf


def build_part(name: str, quantity: str = "accelerance", level: bool = True) -> FRFPart:
    model, frf = build(ELEMENTS[name][0]), measure(name).converted(quantity)
    bounds = {"joint.offset": (-1e-3, 1e-3)} if name == "backlash" else None
    unknowns = updyn.parameters(
        model,
        stiffness="all",
        mass="all",
        loss_factor="all",
        viscous="all",
        nonlinear="all",
        bounds=bounds,
    )
    return FRFPart.build(model, frf if level else frf.with_level(None), unknowns)


def directions(part: FRFPart):
    """Return each parameter of the element, and one direction in all linear unknowns."""
    is_local = np.array([p.of_element for p in part.coordinates.parameters])
    linear = np.random.default_rng(0).uniform(0.5, 1.5, part.n) * ~is_local
    return np.vstack([np.eye(part.n)[is_local], linear])


def difference(part: FRFPart, x, direction, h: float = 1e-6):
    def at(x):
        return part.block(x, slice(0, len(FREQ)), derivatives=False).H

    return (at(x + h * direction) - at(x - h * direction)) / (2 * h)


@pytest.mark.parametrize("name", ELEMENTS)
def test_the_response_is_that_of_the_continuation(name) -> None:
    part = build_part(name)
    found = part.responses(part.coordinates.start)
    np.testing.assert_allclose(found, part.frf.values, atol=1e-4 * np.abs(part.frf.values).max())


@pytest.mark.parametrize("name", ELEMENTS)
@pytest.mark.parametrize("kind", ["periodic", "equivalent", "at rest"])
def test_derivatives_are_those_of_central_differences(name, kind) -> None:
    part = build_part(name, level=kind != "at rest")
    x = part.coordinates.start + 0.01
    if kind == "equivalent":
        local = part.forward.local
        amplitudes = part.forward.amplitudes(part, x)
        part = replace(part, forward=EquivalentForward(local, FREQ, amplitudes))
    block = part.block(x, slice(0, len(FREQ)))
    for direction in directions(part):
        wanted = difference(part, x, direction)
        found = np.einsum("p,pfij->fij", direction, block.dH)
        scale = np.abs(block.H).max() + np.abs(wanted).max()
        np.testing.assert_allclose(found / scale, wanted / scale, atol=1e-6)


@pytest.mark.parametrize("name", ["jenkins", "polynomial", "friction"])
def test_data_without_a_level_are_those_of_the_linearised_model(name) -> None:
    part = build_part(name, "mobility", level=False)
    model = build(ELEMENTS[name][0]).linearised()
    frf = part.frf
    wanted = updyn.response(model, FREQ, frf.responses, frf.references, "mobility").values
    found = part.responses(part.coordinates.start)
    np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_of_several_solutions_the_nearest_to_the_data_is_compared() -> None:
    # A Duffing oscillator with three solutions; unit mass and stiffness, damping 0.05.
    group = updyn.Group([[1.0]], [[1.0]], viscous=[[0.05]])
    model = updyn.Model.from_groups({"spring": group}, ["1:X"])
    model = model.with_elements({"cube": (updyn.CubicSpring(1.0), "1:X")})
    freq = np.linspace(0.8, 2.0, 61) / (2 * np.pi)
    unknowns = updyn.parameters(model, nonlinear="all")
    ends = {}
    for sweep in ("up", "down"):
        data = updyn.response(model, freq, ["1:X"], ["1:X"], level=0.3, sweep=sweep).frf
        part = FRFPart.build(model, data, unknowns)
        ends[sweep] = part.responses(part.coordinates.start)
        np.testing.assert_allclose(ends[sweep], data.values, rtol=1e-4)
    jumps = np.abs(ends["up"]) > 2.0 * np.abs(ends["down"])
    assert jumps.sum() > 5


def test_a_level_differs_from_line_to_line() -> None:
    part = build_part("cubic")
    model = build(ELEMENTS["cubic"][0])
    levels = np.linspace(0.2, 2.0, len(FREQ))
    each = [
        updyn.response(model, [f], part.frf.responses, part.frf.references, "accelerance", level=F)
        for f, F in zip(FREQ, levels, strict=True)
    ]
    values = np.concatenate([one.values for one in each])
    part = part.with_data(replace(part.frf, values=values, level=levels))
    np.testing.assert_allclose(part.responses(part.coordinates.start), values, rtol=1e-5)


def test_other_data_need_a_level() -> None:
    part = build_part("cubic")
    with pytest.raises(DataError, match="state the level of the data"):
        part.with_data(part.frf.with_level(None)).responses(part.coordinates.start)


def test_transmissibilities_are_refused() -> None:
    model = build(updyn.CubicSpring(1e8))
    data = updyn.FRF([5.0], [[[1.0]]], ["2:X"], ["1:X"], "transmissibility", base=["1:X"])
    with pytest.raises(DataError, match="a transmissibility does not state"):
        FRFPart.build(model, data, updyn.parameters(model, nonlinear="all"))


def test_a_copy_in_another_process_is_the_same() -> None:
    part = build_part("jenkins")
    copy = pickle.loads(pickle.dumps(part))  # noqa: S301
    x = part.coordinates.start
    np.testing.assert_array_equal(copy.responses(x), part.responses(x))


def test_parameters_of_elements_are_changed_by_name() -> None:
    model = build(updyn.PolynomialSpring({1: 2e3, 3: 1e8}))
    changed = model.scaled({"joint": {"coefficients_3": 2e8}, "arm": {"stiffness": 2.0}})
    assert dict(changed.nonlinear["joint"].element.coefficients) == {1: 2e3, 3: 2e8}
    assert changed.groups["arm"].stiffness[0, 0] == 2e4
    with pytest.raises(ModelError, match=r"no parameter 'coefficients_2'.*'coefficients_"):
        model.scaled({"joint": {"coefficients_2": 1.0}})


def test_a_response_remembers_the_branch_through_a_step_to_another_one():
    """A step to a softer base, on which the data's branch ends, must not change the response."""
    model = build(updyn.CubicSpring(1e8))
    freq, ends = np.linspace(5.0, 30.0, 60), ["1:X", "2:X"]
    frf = updyn.response(model, freq, ends, ["2:X"], level=5.0).frf
    part = FRFPart.build(model, frf, updyn.parameters(model, stiffness="base"))
    part = replace(part, forward=replace(part.forward, memory={}))
    x = part.coordinates.start

    def respond(change: float):
        return part.block(x + change, slice(0, len(freq)), derivatives=False).H

    start = respond(0.0)
    assert np.abs(respond(-0.2) - start).max() > 0.9 * np.abs(start).max()
    np.testing.assert_allclose(respond(0.0), start, rtol=0, atol=1e-6 * np.abs(start).max())
