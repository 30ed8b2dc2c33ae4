"""A grid of masses on springs, whose eigenvalues are known."""

import numpy as np
import scipy.sparse as sp


def grid(m, shift=0.0):
    """m x m x m masses on springs: K - shift M, real."""
    T, eye = (
        sp.diags_array([-np.ones(m - 1), 2 * np.ones(m), -np.ones(m - 1)], offsets=[-1, 0, 1]),
        sp.eye_array(m),
    )
    K = (
        sp.kron(sp.kron(T, eye), eye)
        + sp.kron(sp.kron(eye, T), eye)
        + sp.kron(sp.kron(eye, eye), T)
    )
    A = sp.csc_array(K - shift * sp.eye_array(m**3))
    A.sort_indices()
    return A


def eigenvalues(m):
    """Of the grid's K (Strang, SIAM Review 41 (1999) 135-147): sums of three of 2 - 2 cos."""
    one = 2 - 2 * np.cos(np.pi * np.arange(1, m + 1) / (m + 1))
    return (one[:, None, None] + one[:, None] + one).ravel()
