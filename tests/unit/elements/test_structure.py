"""Structures in space: mass, rigid motions, turning, links, springs, what is refused."""

from __future__ import annotations

import re
import sys
import tomllib
import warnings
from importlib import metadata

import numpy as np
import pytest

import updyn
from bodies import deflection, rigid_inertia, rotation, strain_of_rigid_motions, turned
from places import ROOT
from updyn.elements.constraints import Equation
from updyn.elements.structure import (
    Beam,
    PointMass,
    RigidLink,
    Section,
    Shell,
    Spring,
    Truss,
    rectangle,
    structure,
    tube,
)
from updyn.errors import DofError, ModelError, UpdynError

E, RHO = 2.1e11, 7850.0
TALL = rectangle(0.1, 0.04)
NODES = {
    10: [0, 0, 0],
    11: [1.0, 0.2, 0.1],
    12: [1.5, 1.2, 0.3],
    13: [1.7, 1.0, 1.4],
    14: [0.1, 1.0, 2.0],
}
PARTS = [
    Beam("legs", [[10, 11], [11, 12]], E, RHO, TALL, orientation=[0, 0, 1.0], loss_factor=0.01),
    Beam("mast", [[12, 13]], E, RHO, tube(0.08, 0.07)),
    Truss("stay", [[11, 13], [13, 14], [14, 11], [14, 12]], E, RHO, 2e-4),
    Spring(
        "joint",
        10,
        14,
        (1e5, 2e5, 3e5, 4e3, 5e3, 6e3),
        axes=[[1, 1, 0], [0, 1, 1]],
        viscous=(1, 2, 3, 4, 5, 6),
    ),
    Spring("strut", 11, 12, (1e6, 0, 0, 1e3, 0, 0), axes="line"),
    PointMass(
        "motor",
        13,
        40.0,
        inertia=[[2.0, 0.1, 0], [0.1, 1.5, -0.2], [0, -0.2, 1.0]],
        offset=[0.1, -0.2, 0.3],
    ),
]


def test_a_free_structure_has_exactly_six_motions_without_energy():
    model = structure(NODES, PARTS)
    assert strain_of_rigid_motions(model) < 1e-12
    K = model.stiffness.toarray()
    scale = np.sqrt(np.diag(K))
    values = np.linalg.eigvalsh(K / np.outer(scale, scale))
    assert (values < 1e-10).sum() == 6
    C = model.viscous.toarray()
    assert (
        np.linalg.matrix_rank(C, tol=1e-9) == 6
    )  # one damper of six directions, none of them rigid


def test_mass_centre_and_inertia_are_those_of_the_body():
    found = rigid_inertia(structure(NODES, PARTS))
    expected = np.zeros((3, 3))

    def add(mass: float, at: np.ndarray, about_own: np.ndarray) -> None:
        expected[...] += about_own + mass * (at @ at * np.eye(3) - np.outer(at, at))

    mass, first = 0.0, np.zeros(3)
    for part in PARTS:
        if isinstance(part, Spring):
            continue
        if isinstance(part, PointMass):
            at = np.array(NODES[part.node]) + part.offset
            add(part.mass, at, part.inertia)
            mass, first = mass + part.mass, first + part.mass * at
            continue
        for i, j in part.connectivity.tolist():
            a, b = np.array(NODES[i], dtype=float), np.array(NODES[j], dtype=float)
            length, x = np.linalg.norm(b - a), (b - a) / np.linalg.norm(b - a)
            A = part.A if isinstance(part, Truss) else part.section.A
            m = RHO * A * length
            about = m * length**2 / 12 * (np.eye(3) - np.outer(x, x))
            if isinstance(part, Beam):  # Izz is the integral of y^2: about z
                z = np.cross(x, [0, 0, 1.0])
                z = z / np.linalg.norm(z)
                y = np.cross(z, x)
                s = part.section
                about += (
                    RHO
                    * length
                    * (
                        s.Izz * np.outer(z, z)
                        + s.Iyy * np.outer(y, y)
                        + (s.Iyy + s.Izz) * np.outer(x, x)
                    )
                )
            add(m, (a + b) / 2, about)
            mass, first = mass + m, first + m * (a + b) / 2
    np.testing.assert_allclose(found[:3, :3], mass * np.eye(3), rtol=1e-10, atol=1e-10 * mass)
    np.testing.assert_allclose(found[3:, 3:], expected, rtol=1e-10, atol=1e-10 * mass)
    # Momentum of a unit turn: omega x (mass times centre).
    np.testing.assert_allclose(found[:3, 3:], np.cross(np.eye(3), first).T, atol=1e-10 * mass)


