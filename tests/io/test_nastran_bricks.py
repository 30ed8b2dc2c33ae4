"""Bricks of 20 grids, which MYSTRAN solves."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from updyn.errors import UpdynWarning
from updyn.io.nastran.bdf import read_model


def bricks_of_20_grids(isop: str) -> str:
    """One brick of 20 grids, held at its bottom."""
    corners = [(x, y, z) for z in (0, 2) for x, y in ((0, 0), (2, 0), (2, 2), (0, 2))]
    ends = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 4), (1, 5), (2, 6), (3, 7)]
    ends += [(4, 5), (5, 6), (6, 7), (7, 4)]
    xyz = np.array(corners + [np.mean([corners[a], corners[b]], axis=0) for a, b in ends])
    grids = [f"GRID,{n},,{x:.2f},{y:.2f},{z:.2f}" for n, (x, y, z) in enumerate(xyz / 2.0, 1)]
    nodes = [str(n) for n in range(1, 21)]
    brick = "CHEXA,1,1," + ",".join(nodes[:6]) + "\n," + ",".join(nodes[6:14])
    brick += "\n," + ",".join(nodes[14:])
    rows = [
        "BEGIN BULK",
        *grids,
        brick,
        f"PSOLID,1,1,,3,,{isop}",
        "MAT1,1,7.+10,,.3,2700.",
        "ENDDATA",
    ]
    return "\n".join(rows) + "\n"


@pytest.mark.needs("mystran")
@pytest.mark.parametrize(("isop", "is_noted"), [("", True), ("REDUCED", True), ("FULL", False)])
def test_reduced_integration_of_large_bricks_is_noted(deck, isop, is_noted):
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always", UpdynWarning)
        model = read_model(deck(bricks_of_20_grids(isop)))
    assert model.n_dofs == 60
    assert is_noted == any(
        "state FULL in field 7 (ISOP) of PSOLID 1" in str(w.message) for w in noted
    )
