"""Parts of a drive train: energies, ratios, senses, rigid against stiff, holds, and what is refused."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

import updyn
from updyn.elements.drivetrain import (
    Belt,
    Brake,
    Coupling,
    DualDrive,
    GearPair,
    Ground,
    Inertia,
    Motor,
    Planetary,
    Shaft,
    Worm,
    drivetrain,
)
from updyn.errors import ModelError


def ends(*nodes, J=0.3):
    return [Inertia(f"end {n}", n, J) for n in nodes]


def matrix(model, name, what="stiffness"):
    return getattr(model.groups[name], what).toarray()


# -- energy and sense ---------------------------------------------------------------------------------------------
@given(
    st.floats(0.01, 1.0),
    st.floats(0.01, 1.0),
    st.floats(0.0, 35.0),
    st.sampled_from(["external", "internal"]),
)
def test_a_mesh_stores_no_energy_in_its_ratio_and_is_positive(r_a, r_b, angle, kind):
    pair = GearPair(
        "mesh", 1, 2, radii=(r_a, r_b), mesh_stiffness=2e8, pressure_angle_deg=angle, kind=kind
    )
    K = matrix(drivetrain([pair, *ends(1, 2)]), "mesh")
    sense = -1.0 if kind == "external" else 1.0
    rolling = np.array([1.0, sense * r_a / r_b])
    assert abs(rolling @ K @ rolling) < 1e-12 * np.abs(K).max() * (rolling @ rolling)
    low, high = np.linalg.eigvalsh(K)
    assert abs(low) < 1e-12 * high
    # wheel 2 held, the mesh gives the force k r cos(alpha) theta at the lever r cos(alpha)
    assert_allclose(K[0, 0], 2e8 * (r_a * np.cos(np.radians(angle))) ** 2, rtol=1e-12)


@pytest.mark.parametrize(("kind", "sign"), [("external", -1.0), ("internal", 1.0)])
def test_power_passes_a_mesh(kind, sign):
    """Static: torque T on 1, wheel 2 held by a spring: what goes in comes out, torques as the ratio."""
    parts = [
        GearPair("mesh", 1, 2, teeth=(20, 50), module=0.002, mesh_stiffness=3e8, kind=kind),
        Ground("spring", 2, 4e3),
        *ends(1, 2),
    ]
    model = drivetrain(parts)
    theta = np.linalg.solve(model.stiffness.toarray(), [10.0, 0.0])
    assert_allclose(4e3 * theta[1], sign * 10.0 * 50 / 20, rtol=1e-9)
    mesh = theta @ matrix(model, "mesh") @ theta
    spring = theta @ matrix(model, "spring") @ theta
    assert_allclose(mesh + spring, 10.0 * theta[0], rtol=1e-12)


PARTS = {
    "external": (GearPair("x", 1, 2, ratio=2.5, torsional_stiffness=1e4), -1 / 2.5),
    "internal": (GearPair("x", 1, 2, ratio=2.5, torsional_stiffness=1e4, kind="internal"), 1 / 2.5),
    "teeth": (GearPair("x", 1, 2, teeth=(20, 50), torsional_stiffness=1e4), -1 / 2.5),
    "worm": (Worm("x", 1, 2, 40, 1e4), 1 / 40),
    "worm, left": (Worm("x", 1, 2, -40, 1e4), -1 / 40),
    "belt": (Belt("x", 1, 2, (0.05, 0.2), 1e6), 0.25),
    "belt, crossed": (Belt("x", 1, 2, (0.05, 0.2), 1e6, crossed=True), -0.25),
    "coupling": (Coupling("x", 1, 2, 1e4), 1.0),
    "shaft": (Shaft("x", 1, 2, 1e4), 1.0),
}


@pytest.mark.parametrize("name", PARTS)
def test_free_motion_has_the_ratio_and_sense(name):
    part, ratio = PARTS[name]
    K = matrix(drivetrain([part, *ends(1, 2)]), "x")
    assert_allclose(K @ [1.0, ratio], 0.0, atol=1e-12 * np.abs(K).max())


@pytest.mark.parametrize(
    "rigid",
    [
        (
            GearPair("x", 1, 2, ratio=2.5, rigid=True),
            GearPair("x", 1, 2, ratio=2.5, torsional_stiffness=1e10),
        ),
        (Worm("x", 1, 2, -40.0), Worm("x", 1, 2, -40.0, 1e10)),
        (Belt("x", 1, 2, (0.05, 0.2)), Belt("x", 1, 2, (0.05, 0.2), 1e12)),
    ],
    ids=["gear", "worm", "belt"],
)
def test_rigid_is_the_limit_of_stiff(rigid):
    others = [*ends(1, 2, 3), Shaft("shaft", 2, 3, 700.0), Ground("ground", 3, 40.0)]
    first, second = (drivetrain([part, *others]) for part in rigid)
    assert first.dofs.labels == ["1:RZ", "3:RZ"]
    assert_allclose(updyn.modes(first, 2).frequency, updyn.modes(second, 2).frequency, rtol=1e-6)
    freq = np.array([0.0, 1.0, 3.0])
    H = [updyn.response(m, freq, ["3:RZ"], ["1:RZ"]).values for m in (first, second)]
    assert_allclose(H[0], H[1], rtol=1e-6)


def test_stiffness_along_the_line_and_at_the_wheel_agree():
    line = GearPair(
        "x",
        1,
        2,
        teeth=(20, 50),
        module=0.004,
        mesh_stiffness=3e8,
        pressure_angle_deg=25,
        viscous=70.0,
    )
    base = 0.002 * 50 * np.cos(np.radians(25))
    turn = GearPair("x", 1, 2, ratio=2.5, torsional_stiffness=3e8 * base**2, viscous=70.0 * base**2)
    a, b = (drivetrain([p, *ends(1, 2)]) for p in (line, turn))
    assert_allclose(matrix(a, "x"), matrix(b, "x"), rtol=1e-12)
    assert_allclose(matrix(a, "x", "viscous"), matrix(b, "x", "viscous"), rtol=1e-12)


# -- distributed mass, discs, groups ------------------------------------------------------------------------------
def test_the_inertia_of_a_shaft_is_that_of_its_body():
    shaft = Shaft(
        "s",
        1,
        2,
        G=80e9,
        outer_diameter=0.06,
        inner_diameter=0.03,
        length=0.8,
        rho=7800.0,
        n_elements=5,
    )
    model = drivetrain([shaft])
    ones = np.ones(model.n_dofs)
    body = 7800.0 * 0.8 * np.pi * (0.06**2 - 0.03**2) / 4  # kg
    assert_allclose(
        ones @ matrix(model, "s", "mass") @ ones, body * (0.03**2 + 0.015**2) / 2, rtol=1e-12
    )
    assert model.dofs.labels == ["1:RZ", "2:RZ", "3:RZ", "4:RZ", "5:RZ", "6:RZ"]
    assert_allclose(
        matrix(model, "s")[0, 2], -5 * 80e9 * np.pi * (0.06**4 - 0.03**4) / 32 / 0.8, rtol=1e-12
    )


def test_the_damping_of_a_shaft_is_that_between_its_ends():
    shaft = Shaft("s", 1, 2, 300.0, inertia=0.1, viscous=7.0, loss_factor=0.1, n_elements=4)
    model = drivetrain([shaft], held=[1])
    for what, total in (("stiffness", 300.0), ("viscous", 7.0)):
        turned = np.linalg.solve(
            matrix(model, "s", what), [1.0, 0, 0, 0]
        )  # 2:RZ, then the inner nodes
        assert_allclose(turned[0], 1 / total, rtol=1e-12)


def test_a_disc_by_geometry():
    disc = Inertia("d", 1, rho=7800.0, outer_diameter=0.3, inner_diameter=0.05, length=0.02)
    body = 7800.0 * 0.02 * np.pi * (0.3**2 - 0.05**2) / 4
    model = drivetrain([disc, Ground("g", 1, 1.0)])
    assert_allclose(matrix(model, "d", "mass"), [[body * (0.15**2 + 0.025**2) / 2]], rtol=1e-12)


def test_each_part_is_a_group_and_equal_names_are_one():
    parts = [
        *ends(1, 2, 3),
        Shaft("shaft", 1, 2, 100.0, inertia=0.1, loss_factor=0.02, viscous=0.5),
        Shaft("shaft", 2, 3, 300.0, loss_factor=0.02),
    ]
    model = drivetrain(parts, title="two")
    assert list(model.groups) == ["end 1", "end 2", "end 3", "shaft"]
    assert model.groups["shaft"].loss_factor == 0.02
    assert_allclose(matrix(model, "shaft"), [[100, -100, 0], [-100, 400, -300], [0, -300, 300]])
    assert_allclose(matrix(model, "shaft", "viscous"), [[0.5, -0.5, 0], [-0.5, 0.5, 0], [0, 0, 0]])
    assert model.title == "two"


# -- motors, brakes, holds -----------------------------------------------------------------------------------------
def servo(**motor):
    return [Motor("motor", 1, 0.1, **motor), Shaft("shaft", 1, 2, 500.0), Inertia("load", 2, 2.0)]


def test_locked_and_free_rotor_have_the_same_groups():
    free, locked = drivetrain(servo()), drivetrain(servo(rotor="locked"))
    assert list(free.groups) == list(locked.groups)
    assert locked.dofs.labels == ["2:RZ"]
    assert_allclose(updyn.modes(locked, 1).frequency, np.sqrt(500 / 2.0) / 2 / np.pi, rtol=1e-12)
    assert_allclose(drivetrain(servo(), held=[1]).stiffness.toarray(), locked.stiffness.toarray())


def test_the_stiffness_of_the_drive():
    model = drivetrain(servo(stiffness=80.0, viscous=0.4, loss_factor=0.1))
    assert_allclose(matrix(model, "motor"), [[80.0, 0], [0, 0]])
    assert_allclose(matrix(model, "motor", "viscous"), [[0.4, 0], [0, 0]])
    assert_allclose(matrix(model, "motor", "mass"), [[0.1, 0], [0, 0]])


def test_a_brake_closed_sprung_and_released():
    rest = [Shaft("shaft", 1, 2, 500.0), Inertia("load", 2, 2.0), Inertia("rotor", 1, 0.1)]
    rigid = drivetrain([Brake("brake", 1, inertia=0.05), *rest])
    assert rigid.dofs.labels == ["2:RZ"]
    sprung = drivetrain([Brake("brake", 1, 900.0, inertia=0.05, viscous=3.0), *rest])
    assert_allclose(matrix(sprung, "brake"), [[900, 0], [0, 0]])
    released = drivetrain(
        [Brake("brake", 1, 900.0, closed=False, inertia=0.05, viscous=3.0), *rest]
    )
    assert released.groups["brake"].stiffness is None
    assert_allclose(matrix(released, "brake", "viscous"), [[3.0, 0], [0, 0]])
    assert_allclose(
        updyn.modes(released, 2).frequency[1], np.sqrt(500 * (1 / 2.0 + 1 / 0.15)) / 2 / np.pi
    )


def test_a_dual_drive_is_two_meshes_and_opens_at_its_preload():
    dual = DualDrive(
        "pair",
        1,
        2,
        3,
        radii=(0.02, 0.2),
        mesh_stiffness=1e8,
        second_factor=0.5,
        preload=4.0,
        inertia_a=0.1,
        inertia_b=3.0,
    )
    model = drivetrain([dual])
    K, M = matrix(model, "pair"), matrix(model, "pair", "mass")
    assert_allclose(np.diag(M), [0.1, 0.1, 3.0])
    base = np.array([0.02, 0.2]) * np.cos(np.radians(20))
    assert_allclose(
        np.diag(K),
        1e8 * np.array([base[0] ** 2, 0.5 * base[0] ** 2, 1.5 * base[1] ** 2]),
        rtol=1e-12,
    )
    assert_allclose(K @ [1.0, 1.0, -0.1], 0.0, atol=1e-9 * K.max())
    # pinions held and the gear under the opening torque: the stiffer mesh just loses the torque of
    # its bias
    turn = dual.opening_torque / K[2, 2]
    assert_allclose(1e8 * base[1] * turn * base[0], 4.0, rtol=1e-12)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_the_opening_torque_takes_the_bias_off_one_mesh(factor):
    """Pinions held, gear under the torque: share of each mesh, at its pinion."""
    dual = DualDrive(
        "d", 1, 2, 3, ratio=5.0, torsional_stiffness=1e6, second_factor=factor, preload=4.0
    )
    turn = dual.opening_torque / (1e6 * (1 + factor))
    at_pinions = np.array([1.0, factor]) * 1e6 * turn / 5.0
    assert_allclose(at_pinions.max(), 4.0, rtol=1e-12)


def test_reaction_on_a_housing_that_turns():
    """Held shafts and a housing that turns by itself: no torque sums are left over, seen from outside."""
    parts = [
        Motor("motor", 1, 0.1, stiffness=60.0, housing=9),
        GearPair("mesh", 1, 2, ratio=4.0, torsional_stiffness=1e4, housing=9),
        Belt("belt", 2, 3, (0.1, 0.3), 1e6, housing=9),
        Brake("brake", 3, 800.0, housing=9),
        Ground("drag", 3, viscous=2.0, housing=9),
        *ends(3, 9),
    ]
    model = drivetrain(parts)
    together = np.ones(4)
    for matrix_ in (model.stiffness, model.viscous):
        assert_allclose(matrix_ @ together, 0.0, atol=1e-10 * np.abs(matrix_).max())
    locked = drivetrain([Motor("motor", 1, 0.1, rotor="locked", housing=9), *parts[1:]])
    assert "1:RZ" not in locked.dofs
    assert_allclose(locked.stiffness @ np.ones(3), 0.0, atol=1e-8)
    assert_allclose(locked.mass.toarray()[-1, -1], 0.1 + 0.3)  # the rotor turns with the housing


def test_a_worm_on_a_housing_that_turns_about_the_wheel():
    model = drivetrain([Worm("worm", 1, 2, 40.0, 1e5, housing=9), *ends(1, 2, 9)])
    assert_allclose(matrix(model, "worm") @ [0.0, 1.0, 1.0], 0.0, atol=1e-9)
    assert_allclose(matrix(model, "worm") @ [40.0, 1.0, 0.0], 0.0, atol=1e-7)


# -- rigid ratios in a row and in loops ----------------------------------------------------------------------------
def test_kept_nodes_stay_and_the_same_motion_results():
    parts = [
        GearPair("one", 1, 2, ratio=3.0, rigid=True),
        GearPair("two", 3, 2, ratio=2.0, rigid=True),
        GearPair("three", 2, 4, ratio=5.0, rigid=True, kind="internal"),
        *ends(1, 2, 3, 4),
    ]
    speed = {1: 1.0, 2: -1 / 3, 3: 2 / 3, 4: -1 / 15}
    for node in speed:
        model = drivetrain(parts, keep=[node])
        assert model.dofs.labels == [f"{node}:RZ"]
        expected = 0.3 * sum(v**2 for v in speed.values()) / speed[node] ** 2
        assert_allclose(model.mass.toarray(), [[expected]], rtol=1e-12)


def test_a_loop_of_gears_that_fits_is_one_motion():
    wheels = [
        GearPair(f"mesh {i}", *p, teeth=t, rigid=True)
        for i, (p, t) in enumerate(zip(LOOP, TEETH, strict=True))
    ]
    assert drivetrain([*wheels, *ends(1, 2, 3, 4)]).n_dofs == 1


LOOP = ((1, 2), (2, 3), (3, 4), (4, 1))
TEETH = ((17, 31), (31, 23), (23, 41), (41, 17))


def test_gears_that_jam_are_refused():
    jam = [
        GearPair(f"mesh {i}", *p, ratio=1.0, rigid=True)
        for i, p in enumerate(((1, 2), (2, 3), (3, 1)))
    ]
    with pytest.raises(
        ModelError, match=r"gear pair 'mesh 2': .* node 1 cannot turn: their ratios contradict"
    ):
        drivetrain([*jam, *ends(1, 2, 3)])


def test_a_rigid_pair_behind_a_locked_motor_stands_still():
    parts = [Motor("motor", 1, 0.1, rotor="locked"), GearPair("x", 1, 2, ratio=3.0, rigid=True)]
    model = drivetrain([*parts, Shaft("s", 2, 3, 10.0), Inertia("load", 3, 1.0)])
    assert model.dofs.labels == ["3:RZ"]


def test_two_locked_motors_may_stop_the_housing_between_them():
    """Rotors that can only turn in opposite senses, both locked to one housing: nothing of it can turn."""
    motors = [Motor(f"motor {n}", n, 0.1, rotor="locked", housing=9) for n in (1, 2)]
    parts = [
        *motors,
        GearPair("x", 1, 2, ratio=2.0, rigid=True),
        Shaft("s", 9, 3, 10.0),
        Inertia("load", 3, 1.0),
    ]
    assert drivetrain(parts).dofs.labels == ["3:RZ"]


@pytest.mark.parametrize("keep", [[1, 2], [2, 1]])
def test_what_cannot_be_kept_is_said(keep):
    with pytest.raises(ModelError, match=r"ties node 1, 2, all of which are to be kept"):
        drivetrain([GearPair("x", 1, 2, ratio=3.0, rigid=True), *ends(1, 2)], keep=keep)


def test_planets_in_one_node_are_the_planets_together():
    stage = {
        "sun": 1,
        "ring": 2,
        "carrier": 3,
        "teeth": (20, 80),
        "module": 0.002,
        "sun_mesh": 2e8,
        "ring_mesh": 3e8,
    }
    whole = drivetrain(
        [Planetary("p", **stage, planet_inertia=1e-3, planet_mass=0.4, viscous=9.0), *ends(1, 2, 3)]
    )
    apart = drivetrain(
        [
            Planetary(
                "p", **stage, planets=(4, 5, 6), planet_inertia=1e-3, planet_mass=0.4, viscous=9.0
            ),
            *ends(1, 2, 3),
        ]
    )
    assert list(whole.groups) == [
        "p planets",
        "p sun mesh",
        "p ring mesh",
        "end 1",
        "end 2",
        "end 3",
    ]
    alike = np.zeros((6, 4))
    alike[:3, :3], alike[3:, 3] = np.eye(3), 1.0
    for what in ("stiffness", "mass", "viscous"):
        assert_allclose(
            alike.T @ getattr(apart, what) @ alike,
            getattr(whole, what).toarray(),
            rtol=1e-12,
            atol=1e-9,
        )


# -- what is refused -----------------------------------------------------------------------------------------------
GEAR = {"name": "g", "a": 1, "b": 2}
STAGE = {"name": "p", "sun": 1, "ring": 2, "carrier": 3, "teeth": (20, 80)}


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (
            Inertia("d", 1),
            (
                "inertia 'd': rho, outer_diameter, length missing; expected value, or rho,"
                " outer_diameter"
            ),
        ),
        (
            Inertia("d", 1, 1.0, rho=3.0),
            "inertia 'd': value and rho are given; expected one or the other",
        ),
        (Inertia("d", 1.5, 1.0), "inertia 'd': node 1.5; expected a whole number"),
        (Inertia("d", 1, -1.0), "inertia 'd': value -1.0; expected a number above 0"),
        (Shaft("s", 1, 1, 5.0), "shaft 's': node 1 occurs twice"),
        (
            Shaft("s", 1, 2),
            "shaft 's': G, outer_diameter, length missing; expected stiffness, or G",
        ),
        (
            Shaft("s", 1, 2, 5.0, rho=2.0),
            "shaft 's': rho requires the geometry; with a stiffness, give inertia",
        ),
        (Shaft("s", 1, 2, 5.0, n_elements=4), "shaft 's': 4 elements of a shaft without mass"),
        (
            Shaft("s", 1, 2, 5.0, n_elements=0),
            "shaft 's': n_elements 0; expected a whole number of at least 1",
        ),
        (
            Shaft("s", 1, 2, 5.0, loss_factor=-0.1),
            "shaft 's': loss_factor -0.1; expected a number of at least 0",
        ),
        (
            Shaft("s", 1, 2, G=1.0, outer_diameter=0.1, inner_diameter=0.1, length=1.0),
            "shaft 's': inner_diameter 0.1 m; expected less than outer_diameter 0.1 m",
        ),
        (
            Shaft("s", 1, 2, G=1.0, outer_diameter=0.1, length=1.0, inertia=1.0),
            "inertia requires a stiffness",
        ),
        (
            GearPair(**GEAR, rigid=True),
            "gear pair 'g': none given; expected one of ratio, teeth, radii",
        ),
        (
            GearPair(**GEAR, ratio=2.0),
            "none given; expected one of mesh_stiffness, torsional_stiffness, rigid",
        ),
        (
            GearPair(**GEAR, ratio=2.0, rigid=True, torsional_stiffness=1.0),
            "torsional_stiffness and rigid given",
        ),
        (
            GearPair(**GEAR, ratio=2.0, mesh_stiffness=1.0),
            "mesh_stiffness requires radii, or teeth and module",
        ),
        (GearPair(**GEAR, ratio=2.0, module=0.1, rigid=True), "module requires teeth"),
        (GearPair(**GEAR, ratio=-2.0, rigid=True), "ratio -2.0; expected a number above 0"),
        (GearPair(**GEAR, teeth=(20,), rigid=True), "teeth (20,); expected two numbers"),
        (
            GearPair(**GEAR, ratio=2.0, rigid=True, kind="externl"),
            "kind 'externl'; did you mean 'external' or 'internal'?",
        ),
        (
            GearPair(**GEAR, ratio=2.0, rigid=True, viscous=1.0),
            "is rigid: its damping would have no effect",
        ),
        (
            GearPair(**GEAR, ratio=2.0, rigid=True, pressure_angle_deg=90),
            "pressure_angle_deg 90; expected 0 up to 60",
        ),
        (GearPair(**GEAR, ratio=2.0, rigid=True, housing=2), "node 2 occurs twice"),
        (Worm("w", 1, 2, 0.0), "worm 'w': ratio 0; expected a number other than 0"),
        (Belt("b", 1, 2, (0.1, -0.1)), "belt 'b': radii -0.1; expected a number above 0"),
        (Motor("m", 1, 0.1, rotor="lock"), "motor 'm': rotor 'lock'; did you mean 'locked'?"),
        (
            Motor("m", 1, 0.1, loss_factor=0.1),
            "motor 'm': a loss factor without stiffness has no effect",
        ),
        (Ground("g", 1), "ground 'g' has neither stiffness nor viscous damping"),
        (Brake("b", 1, closed="no"), "brake 'b': closed 'no'; expected true or false"),
        (DualDrive("d", 1, 1, 3, ratio=2.0, torsional_stiffness=1.0), "node 1 is both pinions"),
        (
            Planetary(**STAGE),
            "planetary stage 'p': sun_mesh is missing; expected sun_mesh, ring_mesh and module",
        ),
        (
            Planetary(**{**STAGE, "teeth": (80, 20)}, rigid=True),
            "expected more on the ring than on the sun",
        ),
        (Planetary(**STAGE, rigid=True, sun_mesh=1.0), "is rigid: sun_mesh would have no effect"),
        (Planetary(**STAGE, rigid=True, planet_mass=1.0), "planet_mass requires module"),
        (
            Planetary(**STAGE, sun_mesh=1.0, ring_mesh=1.0, module=0.1, planets=(5, 6)),
            "planets (5, 6); expected one node, or 3",
        ),
        ("shaft", "'shaft' is no part; expected one of Motor"),
        (Inertia(5, 1, 1.0), "Inertia 5: expected a text as its name"),
        (
            Coupling("end 2", 1, 2, 1.0),
            "'end 2' names a Coupling and a Inertia; a group is of one kind",
        ),
    ],
)
def test_bad_parts(part, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        drivetrain([part, *ends(1, 2, 3)])


@pytest.mark.parametrize(
    ("parts", "options", "message"),
    [
        (ends(1), {"held": [2]}, "held contains node 2, which belongs to no part; valid: '1'"),
        (ends(1), {"held": 1}, "held 1; expected a list of nodes"),
        (ends(1), {"keep": ["a"]}, "keep 'a'; expected a whole number"),
        (ends(1), {"held": [1]}, "every DOF of the model is fixed or tied"),
        (
            [GearPair(**GEAR, ratio=2.0, rigid=True)],
            {},
            "no part has stiffness, inertia or damping",
        ),
        (
            [*ends(3), GearPair(**GEAR, ratio=2.0, rigid=True)],
            {},
            "DOF 1:RZ has neither stiffness, mass nor damping",
        ),
        (
            [Shaft("s", 1, 2, 1.0, loss_factor=0.1), Shaft("s", 2, 3, 1.0)],
            {},
            "'s': loss factors [0.0, 0.1] in one group; use two names",
        ),
    ],
)
def test_bad_trains(parts, options, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        drivetrain(parts, **options)


def test_groups_of_a_stage_do_not_run_into_another_part():
    stage = Planetary(**STAGE, sun_mesh=1e8, ring_mesh=1e8, module=0.002)
    with pytest.raises(
        ModelError, match="group 'p sun mesh' belongs to 'p' and 'p sun mesh'; rename one"
    ):
        drivetrain([stage, *ends(1, 2, 3), Coupling("p sun mesh", 1, 4, 1.0)])


def test_a_dual_drive_without_preload_has_no_limit_to_tell():
    with pytest.raises(ModelError, match="preload is not stated"):
        _ = DualDrive("d", 1, 2, 3, ratio=2.0, torsional_stiffness=1.0).opening_torque
