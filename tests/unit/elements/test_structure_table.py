"""Structures from tables of a job file."""

from __future__ import annotations

import copy
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import updyn
from meshes import block
from updyn.elements.constraints import Equation
from updyn.elements.structure import (
    Beam,
    PointMass,
    RigidLink,
    Section,
    Shell,
    Solid,
    Spring,
    Truss,
    rectangle,
    structure,
    structure_from_table,
    tube,
)
from updyn.errors import JobError, ModelError
from updyn.job import load_job, prepare

TABLE = """
kind = "structure"
title = "Table with a mast"
grounded = [1, "2:X", "2:Y", "2:Z", 4]
nodes = { 1 = [0, 0, 0], 2 = [1, 0, 0], 3 = [1, 1, 0], 4 = [0, 1, 0], 5 = [0, 0, 1], 6 = [1, 0, 1.5], 7 = [1, 1, 1] }

[[beam]]
name = "mast"
connectivity = [[2, 6]]
E = 2.1e11
rho = 7850
section = { shape = "tube", outer = 0.1, inner = 0.08 }

[[beam]]
name = "rim"
connectivity = [[1, 2], [3, 4]]
E = 2.1e11
rho = 7850
orientation = [0, 0, 1]
section = { shape = "rectangle", height = 0.1, width = 0.05 }
loss_factor = 0.01

[[beam]]
name = "edge"
connectivity = [[2, 3]]
E = 2.1e11
rho = 7850
section = { A = 1e-3, Iyy = 1e-7, Izz = 1e-7, J = 1e-7 }

[[truss]]
name = "stay"
connectivity = [[6, 3], [6, 4]]
E = 2.1e11
rho = 7850
A = 1e-4

[[shell]]
name = "top"
connectivity = [[1, 2, 3, 4]]
E = 7e10
rho = 2700
thickness = 0.01

[[spring]]
name = "pad"
first = 3
stiffness = [0, 0, 1e6, 0, 0, 0]

[[mass]]
name = "load"
node = 7
mass = 12.5
inertia = [0.1, 0.2, 0.3]

[[link]]
master = 3
slaves = [7]

[[equation]]
dof = "6:RZ"
terms = { "2:RZ" = 1.0 }
"""

STEEL = {"E": 2.1e11, "rho": 7850}


def table() -> dict:
    return tomllib.loads(TABLE)


def test_a_table_says_what_the_call_says():
    nodes = {int(k): v for k, v in table()["nodes"].items()}
    parts = [
        Beam("mast", [[2, 6]], **STEEL, section=tube(0.1, 0.08)),
        Beam(
            "rim",
            [[1, 2], [3, 4]],
            **STEEL,
            section=rectangle(0.1, 0.05),
            orientation=[0, 0, 1],
            loss_factor=0.01,
        ),
        Beam("edge", [[2, 3]], **STEEL, section=Section(1e-3, 1e-7, 1e-7, 1e-7)),
        Truss("stay", [[6, 3], [6, 4]], **STEEL, A=1e-4),
        Shell("top", [[1, 2, 3, 4]], 7e10, 2700, 0.01),
        Spring("pad", 3, stiffness=[0, 0, 1e6, 0, 0, 0]),
        PointMass("load", 7, 12.5, [0.1, 0.2, 0.3]),
    ]
    same = structure(
        nodes,
        parts,
        links=[RigidLink(3, [7])],
        equations=[Equation("6:RZ", {"2:RZ": 1.0})],
        grounded=[1, "2:X", "2:Y", "2:Z", 4],
    )
    found = structure_from_table(table())
    assert found.title == "Table with a mast"
    assert found.dofs == same.dofs
    assert list(found.groups) == list(same.groups)
    for name, group in same.groups.items():
        assert group.loss_factor == found.group(name).loss_factor
        for kind in ("stiffness", "mass"):
            a, b = getattr(group, kind), getattr(found.group(name), kind)
            assert (a is None) == (b is None)
            assert a is None or abs(a - b).max() == 0.0


def test_solids_in_a_table():
    xyz, elements = block((1, 1, 1), (1.0, 1.0, 1.0), 8)
    nodes = {str(k): x for k, x in enumerate(xyz.tolist(), 1)}
    row = {
        "name": "block",
        "connectivity": elements.tolist(),
        "E": 2.1e11,
        "rho": 7850,
        "lumped": True,
    }
    found = structure_from_table({"nodes": nodes, "solid": [row]})
    same = structure(xyz, [Solid("block", elements, **STEEL, lumped=True)])
    assert abs(found.mass - same.mass).max() == 0.0


