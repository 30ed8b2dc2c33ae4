"""What is particular to PARDISO: its indices, its memory, what it must not be given."""

import numpy as np
import pytest
import scipy.sparse as sp

from grid import eigenvalues, grid
from overriding import override
from updyn.linalg import pardiso
from updyn.linalg.settings import SPARSE_SOLVER

pytestmark = pytest.mark.skipif(
    not pardiso.Pardiso.available(), reason="the mkl wheel is not installed"
)


@pytest.mark.parametrize("most", [500_000_000, 0])
@pytest.mark.parametrize("kind", [float, complex])
def test_indices_of_32_and_of_64_bits(monkeypatch, most, kind):
    """A limit of 0 stands for a matrix that is too large for 32 bits."""
    monkeypatch.setattr("updyn.linalg.pardiso._MOST_ENTRIES", most)
    A = grid(9, 1.234) * kind(1)
    made = pardiso.Pardiso(A, real=kind is float)
    assert made._session.ia.dtype == (np.int64 if most == 0 else np.int32)
    B = np.random.default_rng(0).standard_normal((729, 40)).astype(kind)
    for factor in (1.0, -3.0):
        solve = made.factor(A * factor)
        assert solve(B) == pytest.approx(
            np.linalg.solve(A.toarray() * factor, B), rel=1e-9, abs=1e-11
        )
        below = int((factor * (eigenvalues(9) - 1.234) < 0).sum())
        assert solve.negative == (below if kind is float else None)


def test_memory_is_stated_and_given_back():
    """The factor alone needs 8 bytes an entry, twice as much where complex."""
    A = grid(16, 0.1)
    real, cplx = pardiso.Pardiso(A, real=True), pardiso.Pardiso(A * 1j)
    real.factor(A)
    cplx.factor(A * 1j)
    entries = int(real._session.iparm[17])
    assert entries > 4096 * 50
    assert 8 * entries < real.peak_bytes < 3 * 8 * entries
    assert 16 * entries < cplx.peak_bytes < 2.2 * real.peak_bytes
    handle = real._session.handle
    assert handle.any()
    real.release()
    assert not handle.any()
    real.release()


def test_what_it_must_not_be_given():
    A = grid(3)
    mixed = sp.csc_array((A.data.copy(), A.indices.copy(), A.indptr.copy()), shape=A.shape)
    mixed.indices[:2], mixed.data[:2] = A.indices[1::-1], A.data[1::-1]
    mixed.has_sorted_indices = False
    with pytest.raises(ValueError, match="sorted"):
        pardiso.Pardiso(mixed, real=True)
    lower = A.indices != np.repeat(np.arange(27), np.diff(A.indptr))
    lower[: A.indptr[26]] = True
    without = sp.csc_array(
        (A.data[lower], (A.indices[lower], np.repeat(np.arange(27), np.diff(A.indptr))[lower]))
    )
    with pytest.raises(RuntimeError, match="full diagonal"):
        pardiso.Pardiso(without, real=True)


def test_values_are_taken_in_blocks(monkeypatch):
    A = grid(5)
    override(monkeypatch, SPARSE_SOLVER, entries_per_step=7)
    B = np.ones((125, 1))
    assert pardiso.Pardiso(A, real=True).factor(A)(B) == pytest.approx(
        np.linalg.solve(A.toarray(), B)
    )
