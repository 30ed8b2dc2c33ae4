"""pyFRF as a second opinion on FRFs of one force and of several; skipped where it is not installed."""

from __future__ import annotations

import numpy as np
import pytest

import hits
import updyn
from updyn.signals.records import Records

peers = pytest.importorskip("pyFRF", exc_type=ImportError)

SIZE = 256


@pytest.mark.parametrize("n_forces", [1, 2])
@pytest.mark.parametrize("n_responses", [2, 3])
def test_estimates_are_those_of_pyfrf(n_forces, n_responses):
    rng = np.random.default_rng(21)
    force = rng.standard_normal((24, n_forces, SIZE))
    mixed = rng.standard_normal((n_responses, n_forces)) @ force
    motion = mixed + np.roll(mixed, 2, axis=2) + 0.3 * rng.standard_normal(mixed.shape)
    forces = {f"f{i}": f"{i}:Z" for i in range(1, n_forces + 1)}
    responses = {f"x{i}": f"{i}:X" for i in range(1, n_responses + 1)}
    given = Records.of(
        np.concatenate([force, motion], axis=1),
        hits.STEP,
        [*forces, *responses],
        ["N"] * n_forces + ["m"] * n_responses,
    )
    peer = peers.FRF(
        round(1.0 / hits.STEP),
        exc=force,
        resp=motion,
        exc_type="f",
        resp_type="d",
        window="none",
    )
    for name in ("H1", "H2"):
        found = updyn.frf_estimate(
            given,
            forces,
            responses=responses,
            estimator=name,
            segment=SIZE * hits.STEP,
            window="boxcar",
        )
        wanted = np.moveaxis(peer.get_FRF(frf_estimator=name), 2, 0)[1:]
        assert np.abs(found.frf.values - wanted).max() <= 1e-10 * np.abs(wanted).max()
    wanted = peer.get_coherence().real.T[1:]
    assert np.abs(found.multiple - wanted).max() <= 1e-10
