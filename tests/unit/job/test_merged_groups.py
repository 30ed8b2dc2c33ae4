"""`groups` of `[model]`: merged groups of a file or a builder, and their updated properties."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.demos import find_demo
from updyn.errors import JobError
from updyn.group import Group
from updyn.io.hdf5 import read_model
from updyn.io.nastran.cards import parse, read_lines
from updyn.job import load_job, prepare, run_job
from updyn.model import Model
from updyn.store.result import read_result

JOB = """[model]
{model}
[test]
file = "{test}"
[[parameter]]
groups = "{groups}"
quantity = "stiffness"
[method]
name = "output-error"
[output]
report = false
{output}"""
DECK = """BEGIN BULK
SPOINT,1,2
CELAS2,1,100.,1
CELAS2,2,200.,1,,2
CMASS2,11,1.5,1
CMASS2,12,2.5,2
ENDDATA
"""


@pytest.fixture
def folder(tmp_path):
    find_demo("chain").write_inputs(tmp_path)
    return tmp_path


@pytest.fixture
def job(folder):
    def make(model, *, groups="all", test="chain.uff", output=""):
        path = folder / "job.toml"
        path.write_text(JOB.format(model=model, groups=groups, test=test, output=output))
        return load_job(path)

    return make


def test_groups_of_a_file(job):
    ready = prepare(job('file = "chain.h5"\ngroups = { root = "part1-3" }'))
    assert ready.parameters.names == ["root.stiffness", "part4.stiffness"]


def test_groups_of_a_builder(job, folder):
    segments = "segments = [{ name = 'a1', start = 0.0, end = 0.4 }, { name = 'a2', start = 0.4, end = 1.0 }]\n"
    beam = "kind = 'beam'\nlength = 1.0\nE = 7e10\nrho = 2700.0\nwidth = 0.05\nheight = 0.01\n"
    beam += "n_elements = 4\n" + segments
    values = np.ones((3, 1, 1)) * 1e-3
    frf = updyn.FRF(np.array([5.0, 6.0, 7.0]), values, ["2:Z"], ["2:Z"], "receptance")
    updyn.write_frf(frf, folder / "beam.npz")
    ready = prepare(job(beam + 'groups = { beam = "a*" }', test="beam.npz"))
    assert ready.parameters.names == ["beam.stiffness"]


@pytest.mark.parametrize(
    "groups",
    ['{ root = "port1-3" }', '{ root = "part1", tip = "part*" }', "{ root = 3 }", '"part*"'],
)
def test_an_error_names_the_line(job, groups):
    with pytest.raises(JobError, match=r"job.toml:3: .*groups"):
        prepare(job(f'file = "chain.h5"\ngroups = {groups}'))


def test_updated_properties_are_those_of_the_deck(job, folder):
    (folder / "springs.bdf").write_text(DECK)
    truth = updyn.read_model(folder / "springs.bdf").scaled(
        {name: {"stiffness": 1.1} for name in ("CELAS2 1", "CELAS2 2")}
    )
    frf = updyn.response(truth, np.linspace(0.05, 0.5, 30), ["1:X", "2:X"], ["1:X"])
    updyn.write_frf(frf, folder / "springs.npz")
    model = 'file = "springs.bdf"\ngroups = { springs = "CELAS2 1-2" }'
    ready = job(model, test="springs.npz", groups="springs", output='properties = "new.bdf"')
    out = folder / "results"
    run_job(ready, out=out)
    cards = parse(read_lines(out / "new.bdf"))
    written = {card.integer(0): card.real(1) for card in cards}
    assert written == pytest.approx({1: 110.0, 2: 220.0}, rel=1e-6)
    for stored in (read_model(out / "model.h5"), read_result(out / "run.nc").model):
        members = stored.group("springs").origin.members
        assert members == {"CELAS2 1": ("stiffness",), "CELAS2 2": ("stiffness",)}


def test_members_are_stored_with_the_matrices_that_they_have(tmp_path):
    groups = {
        "größe 1": Group(np.eye(1), np.eye(1)),
        "größe 2": Group(mass=np.eye(1), viscous=np.eye(1)),
    }
    model = Model.from_groups(groups, ["1:X"]).merge_groups({"all of it": "größe 1-2"})
    updyn.write_model(model, tmp_path / "model.h5")
    assert updyn.read_model(tmp_path / "model.h5").group("all of it").origin.members == {
        "größe 1": ("stiffness", "mass"),
        "größe 2": ("mass", "viscous"),
    }
