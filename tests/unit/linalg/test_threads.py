"""Threads: those of MKL limited in a process of its own, since the limit stays."""

import os
import subprocess
import sys

import pytest
import threadpoolctl

from updyn.linalg import pardiso, threads

RUN = """
import numpy as np, scipy.sparse as sp
from updyn.linalg import pardiso, threads
from updyn.linalg.solver import SparseSolver
n = 3000
A = sp.csc_array(sp.diags_array([-np.ones(n - 9), 3 * np.ones(n), -np.ones(n - 9)], offsets=[-9, 0, 9]))
solver, B = SparseSolver("pardiso", real=True), np.ones((n, 40))
for threads_now in (1, 3, 1):
    threads.limit(threads_now)
    assert pardiso.library().MKL_Get_Max_Threads() == threads_now
    assert np.abs(A @ solver.solve(A, B, 1.0) - B).max() < 1e-11
threads.limit(1)
print(pardiso.library().MKL_Get_Max_Threads(), solver.solve_counts)
"""


@pytest.mark.skipif(not pardiso.Pardiso.available(), reason="the mkl wheel is not installed")
def test_the_limit_holds_and_answers_stay_right():
    # As many as are asked for, not as many as there are cores or as the environment says.
    env = {**os.environ, "MKL_DYNAMIC": "FALSE", "MKL_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=env,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["1", "{'pardiso':", "3}"]


def test_without_mkl_nothing_happens(monkeypatch):
    monkeypatch.setattr("updyn.linalg.threads.library", lambda: None)
    threads.limit(4)


@pytest.mark.parametrize("n", [0, -1])
def test_at_least_one_thread(n):
    with pytest.raises(ValueError, match="at least 1"):
        threads.limit(n)


def openblas_threads():
    found = threadpoolctl.ThreadpoolController().select(internal_api="openblas").info()
    return {library["num_threads"] for library in found}


def test_alone_limits_what_it_calls_too_and_ends_with_the_outermost_call():
    seen = []

    @threads.use_one_thread
    def inner(*, fails):
        seen.append(openblas_threads())
        if fails:
            raise ZeroDivisionError

    @threads.use_one_thread
    def outer():
        with pytest.raises(ZeroDivisionError):
            inner(fails=True)
        seen.append(openblas_threads())
        inner(fails=False)

    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = openblas_threads()
        outer()
        assert openblas_threads() == before
        with pytest.raises(ZeroDivisionError):
            inner(fails=True)
        assert openblas_threads() == before
    assert before == {2}
    assert seen == [{1}] * 4
