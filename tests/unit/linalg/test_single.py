"""Factors in single precision: six digits where they do, and double precision where they do not."""

import numpy as np
import pytest
import scipy.sparse as sp

import grid as case
from updyn.linalg.solver import BACKENDS, SparseSolver

ABLE = [
    b for b in BACKENDS if BACKENDS[b].available() and getattr(BACKENDS[b], "has_single", False)
]
M = 9


def grid(shift):
    return case.grid(M, shift)


def loads(r=40, seed=0):
    return np.random.default_rng(seed).standard_normal((M**3, r))


def made(backend, *, single=True):
    return SparseSolver(backend, real=True, single=single)


def off(X, truth):
    return float((np.abs(X - truth).max(axis=0) / np.abs(truth).max(axis=0)).max())


@pytest.mark.parametrize("backend", ABLE)
def test_answers_have_six_digits_and_no_more(backend):
    A, B = grid(1.234), loads()
    truth = np.linalg.solve(A.toarray(), B)
    X = made(backend).factorise(A, 1.0, error=1e-6).solve(B)
    assert X.dtype == np.float64
    assert 1e-10 < off(X, truth) < 1e-3
    assert off(made(backend, single=False).factorise(A, 1.0, error=1e-6).solve(B), truth) < 1e-10


@pytest.mark.parametrize("backend", ABLE)
@pytest.mark.parametrize("shift", [-3.0, 0.4, 1.234, 5.9])
def test_negative_eigenvalues_are_counted_as_in_double_precision(backend, shift):
    truth = int((case.eigenvalues(M) < shift).sum())
    assert made(backend).factorise(grid(shift), 1.0, error=1e-6).negative in (truth, None)
    assert (
        backend != "pardiso"
        or made(backend).factorise(grid(shift), 1.0, error=1e-6).negative == truth
    )


@pytest.mark.parametrize("backend", ABLE)
@pytest.mark.parametrize("side", [-1, 1])
def test_a_shift_too_close_to_an_eigenvalue_is_for_double_precision(backend, side):
    """It is 1e-9 away, less than the rounding of single precision moves it."""
    shift = case.eigenvalues(M)[0] * (1.0 + side * 1e-9)
    A, B = grid(shift), loads(3)
    factorised = made(backend).factorise(A, 1.0, error=1e-6)
    assert factorised.negative in ((side > 0), None)
    X = factorised.solve(B)
    assert off(A @ X, B) < 1e-4  # of an answer 1e8 times as large


@pytest.mark.parametrize("backend", ABLE)
def test_what_single_precision_cannot_solve_is_solved_in_double(backend):
    """20,000 springs in a row: a unit load at the end moves mass i by i; the condition is 1e8."""
    n = 20_000
    diagonal = np.r_[2.0 * np.ones(n - 1), 1.0]
    K = sp.csc_array(
        sp.diags_array([-np.ones(n - 1), diagonal, -np.ones(n - 1)], offsets=[-1, 0, 1])
    )
    load = np.zeros((n, 1))
    load[-1] = 1.0
    solver = made(backend)
    factorised = solver.factorise(K, 1.0, error=1e-6)
    assert factorised.solve(load)[:, 0] == pytest.approx(np.arange(1.0, n + 1), rel=1e-6)
    assert factorised.negative in (0, None)
    assert solver.solve_counts == {backend: 1}  # which is no other backend


@pytest.mark.parametrize("backend", ABLE)
def test_loads_and_answers_may_be_of_any_size(backend):
    """Of 1e-60 nothing is left in single precision, and 1e60 is beyond it."""
    A, B = grid(1.234), loads(3)
    sizes = np.array([1e-60, 1.0, 1e60])
    factorised = made(backend).factorise(A, 1.0, error=1e-6)
    assert off(factorised.solve(B * sizes) / sizes, np.linalg.solve(A.toarray(), B)) < 1e-3
    assert not factorised.solve(np.zeros((M**3, 1))).any()


@pytest.mark.parametrize("backend", ABLE)
@pytest.mark.parametrize("size", [1e50, 1e-50])
def test_a_matrix_beyond_the_range_is_for_double_precision(backend, size):
    A, B = grid(1.234), loads(3)
    X = made(backend).factorise(A * size, 1.0, error=1e-6).solve(B)
    assert off(X * size, np.linalg.solve(A.toarray(), B)) < 1e-10


def test_pardiso_takes_little_over_half_the_memory():
    if "pardiso" not in ABLE:
        pytest.skip("the mkl wheel is not installed")
    peaks = []
    for single in (True, False):
        solver = made("pardiso", single=single)
        solver.factorise(case.grid(24, -1.0), 1.0, error=1e-6)
        peaks.append(solver.peak_bytes)
    assert peaks[0] < 0.7 * peaks[1]


# -- when single precision is given up ------------------------------------------------------------------------
class Rounded:
    """A backend whose single precision solves with the matrix times 1 + `error`."""

    has_single = True
    error = 0.0
    made: list[bool]

    @staticmethod
    def available():
        return True

    def __init__(self, pattern, *, real=False, single=False):
        self.factor_of = 1.0 + self.error * single
        self.made.append(single)

    def factor(self, A):
        def solve(B):
            return np.linalg.solve(A.toarray() * self.factor_of, B)

        return solve

    def release(self):
        pass


@pytest.mark.parametrize(
    ("error", "ways", "accuracy"),
    [
        (1e-4, [True], 1e-6),
        (0.02, [True], 1e-6),
        (0.07, [True], 1e-6),  # after five steps
        (0.2, [True], 1e-6),  # after eight
        (0.5, [True, False], 1e-12),  # too far off
    ],
)
def test_answers_are_refined_or_double_precision_takes_over(monkeypatch, error, ways, accuracy):
    rounded = type("Rounded", (Rounded,), {"error": error, "made": []})
    monkeypatch.setitem(BACKENDS._entries, "pardiso", rounded)
    A, B = grid(-1.0), loads(4)
    solver = made("pardiso")
    X = solver.factorise(A, 1.0, error=1e-6).solve(B)
    assert rounded.made == ways
    assert off(X, np.linalg.solve(A.toarray(), B)) < accuracy
    assert solver.solve_counts == {"pardiso": 1}


def test_a_backend_without_single_precision_is_not_asked_for_it(monkeypatch):
    class Plain(Rounded):
        has_single = False

        def __init__(self, pattern, *, real=False):
            super().__init__(pattern, real=real)

    plain = type("Plain", (Plain,), {"made": []})
    monkeypatch.setitem(BACKENDS._entries, "pardiso", plain)
    A, B = grid(-1.0), loads(4)
    X = made("pardiso").factorise(A, 1.0, error=1e-6).solve(B)
    assert plain.made == [False]
    assert off(X, np.linalg.solve(A.toarray(), B)) < 1e-12


@pytest.mark.parametrize("backend", ABLE)
def test_a_factorisation_returns_products_with_its_matrix(backend):
    A, B = grid(0.4), loads(4)
    assert np.array_equal(made(backend).factorise(A, 1.0, error=1e-6).times(B), A @ B)
