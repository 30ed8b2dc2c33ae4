"""The upper triangle of a symmetric pattern, against scipy's."""

import numpy as np
import pytest
import scipy.sparse as sp

from overriding import override
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.linalg.triangle import upper_triangle


@pytest.mark.parametrize("block", [7, 2**18])
def test_blocks_of_rows_give_the_upper_triangle(monkeypatch, block):
    override(monkeypatch, SPARSE_SOLVER, entries_per_step=block)
    made = sp.random_array((60, 60), density=0.1, rng=np.random.default_rng(0))
    A = sp.csc_array(made + made.T + sp.eye_array(60))
    A.sort_indices()
    kept, begin = upper_triangle(A.indptr, A.indices)
    truth = sp.csr_array(sp.triu(A))
    assert np.array_equal(begin, truth.indptr)
    assert np.array_equal(A.indices[kept], truth.indices)
    assert np.array_equal(A.data[kept], truth.data)
