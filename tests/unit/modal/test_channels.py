"""Least squares of many channels at once against those of each channel alone."""

from __future__ import annotations

import numpy as np
import pytest

from overriding import override
from updyn.modal.channels import Columns
from updyn.modal.settings import CHANNEL_FIT


def case(is_complex: bool, own: bool):
    """Nearly dependent columns, and deviations over four decades."""
    rng = np.random.default_rng(1)
    n, m, p = 30, 5, 4

    def drawn(*shape: int):
        real = rng.standard_normal(shape)
        return real + 1j * rng.standard_normal(shape) if is_complex else real

    A, Y, T = drawn(n, m), drawn(p, n), drawn(n, 2)
    A[:, 1] = A[:, 0] + 1e-6 * A[:, 1]
    deviation = 10.0 ** rng.uniform(-2.0, 2.0, (p if own else 1, n))
    return A, Y, T, deviation


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("is_complex", [True, False])
def test_each_channel_is_fitted_as_alone(is_complex: bool, own: bool) -> None:
    A, Y, T, deviation = case(is_complex, own)
    columns = Columns.of(A, deviation)
    found, error = columns.fit(Y)
    left, follow = columns.project_out(T)
    squared, weighted, leverage = (
        columns.normalise_squares(error),
        columns.divide_by_variance(error),
        columns.leverage(),
    )
    for c in range(len(Y)):
        d = deviation[c if own else 0]
        w = 0 if len(left) == 1 else c
        weightedA, weightedT = A / d[:, None], T / d[:, None]
        expected = np.linalg.lstsq(weightedA, Y[c] / d, rcond=None)[0]
        assert found[c] == pytest.approx(expected, rel=1e-6)
        assert error[c] == pytest.approx(Y[c] - A @ expected, rel=1e-6, abs=1e-9)
        assert squared[c] == pytest.approx(np.abs(error[c] / d) ** 2)
        assert weighted[c] == pytest.approx(error[c] / d**2)
        Q = np.linalg.qr(weightedA)[0]
        assert leverage[w] == pytest.approx(np.sum(np.abs(Q) ** 2, axis=1), rel=1e-6, abs=1e-9)
        beyond = weightedT - Q @ (Q.conj().T @ weightedT)
        assert left[w] == pytest.approx(beyond.conj().T @ beyond, rel=1e-6, abs=1e-9)
        along = np.linalg.lstsq(weightedA, weightedT, rcond=None)[0]
        assert follow[w] == pytest.approx(along, rel=1e-6)
        inverse = np.linalg.solve(np.linalg.qr(weightedA)[1], np.eye(A.shape[1]))[[2, 4]]
        assert columns.covariance([2, 4])[w] == pytest.approx(
            inverse @ inverse.conj().T, rel=1e-6, abs=1e-9
        )


def test_a_column_that_the_others_span_counts_for_nothing() -> None:
    A, Y, _, deviation = case(True, True)
    A[:, 1] = A[:, 0]
    found, error = Columns.of(A, deviation).fit(Y)
    fewer, expected = Columns.of(np.delete(A, 1, axis=1), deviation).fit(Y)
    assert error == pytest.approx(expected)
    assert np.delete(found, 1, axis=1) == pytest.approx(fewer)
    assert not found[:, 1].any()


def test_memory_is_bounded_in_parts_of_the_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    A, Y, T, deviation = case(True, True)
    whole = Columns.of(A, deviation)
    override(monkeypatch, CHANNEL_FIT, block_elements=40)
    parts = Columns.of(A, deviation)
    assert parts.fit(Y)[0] == pytest.approx(whole.fit(Y)[0])
    assert parts.leverage() == pytest.approx(whole.leverage())
    assert parts.project_out(T)[0] == pytest.approx(whole.project_out(T)[0])
