"""Thresholds of reports: a case just inside and just outside of each."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from updyn.report import convergence
from updyn.report.agreement import _fdac_map, fdac_maps
from updyn.report.scene import _ModalShapes


@pytest.mark.parametrize("channels", [2, 3])
def test_an_fdac_map_needs_three_channels(channels):
    values = np.arange(1.0, 2.0 * channels + 1.0).reshape(2, channels, 1) + 0j
    data = SimpleNamespace(
        freq=np.array([1.0, 2.0]),
        compared=np.ones(2, dtype=bool),
        responses=range(channels),
        references=range(1),
        measured=values,
        before=values,
        after=None,
    )
    assert bool(fdac_maps(data)) == (channels == 3)


def test_the_ridge_of_an_fdac_map_is_from_eight_tenths():
    found = np.array([[0.81, 0.1], [0.1, 0.79]])
    *_, ridge = _fdac_map(np.array([10.0, 20.0]), found)["data"]
    assert (ridge["x"], ridge["y"]) == ([10.0], [10.0])


@pytest.mark.parametrize(("distance", "leading"), [(0.9e-3, 1), (1.1e-3, 2)])
def test_a_stage_that_ends_within_a_thousandth_reached_the_result(monkeypatch, distance, leading):
    fits = [
        SimpleNamespace(stage=stage, accepted=[(0, away)], continues=lambda other: False)
        for stage, away in (("search", distance), ("fit", 0.0))
    ]
    monkeypatch.setattr(convergence, "_split_fits", lambda history: fits)
    monkeypatch.setattr(convergence, "_distance", lambda result, away: away)
    found = convergence._find_leading_fits(SimpleNamespace(history=()))
    assert found == fits[:leading]


@pytest.mark.parametrize(("change", "is_same"), [(0.9e-6, True), (1.1e-6, False)])
def test_a_mode_computed_again_has_the_frequency_to_a_millionth(change, is_same):
    entry = SimpleNamespace(frequency=10.0, in_subspace=False)
    modes = SimpleNamespace(frequency=np.array([10.0 * (1.0 + change)]), shapes=np.ones((3, 1)))
    shapes = _ModalShapes((), 0, {}, {"start": modes}, None, {})
    found = shapes.model_shape("start", SimpleNamespace(start=entry))
    assert (found is not None) == is_same
