"""Meshes as a format: the model of docs/formats.md is that built in Python, and what is not said is asked for."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import updyn
from meshes import MSH
from places import ROOT
from updyn.elements.mesh import structure_from_mesh
from updyn.elements.structure import tube
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
    with pytest.raises(OptionError, match="says nothing of its unit"):
        updyn.read_model(mesh)
    with pytest.raises(OptionError, match="says nothing of its materials"):
        updyn.read_model(mesh, unit="mm")
    with pytest.raises(FormatError, match=r"table.msh: group .* has no material"):
        updyn.read_model(
            mesh, unit="mm", materials={"top": {"thickness": 0.01, **STEEL}}, grounded=["foot"]
        )
