"""`[shapes]` of a job: files of updated and expanded modes, and what it refuses, with lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.job import load_job, run_job
from updyn.job.shapes import SHAPES

JOB = """[model]
file = "chain.h5"
[test]
modes = "{modes}"
[[parameter]]
groups = ["part1", "part2"]
quantity = "stiffness"
[method]
name = "modal"
[output]
report = false
{table}"""


@pytest.fixture
def job(tmp_path: Path):
    find_demo("chain").write_inputs(tmp_path)
    found = updyn.modes(updyn.read_model(tmp_path / "chain.h5"), 3)
    for name, sensors in (("modes", ["2:X", "5:X", "7:X", "10:X", "12:X"]), ("few", ["2:X"])):
        shapes = found.at(sensors) * (1.0 + 0.01 * np.cos(np.arange(len(sensors)))[:, None])
        modes = updyn.ModeSet(found.frequency * [1.01, 0.99, 1.0], shapes, sensors)
        updyn.write_modes(modes, tmp_path / f"{name}.unv")

    def make(table: str, modes: str = "modes") -> Path:
        path = tmp_path / "job.toml"
        path.write_text(JOB.format(table=table, modes=f"{modes}.unv"))
        return path

    return make


def test_updated_and_expanded_modes_are_written(job, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = run_job(load_job(job("[shapes]\nn = 3\n")), out)
    modes = updyn.read_modes(out / "modes-updated.nc")
    assert modes.digest == updyn.predict_modes(done.result, 3).digest
    assert modes.dofs == done.result.model.dofs
    coarse = updyn.read_modes(out / "modes-updated.unv").shapes
    np.testing.assert_allclose(np.abs(coarse), np.abs(modes.shapes), atol=1e-5)
    expanded = updyn.read_modes(out / "modes-expanded.nc")
    assert expanded.digest == updyn.expand_modes(done.result).modes.digest
    assert len(expanded.dofs) == 12
    text = SHAPES.summary(done.further["shapes"])
    assert "Modes of the updated structure at 12 DOFs" in text
    assert f"{modes.frequency[2]:.6g}" in text
    assert "Measured shapes expanded to 12 DOFs (local)" in text
    # A run without the table removes its files.
    run_job(load_job(job("")), out)
    assert not (out / "modes-updated.nc").exists()


def test_shapes_that_cannot_be_expanded_leave_the_others(job, tmp_path: Path) -> None:
    done = run_job(load_job(job("[shapes]\n", modes="few")), tmp_path / "out")
    found = done.further["shapes"]
    assert found.expansion is None
    text = SHAPES.summary(found)
    assert "The measured shapes are not expanded: expand_modes: 1 sensor for" in text
    assert (tmp_path / "out" / "modes-updated.unv").is_file()
    assert not (tmp_path / "out" / "modes-expanded.unv").exists()


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[shapes]\nn = 0\n", "n"),
        ('[shapes]\nexpand = "serp"\n', "serep"),
        ('[shapes]\ntest = "left"\n', "the job has one test only"),
    ],
)
def test_bad_tables_are_refused(job, table: str, message: str) -> None:
    with pytest.raises(JobError, match=message):
        load_job(job(table))
