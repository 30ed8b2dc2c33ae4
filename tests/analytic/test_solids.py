"""Solid elements against exact solutions of elasticity, beams and rods."""

from __future__ import annotations

import re
import sys
from math import pi, sqrt

import numpy as np
import pytest

import updyn
from bodies import deflection, rigid_inertia, rotation, strain_of_rigid_motions
from meshes import block
from updyn.elements.structure import Beam, PointMass, RigidLink, Shell, Solid, rectangle, structure
from updyn.errors import ModelError

E, RHO, NU = 2.1e11, 7850.0, 0.3
KINDS = pytest.mark.parametrize("nodes", [4, 8, 10, 20])


def ends(xyz: np.ndarray, axis: int = 0) -> tuple[list[int], list[int]]:
    """Node numbers at both ends of a block along an axis."""
    x = xyz[:, axis]
    return [(np.flatnonzero(np.isclose(x, end)) + 1).tolist() for end in (x.min(), x.max())]


@KINDS
def test_the_patch_test_holds_on_a_distorted_mesh(nodes):
    """A constant strain needs no force inside, and has the energy of the material."""
    size = (1.0, 0.8, 0.6)
    xyz, elements = block((3, 3, 3), size, nodes, skew=0.2)
    model = structure(xyz, [Solid("solid", elements, E, RHO, NU)])
    A = np.array([[1.0, 0.3, -0.2], [0.1, -0.7, 0.5], [0.4, 0.2, 0.6]]) * 1e-3
    u = (xyz @ A.T).ravel()
    force = (model.stiffness @ u).reshape(-1, 3)
    inside = ((xyz > 1e-9) & (xyz < np.array(size) - 1e-9)).all(axis=1)
    assert inside.sum() >= 8
    assert np.abs(force[inside]).max() < 1e-9 * np.abs(force).max()
    strain = (A + A.T) / 2
    lame, shear = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    energy = 0.5 * np.prod(size) * (lame * np.trace(strain) ** 2 + 2 * shear * (strain**2).sum())
    assert 0.5 * u @ (model.stiffness @ u) == pytest.approx(energy, rel=1e-10)


@KINDS
def test_a_free_solid_has_exactly_six_motions_without_energy(nodes):
    xyz, elements = block((2, 2, 2), (1.0, 0.8, 0.6), nodes, skew=0.2)
    model = structure(xyz @ rotation(4).T, [Solid("solid", elements, E, RHO, NU)])
    assert strain_of_rigid_motions(model) < 1e-12
    found = np.linalg.eigvalsh(model.stiffness.toarray()) / E
    assert (np.abs(found) < 1e-9).sum() == 6
    assert found[6] > 1e-4


@KINDS
def test_mass_centre_and_inertia_of_a_block(nodes):
    a, b, c = 1.0, 0.8, 0.6
    xyz, elements = block((2, 3, 2), (a, b, c), nodes, skew=0.2)
    found = rigid_inertia(
        structure(xyz - np.array([a, b, c]) / 2, [Solid("solid", elements, E, RHO, NU)])
    )
    mass = RHO * a * b * c
    np.testing.assert_allclose(found[:3, :3], mass * np.eye(3), rtol=1e-10, atol=1e-9 * mass)
    np.testing.assert_allclose(found[:3, 3:], 0.0, atol=1e-9 * mass)
    about = mass / 12 * np.array([b**2 + c**2, a**2 + c**2, a**2 + b**2])
    np.testing.assert_allclose(found[3:, 3:], np.diag(about), rtol=1e-10, atol=1e-9 * mass)


@KINDS
def test_a_lumped_mass_is_diagonal_positive_and_complete(nodes):
    xyz, elements = block((2, 2, 2), (1.0, 0.8, 0.6), nodes, skew=0.2)
    M = structure(xyz, [Solid("solid", elements, E, RHO, NU, lumped=True)]).mass
    assert (M - np.diag(M.diagonal())).max() == 0.0
    assert M.diagonal().min() > 0
    assert M.diagonal().sum() == pytest.approx(3 * RHO * 0.48)


