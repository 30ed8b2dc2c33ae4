"""Updates of linear and nonlinear unknowns to FRFs at several force levels."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError, ParameterError
from updyn.updating.update import identifiability

FREQ = np.linspace(0.7, 2.0, 27) / (2 * np.pi)
NOISE = {"relative": 0.01, "floor": 0.001}


def duffing(coefficient: float, stiffness: float = 1.0) -> updyn.Model:
    groups = {
        "spring": updyn.Group([[1.0]], viscous=[[0.1]]),
        "mass": updyn.Group(mass=[[1.0]]),
    }
    model = updyn.Model.from_groups(groups, ["1:X"])
    model = model.scaled({"spring": {"stiffness": stiffness}})
    return model.with_elements({"cube": (updyn.CubicSpring(coefficient), "1:X")})


def measure(model: updyn.Model, level: float, sweep: str, seed: int = 0) -> updyn.FRF:
    frf = updyn.response(model, FREQ, ["1:X"], ["1:X"], level=level, sweep=sweep).frf
    return add_noise(frf, seed)


def add_noise(frf: updyn.FRF, seed: int) -> updyn.FRF:
    draw = np.random.default_rng(seed).standard_normal((2, *frf.values.shape))
    size = np.sqrt((0.01 * np.abs(frf.values)) ** 2 + 1e-6 * np.mean(np.abs(frf.values) ** 2))
    return replace(frf, values=frf.values + size * (draw[0] + 1j * draw[1]) / np.sqrt(2))


@pytest.mark.parametrize(("factor", "sweep"), [(3.0, "up"), (1 / 3, "up"), (3.0, "down")])
def test_stiffness_and_coefficient_are_recovered_through_a_jump(factor, sweep) -> None:
    true = duffing(0.5, 1.3)
    data = [measure(true, F, sweep, seed) for seed, F in enumerate((0.05, 0.3))]
    jump = np.abs(np.diff(np.log(np.abs(data[1].values[:, 0, 0])))).max()
    assert jump > np.log(2.0)
    start = duffing(0.5 * factor)
    unknowns = updyn.parameters(start, stiffness="all", viscous="all", nonlinear=["cube.*"])
    result = updyn.update(start, data, unknowns, noise=NOISE, starts=0)
    assert result.status == "converged"
    wanted = {"spring.stiffness": 1.3, "spring.viscous": 1.0, "cube.coefficient": 0.5}
    for name, value in wanted.items():
        assert abs(result.values[name] - value) < 4.0 * result.std[name]
        assert result.std[name] < 0.05 * value
    assert list(result.results) == [f"level {F} N {sweep}" for F in (0.05, 0.3)]
    model = result.results[f"level 0.3 N {sweep}"].model
    assert model.nonlinear["cube"].element.coefficient == result.values["cube.coefficient"]


def test_a_low_level_alone_does_not_determine_the_coefficient() -> None:
    model = duffing(0.5)
    data = measure(model, 1e-4, "up").with_level(1e-7)
    unknowns = updyn.parameters(model, stiffness="all", nonlinear="all")
    found = identifiability(model, data, unknowns, noise=NOISE)
    assert found.rank == 1
    assert list(found.null_directions[0]) == ["cube.coefficient"]


def test_unknowns_of_elements_start_at_their_values() -> None:
    model = duffing(-0.5).with_elements({"joint": (updyn.JenkinsElement(4.0, 0.2), "1:X")})
    unknowns = updyn.parameters(model, nonlinear="all", prior_std={"joint.slip_force": 0.3})
    assert unknowns.names == ["cube.coefficient", "joint.stiffness", "joint.slip_force"]
    assert unknowns.start.tolist() == [-0.5, 4.0, 0.2]
    assert unknowns.lower.tolist() == [-50.0, 0.04, 0.002]
    assert unknowns.upper.tolist() == [-0.005, 400.0, 20.0]
    assert [p.value_unit for p in unknowns] == ["N/m^3", "N/m", "N"]
    chosen = updyn.parameters(model, nonlinear=["joint"], bounds={"joint.*": (0.1, 9.0)})
    assert chosen.names == ["joint.stiffness", "joint.slip_force"]
    assert chosen.upper.tolist() == [9.0, 9.0]
    changed = unknowns.apply(model, [-0.1, 3.0, 0.1])
    assert changed.nonlinear["joint"].element == updyn.JenkinsElement(3.0, 0.1)


def test_choices_of_elements_are_checked() -> None:
    model = duffing(0.5).with_elements({"stop": (updyn.Backlash(4.0, 0.2), "1:X")})
    with pytest.raises(ParameterError, match=r"no parameter 'cub' .*'cube"):
        updyn.parameters(model, nonlinear=["cub"])
    with pytest.raises(ParameterError, match=r"'stop.offset' starts at 0.*give its bounds"):
        updyn.parameters(model, nonlinear=["stop"])
    unknowns = updyn.parameters(model, nonlinear="stop", bounds={"stop.offset": (-0.1, 0.1)})
    assert unknowns.names == ["stop.stiffness", "stop.gap", "stop.offset"]


def test_methods_of_linear_models_are_refused() -> None:
    model = duffing(0.5)
    data = measure(model, 0.05, "up")
    unknowns = updyn.parameters(model, nonlinear="all")
    with pytest.raises(OptionError, match=r"fits linear models only.*cube.*'maximum-likelihood'"):
        updyn.update(model, data, unknowns, method="equation-error")


def test_an_update_needs_data() -> None:
    model = duffing(0.5)
    unknowns = updyn.parameters(model, nonlinear="all")
    with pytest.raises(OptionError, match="at least one FRF"):
        updyn.update(model, [], unknowns)


def measure_two_masses(coefficient: float) -> tuple[updyn.Model, list[updyn.FRF]]:
    """A linear model, and data at two levels of the same with a cubic spring."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    groups = {"springs": updyn.Group(K, loss_factor=0.03), "masses": updyn.Group(mass=np.eye(2))}
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    true = model.with_elements({"cube": (updyn.CubicSpring(coefficient), "1:X")})
    lines, ends = np.linspace(7.0, 14.0, 81), ["1:X", "2:X"]
    found = [updyn.response(true, lines, ends, ["2:X"], level=F).frf for F in (0.5, 4.0)]
    return model, [add_noise(frf, seed) for seed, frf in enumerate(found)]


