"""Sparse solves: right answers, singular matrices found, backends checked by name."""

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.errors import OptionError, SolverError
from updyn.linalg import factorise


def symmetric(n, seed=0):
    rng = np.random.default_rng(seed)
    A = sp.random_array((n, n), density=3.0 / n, rng=rng) + 1j * sp.random_array((n, n), density=3.0 / n, rng=rng)
    return sp.csc_array(A + A.T + (4 + 1j) * sp.eye_array(n))


@pytest.mark.parametrize("backend", sorted(factorise.BACKENDS))
def test_solution_against_dense(backend):
    A, rng = symmetric(80), np.random.default_rng(3)
    B = rng.standard_normal((80, 4)) + 1j * rng.standard_normal((80, 4))
    assert factorise.solve(A, B, backend, 1.0) == pytest.approx(np.linalg.solve(A.toarray(), B), rel=1e-11)


@pytest.mark.parametrize("backend", sorted(factorise.BACKENDS))
def test_zero_on_the_diagonal(backend):
    """A massless mechanism has zeros on the diagonal that pivoting must step around."""
    A = sp.csc_array(np.array([[0, 1.0, 0], [1.0, 0, 2.0], [0, 2.0, 1.0]], dtype=complex))
    B = np.eye(3, dtype=complex)
    assert factorise.solve(A, B, backend, 1.0) == pytest.approx(np.linalg.solve(A.toarray(), B), abs=1e-14)


@pytest.mark.parametrize("backend", sorted(factorise.BACKENDS))
@pytest.mark.parametrize("lost", [0.0, 3e-15])
def test_singular_matrix_is_found_and_the_line_named(backend, lost):
    """Exactly singular, and singular but for rounding: the residual alone shows neither."""
    A = sp.csc_array(np.array([[1.0 + lost, -1.0], [-1.0, 1.0]], dtype=complex))
    with pytest.raises(SolverError, match=r"singular at 12\.5 Hz: a natural frequency without damping"):
        factorise.solve(A, np.eye(2, dtype=complex), backend, 12.5)


def test_message_at_rest_speaks_of_support():
    A = sp.csc_array(np.array([[1.0, -1.0], [-1.0, 1.0]], dtype=complex))
    with pytest.raises(SolverError, match="singular at 0 Hz: the structure is free to move"):
        factorise.solve(A, np.eye(2, dtype=complex), "superlu", 0.0)


def test_solution_that_is_not_a_number_is_never_returned(monkeypatch):
    monkeypatch.setitem(factorise.BACKENDS, "broken", lambda A, B: np.full(B.shape, np.nan + 0j))
    with pytest.raises(SolverError, match="broken: residual nan at 3 Hz"):
        factorise.solve(symmetric(5), np.eye(5, dtype=complex), "broken", 3.0)


def test_one_step_of_refinement_repairs_a_sloppy_backend(monkeypatch):
    """A relative error of 1e-5 is above the residual that is asked for; one correction leaves 1e-10."""
    calls = []

    def sloppy(A, B):
        calls.append(1)
        return np.linalg.solve(A.toarray(), B) * (1 + 1e-5)

    monkeypatch.setitem(factorise.BACKENDS, "sloppy", sloppy)
    A, B = symmetric(6), np.eye(6, dtype=complex)
    assert factorise.solve(A, B, "sloppy", 1.0) == pytest.approx(np.linalg.solve(A.toarray(), B), rel=1e-9)
    assert len(calls) == 2


def test_growth_does_not_depend_on_units():
    """Scaling DOFs (metres to millimetres, radians kept) leaves the measure of singularity as it is."""
    A = symmetric(7).toarray()
    B = np.eye(7)[:, :2] + 0j
    d = 10.0 ** np.arange(-3, 4)
    X = np.linalg.solve(A, B)
    scaled = d[:, None] * A * d
    Y, C = np.linalg.solve(scaled, d[:, None] * B), d[:, None] * B
    one = factorise.growth(A.diagonal(), X, B)
    assert factorise.growth(scaled.diagonal(), Y, C) == pytest.approx(one, rel=1e-9)
    assert 0.5 < one < np.linalg.cond(A)


def test_growth_of_a_column_without_load_and_of_what_is_not_a_number():
    diagonal, B = np.ones(2) + 0j, np.array([[1.0, 0.0], [0.0, 0.0]]) + 0j
    X = np.array([[3.0, 0.0], [4.0, 0.0]]) + 0j
    assert factorise.growth(diagonal, X, B) == pytest.approx(4.0)
    assert factorise.growth(diagonal, X * np.nan, B) == np.inf


def test_backend_names():
    assert factorise.check_backend(None) == "superlu"
    assert factorise.check_backend("superlu") == "superlu"
    with pytest.raises(OptionError, match=r"backend 'superlo'.*superlu"):
        factorise.check_backend("superlo")
