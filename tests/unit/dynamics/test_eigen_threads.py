"""Eigenpairs of small models are computed in one thread of OpenBLAS: threads that wait for a busy core cost 25 times."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
import threadpoolctl

import updyn
from updyn.model import Group, Model


def chain(n: int = 12) -> Model:
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    return Model.from_groups({"all": Group(1e4 * K, np.eye(n))}, [f"{i + 1}:X" for i in range(n)])


@pytest.fixture
def threads(monkeypatch):
    """Record the threads of OpenBLAS in every eigendecomposition."""
    seen: list[int] = []

    def recorded(function):
        def call(*args, **kwargs):
            libraries = threadpoolctl.ThreadpoolController().select(internal_api="openblas").info()
            seen.extend(library["num_threads"] for library in libraries)
            return function(*args, **kwargs)

        return call

    monkeypatch.setattr(scipy.linalg, "eigh", recorded(scipy.linalg.eigh))
    monkeypatch.setattr(scipy.linalg, "eig", recorded(scipy.linalg.eig))
    return seen


@pytest.mark.parametrize("is_complex", [False, True])
def test_modes(threads, is_complex) -> None:
    model = chain().scaled({"all": {"loss_factor": 0.02}})
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        updyn.modes(model, 3, complex=is_complex)
    assert set(threads) == {1}


def test_update_to_modes(threads) -> None:
    measured = updyn.ModeSet(updyn.modes(chain(), 3).frequency * 1.05)
    threads.clear()
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        result = updyn.update(
            chain(), measured, updyn.parameters(chain(), stiffness="all"), starts=0
        )
    assert result.values["all.stiffness"] == pytest.approx(1.05**2, rel=1e-6)
    assert set(threads) == {1}