@pytest.mark.parametrize("seed", range(3))
def test_a_turned_structure_has_the_same_frequencies(seed):
    Q = rotation(seed)
    nodes = {k: Q @ np.array(x, dtype=float) for k, x in NODES.items()}
    before = updyn.modes(structure(NODES, PARTS, grounded=[10]), 12).frequency
    after = updyn.modes(
        structure(nodes, [turned(p, Q) for p in PARTS], grounded=[10]), 12
    ).frequency
    np.testing.assert_allclose(after, before, rtol=1e-9)


def test_parts_of_one_name_are_one_group_and_sum_up():
    two = [Beam("a", [[10, 11]], E, RHO, tube(0.1)), Beam("a", [[11, 12]], E, RHO, tube(0.1))]
    one = structure(NODES, [Beam("a", [[10, 11], [11, 12]], E, RHO, tube(0.1))])
    both = structure(NODES, two)
    assert list(both.groups) == ["a"]
    assert abs(one.stiffness - both.stiffness).max() == 0.0
    assert list(structure(NODES, PARTS).groups) == [
        "legs",
        "mast",
        "stay",
        "joint",
        "strut",
        "motor",
    ]


def test_a_part_may_be_without_mass():
    model = structure(
        NODES, [Beam("b", [[10, 11]], E, 0.0, tube(0.1)), PointMass("m", 11, 2.0)], grounded=[10]
    )
    assert model.group("b").mass is None
    assert rigid_inertia(model)[0, 0] == pytest.approx(2.0)


def test_dofs_that_nothing_touches_are_left_out():
    model = structure(NODES, [Truss("t", [[10, 11], [11, 12], [12, 10]], E, RHO, 1e-4)])
    assert model.dofs.labels == [f"{n}:{d}" for n in (10, 11, 12) for d in "XYZ"]
    assert model.geometry.nodes.tolist() == [10, 11, 12, 13, 14]
    assert model.geometry.lines.tolist() == [[10, 11], [10, 12], [11, 12]]
    chain = [Spring("s", 10, stiffness=(5.0, 0, 0, 0, 0, 0)), PointMass("m", 10, 2.0)]
    assert structure(NODES, chain).dofs.labels == ["10:X", "10:Y", "10:Z"]
    turn = structure(NODES, [Spring("s", 10, stiffness=(0, 0, 0, 0, 0, 7.0))])
    assert turn.dofs.labels == ["10:RZ"]
    assert turn.stiffness.toarray().tolist() == [[7.0]]


# -- springs, masses, links --------------------------------------------------------------------------------
def test_a_spring_between_nodes_apart_acts_half_way():
    """Across a gap d a shear spring k turns its ends: moments k d / 2 each."""
    nodes = [[0, 0, 0], [2.0, 0, 0]]
    model = structure(
        nodes, [Spring("s", 1, 2, (0, 10.0, 0, 0, 0, 0)), PointMass("m", 2, 1.0, (1.0, 1.0, 1.0))]
    )
    K = model.stiffness.toarray()
    at = model.dofs.match(["1:Y", "1:RZ", "2:Y", "2:RZ"]).index
    v = np.array(
        [-1.0, -1.0, 1.0, -1.0]
    )  # slip at the middle from Y and RZ of both ends, arms of 1 m
    np.testing.assert_allclose(K[np.ix_(at, at)], 10.0 * np.outer(v, v), atol=1e-12)


def test_a_line_spring_pulls_along_the_line_only():
    nodes = [[0, 0, 0], [3.0, 0, 4.0]]
    model = structure(
        nodes, [Spring("s", 1, 2, (10.0, 0, 0, 0, 0, 0), axes="line"), PointMass("m", 2, 1.0)]
    )
    at = model.dofs.match(["2:X", "2:Y", "2:Z"]).index
    x = np.array([0.6, 0, 0.8])
    np.testing.assert_allclose(
        model.stiffness.toarray()[np.ix_(at, at)], 10.0 * np.outer(x, x), atol=1e-12
    )
    assert not any(":R" in label for label in model.dofs.labels)