@pytest.mark.parametrize(("coefficient", "is_credible"), [(2e7, False), (1e-3, True)])
def test_a_linear_model_of_a_structure_that_changes_with_the_level_is_refused(
    coefficient, is_credible
) -> None:
    model, data = measure_two_masses(coefficient)
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    tests = [updyn.Test(model, frf, name=f"{frf.level[0]} N", noise=NOISE) for frf in data]
    result = updyn.update_jointly(tests, unknowns, starts=0)
    assert (result.trust.plausible.holds is True) == is_credible
    assert ("The FRFs depend on the level from 0.5 to 4 N" in result.first.message) != is_credible
    advised = "Find the place and the kind" in str(result.first.remedy)
    assert advised != is_credible


def shaft(n: int, coefficient: float) -> updyn.Model:
    """A chain in two parts with a cubic spring in the middle, one end held."""
    groups = {}
    for name, own in (("near", range(n // 2)), ("far", range(n // 2, n))):
        K = np.zeros((n, n))
        for i in own:
            K[i, i] += 1e4
            if i:
                K[i - 1 : i + 1, i - 1 : i + 1] += [[1e4, -1e4], [-1e4, 0.0]]
        groups[name] = updyn.Group(K, loss_factor=0.02)
    groups["masses"] = updyn.Group(mass=np.eye(n))
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    ends = [f"{n // 2}:X", f"{n // 2 + 1}:X"]
    return model.with_elements({"cube": (updyn.CubicSpring(coefficient), ends)})


def test_a_reduced_model_gives_the_answer_of_the_whole_one() -> None:
    n = 40
    true = shaft(n, 1e6).scaled({"near": {"stiffness": 1.2}})
    lines = np.linspace(0.4, 1.6, 31)
    ends = [f"{n // 2}:X", f"{n}:X"]
    tests = [
        add_noise(updyn.response(true, lines, ends, [ends[1]], level=F).frf, seed)
        for seed, F in enumerate((1.0, 15.0))
    ]
    start = shaft(n, 3e5)
    unknowns = updyn.parameters(start, stiffness=["near", "far"], nonlinear="all")
    found = {
        tier: updyn.update(start, tests, unknowns, noise=NOISE, starts=0, tier=tier)
        for tier in ("dense", "reduced")
    }
    assert found["reduced"].first.options["tier"] == "reduced"
    assert found["reduced"].first.options["error"] < 1e-5
    for name, value in {"near.stiffness": 1.2, "cube.coefficient": 1e6}.items():
        whole, reduced = (found[tier].values[name] for tier in ("dense", "reduced"))
        std = found["dense"].std[name]
        assert std < 0.3 * value
        assert abs(whole - value) < 4.0 * std
        assert reduced == pytest.approx(whole, abs=0.05 * std)
        assert found["reduced"].std[name] == pytest.approx(std, rel=1e-2)
