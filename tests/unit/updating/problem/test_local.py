"""QR triangles of tall blocks: by value against known factors, whatever the rows look like."""

import numpy as np
import pytest

from updyn.updating.problem import local
from updyn.updating.problem.local import qr_triangle, reduce_blocks

M, N = 3000, 12


def block(R, seed=0, rows=M):
    """A with known triangle R, and orthonormal columns otherwise unknown."""
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((rows, len(R))))[0]
    return np.asfortranarray(Q @ R)


def triangle(A):
    """R of a block in Fortran order."""
    return qr_triangle(A.T[:-1], A.T[-1])


def signed(R):
    """R with a positive diagonal: unique."""
    return np.where(np.diag(R) < 0.0, -1.0, 1.0)[:, None] * R


def graded():
    """A triangle whose columns go from 1 to 1e-9."""
    R = np.triu(np.random.default_rng(1).uniform(0.2, 1.0, (N, N)))
    np.fill_diagonal(R, 1.0)
    return R * np.logspace(0, -9, N)


@pytest.mark.parametrize("rows", [N, 5 * N, M])
def test_known_triangle_column_by_column(rows):
    R = graded()
    found = signed(triangle(block(R, rows=rows)))
    np.testing.assert_array_less(np.abs(found - R) / np.linalg.norm(R, axis=0), 1e-12)
    assert not np.tril(found, -1).any()


def test_small_singular_values_are_as_exact_as_by_reflections():
    """A triangle of condition 1e10 by dependent columns, scaled to the same size."""
    R = np.eye(N)
    R[:, -1] = 1.0
    R[-1, -1] = 1e-10
    found = signed(triangle(block(R)))
    assert found[-1, -1] == pytest.approx(1e-10, rel=1e-4)


def test_rows_far_larger_than_those_of_the_sample():
    A = block(graded())
    A[1234] *= 1e9
    A[1235, 3:] *= -1e9
    expected = A.T @ A
    R = triangle(A)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_array_less(np.abs(R.T @ R - expected) / np.outer(size, size), 1e-13)


@pytest.mark.parametrize("kind", ["zero", "equal", "sum"])
def test_dependent_columns(kind):
    A = block(graded())
    A[:, 5] = {"zero": 0.0 * A[:, 5], "equal": A[:, 2], "sum": A[:, 1] - A[:, 2]}[kind]
    expected = A.T @ A
    R = triangle(A)
    assert np.isfinite(R).all()
    size = np.maximum(np.sqrt(np.diag(expected)), 1e-12)
    np.testing.assert_array_less(np.abs(R.T @ R - expected) / np.outer(size, size), 1e-13)


def test_blocks_that_are_not_finite_stay_so():
    A = block(graded())
    A[7, 3] = np.nan
    assert not np.isfinite(triangle(A)).all()


def test_gradient_and_cost_of_blocks():
    A = [block(graded(), seed) for seed in range(3)]
    found = reduce_blocks([a.copy(order="F") for a in A], N - 1)
    whole = np.vstack(A)
    assert found.cost == pytest.approx(0.5 * whole[:, -1] @ whole[:, -1], rel=1e-12)
    J, r = whole[:, :-1], whole[:, -1]
    size = np.linalg.norm(J, axis=0) * np.linalg.norm(r)
    np.testing.assert_array_less(np.abs(found.gradient - J.T @ r) / size, 1e-12)


def test_even_rows_take_the_faster_way(monkeypatch):
    A = np.asfortranarray(np.random.default_rng(0).standard_normal((M, N)))
    expected = signed(np.linalg.qr(A)[1])
    tall = []
    reflected = local._householder

    def watched(given):
        tall.append(len(given))
        return reflected(given)

    monkeypatch.setattr(local, "_householder", watched)
    np.testing.assert_allclose(signed(triangle(A)), expected, atol=1e-12)
    assert max(tall) < M
