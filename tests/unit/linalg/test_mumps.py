"""What is particular to MUMPS; that its answers are right, `test_factorise` shows for every backend installed."""

import types

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.linalg import mumps


@pytest.fixture(autouse=True)
def fresh():
    mumps._package.cache_clear()
    yield
    mumps._package.cache_clear()


def test_pymumps_which_has_the_same_module_name_is_not_taken(monkeypatch):
    monkeypatch.setitem(
        __import__("sys").modules, "mumps", types.SimpleNamespace(DMumpsContext=object)
    )
    assert not mumps.Mumps.available()


def test_a_package_whose_library_is_gone_is_not_available(monkeypatch):
    def gone(name):
        raise ImportError("libzmumps_seq.so: cannot open shared object file")

    monkeypatch.setattr("importlib.import_module", gone)
    assert not mumps.Mumps.available()


@pytest.mark.parametrize("kind", [float, complex])
def test_new_values_on_a_kept_analysis(kind):
    if not mumps.Mumps.available():
        pytest.skip("python-mumps is not installed")
    n = 200
    K = sp.diags_array([-np.ones(n - 1), 2.0 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    made, B = None, np.random.default_rng(0).standard_normal((n, 3)).astype(kind)
    for shift in (0.0, 0.3, 1.7):
        A = sp.csc_array(K - shift * sp.eye_array(n)) * kind(1)
        made = mumps.Mumps(A, real=kind is float) if made is None else made
        kept, solve = B.copy(), made.factor(A)
        assert solve(B) == pytest.approx(np.linalg.solve(A.toarray(), B), rel=1e-9, abs=1e-11)
        assert np.array_equal(B, kept)
        below = int((2 - 2 * np.cos(np.pi * np.arange(1, n + 1) / (n + 1)) < shift).sum())
        assert solve.negative == (below if kind is float else None)
    made.release()


def test_memory_is_stated_in_whole_megabytes():
    if not mumps.Mumps.available():
        pytest.skip("python-mumps is not installed")
    A = sp.csc_array(np.ones((1500, 1500)) + 1500 * np.eye(1500))
    made = mumps.Mumps(A, real=True)
    estimated = made.peak_bytes
    made.factor(A)
    assert 0.5 < made.peak_bytes / (8 * 1500**2) < 4
    assert estimated > 0.5 * made.peak_bytes


def test_too_little_memory_has_its_own_name():
    class ShortError(RuntimeError):
        error = -13

    def step():
        raise ShortError("Not enough memory")

    with pytest.raises(MemoryError, match="Not enough memory"):
        mumps.Mumps._run(step)
    ShortError.error = -10
    with pytest.raises(ShortError):
        mumps.Mumps._run(step)
