"""Mesh files: groups, numbers, units, and what is refused."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest

import updyn
from bodies import rigid_inertia
from meshes import MSH, block
from places import DATA
from updyn.elements.mesh import read_mesh, structure_from_mesh
from updyn.elements.structure import PointMass, Shell, Solid, structure, tube
from updyn.errors import FormatError, ModelError, UpdynError

STEEL = {"E": 2.1e11, "rho": 7850.0, "nu": 0.3}


#: The same with triangles of six nodes.
CURVED = MSH.replace("2 1 2 2\n", "2 1 9 2\n").replace(
    "12 13 16\n7 12 16 15", "11 12 13 14 15 16\n7 12 16 15 20 21 40"
)

INP = """*HEADING
two bricks
*NODE
 101, 0., 0., 0.
 102, 1., 0., 0.
 103, 1., 1., 0.
 104, 0., 1., 0.
 105, 0., 0., 1.
 106, 1., 0., 1.
 107, 1., 1., 1.
 108, 0., 1., 1.
 205, 0., 0., 2.
 206, 1., 0., 2.
 207, 1., 1., 2.
 208, 0., 1., 2.
*ELEMENT, TYPE=C3D8, ELSET=lower
 1, 101, 102, 103, 104, 105, 106, 107, 108
*ELEMENT, TYPE=C3D8, ELSET=upper
 2, 105, 106, 107, 108, 205, 206, 207, 208
*NSET, NSET=base
 101, 102, 103, 104
