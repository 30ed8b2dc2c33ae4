"""Masses of laminates (PCOMP): density times thickness times area, for any order of plies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from updyn.io.nastran.bdf import read_model

needs_mystran = pytest.mark.needs("mystran")

TWO = "PCOMP,1,,.2\n,11,.25,0.,,12,.25,90.\n"
THREE = "PCOMP,2,,,,,,,SYM\n,13,.1,0.,,,.3,90.\n,12,,45.\n"
ONE = "PCOMP,3\n,12,.2,0.\nPSHELL,4,12,.3,12,,,,.7\n"
#: Mass of a unit square by number of the property.
MASS = {
    1: 0.2 + 5.0 * 0.25 + 10.0 * 0.25,
    2: 2.0 * (70.0 * (0.1 + 0.3) + 10.0 * 0.3),
    3: 2.0,
    4: 3.7,
}


@pytest.fixture
def plates(tmp_path):
    def make(properties: list[int]) -> Path:
        """Return a deck of separate square plates, each with the given property."""
        lines = ["SPC=1", "BEGIN BULK", TWO + THREE + ONE.rstrip()]
        for k, pid in enumerate(properties):
            grids = [4 * k + n for n in (1, 2, 3, 4)]
            corners = ((0, 0), (1, 0), (1, 1), (0, 1))
            for grid, (x, y) in zip(grids, corners, strict=True):
                lines.append(f"GRID,{grid},,{2.0 * k + x},{float(y)},0.")
            lines.append(f"CQUAD4,{k + 1},{pid},{','.join(map(str, grids))}")
            lines.append(f"SPC1,1,12456,{grids[0]},THRU,{grids[3]}")
        lines += ["MAT8,11,2.+9,1.+8,.3,5.+7,5.+7,5.+7,5.", "MAT1,12,2.+9,,.3,10."]
        lines += ["MAT1,13,2.+9,,.3,70.", "ENDDATA"]
        path = tmp_path / "plates.bdf"
        path.write_text("\n".join(lines) + "\n")
        return path

    return make


@needs_mystran
@pytest.mark.parametrize("properties", [[1], [1, 1], [2, 1, 3], [3, 2, 2], [4, 1, 4, 3]])
def test_mass_of_each_plate(plates, properties):
    model = read_model(plates(properties))
    M = np.diag(model.mass.toarray())[model.dofs.axes == 2]
    found = M.reshape(len(properties), 4).sum(axis=1)
    np.testing.assert_allclose(found, [MASS[pid] for pid in properties], rtol=1e-9)
    assert len(model.groups) == len(set(properties))


@needs_mystran
def test_a_material_that_laminates_share_is_scaled_for_one_of_them(plates):
    model = read_model(plates([1, 3]))
    heavy = model.group("PCOMP 1").mass.diagonal().sum() / 4.0
    assert heavy == pytest.approx(MASS[1] / 4.0, rel=1e-9)
