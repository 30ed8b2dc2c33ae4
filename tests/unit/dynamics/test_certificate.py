"""Norms of the fields of a reduced model, against the definition in complex arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.dynamics.certificate import square_norms


@pytest.mark.parametrize("shape", [(5, 7, 3), (5, 4), (5, 2, 0)])
def test_squared_norms_of_complex_fields(shape) -> None:
    rng = np.random.default_rng(2)
    A = rng.standard_normal((5, 5))
    P = A @ A.T
    q = rng.standard_normal((2, *shape)) * np.array([1.0, 2.0]).reshape(2, *[1] * len(shape))
    q = q[0] + 1j * q[1]
    energy, length = square_norms(q, P)
    columns = q.reshape(5, -1).T
    expected = [float((x.conj() @ P @ x).real) for x in columns]
    np.testing.assert_allclose(energy.ravel(), expected, rtol=1e-12)
    np.testing.assert_allclose(length.ravel(), [np.vdot(x, x).real for x in columns], rtol=1e-12)
    assert energy.shape == length.shape == shape[1:]
