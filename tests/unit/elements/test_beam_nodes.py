"""Nodes of a beam: their default number, and positions that differ by rounding."""

import numpy as np

from updyn.elements.beam import beam


def count_nodes(**options):
    """Return the number of nodes of a beam of 1 m."""
    found = beam(1.0, E=2.1e11, rho=7850.0, width=0.02, height=0.01, **options)
    return len(np.unique(found.dofs.nodes))


def test_a_beam_has_a_hundred_elements_by_default():
    assert count_nodes() == 101


def test_positions_that_differ_by_rounding_are_one_node():
    assert count_nodes(n_elements=2, stations=[0.5, 0.5 + 0.9e-9]) == 3
    assert count_nodes(n_elements=2, stations=[0.5, 0.5 + 1.1e-9]) == 4
