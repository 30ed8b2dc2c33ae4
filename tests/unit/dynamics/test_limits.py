"""Limits of reduced models and of blocks of lines, by numbers just inside and outside of each."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from updyn.dynamics import certificate, shifted
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.basis import Basis
from updyn.dynamics.fields import LineSolver
from updyn.dynamics.reduced_solver import ReducedSolver
from updyn.dynamics.reduction import Reduction


@pytest.fixture
def basis() -> Basis:
    group = updyn.Group(np.eye(3), np.eye(3))
    model = updyn.Model.from_groups({"g": group}, ["1:X", "2:X", "3:X"])
    return Basis(AffineSystem.compile(model), np.ones(3))


@pytest.mark.parametrize(("norm", "size"), [(0.9e-9, 1), (1.1e-9, 2)])
def test_a_new_direction_of_a_basis(basis, norm, size):
    basis.append(np.array([[1.0], [0.0], [0.0]]))
    basis.append(np.array([[1.0], [norm], [0.0]]))
    assert basis.size == size


@pytest.mark.parametrize(("distance", "rank"), [(1.9e-5, 1), (2.1e-5, 2)])
def test_independent_directions_of_a_basis(basis, distance, rank):
    """The squared sizes of two columns at a small angle are 2 and half the angle squared."""
    basis.extend(np.array([[1.0, 1.0], [0.0, distance], [0.0, 0.0]]))
    assert basis._normaliser().shape == (2, rank)


@pytest.mark.parametrize(("change", "close"), [(0.09, True), (0.11, False)])
def test_close_states_differ_by_a_tenth(change, close):
    state = SimpleNamespace(factor=np.array([1.0, 4.0]))
    other = SimpleNamespace(factor=np.array([1.0, 4.0 * (1.0 + change)]))
    assert shifted._are_close(other, state) is close


@pytest.mark.parametrize(
    ("n_loaded", "moments"), [(1, 8), (4, 8), (5, 7), (16, 2), (31, 2), (32, 1), (100, 1)]
)
def test_moments_for_few_loads(n_loaded, moments):
    reduction = SimpleNamespace(_loaded_dofs=range(n_loaded))
    assert Reduction._depth.fget(reduction) == moments


@pytest.mark.parametrize(
    ("n", "sizes"), [(1000, [4, 1]), (1_000_000, [3, 2]), (2_000_000, [1] * 5)]
)
def test_lines_with_residuals_in_memory(n, sizes):
    channels = SimpleNamespace(forced=range(5))
    reduction = SimpleNamespace(system=SimpleNamespace(n=n), _channels=channels)
    groups = Reduction._group_lines(reduction, np.arange(5.0))
    assert [len(lines) for lines in groups] == sizes


@pytest.mark.parametrize(("r", "lines"), [(100, 32), (400, 25), (5000, 1)])
def test_lines_in_a_block_of_a_reduced_model(r, lines):
    solver = SimpleNamespace(system=SimpleNamespace(n=r))
    assert ReducedSolver.block_size(solver, 20) == lines


@pytest.mark.parametrize(("n", "lines"), [(150, 164), (2000, 1), (5000, 1)])
def test_lines_in_a_block_of_a_dense_model(n, lines):
    assert LineSolver(SimpleNamespace(n=n), "dense", "superlu").block_size(10) == lines


def test_the_stated_error_is_twice_the_difference_and_sixteen_times_the_residual():
    difference, residual = np.array([1.0, 0.0, 2.0]), np.array([0.0, 1.0, 1.0])
    found = certificate._reduction_error(difference, residual)
    np.testing.assert_array_equal(found, [2.0, 16.0, 20.0])
