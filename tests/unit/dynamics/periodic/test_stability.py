"""Stability by the winding of the determinant, against Floquet multipliers by time integration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import updyn
from periodic_cases import balance_of, oscillator, two_masses
from updyn.dynamics.periodic.balance import Balance, Evaluation
from updyn.dynamics.periodic.continuation import follow_branch
from updyn.dynamics.periodic.first import solve_first
from updyn.dynamics.periodic.stability import count_unstable
from updyn.nonlinear.element import NonlinearElement


@dataclass(frozen=True)
class Case:
    """A model with one element, a force, lines in rad/s, and the counts of unstable exponents."""

    model: updyn.Model
    element: NonlinearElement
    level: float
    omega: np.ndarray
    harmonics: int
    counts: set[int]

    @property
    def weights(self) -> np.ndarray:
        return np.array([1.0, -1.0])[: self.model.n_dofs]


CASES = {
    # Turning points of a hardening and of a softening spring.
    "hardening": Case(
        oscillator(viscous=0.08), updyn.CubicSpring(0.5), 0.4, np.array([0.5, 2.2]), 9, {0, 1}
    ),
    "softening": Case(
        oscillator(viscous=0.08), updyn.CubicSpring(-0.1), 0.15, np.array([0.5, 1.4]), 9, {0, 1}
    ),
    # The motion loses its symmetry.
    "symmetry": Case(
        oscillator(viscous=0.1), updyn.CubicSpring(1.0), 6.0, np.array([0.9, 2.0]), 15, {0, 1}
    ),
    # The period doubles, at twice the natural frequency.
    "doubling": Case(
        oscillator(viscous=0.02),
        updyn.PolynomialSpring({2: 0.8, 3: 0.5}),
        1.0,
        np.array([1.6, 2.8]),
        15,
        {0, 1},
    ),
    "two masses": Case(
        two_masses(stiffness_damping=0.002),
        updyn.CubicSpring(80.0),
        60.0,
        np.array([14.0, 35.0]),
        9,
        {0, 1},
    ),
}


def find_multipliers(case: Case, balance: Balance, found: Evaluation) -> np.ndarray:
    """Floquet multipliers of M q'' + C q' + K q + w f(w q), linearised around the motion."""
    K, C = case.model.stiffness.toarray(), case.model.viscous.toarray()
    M, w, n = case.model.mass.toarray(), case.weights, case.model.n_dofs
    Q, k = balance.fourier.to_complex(found.x)[0], balance.fourier.harmonics

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        u = np.real(np.sum(Q * np.exp(1j * k * found.omega * t)))
        force = case.element.over_period(np.array([u]), np.zeros(1))
        q, v = y.reshape(2, n, -1)
        pull = K @ q + force.stiffness.toarray()[0, 0] * np.outer(w, w @ q)
        return np.append(v, -np.linalg.solve(M, C @ v + pull))

    period = 2 * np.pi / found.omega
    flow = solve_ivp(slope, (0.0, period), np.eye(2 * n).ravel(), rtol=1e-8, atol=1e-9)
    return np.linalg.eigvals(flow.y[:, -1].reshape(2 * n, 2 * n))


@pytest.mark.parametrize("name", CASES)
def test_unstable_exponents_are_multipliers_beyond_one(name: str) -> None:
    case = CASES[name]
    dofs = case.model.dofs.labels
    balance = balance_of(
        case.model.with_elements({"a": (case.element, dofs)}), case.harmonics, level=case.level
    )
    start = solve_first(balance, float(case.omega[0]))
    assert start is not None
    seen = set()
    for point in list(follow_branch(balance, start, case.omega))[::6]:
        size = np.abs(find_multipliers(case, balance, point.found))
        if np.min(np.abs(size - 1.0)) > 1e-3:  # the point decides clearly
            count = int((size > 1.0).sum())
            assert count_unstable(balance, point.found) == count, point.found.omega
            seen.add(count)
    assert seen == case.counts


def test_sliding_friction_is_stable() -> None:
    model = oscillator(loss=0.02)
    model = model.with_elements({"a": (updyn.JenkinsElement(0.5, slip_force=0.1), "1:X")})
    balance = balance_of(model, 7, level=0.2)
    start = solve_first(balance, 0.8)
    assert start is not None
    points = list(follow_branch(balance, start, np.array([0.8, 1.5])))
    assert [count_unstable(balance, point.found) for point in points] == [0] * len(points)


def sliding_masses() -> updyn.Model:
    """Three masses with two sliders on stiff springs and two cubic springs (an example of NLvib)."""
    K = 2.0 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    groups = {"springs": updyn.Group(K, stiffness_damping=0.02), "m": updyn.Group(mass=np.eye(3))}
    model = updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])
    slider, cubic = updyn.JenkinsElement(20.0, slip_force=1.0), updyn.CubicSpring(1.0)
    return model.with_elements(
        {
            "a": (slider, "1:X"),
            "b": (slider, ["2:X", "1:X"]),
            "c": (cubic, "2:X"),
            "d": (cubic, ["3:X", "2:X"]),
        }
    )


def test_sticking_elements_are_stable_springs() -> None:
    """The modes of the held masses are far above the harmonics of the motion."""
    freq, at = [0.5 / (2 * np.pi)], ["2:X"]
    found = updyn.response(sliding_masses(), freq, at, at, level=1.0, samples=128)
    assert found.stable.all()
    held = sliding_masses().linearised()
    linear = updyn.response(held, found.freq, ["2:X"], ["2:X"])
    assert found.values == pytest.approx(linear.values, rel=0.01)


def test_a_branch_with_corners_is_followed() -> None:
    """The onset of slip at a second peak of a period is a corner of the branch."""
    freq = np.linspace(1.02, 1.04, 3) / (2 * np.pi)
    options = {"level": 1.0, "samples": 128}
    found = updyn.response(sliding_masses(), freq, ["2:X"], ["2:X"], **options)
    alone = updyn.response(sliding_masses(), freq[-1:], ["2:X"], ["2:X"], **options)
    assert found.values[-1] == pytest.approx(alone.values[0], rel=1e-6)


def test_stability_is_computed_once_when_it_is_asked_for(monkeypatch) -> None:
    """It may take longer than the response."""
    counted = []

    def count(balance: Balance, found: Evaluation) -> int:
        counted.append((found.omega, found.x))
        return count_unstable(balance, found)

    monkeypatch.setattr("updyn.dynamics.periodic.response.count_unstable", count)
    case = CASES["hardening"]
    model = case.model.with_elements({"stop": (case.element, "1:X")})
    freq = np.linspace(0.9, 1.5, 7) / (2 * np.pi)
    found = updyn.response(model, freq, ["1:X"], ["1:X"], level=case.level)
    assert counted == []
    at_lines = found.stable
    assert [omega for omega, _ in counted] == pytest.approx(2 * np.pi * freq)
    (branch,) = found.branches
    for f, stable in zip(freq, at_lines[:, 0], strict=True):
        assert stable in branch.stable[np.isclose(branch.freq, f)]
    assert len(counted) == len(branch.freq)
    assert (found.stable == at_lines).all()
    assert len(counted) == len(branch.freq)