@pytest.mark.parametrize(
    ("place", "value", "said"),
    [
        (("beams",), [], "model: no key 'beams'; did you mean 'beam'?"),
        (("kind",), "frame", "model: kind 'frame'; expected 'structure'"),
        (
            ("nodes",),
            [[0, 0, 0]],
            "model: nodes holds list; expected a table from node number to position",
        ),
        (("nodes", "a"), [0, 0, 0], "model.nodes: 'a'; expected a node number"),
        (
            ("nodes", "2"),
            [0, 0],
            "model.nodes: node 2 has the position [0, 0]; expected three numbers",
        ),
        (("nodes", "02"), [0, 0, 0], "model.nodes: node 2 occurs twice"),
        (
            ("beam",),
            {"name": "b"},
            "model: beam holds dict; expected an array of tables, [[model.beam]]",
        ),
        (("beam", 0, "rh"), 1, "model.beam, number 1: no key 'rh'; did you mean 'rho'?"),
        (("beam", 1, "section"), "tube", "model.beam, number 2: section 'tube'; expected a table"),
        (("beam", 1, "section"), {"shape": "tub"}, "section.shape 'tub': did you mean 'tube'?"),
        (
            ("beam", 1, "section"),
            {"shape": "tube"},
            "model.beam, number 2: section, a tube: 'outer' is missing",
        ),
        (
            ("beam", 2, "section", "Iy"),
            1.0,
            "model.beam, number 3: section: no key 'Iy'; did you mean 'Iyy'?",
        ),
        (("beam", 0, "E"), "steel", "beam 'mast': E 'steel'; expected a finite number"),
        (("link", 0, "slave"), 3, "model.link, number 1: no key 'slave'; did you mean 'slaves'?"),
        (("equation", 0), 5, "model.equation, number 1: expected a table, found 5"),
        (("equation", 0, "terms"), [1], "model.equation, number 1: terms [1]; expected a table"),
        (("grounded",), 1, "model: grounded 1; expected an array of DOFs and node numbers"),
        (("mass", 0, "node"), 70, "mass 'load': node 70 is not among the 7 nodes"),
    ],
)
def test_what_is_wrong_is_named(place, value, said):
    data = copy.deepcopy(table())
    inner = data
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    with pytest.raises(ModelError, match=re.escape(said)):
        structure_from_table(data)


JOB = """
[model]
kind = "structure"
grounded = [1]

[model.nodes]
1 = [0, 0, 0]
2 = [0.5, 0, 0]
3 = [1.0, 0, 0]

[[model.beam]]
name = "root"
connectivity = [[1, 2]]
E = 7e10
rho = 2700
section = { shape = "tube", outer = 0.03 }
loss_factor = 0.01

[[model.beam]]
name = "end"
connectivity = [[2, 3]]
E = 7e10
rho = 2700
section = { shape = "tube", outer = 0.03 }
loss_factor = 0.01

[test]
file = "test.uff"

[[parameter]]
groups = ["root", "end"]
quantity = "stiffness"
"""


def test_a_job_updates_a_structure(tmp_path: Path):
    start = structure_from_table(tomllib.loads(JOB)["model"])
    truth = start.scaled({"root": {"stiffness": 0.8}, "end": {"stiffness": 1.1}})
    freq = np.linspace(10, 400, 196)
    frf = updyn.response(truth, freq, ["2:Z", "3:Z"], ["3:Z"], quantity="accelerance")
    updyn.write_frf(frf, tmp_path / "test.uff")
    (tmp_path / "job.toml").write_text(JOB, encoding="utf-8")
    prepared = prepare(load_job(tmp_path / "job.toml"))
    result = updyn.update(prepared.model, prepared.frf, prepared.parameters)
    assert result.values["root.stiffness"] == pytest.approx(0.8, rel=1e-6)
    assert result.values["end.stiffness"] == pytest.approx(1.1, rel=1e-6)


def test_a_job_says_where_it_is_wrong(tmp_path: Path):
    (tmp_path / "job.toml").write_text(
        JOB.replace("grounded = [1]", "grounded = [9]"), encoding="utf-8"
    )
    with pytest.raises(JobError, match="grounded: node 9 is not among the 3 nodes") as caught:
        prepare(load_job(tmp_path / "job.toml"))
    assert caught.value.line == 4
