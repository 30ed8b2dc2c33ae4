"""One unknown for several groups: laws, derivatives against differences, a plate's thickness found again."""

import numpy as np
import pytest

import updyn
from updyn import sensitivity
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.fields import LineSolver
from updyn.errors import ParameterError
from updyn.sensitivity import Unknowns

RNG = np.random.default_rng(3)
LABELS = [f"{i}:Z" for i in range(1, 7)]


def spd() -> np.ndarray:
    A = RNG.standard_normal((6, 6))
    return A @ A.T + 6.0 * np.eye(6)


@pytest.fixture(scope="module")
def model() -> updyn.Model:
    groups = {
        "membrane": updyn.Group(900.0 * spd(), None, 0.02),
        "bending": updyn.Group(400.0 * spd(), None, 0.02),
        "skin": updyn.Group(None, spd(), 0.0, 3.0 * spd()),
        "left": updyn.Group(200.0 * spd(), None, 0.05),
        "right": updyn.Group(300.0 * spd(), None, 0.05),
    }
    return updyn.Model.from_groups(groups, LABELS)


def thickness(model: updyn.Model) -> updyn.updating.problem.parameters.ParameterSet:
    return updyn.link(
        model,
        "dish.thickness",
        {"membrane.stiffness": 1, "bending.stiffness": 3, "skin.mass": 1},
        nominal=0.002,
        unit="m",
    )


def everything(model: updyn.Model):
    pair = updyn.link(model, "sides.stiffness", ["left.stiffness", "right.stiffness"])
    losses = updyn.link(model, "sides.loss", ["left.loss_factor", "right.loss_factor"])
    modulus = updyn.link(model, "dish.E", {"membrane.stiffness": 1, "bending.stiffness": 1})
    return thickness(model) + pair + losses + modulus + updyn.parameters(model, viscous="skin")


def test_the_laws(model: updyn.Model) -> None:
    unknowns = everything(model)
    assert unknowns.names == [
        "dish.thickness",
        "sides.stiffness",
        "sides.loss",
        "dish.E",
        "skin.viscous",
    ]
    assert unknowns.is_factor.tolist() == [True, True, False, True, True]
    changed = unknowns.changes([1.1, 0.8, 0.07, 0.9, 2.0])
    assert changed["membrane"]["stiffness"] == pytest.approx(1.1 * 0.9, rel=1e-15)
    assert changed["bending"]["stiffness"] == pytest.approx(1.1**3 * 0.9, rel=1e-15)
    assert changed["skin"] == {"mass": pytest.approx(1.1), "viscous": 2.0}
    assert changed["left"] == changed["right"] == {"stiffness": 0.8, "loss_factor": 0.07}
    after = unknowns.apply(model, [1.1, 0.8, 0.07, 0.9, 2.0])
    ratio = after.group("bending").stiffness.toarray() / model.group("bending").stiffness.toarray()
    np.testing.assert_allclose(ratio, 1.1**3 * 0.9, rtol=1e-14)


@pytest.mark.parametrize("tier", ["dense", "sparse"])
def test_derivatives_equal_central_differences(model: updyn.Model, tier: str) -> None:
    unknowns = everything(model)
    solver = LineSolver.choose(AffineSystem.compile(model), tier)
    at, values = Unknowns.find(solver.system, unknowns), np.array([1.1, 0.8, 0.07, 0.9, 2.0])
    freq, rows, columns = np.array([1.0, 4.0, 9.0]), np.array([0, 2, 5]), np.array([1])
    motion = RNG.standard_normal((3, 3, 1)) + 1j * RNG.standard_normal((3, 3, 1))

    def both(v: np.ndarray, derivatives: bool = False):
        H = sensitivity.receptance(solver, at, v, freq, rows, columns, derivatives=derivatives)
        P = sensitivity.condensed_product(
            solver, at, v, freq, rows, motion, derivatives=derivatives
        )
        return H, P

    exact = both(values, derivatives=True)
    for i in range(len(unknowns)):
        step = np.zeros(5)
        step[i] = 1e-5
        for (plus, _), (minus, _), (_, slope) in zip(
            both(values + step), both(values - step), exact, strict=True
        ):
            np.testing.assert_allclose(
                slope[i], (plus - minus) / 2e-5, rtol=0, atol=1e-7 * np.abs(slope[i]).max()
            )


def test_a_thickness_is_found(model: updyn.Model) -> None:
    unknowns = thickness(model) + updyn.link(
        model, "sides.stiffness", ["left.stiffness", "right.stiffness"]
    )
    truth = unknowns.apply(model, [1.25, 0.7])
    data = updyn.response(truth, np.linspace(0.5, 12.0, 40), LABELS[:3], LABELS[:1])
    result = updyn.update(model, data, unknowns)
    assert result.ok, result.summary()
    assert result.values == pytest.approx(
        {"dish.thickness": 1.25, "sides.stiffness": 0.7}, rel=1e-8
    )


def test_globs_stand_for_what_is_there(model: updyn.Model) -> None:
    (p,) = updyn.link(model, "all.stiffness", ["*.stiffness"])
    assert [d.group for d in p.acts_on] == ["membrane", "bending", "left", "right"]
    assert (p.lower, p.upper) == (0.1, 10.0)


def test_what_does_not_fit_is_refused(model: updyn.Model) -> None:
    def refused(
        match: str, name: str = "a.b", drives: object = ("left.stiffness",), **options: object
    ) -> None:
        with pytest.raises(ParameterError, match=match):
            updyn.link(model, name, drives, **options)

    refused("name of two parts", name="thickness")
    refused("no 'lefd.stiffness'; .*'left.stiffness'", drives=["lefd.stiffness"])
    refused("the model has no", drives=["skin.stiffness"])
    refused("drives is empty", drives=[])
    refused("loss factors and on other", drives=["left.stiffness", "left.loss_factor"])
    refused("power 2; expected 1", drives={"left.loss_factor": 2})
    refused("power 0; expected", drives={"left.stiffness": 0})
    refused(
        r"start at \[0.02, 0.05\]; give start", drives=["left.loss_factor", "bending.loss_factor"]
    )
    refused("nominal -1", nominal=-1.0)
    refused("'left.stiffness' twice", drives={"left.stiffness": 1, "l*.stiffness": 1})
    with pytest.raises(ParameterError, match="set by two unknowns"):
        updyn.link(model, "a.loss", ["left.loss_factor"]) + updyn.parameters(
            model, loss_factor="left"
        )
