"""The linear part of a model, condensed onto its nonlinear elements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from periodic_cases import K2, two_masses
from updyn.dynamics.periodic.transfer import Transfer
from updyn.errors import OptionError

TABLE = updyn.LossTable([0.1, 0.7, 3.0, 20.0], [0.5, 2.0, 1.0, 1.5])
FREQ = np.array([0.4, 1.3, 2.9])
DAMPING = {
    "structural": {"loss_factor": 0.03},
    "viscous": {"stiffness_damping": 0.01},
    "mixed": {"loss_factor": 0.03, "stiffness_damping": 0.01},
    "table": {"loss_factor": 0.03, "loss_table": TABLE},
}


def chain(n: int, **damping) -> updyn.Model:
    """Masses of 1 kg between springs, held at one end, with a massless DOF at the other."""
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1.0
    M = np.diag([*np.ones(n - 1), 0.0])
    groups = {"springs": updyn.Group(1e3 * K, **damping), "masses": updyn.Group(mass=M)}
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def build(model: updyn.Model, tier: str | None = "dense", accuracy: float = 1e-6) -> Transfer:
    """Transfer from an element between the first DOFs and a force at the last to the first."""
    model = model.with_elements({"joint": (updyn.CubicSpring(1.0), ["1:X", "2:X"])})
    first, last = np.array([0]), np.array([model.n_dofs - 1])
    lines = np.linspace(0.1, 6.0, 40)
    return Transfer.build(
        model, first, last, (0.1, 3.0), lines, tier=tier, backend=None, accuracy=accuracy
    )


def expected(model: updyn.Model, freq: np.ndarray) -> np.ndarray:
    """The same by `updyn.response`."""
    dofs = model.dofs.labels
    H = updyn.response(model, freq, dofs, dofs).values
    w, last = np.zeros(model.n_dofs), np.eye(model.n_dofs)[-1]
    w[:2] = 1.0, -1.0
    inputs, outputs = np.stack([w, last], axis=1), np.stack([w, np.eye(model.n_dofs)[0]])
    return outputs @ H @ inputs


@pytest.mark.parametrize("kind", DAMPING)
@pytest.mark.parametrize("n", [2, 5])
def test_receptance_is_that_of_the_model(kind: str, n: int) -> None:
    model = chain(n, **DAMPING[kind])
    found = build(model)
    H, _ = found.at(2 * np.pi * FREQ)
    reference = expected(model, FREQ)
    assert np.abs(H - reference).max() < 1e-11 * np.abs(reference).max()


@pytest.mark.parametrize("kind", DAMPING)
def test_one_decomposition_serves_all_lines(kind: str) -> None:
    model = two_masses(**DAMPING[kind])
    found = build(model)
    direct = replace(found, rational=None)
    assert (found.rational is None) == (kind == "table")
    omega, h = 2 * np.pi * FREQ, 1e-6
    for decay in (0.0, 0.3):
        H, slope = found.at(omega, decay)
        exact, exact_slope = direct.at(omega, decay)
        assert np.abs(H - exact).max() < 1e-12 * np.abs(exact).max()
        assert np.abs(slope - exact_slope).max() < 1e-11 * np.abs(exact_slope).max()
        change = (found.at(omega + h, decay)[0] - found.at(omega - h, decay)[0]) / (2 * h)
        assert np.abs(change - slope).max() < 1e-7 * np.abs(slope).max()


@pytest.mark.parametrize("kind", DAMPING)
def test_static_receptance_has_the_real_stiffness(kind: str) -> None:
    found = build(two_masses(**DAMPING[kind]))
    w = np.array([1.0, -1.0])
    X = np.linalg.solve(K2, np.stack([w, [0.0, 1.0]], axis=1))
    assert found.static == pytest.approx(np.stack([w, [1.0, 0.0]]) @ X, rel=1e-12)


def test_a_free_model_has_no_static_receptance() -> None:
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    groups = {"spring": updyn.Group(K), "masses": updyn.Group(mass=np.eye(2))}
    assert build(updyn.Model.from_groups(groups, ["1:X", "2:X"])).static is None


def test_the_reduced_tier_has_the_permitted_error() -> None:
    model = chain(200, loss_factor=0.02)
    assert "reduced" in build(model, None).source
    assert build(chain(20), None).source == "model"
    exact, _ = build(model).at(2 * np.pi * FREQ)
    for accuracy in (1e-4, 1e-7):
        H, _ = build(model, "reduced", accuracy).at(2 * np.pi * FREQ)
        # The elements act on differences of the receptances that the error refers to.
        scale = np.abs(
            updyn.response(model, FREQ, ["1:X", "2:X", "200:X"], ["1:X", "200:X"]).values
        )
        assert np.abs(H - exact).max() < 4.0 * accuracy * scale.max()


def test_other_tiers_are_refused() -> None:
    with pytest.raises(OptionError, match=r"tier 'sparse': a level needs .*'dense' or 'reduced'"):
        build(two_masses(), "sparse")
