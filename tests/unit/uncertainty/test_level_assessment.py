"""Information of each force level, and of further ones, against differences and other updates."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from updyn.uncertainty.settings import LEVEL_CANDIDATES

FREQ = np.linspace(9.0, 13.0, 33)
ENDS = ["1:X", "2:X"]
NOISE = {"relative": 0.01, "floor": 0.001}
LEVELS = (0.5, 2.0, 5.0)


def make_model(**changes: float) -> updyn.Model:
    """Two masses on springs with a slider between them, and its parameters."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    groups = {"springs": updyn.Group(K, loss_factor=0.03), "masses": updyn.Group(mass=np.eye(2))}
    model = updyn.Model.from_groups(groups, ENDS)
    joint = {"stiffness": 4e3, "slip_force": 2.0} | changes
    model = model.scaled({"springs": {"stiffness": joint.pop("springs", 1.0)}})
    return model.with_elements({"joint": (updyn.JenkinsElement(**joint), ENDS)})


def measure(model: updyn.Model, level: float) -> updyn.FRF:
    return updyn.response(model, FREQ, ENDS, ["2:X"], level=level).frf


def choose(model: updyn.Model, **options: object) -> updyn.ParameterSet:
    return updyn.parameters(model, stiffness=["springs"], nonlinear="all", **options)


def fit(levels: tuple[float, ...], **options: object) -> updyn.JointResult:
    """Return an update from the truth to data without noise, so that it ends where it begins."""
    model = make_model()
    data = [measure(model, F) for F in levels]
    return updyn.update(model, data, choose(model, **options), noise=NOISE, starts=0)


@pytest.fixture(scope="module")
def result() -> updyn.JointResult:
    return fit(LEVELS)


@pytest.fixture(scope="module")
def found(result) -> updyn.LevelAssessment:
    return updyn.assess_levels(result, [1.0, 20.0])


@cache
def difference_information(level: float) -> np.ndarray:
    """Return the information on the values by central differences of the responses."""
    values = {"springs": 1.0, "stiffness": 4e3, "slip_force": 2.0}
    J = []
    for name, value in values.items():
        step = 1e-4 * value
        ends = [measure(make_model(**{name: value + s * step}), level).values for s in (1, -1)]
        J.append((ends[0] - ends[1]).ravel() / (2.0 * step))
    H = 0.5 * (ends[0] + ends[1])
    rms = np.sqrt(np.mean(np.abs(H) ** 2))
    variance = (0.01 * np.abs(H)) ** 2 + (0.001 * rms) ** 2
    weighted = np.array(J) * np.sqrt(2.0 / variance).ravel()
    return np.asarray((weighted @ weighted.conj().T).real)


def spread(*levels: float) -> np.ndarray:
    total = sum(map(difference_information, levels))
    return np.sqrt(np.diag(np.linalg.solve(total, np.eye(3))))


def inflation(result: updyn.JointResult) -> float:
    """Return the factor on standard deviations; the residual is not noise but smooth rounding."""
    return float(result.first.noise["inflation"])


def as_array(std: dict[str, float]) -> np.ndarray:
    assert list(std) == ["springs.stiffness", "joint.stiffness", "joint.slip_force"]
    return np.array(list(std.values()))


def test_deviations_are_those_of_differences(result, found) -> None:
    unit, near = inflation(result), {"rtol": 0.01}
    np.testing.assert_allclose(as_array(found.std) / unit, spread(*LEVELS), **near)
    for one, others in zip(found.fitted, [(2.0, 5.0), (0.5, 5.0), (0.5, 2.0)], strict=True):
        np.testing.assert_allclose(as_array(one.without) / unit, spread(*others), **near)
    np.testing.assert_allclose(as_array(found.fitted[2].alone) / unit, spread(5.0), **near)
    of_candidate = as_array(found.candidates[1].std) / unit
    np.testing.assert_allclose(of_candidate, spread(*LEVELS, 20.0), **near)
    for candidate in found.candidates:
        std = as_array(candidate.std)
        smaller = 1.0 - np.exp(np.mean(np.log(std / as_array(found.std))))
        assert candidate.gain == pytest.approx(smaller)
        assert 0.02 < candidate.gain < 0.9


def test_deviations_are_those_of_updates_with_other_levels(result, found) -> None:
    np.testing.assert_allclose(as_array(found.std), as_array(result.std), rtol=1e-6)
    fewer, same = fit(LEVELS[:2]), {"rtol": 1e-4}
    of_update = as_array(fewer.std) / inflation(fewer)
    without = as_array(found.fitted[2].without) / inflation(result)
    np.testing.assert_allclose(without, of_update, **same)
    (added,) = updyn.assess_levels(fewer, [LEVELS[2]]).candidates
    of_update = as_array(result.std) / inflation(result)
    np.testing.assert_allclose(as_array(added.std) / inflation(fewer), of_update, **same)


def test_a_level_without_slip_does_not_determine_the_slip_force() -> None:
    low = fit((0.02, 0.05))
    assert np.isinf(low.std["joint.slip_force"])
    found = updyn.assess_levels(low, [0.03, 2.0])
    assert [one.determines for one in found.candidates] == [(), ("joint.slip_force",)]
    assert found.best is found.candidates[1]
    assert np.isinf(found.candidates[0].std["joint.slip_force"])
    assert found.candidates[1].std["joint.slip_force"] < 0.2
    assert "determines joint.slip_force" in found.summary()
    # All levels without slip are equally informative.
    assert found.candidates[0].gain == pytest.approx(1.0 - np.sqrt(2.0 / 3.0), rel=0.02)


