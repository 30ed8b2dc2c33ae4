"""Models too large for dense matrices: draws in a reduced model about the estimate, whose error is told."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from overriding import override
from uncertain_cases import noisy
from updyn.errors import SolverError
from updyn.uncertainty.minima import _exchange_parts
from updyn.uncertainty.restored import restore
from updyn.uncertainty.settings import PREDICTED_BAND
from updyn.uncertainty.surrogate import Surrogate, reduce_about

N = 60


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    """A chain of 60 masses in two halves, solved as a sparse model."""
    groups = {}
    for name, members in (("near", range(N // 2)), ("far", range(N // 2, N))):
        K, M = np.zeros((N, N)), np.zeros((N, N))
        for i in members:
            M[i, i] = 1.0
            K[i, i] += 1e5
            if i:
                K[i - 1, i - 1] += 1e5
                K[[i - 1, i], [i, i - 1]] -= 1e5
        groups[name] = updyn.Group(K, M, loss_factor=0.03)
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(N)])
    frf = updyn.response(
        model.scaled({"far": {"stiffness": 1.1}}),
        np.linspace(0.5, 6.0, 25),
        ["60:X", "20:X"],
        ["60:X"],
    )
    unknowns = updyn.parameters(model, stiffness="all")
    return updyn.update(
        model,
        noisy(frf, 0, 0.02),
        unknowns,
        noise={"relative": 0.02},
        tier="sparse",
        backend="superlu",
        starts=0,
    )


@pytest.fixture(scope="module")
def whole(result) -> updyn.UpdateResult:
    """The same fit in dense matrices."""
    return updyn.update(
        result.start,
        result.frf,
        result.parameters,
        noise={"relative": 0.02},
        tier="dense",
        starts=0,
    )


@pytest.fixture(scope="module")
def draws(result) -> updyn.Draws:
    return updyn.bootstrap(result, 110)


def test_a_bootstrap_is_made_in_a_reduced_model(result, whole) -> None:
    found = updyn.bootstrap(result, 30)
    assert found.options["basis"] < N
    assert found.options["error"] <= found.options["accuracy"] == 1e-5
    assert found.converged
    for name in found.names:
        assert found.deviation[name] == pytest.approx(result.std[name], rel=0.4)
    # Those of the whole model, refit by refit.
    exact = updyn.bootstrap(whole, 4)
    std = np.array([result.std[n] for n in found.names])
    assert (np.abs(exact.values - found.values[:4]) < 0.02 * std).all()


def test_sampling_is_made_in_a_reduced_model(result) -> None:
    pytest.importorskip("emcee")
    pytest.importorskip("arviz_stats")
    found = updyn.sample(result, 200, max_evaluations=8000)
    assert found.options["basis"] < N
    assert found.options["error"] <= found.options["accuracy"]
    assert found.options["n_modes"] == 1
    for name in found.names:
        assert found.deviation[name] == pytest.approx(result.std[name], rel=0.15)


def test_a_reduced_model_that_is_not_good_enough_is_told(result, monkeypatch) -> None:
    monkeypatch.setattr(Surrogate, "error", lambda self, x: 0.01)
    found = updyn.bootstrap(result, 3)
    assert not found.converged
    assert (
        "The error of the reduced model is 0.01 at the furthest draws, above the accuracy of 1e-05"
        in found.message
    )


def test_a_profile_is_made_in_a_reduced_model(result, whole) -> None:
    found = updyn.profile(result)
    assert found.reduction["basis"] < N
    assert found.reduction["error"] <= found.reduction["accuracy"] == 1e-5
    assert not found.message
    exact = updyn.profile(whole, starts=0)
    assert exact.reduction == {}
    for name, (lower, upper) in exact.intervals().items():
        assert found.intervals()[name] == pytest.approx((lower, upper), abs=0.02 * result.std[name])


def test_parts_are_exchanged_by_their_own_stiffness(result) -> None:
    """Not by that of the reduced model: the projected matrices of a part have other sizes."""
    restored = restore(result)
    surrogate = reduce_about(restored, 1e-5, 0)
    assert surrogate is not None
    reduced = restored.with_problem(surrogate.problem())
    points = [x for x, _ in _exchange_parts(reduced.likelihood(), reduced.whole, restored.x)]
    sizes = {name: abs(group.stiffness).sum() for name, group in result.start.groups.items()}
    swapped = {
        "near.stiffness": result.values["far.stiffness"] * sizes["far"] / sizes["near"],
        "far.stiffness": result.values["near.stiffness"] * sizes["near"] / sizes["far"],
    }
    expected = restored.whole.coordinates.to_x(np.array([swapped[n] for n in restored.names]))
    assert any(np.allclose(x, expected, atol=1e-12) for x in points)


def test_a_profile_of_a_reduced_model_that_is_not_good_enough_is_told(result, monkeypatch) -> None:
    monkeypatch.setattr(Surrogate, "error", lambda self, x: 0.01)
    found = updyn.profile(result, ["near.stiffness"])
    assert (
        "The error of the reduced model is 0.01 at the furthest points, above the accuracy of 1e-05"
        in found.message
    )


@pytest.mark.parametrize("freq", [np.linspace(0.5, 6.0, 40), [2.0]])
def test_bands_of_draws_are_made_in_a_reduced_model(draws, monkeypatch, freq) -> None:
    reduced = updyn.predict(draws, freq, ["40:X"], ["60:X"])
    with monkeypatch.context() as patch:
        override(patch, PREDICTED_BAND, least_solves=np.inf)
        whole = updyn.predict(draws, freq, ["40:X"], ["60:X"])
    assert np.allclose(reduced.lower, whole.lower, rtol=1e-3)
    assert np.allclose(reduced.upper, whole.upper, rtol=1e-3)
    monkeypatch.setattr(Surrogate, "error", lambda self, x: 0.01)
    with pytest.raises(SolverError, match=r"is 0\.01 at the furthest points.*accuracy="):
        updyn.predict(draws, freq, ["40:X"], ["60:X"])


def test_a_band_of_the_covariance_is_made_in_a_reduced_model(result, monkeypatch) -> None:
    asked = result, np.linspace(0.5, 6.0, 60), ["40:X"], ["60:X"]
    reduced = updyn.predict(*asked)
    override(monkeypatch, PREDICTED_BAND, least_solves=np.inf)
    whole = updyn.predict(*asked)
    np.testing.assert_allclose(reduced.frf.values, whole.frf.values, rtol=1e-3)
    for side in ("lower", "upper", "phase_lower", "phase_upper", "std_real", "std_imag"):
        np.testing.assert_allclose(getattr(reduced, side), getattr(whole, side), rtol=2e-3)