def test_an_offset_mass_is_a_mass_at_the_end_of_a_rigid_link():
    beams = Beam("b", [[10, 11], [11, 12]], E, RHO, tube(0.1))
    offset = np.array([0.3, -0.2, 0.5])
    inertia = (0.4, 0.5, 0.6)
    direct = structure(NODES, [beams, PointMass("m", 12, 20.0, inertia, offset)], grounded=[10])
    nodes = NODES | {99: np.array(NODES[12]) + offset}
    linked = structure(
        nodes,
        [beams, PointMass("m", 99, 20.0, inertia)],
        links=[RigidLink(12, [99])],
        grounded=[10],
    )
    assert linked.dofs.labels == direct.dofs.labels
    assert abs(linked.mass - direct.mass).max() < 1e-12 * abs(direct.mass).max()
    # Parallel axes, by hand: about X, Ixx + m (dy^2 + dz^2).
    at = direct.dofs.match(["12:RX"]).index[0]
    bare = structure(NODES, [beams], grounded=[10])
    added = direct.mass.toarray()[at, at] - bare.mass.toarray()[at, at]
    assert added == pytest.approx(0.4 + 20.0 * (0.2**2 + 0.5**2))


def test_a_rigid_link_carries_nodes_of_trusses_by_their_three_dofs():
    nodes = [
        [0, 0, 0],
        [1, 0, 0],
        [0, 1, 0],
        [0.2, 0.2, 1.0],
        [1.2, 0.2, 1.0],
        [0.2, 1.2, 1.0],
        [0.5, 0.5, 1.5],
    ]
    bars = Truss("bars", [[1, 4], [2, 5], [3, 6], [1, 5], [2, 6], [3, 4]], E, RHO, 1e-4)
    model = structure(nodes, [bars], links=[RigidLink(7, [4, 5, 6])], grounded=[1, 2, 3])
    assert model.dofs.labels == [f"7:{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    assert np.linalg.eigvalsh(model.stiffness.toarray())[0] > 0
    chained = structure(
        [*nodes, [0, 0, 3.0]],
        [bars],
        links=[RigidLink(8, [7]), RigidLink(7, [4, 5, 6])],
        grounded=[1, 2, 3],
    )
    assert chained.dofs.labels == [f"8:{d}" for d in ("X", "Y", "Z", "RX", "RY", "RZ")]
    np.testing.assert_allclose(
        updyn.modes(chained, 6).frequency, updyn.modes(model, 6).frequency, rtol=1e-8
    )


def test_a_link_may_carry_some_directions_only():
    parts = [Beam("b", [[10, 11]], E, RHO, tube(0.1)), Spring("s", 10, stiffness=(1.0,) * 6)]
    nodes = {10: [0, 0, 0], 11: [1.0, 0, 0]}
    model = structure(nodes, parts, links=[RigidLink(10, [11], "Y")])
    assert "11:Y" not in model.dofs.labels
    assert "11:Z" in model.dofs.labels


def test_an_equation_ties_dofs():
    two = [
        Spring("a", 10, stiffness=(3.0, 0, 0, 0, 0, 0)),
        Spring("b", 11, stiffness=(5.0, 0, 0, 0, 0, 0)),
    ]
    model = structure(NODES, two, equations=[Equation("11:X", {"10:X": 2.0})])
    assert model.stiffness.toarray().tolist() == [[3.0 + 4 * 5.0]]
    mean = structure(
        NODES, two, equations=[Equation("11:X", {"13:X": 1.0}), Equation("10:X", {"13:X": 1.0})]
    )
    assert mean.dofs.labels == ["13:X"]
    assert mean.stiffness.toarray().tolist() == [[8.0]]


def test_grounds_hold_a_node_or_a_dof():
    beams = Beam("b", [[10, 11]], E, RHO, tube(0.1))
    both = structure(NODES, [beams], grounded=[10, "10:X", "10:-Y", 10])  # held twice is held
    assert both.dofs.labels[0] == "11:X"
    assert both.n_dofs == 6
    assert structure(NODES, [beams], grounded=[10]).dofs.labels[0] == "11:X"
    assert structure(NODES, [beams], grounded=["10:X", "10:RZ"]).dofs.labels[:4] == [
        "10:Y",
        "10:Z",
        "10:RX",
        "10:RY",
    ]
    assert deflection(structure(NODES, [beams], grounded=[10]), {"11:X": 1.0})["11:X"] > 0


# -- what is refused ---------------------------------------------------------------------------------------
def beam(**changes):
    given = {
        "name": "b",
        "connectivity": [[10, 11]],
        "E": E,
        "rho": RHO,
        "section": tube(0.1),
    } | changes
    return lambda: structure(NODES, [Beam(**given)])


def free(*parts, **kw):
    return lambda: structure(NODES, list(parts) or [Beam("b", [[10, 11]], E, RHO, tube(0.1))], **kw)


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (
            beam(connectivity=[[10, 15]]),
            "beam 'b': node 15 is not among the 5 nodes; nearest: 14, 13, 12",
        ),
        (beam(connectivity=[[10, 10]]), "beam 'b': element 1 names a node twice: [10, 10]"),
        (
            beam(connectivity=[[10, 11, 12]]),
            "beam 'b': connectivity of shape (1, 3); expected (m, 2) node numbers",
        ),
        (beam(connectivity=[[10, 11.5]]), "beam 'b': connectivity: expected whole numbers"),
        (beam(E=0), "beam 'b': E 0; expected a number above 0"),
        (beam(rho=float("nan")), "beam 'b': rho nan; expected a finite number"),
        (beam(nu=0.6), "beam 'b': nu 0.6; expected above -1 and at most 0.5"),
        (beam(G=-1.0), "beam 'b': G -1.0; expected a number above 0"),
        (beam(loss_factor=-0.1), "beam 'b': loss_factor -0.1; expected a number of at least 0"),
        (beam(section=TALL), "beam 'b': an orientation (a vector in its local xy plane) is needed"),
        (beam(section=(1, 2, 3)), "beam 'b': section (1, 2, 3); expected a Section"),
        (beam(orientation=[0, 0]), "beam 'b': orientation [0, 0]; expected three numbers"),
        (
            beam(connectivity=[[10, 11]], orientation=[1.0, 0.2, 0.1]),
            (
                "beam 'b': the orientation [1.0, 0.2, 0.1] is parallel to the element of nodes"
                " [10, 11]"
            ),
        ),
        (lambda: Section(1.0, 1.0, 1.0, 0.0), "section: J 0.0; expected a number above 0"),
        (
            lambda: tube(0.1, 0.2),
            "tube: inner diameter 0.2; expected at least 0 and below the outer one",
        ),
        (lambda: rectangle(0.1, 0.1, nu=0.7), "rectangle: nu 0.7"),
        (
            lambda: structure({1: [0, 0, 0], 2: [0, 0, 0]}, [Truss("t", [[1, 2]], E, RHO, 1.0)]),
            "has no length",
        ),
        (lambda: structure([[0, 0]], PARTS), "positions of shape (1, 2)"),
        (lambda: structure({1: ["0", "0", "1"]}, PARTS), "numbers for each node (found <U1)"),
        (lambda: structure({1: [0, 0, 1j]}, PARTS), "numbers for each node (found complex128)"),
        (lambda: structure(NODES, []), "there are no parts"),
        (lambda: structure({}, PARTS), "there are no nodes"),
        (free("beam"), "structure: 'beam'; expected a Beam, Truss"),
        (
            free(PARTS[0], Truss("legs", [[10, 11]], E, RHO, 1e-4)),
            "group 'legs': loss factors 0.01 and 0.0 in one group; use two names",
        ),
        (lambda: Spring("s", 1), "spring 's' has neither stiffness nor viscous damping"),
        (lambda: Spring("s", 1, 1, (1,) * 6), "spring 's': both ends are node 1"),
        (lambda: Spring("s", 1, 2, (1,) * 6, axes="line"), "axes 'line' leaves y and z open"),
        (
            lambda: Spring("s", 1, None, (1, 0, 0, 0, 0, 0), axes="line"),
            "axes 'line' needs a second node",
        ),
        (lambda: Spring("s", 1, 2, (1,) * 6, axes="lines"), "axes 'lines'; expected 'line'"),
        (lambda: Spring("s", 1, 2, (1,) * 6, axes=[[1, 0, 0], [2, 0, 0]]), "are parallel or 0"),
        (lambda: Spring("s", 1, 2, (1, 2, 3)), "stiffness (1, 2, 3); expected six numbers"),
        (lambda: Spring("s", 1, 2, "123456"), "stiffness '123456'; expected numbers"),
        (
            lambda: Spring("s", 1, 2, ["1"] * 6),
            "stiffness ['1', '1', '1', '1', '1', '1']; expected",
        ),
        (lambda: Spring("s", 1.5), "spring 's': first 1.5; expected a node number"),
        (lambda: PointMass("m", 1, -1.0), "mass 'm': mass -1.0"),
        (lambda: PointMass("m", 1, 0.0), "mass 'm' has neither mass nor inertia"),
        (
            lambda: PointMass("m", 1, 1.0, [[1, 2, 0], [0, 1, 0], [0, 0, 1]]),
            "or a symmetric (3, 3) tensor",
        ),
        (lambda: PointMass("m", 1, 1.0, (1.0, -1.0, 1.0)), "is negative about some axis"),
        (lambda: RigidLink(1, [2], ["Q"]), "rigid link of node 1: direction 'Q'"),
        (lambda: RigidLink(1, []), "expected at least one node number"),
        (free(links=[RigidLink(10, [12])]), "rigid link of node 10: no part uses node 12"),
        (
            free(links=[RigidLink(77, [11])]),
            "rigid link of node 77: node 77 is not among the 5 nodes",
        ),
        (free(links=[(10, [11])]), "expected a RigidLink"),
        (free(links=[RigidLink(10, [11])], grounded=["11:X"]), "DOF 11:X is held and tied"),
        (free(grounded=[12]), "grounded: no part uses node 12"),
        (free(grounded=[True]), "grounded True: expected a DOF such as '3:X', or a node number"),
        (
            free(grounded=[10, 11]),
            "every DOF of the structure is fixed: the structure has no free DOF",
        ),
        (
            free(links=[RigidLink(10, [11])], grounded=[10]),
            "every DOF of the model is fixed or tied",
        ),
        (
            free(equations=[Equation("11:X", {"55:X": 1.0})]),
            "equation: node 55 is not among the 5 nodes",
        ),
    ],
)
def test_what_cannot_be_built_is_named(build, said):
    with pytest.raises(ModelError, match=re.escape(said)):
        build()


