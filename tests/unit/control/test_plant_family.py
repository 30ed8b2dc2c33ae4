"""Families of plants: resonances where the drawn stiffness puts them, draws as the covariance says, wherever made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.control.family import PlantFamily, plant_family
from updyn.control.shared import SharedPlantBasis
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.reduction import Reduction
from updyn.errors import ModelError, OptionError, SolverError
from updyn.uncertainty.draws import Draws
from updyn.updating.result import JointResult, UpdateResult

MOTOR, LOAD, STIFFNESS = 0.5, 2.0, 1e4
PORTS = {"inputs": "1:RZ", "outputs": ["1:RZ", "2:RZ"], "band": (2.0, 80.0), "error": "peak"}


def free_drive() -> updyn.Model:
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {
        "rotors": updyn.Group(mass=np.diag([MOTOR, LOAD])),
        "shaft": updyn.Group(STIFFNESS * spring, loss_factor=0.02),
    }
    return updyn.Model.from_groups(groups, ["1:RZ", "2:RZ"])


def noisy(frf: updyn.FRF, relative: float) -> updyn.FRF:
    draw = np.random.default_rng(0).standard_normal((2, *frf.values.shape))
    return replace(frf, values=frf.values * (1 + relative * (draw[0] + 1j * draw[1]) / np.sqrt(2)))


@pytest.fixture(scope="module")
def fit() -> UpdateResult:
    true = free_drive().scaled({"shaft": {"stiffness": 1.2, "loss_factor": 0.03}})
    frf = noisy(updyn.response(true, np.linspace(5.0, 50.0, 60), ["1:RZ", "2:RZ"], ["1:RZ"]), 0.05)
    unknowns = updyn.parameters(free_drive(), stiffness=["shaft"], loss_factor=["shaft"])
    return updyn.update(free_drive(), frf, unknowns, noise={"relative": 0.05}, starts=0)


@pytest.fixture(scope="module")
def unsure(fit) -> UpdateResult:
    """The same with 10 and 20 % of deviation, and a correlation of a half."""
    at = np.array([fit.values["shaft.stiffness"], fit.values["shaft.loss_factor"]])
    std = at * [0.1, 0.2]
    covariance = np.outer(std, std) * [[1.0, 0.5], [0.5, 1.0]]
    return replace(
        fit, covariance=covariance, std=dict(zip(fit.parameters.names, std, strict=True))
    )


@pytest.fixture(scope="module")
def family(unsure) -> PlantFamily:
    return plant_family(unsure, **PORTS, n=6)


def resonance(factor: float) -> float:
    return float(np.sqrt(factor * STIFFNESS * (1 / MOTOR + 1 / LOAD)) / (2 * np.pi))


def test_each_resonance_is_where_its_stiffness_puts_it(fit, family) -> None:
    assert family.names == ("shaft.stiffness", "shaft.loss_factor")
    assert family.nominal.modes == pytest.approx(
        [0.0, resonance(fit.values["shaft.stiffness"])], rel=1e-9
    )
    for member, (factor, loss) in zip(family.members, family.values, strict=True):
        assert member.modes == pytest.approx([0.0, resonance(factor)], rel=1e-9)
        pole = member.poles[np.argmax(member.poles.imag)]
        assert abs(pole) == pytest.approx(2 * np.pi * resonance(factor), rel=1e-3)
        assert -pole.real / abs(pole) == pytest.approx(loss / 2, rel=1e-3)
    assert np.ptp(family.values[:, 0]) > 0.05


def test_rational_members_have_the_poles_of_their_own_models(unsure) -> None:
    found = plant_family(unsure, **{**PORTS, "error": "relative", "route": "rational"}, n=6)
    assert {p.n_states for p in found.members} == {found.nominal.n_states}
    for member, (factor, _) in zip(found.members, found.values, strict=True):
        own = np.abs(member.poles / (2 * np.pi * resonance(factor)))
        assert np.abs(own - 1.0).min() < 2e-3
        assert member.relative_error <= 0.02


def test_each_member_answers_as_its_own_model(unsure, family) -> None:
    freq = np.linspace(2.0, 80.0, 301)
    G = family.response(freq)
    for own, member, values in zip(G, family.members, family.values, strict=True):
        model = unsure.parameters.apply(unsure.start, values)
        exact = updyn.response(model, freq, ["1:RZ", "2:RZ"], ["1:RZ"]).values
        assert (np.abs(own - exact) / np.abs(exact).max(axis=0)).max() <= 1.05 * max(
            member.error, 1e-6
        )
        assert member.error <= 0.02
        assert (member.route, member.tolerance) == (family.nominal.route, 0.02)
        assert (member.inputs, member.outputs) == (family.inputs, family.outputs)
    assert family.error == max(p.error for p in (family.nominal, *family.members))
    nominal = updyn.response(unsure.model, freq, ["1:RZ", "2:RZ"], ["1:RZ"]).values
    np.testing.assert_allclose(
        family.nominal.response(freq).values, nominal, atol=0.02 * np.abs(nominal).max(axis=0).min()
    )


def test_the_words(family) -> None:
    text = family.summary()
    assert text.startswith("Family: 6 members of 2 unknowns, covariance")
    low, high = (resonance(f(family.values[:, 0])) for f in (np.min, np.max))
    assert text.splitlines()[-1].split() == [
        "2",
        *(f"{f:.6g}" for f in (family.nominal.modes[1], low, high)),
    ]
    fewer = replace(family.members[0], modes=family.members[0].modes[:1])
    mixed = replace(
        family,
        members=(fewer, *family.members[1:]),
        facts={"cut": {"a.loss_factor": 0.5}, "note": "So."},
    )
    assert (
        "The plants have 4 states.\n50 % of the draws of a.loss_factor lie on its bound.\nSo."
        in mixed.summary()
    )


def test_draws_are_as_the_covariance_says(unsure, monkeypatch) -> None:
    """Log-normal in the factor, normal in the loss factor: 4000 draws without their plants."""
    nominal = plant_family(unsure, **PORTS, n=1).nominal
    monkeypatch.setattr(SharedPlantBasis, "member", lambda *about: (nominal, None))
    found = plant_family(unsure, **PORTS, n=4000, seed=1)
    at = [unsure.values[name] for name in found.names]
    x = np.column_stack([np.log(found.values[:, 0] / at[0]), found.values[:, 1] / at[1] - 1.0])
    assert x.mean(axis=0) == pytest.approx([0.0, 0.0], abs=4 * 0.2 / np.sqrt(4000))
    assert x.std(axis=0) == pytest.approx([0.1, 0.2], rel=0.05)
    assert np.corrcoef(x.T)[0, 1] == pytest.approx(0.5, abs=0.05)
    assert found.facts["source"] == "covariance"
    assert found.facts["cut"] == {}


def test_what_falls_below_zero_is_put_on_it(unsure, monkeypatch) -> None:
    nominal = plant_family(unsure, **PORTS, n=1).nominal
    monkeypatch.setattr(SharedPlantBasis, "member", lambda *about: (nominal, None))
    covariance = unsure.covariance.copy()
    covariance[1, 1] = (2.0 * unsure.values["shaft.loss_factor"]) ** 2
    found = plant_family(replace(unsure, covariance=covariance), **PORTS, n=2000)
    zero = found.values[:, 1] == 0.0
    # A Gaussian is below its mean by half its deviation in 31 % of its draws.
    assert zero.mean() == pytest.approx(0.3085, abs=0.04)
    assert found.facts["cut"] == {"shaft.loss_factor": zero.mean()}


def test_the_same_wherever_made_and_however_many(unsure, family) -> None:
    fewer = plant_family(unsure, **PORTS, n=3, engine=2)
    np.testing.assert_array_equal(fewer.values, family.values[:3])
    for one, other in zip(fewer.members, family.members, strict=False):
        for name in "ABCD":
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert not np.array_equal(plant_family(unsure, **PORTS, n=1, seed=1).values, family.values[:1])


def test_draws_of_a_bootstrap_are_thinned_evenly(fit) -> None:
    drawn = updyn.bootstrap(fit, 10)
    found = plant_family(fit, **PORTS, n=4, draws=drawn)
    np.testing.assert_array_equal(found.values, drawn.values[[0, 3, 6, 9]])
    assert found.facts["source"] == "bootstrap"
    with pytest.raises(OptionError, match="11 members of 10 draws"):
        plant_family(fit, **PORTS, n=11, draws=drawn)
    with pytest.raises(OptionError, match="another update"):
        plant_family(fit, **PORTS, draws=replace(drawn, estimate=2 * drawn.estimate))
    with pytest.raises(OptionError, match="expected draws of a bootstrap"):
        plant_family(fit, **PORTS, draws=drawn.values)


def in_series() -> UpdateResult:
    """The DOF between two springs is not measured: only the sum of their compliances is known."""
    groups = {
        "a": updyn.Group(np.array([[3000.0, 0.0], [0.0, 0.0]]), loss_factor=0.02),
        "b": updyn.Group(
            1500.0 * np.array([[1.0, -1.0], [-1.0, 1.0]]), np.diag([0.0, 2.0]), loss_factor=0.02
        ),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    frf = noisy(updyn.response(model, np.linspace(1.0, 6.0, 30), ["2:X"], ["2:X"]), 0.01)
    unknowns = updyn.parameters(model, stiffness="all", bounds={"stiffness": (0.2, 5.0)})
    return updyn.update(model, frf, unknowns, noise={"relative": 0.01}, starts=0)


def test_what_the_data_leave_open_is_refused_unless_draws_are_given() -> None:
    result = in_series()
    about = {"inputs": "2:X", "outputs": "2:X", "band": (1.0, 6.0)}
    with pytest.raises(OptionError, match=r"do not determine a\.stiffness, b\.stiffness") as error:
        plant_family(result, **about)
    assert result.identifiability.advice in str(error.value)
    estimate = np.array([result.values[n] for n in result.parameters.names])
    away = np.array([[[0.0, 0.0], [0.1, -0.05], [-0.1, 0.06]]])
    drawn = Draws(
        "sampling", tuple(result.parameters.names), estimate + away, estimate,
        np.full(2, np.inf), result.parameters.lower, result.parameters.upper, np.ones(2, dtype=bool), message="Three.",
    )  # fmt: skip
    found = plant_family(result, **about, n=3, draws=drawn)
    compliance = (1 / (3000.0 * found.values[:, 0]) + 1 / (1500.0 * found.values[:, 1])) ** -1
    for member, k in zip(found.members, compliance, strict=True):
        assert member.modes[0] == pytest.approx(np.sqrt(k / 2.0) / (2 * np.pi), rel=1e-9)
    assert found.facts["note"] == "Three."


def test_of_several_tests_one_is_named(unsure, family) -> None:
    joint = JointResult({"free": unsure, "locked": unsure})
    with pytest.raises(OptionError, match=r"test = 'fre': .*did you mean 'free'"):
        plant_family(joint, **PORTS, test="fre")
    found = plant_family(joint, **PORTS, n=2, test="free")
    np.testing.assert_array_equal(found.values, family.values[:2])
    with pytest.raises(OptionError, match="one test only"):
        plant_family(unsure, **PORTS, test="free")


def test_one_route_serves_all(unsure, monkeypatch) -> None:
    plain, asked = SharedPlantBasis.member, []

    def sometimes(shared, state, route, like=None):
        asked.append(route)
        if route == "modal" and len(asked) > 2:
            raise ModelError("no order holds the tolerance")
        return plain(shared, state, route, like)

    monkeypatch.setattr(SharedPlantBasis, "member", sometimes)
    found = plant_family(unsure, **PORTS, n=2)
    assert asked == ["auto", "modal", "modal", "complex", "complex", "complex"]
    assert (
        {p.route for p in (found.nominal, *found.members)} == {"complex"} == {found.facts["route"]}
    )
    asked.clear()
    with pytest.raises(
        ModelError, match=r"member 1 of the family \(shaft\.stiffness = .*\): no order holds"
    ):
        plant_family(unsure, **PORTS, n=2, route="modal")


def test_a_member_that_cannot_be_solved_is_named(unsure, monkeypatch) -> None:
    plain = SharedPlantBasis.member

    def sometimes(shared, state, route, like=None):
        if like is not None:
            raise SolverError("no finite answer at 3 Hz")
        return plain(shared, state, route, like)

    monkeypatch.setattr(SharedPlantBasis, "member", sometimes)
    with pytest.raises(
        SolverError,
        match=r"member 0 of the family \(.*, shaft\.loss_factor = 0\.0\d+\): no finite answer",
    ):
        plant_family(unsure, **PORTS, n=2)


def test_what_is_not_understood_is_refused(unsure) -> None:
    with pytest.raises(OptionError, match="n = 0; expected a number of members"):
        plant_family(unsure, **PORTS, n=0)
    with pytest.raises(OptionError, match="seed = -1"):
        plant_family(unsure, **PORTS, seed=-1)
    with pytest.raises(OptionError, match="band None; expected two frequencies"):
        plant_family(unsure, **PORTS | {"band": None})
    with pytest.raises(OptionError, match="expected the result of an update, found Model"):
        plant_family(unsure.model, **PORTS)
    with pytest.raises(OptionError, match="ended as 'failed', not at a minimum"):
        plant_family(replace(unsure, status="failed"), **PORTS)


# -- one basis for all ------------------------------------------------------------------------------
LONG = 340
ROW = {
    "inputs": "1:X",
    "outputs": ["1:X", f"{LONG}:X"],
    "band": (1.0, 40.0),
    "quantity": ["mobility", "receptance"],
}


def long_row() -> updyn.Model:
    """A row of masses, more than are taken as they are, in two halves, one end held."""
    near, far = np.zeros((LONG, LONG)), np.zeros((LONG, LONG))
    near[0, 0] = 1.0
    for i in range(LONG - 1):
        half = near if i < LONG // 2 else far
        half[i : i + 2, i : i + 2] += [[1.0, -1.0], [-1.0, 1.0]]
    groups = {
        "masses": updyn.Group(mass=np.eye(LONG)),
        "near": updyn.Group(4e8 * near, loss_factor=0.02),
        "far": updyn.Group(3e8 * far, loss_factor=0.05),
    }
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(LONG)])


@pytest.fixture(scope="module")
def long_fit() -> UpdateResult:
    """An update of the row whose deviations are made 3 % of stiffness, 10 % of loss factors."""
    model = long_row()
    frf = noisy(updyn.response(model, np.linspace(2.0, 30.0, 20), ["1:X"], ["1:X"]), 0.01)
    unknowns = updyn.parameters(model, stiffness=["near", "far"], loss_factor=["far"])
    fit = updyn.update(model, frf, unknowns, noise={"relative": 0.01}, starts=0)
    std = np.array([fit.values[n] for n in fit.parameters.names]) * [0.03, 0.03, 0.1]
    return replace(
        fit,
        covariance=np.diag(std**2),
        std=dict(zip(fit.parameters.names, std, strict=True)),
    )


@pytest.mark.parametrize("error", ["peak", "relative"])
def test_one_basis_serves_all_members(long_fit, monkeypatch, error) -> None:
    """Each member answers as its model does, and as the plant that is made of it alone."""
    built, plain = [], Reduction.build

    def counted(reduction, state):
        built.append(state)
        return plain(reduction, state)

    monkeypatch.setattr(Reduction, "build", counted)
    found = plant_family(long_fit, **ROW, error=error, n=3)
    assert len(built) == 1
    freq = np.linspace(1.0, 40.0, 400)
    for member, values in zip(found.members, found.values, strict=True):
        assert "one basis for all" in member.facts["basis"]
        stated = member.relative_error if error == "relative" else member.error
        assert stated <= 0.02
        model = long_fit.parameters.apply(long_fit.start, values)
        exact = updyn.response(model, freq, ["1:X", f"{LONG}:X"], ["1:X"], tier="sparse").values
        exact = exact * np.stack([2j * np.pi * freq, np.ones(len(freq))], axis=1)[:, :, None]
        alone = updyn.plant(model, **ROW, error=error, route=found.facts["route"])
        level = np.abs(exact).max(axis=0)
        for other in (exact, alone.response(freq).values):
            off = np.abs(member.response(freq).values - other)
            assert (off / level).max() <= 2 * 0.02
        assert (np.abs(member.response(freq).values - exact) / level).max() <= 1.05 * max(
            member.error, 1e-6
        )


def test_a_member_at_which_the_basis_does_not_hold_is_made_alone(long_fit, monkeypatch) -> None:
    plain = Reduction.residual_errors

    def bad(reduction, states, freq):
        return np.maximum(plain(reduction, states, freq), [0.0, 1.0])

    expected = plant_family(long_fit, **ROW, error="peak", n=2)
    monkeypatch.setattr(Reduction, "residual_errors", bad)
    found = plant_family(long_fit, **ROW, error="peak", n=2)
    assert ["one basis for all" in m.facts["basis"] for m in found.members] == [True, False]
    freq = np.linspace(1.0, 40.0, 200)
    level = np.abs(expected.response(freq)).max(axis=1, keepdims=True)
    assert (np.abs(found.response(freq) - expected.response(freq)) / level).max() <= 0.02


def test_what_a_basis_lacks_is_about_its_error(long_fit) -> None:
    """The estimate by residuals bounds the difference to the whole model, and is not far off."""
    model = long_row()
    system = AffineSystem.compile(model)
    reduction = Reduction(
        system, np.array([0, LONG - 1]), np.array([0]), (1.0, 40.0), "superlu", 1e-4
    )
    reduction.build(system.start)
    reduction.basis = reduction.basis.take_leading(8)
    other = replace(system.start, factor=system.start.factor * [1.0, 1.1, 0.9])
    line = np.array([40.0])
    (said,) = reduction.residual_errors([other], line)
    changed = model.scaled({"near": {"stiffness": 1.1}, "far": {"stiffness": 0.9}})
    solver = reduction.solver()
    q = solver.solve(system.coefficients(other, 2 * np.pi * line), np.array([0]), line)
    H = solver.at(q, np.array([0, LONG - 1]))[:, 0, 0]
    exact = updyn.response(changed, line, ["1:X", f"{LONG}:X"], ["1:X"], tier="sparse").values[
        0, :, 0
    ]
    off = np.abs(H - exact).max() / np.abs(exact).max()
    assert off <= said <= 100 * off + 1e-12
    reduction.enrich([other, other], line)
    assert reduction.residual_errors([other], line)[0] <= 0.1 * said