@pytest.mark.parametrize(("nodes", "error"), [(4, 3e-3), (8, 3e-3), (10, 3e-5), (20, 3e-5)])
def test_a_free_rod_stretches_as_in_rao(nodes, error):
    """f_n = n / (2 L) sqrt(E / rho), nu = 0: Rao, Mechanical Vibrations, 5th ed. 2011, section 8.3, free-free."""
    length = 1.5
    xyz, elements = block((24, 1, 1), (length, 0.02, 0.02), nodes)
    across = [f"{k}:{d}" for k in range(1, len(xyz) + 1) for d in "YZ"]
    rod = structure(xyz, [Solid("rod", elements, E, RHO, 0.0)], grounded=across)
    exact = np.arange(1, 3) / (2 * length) * sqrt(E / RHO)
    # Linear functions: (k h)^2 / 24 from above, 2.9e-3 of the second (Petyt 2010, section 3.3).
    np.testing.assert_allclose(updyn.modes(rod, 3).frequency[1:], exact, rtol=error)


@pytest.mark.parametrize(
    ("nodes", "cells", "error"), [(20, 12, 2e-3), (10, 12, 6e-3), (8, 12, 0.025), (8, 24, 0.012)]
)
def test_a_cantilever_bends_as_a_timoshenko_beam(nodes, cells, error):
    size = (1.0, 0.08, 0.12)
    xyz, elements = block((cells, 2, 2), size, nodes)
    solid = structure(xyz, [Solid("solid", elements, E, RHO, 0.0)], grounded=ends(xyz)[0])
    line = np.column_stack([np.linspace(0, 1, 61), np.zeros((61, 2))])
    section = rectangle(size[1], size[2], nu=0.0)
    pairs = np.column_stack([np.arange(1, 61), np.arange(2, 62)])
    beam = structure(
        line, [Beam("b", pairs, E, RHO, section, nu=0.0, orientation=[0, 1, 0])], grounded=[1]
    )
    expected = updyn.modes(beam, 4).frequency
    np.testing.assert_allclose(updyn.modes(solid, 4).frequency, expected, rtol=error)


def test_eight_node_bricks_bend_without_locking():
    """One layer of long bricks, P L^3 / 3 E I + P L / (kappa G A); without incompatible modes 0.1 of that."""
    xyz, elements = block((10, 1, 1), (2.0, 0.05, 0.05), 8)
    clamped, tip = ends(xyz)
    model = structure(xyz, [Solid("solid", elements, E, RHO, 0.0)], grounded=clamped)
    found = deflection(model, {f"{k}:Z": 0.25 for k in tip})[f"{tip[0]}:Z"]
    exact = 2.0**3 / (3 * E * 0.05**4 / 12) + 2.0 / (10 / 12 * E / 2 * 0.05**2)
    assert found == pytest.approx(exact, rel=0.01)


@pytest.mark.parametrize(
    ("nodes", "cells", "error"),
    [(20, 3, 2e-3), (20, 6, 2e-4), (10, 3, 5e-3), (8, 8, 0.01), (4, 8, 0.04)],
)
def test_a_free_cube_has_the_modes_of_lame(nodes, cells, error):
    """f = c_s / (sqrt(2) a) whatever nu, equivoluminal: Lame, Lecons sur la theorie de l'elasticite, 1852."""
    side = 0.3
    xyz, elements = block((cells,) * 3, (side,) * 3, nodes)
    cube = structure(xyz, [Solid("cube", elements, E, RHO, NU)])
    exact = sqrt(E / (2 * (1 + NU)) / RHO) / (sqrt(2) * side)
    found = updyn.modes(cube, 24).frequency
    assert np.abs(found / exact - 1).min() < error


def test_a_turned_solid_has_the_same_frequencies():
    xyz, elements = block((3, 1, 1), (1.0, 0.2, 0.3), 20, skew=0.1)
    clamped = ends(xyz)[0]
    solid = Solid("solid", elements, E, RHO, NU)
    before = updyn.modes(structure(xyz, [solid], grounded=clamped), 6).frequency
    after = updyn.modes(structure(xyz @ rotation(2).T, [solid], grounded=clamped), 6).frequency
    np.testing.assert_allclose(after, before, rtol=1e-8)


