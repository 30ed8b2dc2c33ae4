"""Factors for eigensolvers: solutions and the number of negative eigenvalues, by every backend."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.linalg import direct
from updyn.linalg.direct import factorise


def chain(n: int, shift: float) -> sp.csc_array:
    """Return the stiffness of a chain with free ends, less a shift of the diagonal."""
    diagonal = np.full(n, 2.0)
    diagonal[[0, -1]] = 1.0
    return sp.diags_array(
        [-np.ones(n - 1), diagonal - shift, -np.ones(n - 1)], offsets=[-1, 0, 1]
    ).tocsc()


@pytest.fixture(params=["fastest", "superlu"])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "superlu":
        monkeypatch.setattr(direct, "check_backend", lambda name: "superlu")
    return request.param


@pytest.mark.parametrize("shift", [-0.1, 0.05, 1.3, 3.7])
def test_negative_eigenvalues_are_counted_and_loads_solved(backend: str, shift: float) -> None:
    A = chain(40, shift)
    found = factorise(A)
    values = np.linalg.eigvalsh(A.toarray())
    assert found.negative == (values < 0).sum()
    rng = np.random.default_rng(3)
    for B in (rng.standard_normal(40), rng.standard_normal((40, 3))):
        X = found.solve(B)
        assert X.shape == B.shape
        assert np.allclose(A @ X, B, rtol=0.0, atol=1e-10)


def test_a_complex_matrix_has_no_count(backend: str) -> None:
    A = (chain(40, 0.5) + 0.02j * chain(40, 0.0)).tocsc()
    found = factorise(A)
    b = np.arange(40) + 1.0j
    assert found.negative is None
    assert np.allclose(A @ found.solve(b), b, rtol=0.0, atol=1e-10)


def test_a_singular_matrix_is_an_error(backend: str) -> None:
    A = chain(40, 0.0).tolil()
    A[7, :] = 0.0
    A[:, 7] = 0.0
    with pytest.raises(RuntimeError, match="singular"):
        factorise(A.tocsc())


def test_a_matrix_refused_by_a_backend_goes_to_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    class Refusing:
        def __init__(self, pattern: object, *, real: bool) -> None:
            assert real

        def factor(self, A: object) -> None:
            raise RuntimeError("a pivot was perturbed")

    monkeypatch.setattr(direct, "check_backend", lambda name: "refusing")
    monkeypatch.setattr(direct, "BACKENDS", {"refusing": Refusing})
    A = chain(10, 0.3)
    assert np.allclose(A @ factorise(A).solve(np.ones(10)), 1.0)
