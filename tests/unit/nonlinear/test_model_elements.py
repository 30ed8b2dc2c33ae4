"""Nonlinear elements of a model: where they act, and linear methods that refuse them."""

from __future__ import annotations

import copy

import numpy as np
import pytest

import updyn
from updyn.elements.constraints import constrain, join
from updyn.errors import DofError, ModelError, OptionError

JOINT = updyn.JenkinsElement(stiffness=500.0, slip_force=2.0)


@pytest.fixture
def model() -> updyn.Model:
    parts = {
        "springs": updyn.Group(1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]]), loss_factor=0.02),
        "masses": updyn.Group(mass=np.eye(2)),
    }
    return updyn.Model.from_groups(parts, ["1:X", "2:X"])


@pytest.mark.parametrize(
    ("dofs", "column"),
    [
        ("2:X", [0.0, 1.0]),
        (["1:X"], [1.0, 0.0]),
        (["1:X", "2:X"], [1.0, -1.0]),
        (["1:X", "2:-X"], [1.0, 1.0]),
        ({"2:-X": 0.5, "1:X": 2.0}, [2.0, -0.5]),
    ],
)
def test_the_deformation_is_a_combination_of_dofs(model, dofs, column) -> None:
    local = model.with_elements({"joint": (JOINT, dofs)}).nonlinear["joint"]
    assert local.column(model.dofs).tolist() == column
    K = model.with_elements({"joint": (JOINT, dofs)}).linearised().stiffness.toarray()
    assert pytest.approx(model.stiffness.toarray() + 500.0 * np.outer(column, column)) == K


def test_changes_of_groups_keep_the_elements(model) -> None:
    model = model.with_elements({"joint": (JOINT, "2:X")})
    changed = (
        model.scaled({"springs": {"stiffness": 2.0}}),
        model.with_damping({"springs": {"loss_factor": 0.1}}),
        model.with_element("mass", ["1:X"], mass=1.0),
        model.merge_groups({"all": ["masses"]}),
        copy.deepcopy(model),
    )
    for other in changed:
        assert other.nonlinear == model.nonlinear
    assert not model.linearised().nonlinear
    assert "nonlinear: joint" in repr(model)
    assert "joint" in model._repr_html_()


def test_elements_without_stiffness_at_rest_add_no_group(model) -> None:
    cubic = model.with_elements({"stop": (updyn.CubicSpring(1e9), ["1:X", "2:X"])})
    assert list(cubic.linearised().groups) == list(model.groups)


def test_linear_methods_refuse_the_model(model, tmp_path) -> None:
    model = model.with_elements({"joint": (JOINT, "2:X")})
    calls = (
        lambda: updyn.response(model, [1.0], ["1:X"], ["1:X"]),
        lambda: updyn.modes(model, 1),
        lambda: updyn.condense(model, [1.0], ["1:X"]),
        lambda: updyn.write_model(model, tmp_path / "model.npz"),
        lambda: constrain(model, grounded=["1:X"]),
        lambda: join([model]),
        lambda: updyn.plant(model, ["1:X"], ["1:X"], (1.0, 20.0)),
    )
    for call in calls:
        with pytest.raises(ModelError, match=r"nonlinear elements \(joint\).*linearised"):
            call()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "element", "dofs", "error", "message"),
    [
        ("a", 5.0, "1:X", ModelError, "expected a nonlinear element such as CubicSpring, found f"),
        ("a", JOINT, ["1:X", "2:X", "3:X"], ModelError, "found 3"),
        ("a", JOINT, [], ModelError, "found 0"),
        ("a", JOINT, ["1:X", "1:X"], DofError, "DOF 1:X occurs twice"),
        ("a", JOINT, {}, ModelError, "at least one degree of freedom"),
        ("a", JOINT, {"1:X": 0.0}, ModelError, "all weights are 0"),
        ("a", JOINT, {"1:X": np.nan}, OptionError, "weight of 1:X is nan"),
        ("a", JOINT, "3:X", DofError, "nonlinear element 'a': DOF 3:X is not among the 2 DOFs"),
        ("a.b", JOINT, "1:X", ModelError, "nonlinear element name 'a.b' holds '.'"),
        ("springs", JOINT, "1:X", ModelError, "'springs': the name exists"),
    ],
)
def test_wrong_elements_are_refused(model, name, element, dofs, error, message) -> None:
    with pytest.raises(error) as found:
        model.with_elements({name: (element, dofs)})
    assert message in str(found.value)


@pytest.mark.parametrize(
    ("element", "units"),
    [
        (updyn.Backlash(1e6, 1e-4), {"stiffness": "N m/rad", "gap": "rad", "offset": "rad"}),
        (updyn.CoulombFriction(10.0, transition=0.1), {"level": "N m", "transition": "rad/s"}),
        (updyn.QuadraticDamper(2.0), {"coefficient": "N m s2/rad2"}),
        (updyn.PolynomialSpring({3: 1.0}), {"coefficients_3": "N m/rad^3"}),
    ],
)
def test_parameters_on_a_rotation_have_its_units(element, units) -> None:
    """Unknowns of an element between two rotations, and the same one between displacements."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    for axis, expected in (("RZ", units), ("X", {})):
        groups = {"k": updyn.Group(K), "m": updyn.Group(mass=np.eye(2))}
        ends = [f"1:{axis}", f"2:{axis}"]
        model = updyn.Model.from_groups(groups, ends).with_elements({"mesh": (element, ends)})
        bounds = {"mesh.*": (-1.0, 1e7)}
        unknowns = updyn.parameters(model, nonlinear="mesh", bounds=bounds)
        for unknown in unknowns:
            if axis == "RZ":
                assert unknown.unit == expected[unknown.quantity]
            else:
                assert "rad" not in unknown.unit


def test_a_rotation_that_a_weight_may_convert_has_both_units() -> None:
    """A weight other than 1 is a ratio of rotations, or a radius in m."""
    groups = {"k": updyn.Group(np.eye(2)), "m": updyn.Group(mass=np.eye(2))}
    model = updyn.Model.from_groups(groups, ["1:RZ", "2:RZ"])
    mesh = (updyn.Backlash(1e6, 1e-4), {"1:RZ": 1.0, "2:RZ": -2.0})
    unknowns = updyn.parameters(model.with_elements({"mesh": mesh}), nonlinear="mesh.gap")
    assert [unknown.unit for unknown in unknowns] == ["m or rad"]