"""


def written(folder: Path, text: str, name: str = "mesh.msh") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


LEGS = {"section": tube(0.05, 0.04), **STEEL}
PLATE = {"thickness": 0.01, **STEEL}


def test_a_mesh_of_gmsh_becomes_parts_with_its_own_node_numbers(tmp_path):
    path = written(tmp_path, MSH)
    model = structure_from_mesh(
        path,
        {"legs": LEGS, "top": PLATE, "tip": {"mass": 3.0}},
        unit="mm",
        grounded=["foot"],
        title="table",
    )
    nodes = {
        11: [0, 0, 0.5],
        12: [0.5, 0, 0.5],
        13: [1, 0, 0.5],
        14: [0, 1, 0.5],
        15: [0.5, 1, 0.5],
        16: [1, 1, 0.5],
    }
    nodes |= {40: [7e-3] * 3, 20: [0, 0, 0], 21: [1.0, 0, 0]}
    from updyn.elements.structure import Beam

    same = structure(
        nodes,
        [
            Beam("legs", [[20, 11], [21, 13]], **LEGS),
            Shell("top", [[11, 12, 15, 14]], **PLATE),
            Shell("top", [[12, 13, 16], [12, 16, 15]], **PLATE),
            PointMass("tip", 13, 3.0),
        ],
        grounded=[20, 21],
    )
    assert model.dofs.labels == same.dofs.labels
    assert set(model.groups) == set(same.groups)
    for name, group in same.groups.items():
        if group.stiffness is not None:
            assert (
                abs(group.stiffness - model.group(name).stiffness).max()
                < 1e-9 * abs(group.stiffness).max()
            )
        assert abs(group.mass - model.group(name).mass).max() < 1e-12
    assert model.title == "table"


def test_what_is_in_a_mesh_can_be_looked_at(tmp_path):
    mesh = read_mesh(written(tmp_path, MSH), unit="m")
    assert mesh.nodes.tolist() == [11, 12, 13, 14, 15, 16, 40, 20, 21]
    assert {name: {k: len(c) for k, c in kinds.items()} for name, kinds in mesh.groups.items()} == {
        "tip": {"vertex": 1},
        "legs": {"line": 2},
        "foot": {"line": 1},
        "top": {"quad": 1, "triangle": 2},
    }
    assert mesh.nodes_of("foot").tolist() == [20, 21]
    assert mesh.xyz[2].tolist() == [1000, 0, 500]


def test_an_abaqus_deck_keeps_its_numbers_and_sets(tmp_path):
    path = written(tmp_path, INP, "deck.inp")
    model = structure_from_mesh(
        path, {"lower": STEEL, "upper": STEEL | {"loss_factor": 0.02}}, unit="m"
    )
    assert list(model.groups) == ["lower", "upper"]
    assert model.group("upper").loss_factor == 0.02
    assert rigid_inertia(model)[0, 0] == pytest.approx(2 * 7850)
    assert set(model.dofs.nodes.tolist()) == {*range(101, 109), *range(205, 209)}
    upper = abs(model.group("upper").stiffness).sum(axis=0) > 0
    assert set(model.dofs.nodes[upper].tolist()) == {*range(105, 109), *range(205, 209)}
    held = structure_from_mesh(
        path, {"lower": STEEL, "upper": STEEL}, unit="m", grounded=["base", "205:X"]
    )
    assert held.n_dofs == 3 * 8 - 1


@pytest.mark.parametrize("name", ["mesh.vtu", "mesh.xdmf", "mesh22.msh", "mesh.msh"])
@pytest.mark.parametrize("nodes", [4, 8, 10, 20])
def test_solids_of_every_kind_come_through_files(tmp_path, nodes, name):
    """Node orders differ between formats; the frequencies do not."""
    xyz, elements = block((2, 1, 1), (1.0, 0.3, 0.2), nodes)
    kind = {4: "tetra", 8: "hexahedron", 10: "tetra10", 20: "hexahedron20"}[nodes]
    n = len(elements)
    tagged = (
        {"gmsh:physical": [np.full(n, 1)], "gmsh:geometrical": [np.full(n, 1)]}
        if name.endswith("msh")
        else {}
    )
    field = {"block": np.array([1, 3])} if name.endswith("msh") else {}
    entity = {"gmsh:dim_tags": np.tile([3, 1], (len(xyz), 1))} if name == "mesh.msh" else {}
    mesh = meshio.Mesh(
        xyz * 1e3, [(kind, elements - 1)], point_data=entity, cell_data=tagged, field_data=field
    )
    path = tmp_path / name
    kw = (
        {"file_format": "gmsh22" if "22" in name else "gmsh", "binary": False}
        if name.endswith("msh")
        else {}
    )
    if name == "mesh.xdmf":
        kw = {"data_format": "XML"}
    mesh.write(path, **kw)
    group = "block" if name.endswith("msh") else "all"
    model = structure_from_mesh(path, {group: STEEL}, unit="mm")
    same = structure(xyz, [Solid("all", elements, **STEEL)])
    np.testing.assert_allclose(
        updyn.modes(model, 9).frequency[6:], updyn.modes(same, 9).frequency[6:], rtol=1e-6
    )


def build(folder, text=MSH, name="mesh.msh", materials=None, **kw):
    given = {"legs": LEGS, "top": PLATE, "tip": {"mass": 3.0}} if materials is None else materials
    return structure_from_mesh(
        written(folder, text, name), given, **{"unit": "mm", "grounded": ["foot"]} | kw
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"unit": "ft"}, "unit 'ft': valid: 'm', 'mm', 'cm', 'in'"),
        ({"materials": {"legs": LEGS, "tip": {"mass": 1.0}}}, "group 'top' (1 quad, 2 triangle) has no material"),
        ({"materials": {"legs": LEGS, "tops": PLATE}}, "no group 'tops'; did you mean 'top'?"),
        ({"grounded": ["fooot"]}, "grounded: no group 'fooot'; did you mean 'foot'?"),
        ({"grounded": []}, "group 'foot' (1 line) has no material"),
        ({"leave_out": ["legz"]}, "no group 'legz'; did you mean 'legs'?"),
        (
            {"materials": {"legs": LEGS, "top": STEEL, "tip": {"mass": 1.0}}},
            "material of group 'top', a Shell: 'thickness' is missing",
        ),
        (
            {"materials": {"legs": LEGS, "top": PLATE | {"thicknes": 1}, "tip": {"mass": 1.0}}},
            "material of group 'top', a Shell: no key 'thicknes'; did you mean 'thickness'?",
        ),
        ({"materials": {"legs": LEGS, "top": 3, "tip": {"mass": 1.0}}}, "material of group 'top': 3; expected"),
        ({"text": CURVED}, "group 'top' has 2 cells of kind 'triangle6'; did you mean 'triangle'?"),
        ({"text": MSH.replace("1000 1000 500 1 7 0", "1000 1000 500 0 0")}, "mesh.msh: "),
        ({"text": MSH[:300]}, "mesh.msh: the nodes cannot be read"),
        ({"text": MSH[:-60]}, "mesh.msh: "),
        ({"text": MSH.replace("4.1 0 8", "4.1 1 8")}, "a binary .msh: its node numbers are not read; save it as text"),
        ({"text": "solid\n", "name": "mesh.xyz"}, "not a readable mesh"),
        ({"text": MSH, "name": "mesh.vtu"}, "not a readable mesh"),
        ({"ungrouped": "drop"}, "ungrouped 'drop': valid: 'error', 'leave out'"),
    ],
)  # fmt: skip
def test_what_cannot_be_built_is_named(tmp_path, given, said, capfd):
    with pytest.raises(UpdynError, match=re.escape(said)):
        build(tmp_path, **given)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        (", ELSET=upper", "", 18, "*ELEMENT without ELSET, but others have one"),
        (
            "ELSET=upper",
            "ELSET=lower",
            18,
            "*ELEMENT with ELSET=lower, as on line 16, which would be lost",
        ),
        (" 205, 0.", "*NODE\n 205, 0.", 12, "a second *NODE block"),
        (
            "*HEADING\ntwo bricks",
            "*INCLUDE, INPUT=other.inp",
            1,
            "*INCLUDE: only flat decks are read",
        ),
        (" 101, 0., 0.", " abc, 0., 0.", 4, "expected a node number first"),
        (" 101, 0., 0.", f" {2**63}, 0., 0.", 4, "expected a node number first"),
        ("C3D8, ELSET=upper", "C3D8X, ELSET=upper", None, "not a readable mesh"),
    ],
)
def test_decks_that_would_be_read_wrongly_are_refused(tmp_path, old, new, line, said):
    path = written(tmp_path, INP.replace(old, new, 1), "deck.inp")
    with pytest.raises(FormatError, match=re.escape(said)) as caught:
        structure_from_mesh(path, {"lower": STEEL, "upper": STEEL}, unit="m")
    assert caught.value.line == line


def test_a_cell_in_two_groups_is_an_error(tmp_path):
    path = written(tmp_path, INP + "*ELSET, ELSET=both\n 1, 2\n", "deck.inp")
    with pytest.raises(FormatError, match="occurs twice: in group 'lower' and in 'both'"):
        structure_from_mesh(path, {"lower": STEEL, "upper": STEEL, "both": STEEL}, unit="m")
    model = structure_from_mesh(
        path, {"lower": STEEL, "upper": STEEL}, unit="m", leave_out=["both"]
    )
    assert list(model.groups) == ["lower", "upper"]


def test_a_group_with_a_material_cannot_be_left_out(tmp_path):
    path = written(tmp_path, INP, "deck.inp")
    with pytest.raises(FormatError, match="group 'upper' has a material, but is omitted"):
        structure_from_mesh(path, {"lower": STEEL, "upper": STEEL}, unit="m", leave_out=["upper"])


def test_cells_in_no_group_are_an_error_unless_said(tmp_path):
    text = (
        INP.replace(", ELSET=lower", "").replace(", ELSET=upper", "") + "*ELSET, ELSET=lower\n 1\n"
    )
    path = written(tmp_path, text, "deck.inp")
    with pytest.raises(FormatError, match="cells in no group: 1 hexahedron"):
        structure_from_mesh(path, {"lower": STEEL}, unit="m")
    model = structure_from_mesh(path, {"lower": STEEL}, unit="m", ungrouped="leave out")
    assert model.n_dofs == 24


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FormatError, match="no such file"):
        read_mesh(tmp_path / "none.msh", unit="m")


def test_without_meshio_the_error_says_how_to_install_it(tmp_path, monkeypatch):
    path = written(tmp_path, MSH)
    monkeypatch.setitem(sys.modules, "meshio", None)
    monkeypatch.delitem(sys.modules, "updyn.foreign.mesh", raising=False)
    with pytest.raises(ModelError, match=re.escape('pip install "updyn[mesh]"')):
        read_mesh(path, unit="m")


def test_a_mesh_that_gmsh_wrote():
    path = DATA / "mesh" / "bar_hex20.msh"
    model = structure_from_mesh(path, {"steel bar": STEEL}, unit="mm", grounded=["clamp"])
    xyz, elements = block((4, 1, 2), (1.0, 0.1, 0.08), 20)
    held = (np.flatnonzero(xyz[:, 0] == 0) + 1).tolist()
    same = structure(xyz, [Solid("all", elements, **STEEL)], grounded=held)
    np.testing.assert_allclose(
        updyn.modes(model, 6).frequency, updyn.modes(same, 6).frequency, rtol=1e-7
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("\n13\n14\n", "\n13\n" + "9" * 30 + "\n"),
        ("2 1 0 6\n", "2 1 0 -6\n"),
        ("2 1 0 6\n", "2 1 0\n"),
    ],
)
def test_node_numbers_that_are_none_are_refused(tmp_path, old, new):
    assert old in MSH
    with pytest.raises(FormatError, match=r"mesh\.msh: the nodes cannot be read"):
        read_mesh(written(tmp_path, MSH.replace(old, new)), unit="m")


def test_a_node_number_that_stands_twice_is_refused(tmp_path):
    text = INP.replace(" 108, 0., 1., 1.\n", " 108, 0., 1., 1.\n 108, 0., 1., 1.5\n")
    with pytest.raises(FormatError, match="node 108 occurs twice"):
        read_mesh(written(tmp_path, text, "deck.inp"), unit="m")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"points": np.zeros(3)}, "positions: float64 of shape (3,); expected rows of 1 to 3"),
        ({"points": np.zeros((3, 4))}, "positions: float64 of shape (3, 4); expected rows of 1"),
        ({"points": np.array([["a", "b", "c"]] * 3)}, "positions: <U1 of shape (3, 3)"),
        ({"point_sets": {"base": np.array([0, -1])}}, "set 'base' has a nonexistent member"),
        ({"point_sets": {"base": np.array([0.5])}}, "set 'base': float64 of shape (1,)"),
        ({"cell_sets": {"top": [np.array([1])]}}, "group 'top' has a nonexistent member"),
        ({"physical": [np.array([7, 7])]}, "are not one for each cell"),
        ({"names": {"top": np.array([7])}}, "'top': expected its tag and dimension"),
    ],
)
def test_what_a_damaged_mesh_makes_of_meshio_is_refused(tmp_path, monkeypatch, given, said):
    """Read of such files, as of "2S2 2 7 7 2 5 3" in the elements of Gmsh 2.2."""
    good = {
        "points": np.eye(3),
        "cells": [["triangle", 2, np.array([[0, 1, 2]])]],
        "point_sets": {},
        "cell_sets": {},
        "physical": [np.array([7])],
        "names": {"top": np.array([7, 2])},
    }
    monkeypatch.setattr("updyn.elements.mesh.box.load", lambda *_, **__: {**good, **given})
    path = written(tmp_path, "not looked at", "mesh.vtk")
    with pytest.raises(FormatError, match=re.escape(said)):
        read_mesh(path, unit="m")
