"""Thresholds of the pairing of modes: a case on either side of each."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.correlation import clusters, shapes
from updyn.correlation.clusters import PairingRule


@pytest.mark.parametrize(("gap", "count"), [(0.0059, 1), (0.0061, 2)])
def test_modes_are_close(gap, count):
    assert len(clusters.cluster_modes(np.array([1.0, 1.0 + gap]))) == count


@pytest.mark.parametrize(("mac", "count"), [(0.89, 0), (0.91, 1)])
def test_a_pair_at_the_gate_has_a_mac_of_nine_tenths(mac, count):
    similarity, gate = np.array([[mac]]), np.array([[0.3]])
    first, _ = clusters._assign_pairs(similarity, gate, gate, PairingRule(0.3, 0.5, 0.006))
    assert len(first) == count


@pytest.mark.parametrize(
    ("mac", "difference", "count"), [(1.0, 0.29, 1), (1.0, 0.31, 0), (0.51, 0.0, 1), (0.49, 0.0, 0)]
)
def test_a_pair_is_within_three_tenths_with_a_mac_of_a_half(mac, difference, count):
    rule = PairingRule()
    found, _ = clusters._assign_pairs(*np.array([[[mac]], [[difference]], [[rule.gate]]]), rule)
    assert len(found) == count


@pytest.mark.parametrize(("spread", "rank"), [(0.09, 1), (0.11, 2)])
def test_the_span_of_shapes_excludes_their_errors(spread, rank):
    # Two vectors at an angle have singular values of the ratio tan(angle / 2).
    angle = 2.0 * np.arctan(spread)
    pair = np.array([[1.0, np.cos(angle)], [0.0, np.sin(angle)]])
    assert shapes.orthonormalise(pair).shape[1] == rank


@pytest.mark.parametrize(("size", "moves"), [(0.9e-9, False), (1.1e-9, True)])
def test_a_shape_is_at_rest_at_the_sensors(size, moves):
    assert shapes.find_moving(np.array([[size]]), np.array([[1.0], [size]]))[0] == moves
