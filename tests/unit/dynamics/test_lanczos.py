"""Block Lanczos against the closed form of a fixed chain, and against dense solutions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from updyn.dynamics import eigen, lanczos
from updyn.dynamics.lanczos import BlockLanczos, RealPencil
from updyn.errors import SolverError

N = 900


def chain(n: int = N) -> tuple[sp.csr_array, sp.csr_array, np.ndarray]:
    """Return K, M and the exact eigenvalues of a chain fixed at both ends."""
    K = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tocsr() * 1e6
    exact = 4e6 * np.sin(0.5 * np.pi * np.arange(1, n + 1) / (n + 1)) ** 2
    return K, sp.eye_array(n).tocsr(), exact


def test_modes_of_a_chain_and_their_shapes() -> None:
    K, M, exact = chain()
    process = BlockLanczos.begin(RealPencil(K, M), 0.1 * exact[9])
    value, vectors = process.solve(10)
    np.testing.assert_allclose(value, exact[:10], rtol=1e-9)
    residual = K @ vectors - (M @ vectors) * value
    assert np.linalg.norm(residual) < 1e-7 * np.linalg.norm(K @ vectors)


def test_a_restarted_basis_gives_the_same_modes(monkeypatch) -> None:
    K, M, exact = chain()
    pencil = RealPencil(K, M)
    settings = replace(lanczos.LANCZOS, most_vectors=20, vectors_per_mode=2)
    monkeypatch.setattr(lanczos, "LANCZOS", settings)
    process = BlockLanczos.begin(pencil, 0.1 * exact[11])
    np.testing.assert_allclose(process.solve(12)[0], exact[:12], rtol=1e-9)
    assert process._size <= 24 + process.block


def test_more_modes_continue_the_basis_and_another_start_gives_them_too() -> None:
    K, M, exact = chain()
    process = BlockLanczos.begin(RealPencil(K, M), 0.1 * exact[5])
    np.testing.assert_allclose(process.solve(3, 1e-2)[0], exact[:3], rtol=1e-2)
    np.testing.assert_allclose(process.solve(14)[0], exact[:14], rtol=1e-9)
    np.testing.assert_allclose(process.repeat().solve(14)[0], exact[:14], rtol=1e-9)


def test_masses_on_few_dofs_give_as_many_modes() -> None:
    K, _, _ = chain(60)
    mass = np.zeros(60)
    at = [10, 30, 44]
    mass[at] = 1.0, 2.0, 3.0
    value, vectors = BlockLanczos.begin(RealPencil(K, sp.diags_array(mass)), 1.0).solve(8)
    # Static condensation to the three masses.
    flexible = np.linalg.solve(K.toarray(), np.eye(60)[:, at])[at]
    exact = 1.0 / np.linalg.eigvals(flexible @ np.diag([1.0, 2.0, 3.0])).real
    np.testing.assert_allclose(value, np.sort(exact), rtol=1e-9)
    assert vectors.shape == (60, 3)


def test_repeated_and_rigid_body_modes_of_a_free_plane_of_springs() -> None:
    n = 12
    one = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tolil()
    one[0, 0] = one[-1, -1] = 1.0
    eye = sp.eye_array(n)
    K = 1e4 * (sp.kron(one, eye) + sp.kron(eye, one)).tocsr()
    M = sp.diags_array(np.ones(n * n)).tocsr()
    exact = scipy.linalg.eigh(K.toarray(), M.toarray(), eigvals_only=True)[:11]
    value, _ = BlockLanczos.begin(RealPencil(K, M), 0.1 * exact[-1]).solve(11)
    np.testing.assert_allclose(value, exact, rtol=1e-9, atol=1e-9 * exact[-1])


def test_an_indefinite_matrix_is_refused() -> None:
    K, M, exact = chain()
    with pytest.raises(SolverError, match="not positive definite"):
        BlockLanczos.begin(RealPencil(K, M), -1.5 * exact[0])


def test_matrices_of_different_patterns_are_summed() -> None:
    K = sp.csr_array(np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]))
    M = sp.csr_array(np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.5, 0.0, 1.0]]))
    pencil = RealPencil(K, M)
    for shift in (0.0, 2.0, -2.0):
        A = K.toarray() + shift * M.toarray()
        np.testing.assert_array_equal(pencil.matrix(shift).toarray(), A)
        b = np.arange(3.0)
        np.testing.assert_allclose(A @ pencil.factor(shift).solve(b), b, atol=1e-14)


def test_modes_up_to_a_value_that_is_an_eigenvalue() -> None:
    K, M, exact = chain()
    for number in (5, 9):
        value = eigen.pairs_up_to(K, M, float(exact[number - 1]), 400)[0]
        assert len(value) == number + 1
        np.testing.assert_allclose(value, exact[: number + 1], rtol=1e-9)
