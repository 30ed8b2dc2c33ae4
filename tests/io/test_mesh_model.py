"""Meshes as a format: the model of docs/formats.md is that built in Python, and what is not said is asked for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

import updyn
from meshes import MSH, block
from places import ROOT
from updyn.elements.mesh import structure_from_mesh
from updyn.elements.structure import Solid, structure, tube
from updyn.errors import FormatError, OptionError, UpdynWarning

pytestmark = pytest.mark.kernels

STEEL = {"E": 2.1e11, "nu": 0.3, "rho": 7850.0}


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    """The mesh of the tests of `updyn.elements.mesh`, text of Gmsh in mm."""
    path = tmp_path / "table.msh"
    path.write_text(MSH)
    return path


def options() -> dict[str, object]:
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8").split('<a id="mesh"></a>')[1]
    found = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert found is not None
    table = tomllib.loads(found[1])["model"]
    assert table.pop("file") == "table.msh"
    return table


def test_the_documented_job_is_the_model_built_in_python(mesh: Path) -> None:
    materials = {
        "top": {"thickness": 0.01, **STEEL},
        "legs": {"section": tube(0.05, 0.04), **STEEL},
        "tip": {"mass": 3.0},
    }
    built = structure_from_mesh(mesh, materials, unit="mm", grounded=["foot"])
    read = updyn.read_model(mesh, **options())
    assert read.dofs == built.dofs
    assert abs(read.stiffness - built.stiffness).max() == 0.0
    assert abs(read.mass - built.mass).max() == 0.0


def test_a_job_on_a_mesh(mesh: Path, tmp_path: Path) -> None:
    from updyn.job import load_job, prepare, run_job

    given = options()
    model = updyn.read_model(mesh, **given)
    truth = model.scaled({"legs": {"stiffness": 0.8}})
    corner = f"{int(model.dofs[0].node)}:Z"
    low = updyn.modes(model, 4).frequency
    frf = updyn.response(truth, [0.7 * low[0], low[0], low[1], low[2]], [corner], [corner])
    updyn.write_frf(frf, tmp_path / "test.npz")
    page = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8").split('<a id="mesh"></a>')[1]
    block = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert block is not None
    more = """
[test]
file = "test.npz"
[[parameter]]
groups = "legs"
quantity = "stiffness"
[output]
report = false
"""
    (tmp_path / "job.toml").write_text(block[1] + more)
    job = load_job(tmp_path / "job.toml")
    assert prepare(job).model.dofs == model.dofs
    # Without damping, three of the lines are natural frequencies of the model where it starts.
    named = f"singular at {low[0]:g} Hz.*The fit starts"
    with pytest.warns(UpdynWarning, match=named):
        result = run_job(job, out=tmp_path / "out").result
    assert result.values["legs.stiffness"] == pytest.approx(0.8, rel=1e-6)
    with pytest.warns(UpdynWarning, match=named):
        again = run_job(load_job(tmp_path / "out" / "job.toml"), out=tmp_path / "again").result
    assert again.values == result.values


def test_what_a_mesh_does_not_say_is_asked_for(mesh: Path) -> None:
    with pytest.raises(OptionError, match="does not contain its unit"):
        updyn.read_model(mesh)
    with pytest.raises(OptionError, match="does not contain its materials"):
        updyn.read_model(mesh, unit="mm")
    with pytest.raises(FormatError, match=r"table.msh: group .* has no material"):
        updyn.read_model(
            mesh, unit="mm", materials={"top": {"thickness": 0.01, **STEEL}}, grounded=["foot"]
        )


# -- MED --------------------------------------------------------------------------------------------
#: Order of the nodes of MED files, of which the solids are mirrored (Gmsh: med2mshNodeIndex).
MIRRORED = {
    "tetra": [0, 2, 1, 3],
    "tetra10": [0, 2, 1, 3, 6, 5, 4, 7, 9, 8],
    "hexahedron": [0, 3, 2, 1, 4, 7, 6, 5],
    "hexahedron20": [0, 3, 2, 1, 4, 7, 6, 5, 11, 10, 9, 8, 15, 14, 13, 12, 16, 19, 18, 17],
}


def write_med(
    path: Path, kind: str, nodes: int, is_mirrored: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Write a block of two halves and a held face; return its positions and its cells."""
    xyz, cells = block((2, 1, 1), (1.0, 0.6, 0.4), nodes)
    half = xyz[cells - 1].mean(axis=1)[:, 0] < 0.5
    written = cells[:, MIRRORED[kind]] if is_mirrored else cells
    mesh = meshio.Mesh(
        xyz,
        [(kind, written - 1)],
        cell_data={"cell_tags": [np.where(half, -7, -8)]},
        point_data={"point_tags": np.where(xyz[:, 0] == 0.0, 2, 0)},
    )
    mesh.cell_tags = {-7: ["left", "all of it"], -8: ["right", "all of it"]}
    mesh.point_tags = {2: ["held"]}
    mesh.write(path)
    return xyz, cells


@pytest.mark.parametrize("is_mirrored", [False, True])
@pytest.mark.parametrize(
    ("kind", "nodes"), [("tetra", 4), ("tetra10", 10), ("hexahedron", 8), ("hexahedron20", 20)]
)
def test_med_files(tmp_path: Path, kind: str, nodes: int, is_mirrored: bool) -> None:
    path = tmp_path / "a.med"
    xyz, cells = write_med(path, kind, nodes, is_mirrored)
    model = updyn.read_model(
        path,
        unit="m",
        materials={"left": STEEL, "right": {**STEEL, "E": 1.0e11}},
        leave_out=["all of it"],
        grounded=["held"],
    )
    assert set(model.groups) == {"left", "right"}
    half = xyz[cells - 1].mean(axis=1)[:, 0] < 0.5
    parts = [
        Solid("left", cells[half], **STEEL),
        Solid("right", cells[~half], **{**STEEL, "E": 1.0e11}),
    ]
    held = np.flatnonzero(xyz[:, 0] == 0.0) + 1
    built = structure(xyz, parts, grounded=held.tolist())
    assert model.dofs == built.dofs
    for name in ("stiffness", "mass"):
        given, expected = getattr(model, name), getattr(built, name)
        assert abs(given - expected).max() <= 1e-12 * abs(expected).max()


def test_a_file_with_the_suffix_med_that_is_no_mesh(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.med", "w") as file:
        file["x"] = [1.0]
    with pytest.raises(FormatError, match=r"a\.med: not a readable mesh"):
        updyn.read_model(tmp_path / "a.med", unit="m", materials={})
    (tmp_path / "b.med").write_text("text")
    with pytest.raises(FormatError, match=r"b\.med: not a readable mesh"):
        updyn.read_model(tmp_path / "b.med", unit="m", materials={})