def test_nodes_of_solids_have_three_dofs_and_lines_run_outside():
    xyz, elements = block((2, 2, 2), (1.0, 1.0, 1.0), 8)
    model = structure(xyz, [Solid("solid", elements, E, RHO)])
    assert model.n_dofs == 3 * 27
    assert len(model.geometry.lines) == 48  # of 54 edges, the six at the middle node lie inside
    middle = int(np.flatnonzero((xyz == 0.5).all(axis=1))[0]) + 1
    assert middle not in model.geometry.lines


def test_a_rigid_link_holds_a_motor_on_a_block():
    """A face of three-DOF nodes follows a master that carries mass and inertia."""
    xyz, elements = block((4, 2, 2), (0.4, 0.1, 0.1), 20)
    clamped, face = ends(xyz)
    nodes = np.vstack([xyz, [0.5, 0.05, 0.05]])
    master = len(nodes)
    motor = PointMass("motor", master, 30.0, (0.1, 0.2, 0.3))
    model = structure(
        nodes,
        [Solid("solid", elements, E, RHO, NU), motor],
        links=[RigidLink(master, face)],
        grounded=clamped,
    )
    assert [d for d in model.dofs.labels if d.startswith(f"{master}:")] == [
        f"{master}:{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")
    ]
    k = E * 0.01 / 0.4  # along, the end sections hardly deform
    own = sqrt(k / (30.0 + RHO * 0.004 / 3)) / (2 * pi)
    found = updyn.modes(model, 8)
    along = np.abs(found.shapes[model.dofs.match([f"{master}:X"]).index[0]])
    assert found.frequency[int(np.argmax(along))] == pytest.approx(own, rel=0.03)


def test_solids_and_shells_share_nodes():
    xyz, elements = block((2, 2, 2), (1.0, 1.0, 1.0), 8)
    top = np.flatnonzero(xyz[:, 2] == 1.0) + 1
    I = top[np.lexsort((xyz[top - 1, 1], xyz[top - 1, 0]))].reshape(3, 3)
    quads = np.stack([I[:-1, :-1], I[1:, :-1], I[1:, 1:], I[:-1, 1:]], axis=-1).reshape(-1, 4)
    both = structure(xyz, [Solid("block", elements, E, RHO), Shell("skin", quads, E, RHO, 0.01)])
    assert both.n_dofs == 3 * 27 + 3 * 9
    assert rigid_inertia(both)[0, 0] == pytest.approx(RHO * 1.01)
    assert strain_of_rigid_motions(both) < 1e-12


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (
            lambda e: Solid("s", e[:, [1, 0, 2, 3, 4, 5, 6, 7]], E, RHO),
            "is turned inside out or has no volume",
        ),
        (
            lambda e: Solid("s", e[:, [4, 5, 6, 7, 0, 1, 2, 3]], E, RHO),
            "solid 's': the element of nodes [2,",
        ),
        (lambda e: Solid("s", e, E, RHO, nu=0.5), "solid 's': nu 0.5; expected below 0.5"),
        (
            lambda e: Solid("s", e[:, :6], E, RHO),
            "expected (m, 4) or (m, 8) or (m, 10) or (m, 20) node numbers",
        ),
        (lambda e: Solid("s", e, E, RHO, lumped=1), "solid 's': lumped 1; expected True or False"),
    ],
)
def test_what_cannot_be_built_is_named(build, said):
    xyz, elements = block((2, 1, 1), (1.0, 1.0, 1.0), 8)
    with pytest.raises(ModelError, match=re.escape(said)):
        structure(xyz, [build(elements)])


def test_without_scikit_fem_the_error_says_how_to_install_it(monkeypatch):
    from updyn.elements.structure import solids as solid

    solid._shape.cache_clear()
    monkeypatch.setitem(sys.modules, "skfem", None)
    xyz, elements = block((1, 1, 1), (1.0, 1.0, 1.0), 8)
    with pytest.raises(ModelError, match=re.escape('pip install "updyn[structures]"')):
        structure(xyz, [Solid("s", elements, E, RHO)])