def test_default_candidates_lie_about_the_levels(result) -> None:
    found = updyn.assess_levels(result)
    between = np.sqrt([0.5 * 2.0, 2.0 * 5.0])
    low, high = LEVEL_CANDIDATES.below * 0.5, LEVEL_CANDIDATES.above * 5.0
    wanted = [low, 0.5, between[0], 2.0, between[1], 5.0, high]
    assert [one.level for one in found.candidates] == pytest.approx(wanted)
    assert [one.is_repeat for one in found.candidates] == [False, True] * 3 + [False]
    nearest = [one.like for one in found.candidates]
    assert nearest[0] == nearest[1] == "level 0.5 N up"
    assert nearest[-1] == "level 5 N up"


def test_the_noise_of_a_candidate_may_be_stated(result, found) -> None:
    tiny = updyn.assess_levels(result, [1.0], noise={"relative": 1e-5, "floor": 1e-6})
    shares = as_array(tiny.candidates[0].std) / as_array(found.candidates[0].std)
    assert (shares < 0.01).all()


def test_priors_count() -> None:
    found = updyn.assess_levels(fit((0.02,), prior_std={"joint.slip_force": 0.3}), [2.0])
    (one,) = found.fitted
    assert found.std["joint.slip_force"] == pytest.approx(0.3 * 2.0, rel=1e-3)
    assert one.without["joint.slip_force"] == pytest.approx(0.3 * 2.0)
    assert np.isinf(one.without["springs.stiffness"])
    assert found.candidates[0].gain > 0.3


def test_the_tables_have_all_levels(found) -> None:
    frame = found.to_pandas()
    assert list(frame.index) == list(found.std)
    without = [f"without level {F:g} N up" for F in LEVELS]
    only = [f"only level {F:g} N up" for F in LEVELS]
    with_more = [f"with {F:g} N" for F in (1.0, 20.0)]
    assert list(frame.columns) == ["value", "std", *without, *only, *with_more, "unit"]
    assert frame["with 20 N"].tolist() == list(found.candidates[1].std.values())
    text = found.summary()
    assert "without level 0.5 N up" in text
    assert f"{found.std['joint.slip_force']:.3g}" in text
    assert f"Add a test at {found.best.level:g} N" in text
    assert "joint.slip_force" in found._repr_html_()
    assert repr(found) == "LevelAssessment(3 tests, 2 candidates, 3 unknowns)"


def test_large_models_are_reduced() -> None:
    n = 30
    chain = updyn.Model.from_groups(make_chain(n), [f"{i + 1}:X" for i in range(n)])
    ends = [f"{n // 2}:X", f"{n // 2 + 1}:X"]
    model = chain.with_elements({"joint": (updyn.CubicSpring(1e6), ends)})
    freq = np.linspace(0.4, 1.6, 25)
    data = [updyn.response(model, freq, ends, [f"{n}:X"], level=F).frf for F in (3.0, 8.0)]
    unknowns = updyn.parameters(model, stiffness=["chain"], nonlinear="all")
    found = []
    for tier in ("dense", "reduced"):
        fit = updyn.update(model, data, unknowns, noise=NOISE, starts=0, tier=tier)
        (candidate,) = updyn.assess_levels(fit, [16.0]).candidates
        found.append(np.array(list(candidate.std.values())) / inflation(fit))
    assert np.isfinite(found[0]).all()
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)


def make_chain(n: int) -> dict[str, updyn.Group]:
    K = 1e4 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = 1e4
    return {"chain": updyn.Group(K, loss_factor=0.02), "masses": updyn.Group(mass=np.eye(n))}


def test_linear_models_and_wrong_candidates_are_refused(result) -> None:
    model = make_model()
    linear = updyn.Model.from_groups(dict(model.groups), ENDS)
    frf = updyn.response(linear, FREQ, ENDS, ["2:X"]).with_level(1.0)
    unknowns = updyn.parameters(linear, stiffness=["springs"])
    with pytest.raises(OptionError, match=r"no nonlinear elements.*updyn\.plan"):
        updyn.assess_levels(updyn.update(linear, frf, unknowns, noise=NOISE, starts=0))
    with pytest.raises(OptionError, match=r"candidates: -1.*above 0"):
        updyn.assess_levels(result, [-1.0])
    with pytest.raises(OptionError, match="candidates: expected at least one"):
        updyn.assess_levels(result, [])
    with pytest.raises(OptionError, match="expected the result of an update"):
        updyn.assess_levels(model)


def test_a_random_test_predicts_random_levels() -> None:
    """The further test has the spectrum of the nearest one in level, scaled."""
    model = make_model()

    def measure_noise(level: float) -> updyn.FRF:
        options = {"level": level, "excitation": "random"}
        return updyn.response(model, FREQ, ENDS, ["2:X"], **options).frf

    def fit_noise(levels: tuple[float, ...]) -> updyn.JointResult:
        data = [measure_noise(level) for level in levels]
        return updyn.update(model, data, choose(model), noise=NOISE, starts=0)

    few, all_levels = fit_noise((0.5, 2.0)), fit_noise((0.5, 2.0, 5.0))
    (added,) = updyn.assess_levels(few, [5.0]).candidates
    of_update = as_array(all_levels.std) / inflation(all_levels)
    np.testing.assert_allclose(as_array(added.std) / inflation(few), of_update, rtol=1e-3)
