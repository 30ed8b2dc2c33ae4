"""FRFs under a random force in an update, and their derivatives."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError, SolverError
from updyn.updating.fit.equivalent import make_equivalent
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.random_forward import FixedRandomForward

FREQ = np.linspace(6.0, 30.0, 25)
#: A spectrum that falls near the first resonance, as that of a shaker.
SPECTRUM = np.array([[5.0, 0.3], [9.0, 0.3], [10.0, 0.03], [12.0, 0.3], [35.0, 0.1]])
ELEMENTS = {
    "cubic": updyn.CubicSpring(3e8),
    "polynomial": updyn.PolynomialSpring({1: 2e3, 2: 2e5, 3: 1e8}),
    "backlash": updyn.Backlash(1e4, 3e-4, offset=1e-4),
    "jenkins": updyn.JenkinsElement(5e3, 1.0),
    "iwan": updyn.IwanJoint(4.0, 5e3, -0.4, 0.3),
    "friction": updyn.CoulombFriction(0.5, transition=0.05),
    "damper": updyn.QuadraticDamper(30.0),
}


def build(*elements, ground: float = 1e4) -> updyn.Model:
    first, second = np.diag([ground, 0.0]), 1e4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "base": updyn.Group(first, loss_factor=0.03),
        "arm": updyn.Group(second, np.diag([0.0, 1.0]), viscous=1e-4 * second),
        "block": updyn.Group(mass=np.diag([1.0, 0.0])),
    }
    linear = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    places = {f"element {i}": (one, ["1:X", "2:X"]) for i, one in enumerate(elements)}
    return linear.with_elements(places)


def measure(model: updyn.Model, spectrum=SPECTRUM, freq=FREQ) -> updyn.FRF:
    ends = ["1:X", "2:-X"], ["2:-X", "1:X"]
    return updyn.response(
        model, freq, *ends, "accelerance", spectrum=spectrum, excitation="random"
    ).frf


@pytest.mark.parametrize("name", ["cubic", "jenkins", "damper"])
def test_forces_of_elements_change_the_responses_of_the_linear_model(name):
    model = build(ELEMENTS[name])
    frf = measure(model)
    part = FRFPart.build(model, frf, updyn.parameters(model, nonlinear="all"))
    z = part.forward.forces(part, part.coordinates.start)[:, 0] * [-1.0, 1.0]  # a force along 2:X
    ends = frf.responses, frf.references
    linear = updyn.response(replace(model, nonlinear={}), FREQ, *ends, "accelerance").values
    both = linear.sum(axis=2)  # the element is between both references, 2:-X is opposite
    expected = linear - both[:, :, None] * z[:, None]
    np.testing.assert_allclose(frf.values, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def build_part(*elements, ground: float = 1e4) -> FRFPart:
    model = build(*elements, ground=ground)
    bounds = {"element 0.offset": (-1e-3, 1e-3)} if "backlash" in str(elements[0]).lower() else None
    unknowns = updyn.parameters(
        model,
        stiffness="all" if ground else ["arm"],
        mass="all",
        loss_factor=["base"] if ground else [],
        viscous="all",
        nonlinear="all",
        bounds=bounds,
    )
    return FRFPart.build(model, measure(model), unknowns)


def check_derivatives(part: FRFPart, rtol: float) -> None:
    """Compare with central differences, by each parameter and in a direction of the others."""
    x, everything = part.coordinates.start, slice(0, part.n_lines)
    is_local = np.array([p.of_element for p in part.coordinates.parameters])
    linear = np.random.default_rng(0).uniform(0.5, 1.5, part.n) * ~is_local
    # Steps of 1e-4 of each value.
    size = np.abs(part.values(x)) / part.coordinates.slope(x)
    dH = part.block(x, everything, derivatives=True).dH
    for direction in np.vstack([np.eye(part.n)[is_local], linear]) * size:
        h = 1e-4 * direction
        high, low = (part.block(x + s * h, everything, derivatives=False).H for s in (1, -1))
        expected, found = (high - low) / 2e-4, np.tensordot(direction, dH, axes=(0, 0))
        np.testing.assert_allclose(found, expected, atol=rtol * np.abs(expected).max())


@pytest.mark.parametrize("name", ELEMENTS)
def test_responses_and_derivatives(name) -> None:
    part = build_part(ELEMENTS[name])
    found = part.responses(part.coordinates.start)
    np.testing.assert_allclose(found, part.frf.values, rtol=1e-5)
    check_derivatives(part, 1e-4)


def test_derivatives_with_several_elements() -> None:
    check_derivatives(build_part(*(ELEMENTS[name] for name in ("cubic", "damper"))), 1e-4)


def test_a_free_model_has_no_mean() -> None:
    part = build_part(ELEMENTS["cubic"], ground=0.0)
    np.testing.assert_allclose(part.responses(part.coordinates.start), part.frf.values, rtol=1e-5)
    check_derivatives(part, 1e-4)
    model = build(ELEMENTS["backlash"], ground=0.0)
    frf = replace(part.frf, values=part.frf.values)
    unknowns = updyn.parameters(model, stiffness=["arm"])
    with pytest.raises(SolverError):
        FRFPart.build(model, frf, unknowns).responses(np.zeros(1))


def test_a_part_of_the_lines_has_the_same_force() -> None:
    part = build_part(ELEMENTS["cubic"])
    few = part.with_data(part.frf.select(band=(8.0, 14.0)))
    every = part.responses(part.coordinates.start)[(FREQ >= 8.0) & (FREQ <= 14.0)]
    np.testing.assert_allclose(few.responses(part.coordinates.start), every, rtol=1e-12)


def test_workers_get_the_force() -> None:
    part = build_part(ELEMENTS["damper"])
    copy = pickle.loads(pickle.dumps(part))  # noqa: S301
    x = part.coordinates.start
    np.testing.assert_array_equal(copy.responses(x), part.responses(x))


@pytest.mark.parametrize("name", ["cubic", "jenkins", "friction"])
def test_the_equivalent_start_has_the_motion_of_the_data(name) -> None:
    """With all DOFs measured, its FRFs are nearly those of the data, from a wrong start, too."""
    part = build_part(ELEMENTS[name])
    fine = np.linspace(5.0, 35.0, 400)
    part = part.with_data(measure(build(ELEMENTS[name]), freq=fine))
    for x in (part.coordinates.start, part.coordinates.start + 0.1):
        (equivalent,) = make_equivalent(Problem.of([part]), x).parts
        assert isinstance(equivalent.forward, FixedRandomForward)
        _, sigma, _ = equivalent.forward.motion
        _, expected, _ = part.forward.spreads(part, part.coordinates.start)
        np.testing.assert_allclose(sigma, expected, rtol=0.02)
        everything = slice(0, 25)
        H = equivalent.block(x, everything, derivatives=True)
        direction = np.full(part.n, 1e-5)
        high, low = (
            equivalent.block(x + s * direction, everything, derivatives=False).H for s in (1, -1)
        )
        slope = np.einsum("p,pfij->fij", direction, H.dH)
        np.testing.assert_allclose(slope, (high - low) / 2, atol=1e-6 * np.abs(slope).max())


def test_lines_that_miss_the_resonances_do_not_state_the_motion() -> None:
    """The start then has the motion of the model."""
    part = build_part(ELEMENTS["cubic"])
    _, known = part.forward.measured(part.with_data(measure(build(ELEMENTS["cubic"]))))
    assert not known.any()
    x = part.coordinates.start
    (equivalent,) = make_equivalent(Problem.of([part]), x).parts
    np.testing.assert_allclose(equivalent.forward.motion, part.forward.spreads(part, x), rtol=1e-6)


@pytest.mark.parametrize(("change", "resolved"), [(0.09, True), (0.11, False)])
def test_every_other_line_changes_a_resolved_motion_by_less_than_a_tenth(change, resolved) -> None:
    """With motions of 1 and of b at lines in turn, the variances are 1 and (1 + b^2) / 2."""
    model, fine = build(ELEMENTS["cubic"]), np.linspace(20.0, 30.0, 2001)
    flat = np.array([[5.0, 0.1], [35.0, 0.1]])
    part = build_part(ELEMENTS["cubic"]).with_data(measure(model, flat, fine))
    between = np.sqrt(2.0 / (1.0 - change) ** 2 - 1.0)
    size = np.where(np.arange(len(fine)) % 2, between, 1.0)
    displacement = size[:, None, None] * np.array([[1.0, 1.0], [0.0, 0.0]])
    values = displacement * (2j * np.pi * fine[:, None, None]) ** 2
    data = replace(part.frf, values=values)
    _, known = part.forward.measured(part.with_data(data))
    assert known.all() == resolved


def test_a_window_is_refused() -> None:
    model = build(ELEMENTS["cubic"])
    with pytest.raises(DataError, match="no exponential window"):
        FRFPart.build(
            model, replace(measure(model), decay=1.0), updyn.parameters(model, stiffness=["base"])
        )


def test_an_update_to_two_random_levels_finds_the_elements() -> None:
    """Without noise it ends at the truth, and a sine test fits together with them."""
    model = build(ELEMENTS["cubic"], ELEMENTS["friction"])
    low, high = (measure(model, SPECTRUM * [1.0, share]) for share in (0.05, 3.0))
    sine = updyn.response(model, FREQ, ["1:X"], ["1:X"], "accelerance", level=0.5).frf
    start = model.scaled(
        {
            "base": {"stiffness": 1.2},
            "element 0": {"coefficient": 1e8},
            "element 1": {"level": 1.2},
        }
    )
    unknowns = updyn.parameters(
        start, stiffness=["base"], nonlinear=["element 0.coefficient", "element 1.level"]
    )
    result = updyn.update(
        start, [low, high, sine], unknowns, noise={"relative": 0.01, "floor": 1e-3}, starts=0
    )
    assert result.status == "converged"
    assert result.values["base.stiffness"] == pytest.approx(1 / 1.2, rel=1e-3)
    assert result.values["element 0.coefficient"] == pytest.approx(3e8, rel=0.01)
    assert result.values["element 1.level"] == pytest.approx(0.5, rel=0.01)
