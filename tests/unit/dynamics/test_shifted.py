"""Factorisations of K - s M whose shift is close to an eigenvalue."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from overriding import override
from reduced_cases import plate
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.settings import SHIFTED
from updyn.dynamics.shifted import Shifted
from updyn.linalg.solver import BACKENDS

ABLE = [
    b for b in BACKENDS if BACKENDS[b].available() and getattr(BACKENDS[b], "has_single", False)
]


def matrices(system: AffineSystem) -> tuple[np.ndarray, np.ndarray]:
    """K and M of the start."""
    of = Shifted(system, 1.0, "superlu")
    K = of.matrix(system.start, 0.0).toarray()
    return K, K - of.matrix(system.start, 1.0).toarray()


@pytest.mark.parametrize("backend", ABLE)
@pytest.mark.parametrize("mode", [1, 9])
def test_in_single_precision_a_shift_near_an_eigenvalue_is_moved_out_of_the_band(
    monkeypatch: pytest.MonkeyPatch, backend: str, mode: int
) -> None:
    override(monkeypatch, SHIFTED, double_dofs=0)
    system = AffineSystem.compile(plate())
    K, M = matrices(system)
    eigenvalues = scipy.linalg.eigh(K, M, eigvals_only=True)
    top = 1.05 * float(eigenvalues[9])
    of, near = Shifted(system, top, backend), float(eigenvalues[mode]) * (1.0 + 1e-9)
    loads = np.random.default_rng(0).standard_normal((system.n, 3))
    s, factorised, X = of.solve(system.start, near, loads)
    assert factorised.error > 0.0  # single precision
    assert 1e-3 * top < (s - near) * np.sign(near - 0.5 * top) < 0.02 * top
    truth = np.linalg.solve(K - s * M, loads)
    assert np.abs(X - truth).max() < 1e-7 * np.abs(truth).max()
    assert factorised.negative in (int((eigenvalues < s).sum()), None)
    assert of.count > 1


@pytest.mark.parametrize("backend", ABLE)
def test_a_shift_far_from_eigenvalues_stays(monkeypatch: pytest.MonkeyPatch, backend: str) -> None:
    override(monkeypatch, SHIFTED, double_dofs=0)
    system = AffineSystem.compile(plate())
    K, M = matrices(system)
    first, second = scipy.linalg.eigh(K, M, eigvals_only=True)[:2]
    between = float(0.5 * (first + second))
    of = Shifted(system, float(second), backend)
    s, _, X = of.solve(system.start, between, np.eye(system.n)[:, :2])
    assert (s, of.count) == (between, 1)
    truth = np.linalg.solve(K - s * M, np.eye(system.n)[:, :2])
    assert np.abs(X - truth).max() < 1e-7 * np.abs(truth).max()


def test_without_a_shift_that_does_double_precision_takes_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    override(monkeypatch, SHIFTED, double_dofs=0)
    override(monkeypatch, SHIFTED, moves_in_single=(0.0,))
    system = AffineSystem.compile(plate())
    K, M = matrices(system)
    near = float(scipy.linalg.eigh(K, M, eigvals_only=True)[4]) * (1.0 + 1e-9)
    s, factorised, _ = Shifted(system, near, "superlu").solve(
        system.start, near, np.eye(system.n)[:, :1]
    )
    assert s == near
    assert factorised.error == 0.0