def test_a_dof_that_is_not_there_cannot_be_held():
    with pytest.raises(DofError, match="12:X is not among the 12 DOFs"):
        free(grounded=["12:X"])()


def test_without_pyfe3d_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyfe3d", None)
    with pytest.raises(ModelError, match=re.escape('pip install "updyn[structures]"')):
        structure(NODES, PARTS)


def test_parts_are_not_changed_from_outside():
    mine = np.array([[10, 11]])
    part = Truss("t", mine, E, RHO, 1e-4)
    mine[0, 0] = 12
    assert part.connectivity.tolist() == [[10, 11]]
    with pytest.raises(ValueError, match="read-only"):
        part.connectivity[0, 0] = 5


@pytest.mark.parametrize(
    "build",
    [
        lambda: PointMass([], 1, 1.0),
        lambda: Spring(None, 1, stiffness=(1.0,) * 6),
        lambda: PointMass("m", 10**30, 1.0),
        lambda: PointMass("m", 1, 10**400),
        lambda: Truss("t", [[1, 10**30]], E, RHO, 1.0),
        lambda: tube(1e300),
        lambda: rectangle(1e300, 1e300),
        lambda: RigidLink(1, [2], True),
        lambda: structure(NODES, PARTS, grounded=[10**30]),
        lambda: structure(NODES, [Shell("s", [[10, 11, 12]], 1e300, RHO, 0.1)]),
    ],
)
def test_absurd_values_are_errors_of_the_input(build):
    with pytest.raises(UpdynError):
        build()


def test_pyfe3d_is_the_one_that_was_looked_at():
    """Its traps are those of one version: another one has to pass these tests before the pin moves."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (pin,) = [r for r in project["optional-dependencies"]["structures"] if r.startswith("pyfe3d")]
    assert pin == f"pyfe3d=={metadata.version('pyfe3d')}"


@pytest.mark.parametrize(("height", "is_warned"), [(0.42, False), (0.44, True)])
def test_an_element_is_warped_from_a_tenth_of_its_size(height, is_warned):
    nodes = [[0, 0, 0], [1, 0, 0], [1, 1, height], [0, 1, 0]]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        structure(nodes, [Shell("s", [[1, 2, 3, 4]], E, RHO, 0.01)])
    assert bool(caught) is is_warned


def test_an_orientation_is_parallel_below_a_millionth():
    def build(sine):
        legs = Beam("legs", [[1, 2]], E, RHO, TALL, orientation=[1.0, sine, 0.0])
        return structure([[0, 0, 0], [1, 0, 0]], [legs])

    assert build(1.1e-6).n_dofs == 12
    with pytest.raises(ModelError, match="is parallel to the element"):
        build(0.9e-6)
