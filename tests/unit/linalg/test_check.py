"""The check of a solve: nothing that is wrong passes, whatever the sizes of the columns and the units."""

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.linalg import solver as check
from updyn.linalg.settings import SPARSE_SOLVER


def system(n=90, r=5, seed=0, *, real=False):
    """A well conditioned symmetric matrix, right-hand sides of very different sizes, and the solution."""
    rng = np.random.default_rng(seed)
    A = sp.random_array((n, n), density=3.0 / n, rng=rng)
    A = sp.csc_array(A + A.T + 5 * sp.eye_array(n)) * (1.0 if real else 1.0 + 0.02j)
    B = rng.standard_normal((n, r)) * 10.0 ** rng.uniform(-9, 9, r)
    return A, np.linalg.solve(A.toarray(), B), B


def accuracy(A, X, B):
    return check.accuracy(A, check.unit_scale(A.diagonal()), X, B, SPARSE_SOLVER.backward_error)


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("r", [1, 33, 64, 65, 200])
def test_a_right_answer_passes(real, r):
    errors, grown = accuracy(*system(r=r, real=real))
    assert errors.shape == grown.shape == (r,)
    assert (errors < 1e-11).all()
    assert (grown > 0.1).all()
    assert (grown < 100).all()


@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("column", [0, 7, 32, 69])
@pytest.mark.parametrize("wrong", [1e-5, 1.0, np.nan, np.inf])
def test_one_bad_value_in_one_column_is_found_there(real, column, wrong):
    """The columns differ by up to 18 orders of magnitude: none may hide behind another."""
    A, X, B = system(r=70, real=real)
    X[41, column] += wrong * np.abs(X[:, column]).max()
    errors, _ = accuracy(A, X, B)
    assert list(np.flatnonzero(~(errors <= SPARSE_SOLVER.backward_error))) == [column]


def test_a_small_solution_does_not_hide_behind_a_large_one():
    """Equal loads, one near a natural frequency: the other's answer is a million times smaller."""
    A = sp.csc_array(np.array([[1.0, -1, 0, 0], [-1, 1 + 1e-6, 0, 0], [0, 0, 2, 1], [0, 0, 1, 2]]))
    B = np.eye(4)[:, [0, 2]]
    X = np.linalg.solve(A.toarray(), B)
    assert (accuracy(A, X, B)[0] < 1e-12).all()
    X[3, 1] += 1e-5
    assert list(np.flatnonzero(accuracy(A, X, B)[0] > SPARSE_SOLVER.backward_error)) == [1]


def test_a_bad_value_in_a_soft_dof_of_other_units_is_found():
    """Rotations and translations: the sizes of rows differ by 1e8, so that only scaled they compare."""
    A, X, B = system(r=4)
    d = np.where(np.arange(90) % 2, 1e4, 1.0)
    A, X, B = (
        sp.csc_array(sp.diags_array(d) @ A @ sp.diags_array(d)),
        X / d[:, None],
        B * d[:, None],
    )
    assert (accuracy(A, X, B)[0] < 1e-11).all()
    X[40, 2] *= 1.001
    assert list(np.flatnonzero(accuracy(A, X, B)[0] > SPARSE_SOLVER.backward_error)) == [2]


def test_a_wrong_answer_of_zero_is_found():
    A, X, B = system()
    X[:, 3] = 0.0
    assert accuracy(A, X, B)[0] == pytest.approx([0, 0, 0, 1, 0], abs=1e-11)


def test_errors_are_backward_errors():
    """Against the definition, on an answer that is wrong everywhere."""
    A, X, B = system()
    Y = X * (1 + 1e-3 * np.random.default_rng(4).standard_normal(X.shape))
    scale = np.sqrt(np.abs(A.diagonal()))
    residual = np.abs(A.toarray() @ Y - B) / scale[:, None]
    size = (np.abs(A.toarray()) @ np.abs(Y) + np.abs(B)) / scale[:, None]
    assert accuracy(A, Y, B)[0] == pytest.approx(residual.max(axis=0) / size.max(axis=0), rel=1e-9)


def test_columns_without_load_and_rows_without_a_diagonal():
    A = sp.csc_array(np.array([[0, 1.0, 0], [1.0, 0, 2.0], [0, 2.0, 1.0]]))
    B = np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    X = np.linalg.solve(A.toarray(), B)
    errors, grown = accuracy(A, X, B)
    assert (errors < 1e-15).all()
    assert grown[1] == 0.0
    nothing = sp.csc_array(np.array([[0, 1.0], [1.0, 0]]))
    assert accuracy(nothing, np.eye(2)[::-1], np.eye(2))[0] == pytest.approx([0.0, 0.0])


def test_growth_by_column():
    """Real and imaginary part are looked at apart, which is right to a factor of the root of two."""
    A, X, B = system()
    scale = np.sqrt(np.abs(A.diagonal()))[:, None]
    truth = (np.abs(X) * scale).max(axis=0) / (np.abs(B) / scale).max(axis=0)
    assert accuracy(A, X, B)[1] == pytest.approx(truth, rel=0.42)
    assert check.growth(A.diagonal(), X, B) == pytest.approx(truth.max())
    X[3, 1] = np.nan
    assert accuracy(A, X, B)[1][1] == np.inf
