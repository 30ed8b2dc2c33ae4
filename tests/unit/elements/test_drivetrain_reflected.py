"""Stiffness and inertia reflected through a train: 1/k = sum 1/(k n^2), against the assembled matrices."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from updyn.elements.drivetrain import (
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
    reflected,
)
from updyn.errors import ModelError

TRAIN = [
    Motor("motor", 1, 3e-4),
    Shaft("motor shaft", 1, 2, 900.0),
    GearPair("pinion", 2, 3, teeth=(20, 100), module=0.001, mesh_stiffness=2e8),
    Shaft("mid", 3, 4, G=80e9, outer_diameter=0.03, length=0.4, rho=7850.0, n_elements=6),
    Worm("worm", 4, 5, -40, 5e6),
    Inertia("table", 5, 60.0),
]


def static(parts, node, held=()):
    """Torque over rotation at a node from the assembled stiffness: a second way to the total."""
    model = drivetrain(parts, held=held, keep=[node])
    load = np.array([1.0 if label == f"{node}:RZ" else 0.0 for label in model.dofs.labels])
    return 1.0 / (load @ np.linalg.lstsq(model.stiffness.toarray(), load, rcond=1e-14)[0])


def values(table, quantity="stiffness"):
    return {p.group: p.value for p in table.parts if p.quantity == quantity}


def test_a_row_of_parts_by_the_textbook_formula():
    table = reflected(TRAIN, 5, held=[1])
    n = {1: 200.0, 2: 200.0, 3: -40.0, 4: -40.0, 5: 1.0}
    assert {k: table.ratios[k] for k in n} == pytest.approx(n, rel=1e-12)
    base = 0.01 * np.cos(np.radians(20))  # of the pinion
    mid = 80e9 * np.pi * 0.03**4 / 32 / 0.4
    k = {
        "motor shaft": 900 * 200**2,
        "pinion": 2e8 * (base * 200) ** 2,
        "mid": mid * 40**2,
        "worm": 5e6,
    }
    assert values(table) == pytest.approx(k, rel=1e-9)
    total = 1 / sum(1 / v for v in k.values())
    assert_allclose(table.stiffness, total, rtol=1e-9)
    assert_allclose(static(TRAIN, 5, [1]), total, rtol=1e-8)
    shares = {p.group: p.share for p in table.parts if p.quantity == "stiffness"}
    assert shares == pytest.approx({name: total / v for name, v in k.items()}, rel=1e-9)


def test_inertias_count_with_the_square_of_their_speed():
    table = reflected(TRAIN, 5)
    J_mid = 7850 * 0.4 * np.pi * 0.03**4 / 32
    J = {"motor": 3e-4 * 200**2, "mid": J_mid * 40**2, "table": 60.0}
    assert values(table, "inertia") == pytest.approx(J, rel=1e-12)
    assert_allclose(table.inertia, sum(J.values()), rtol=1e-12)
    assert_allclose(sum(p.share for p in table.parts if p.quantity == "inertia"), 1.0, rtol=1e-12)
    # the same from the model, turned as a rigid body
    model = drivetrain([*TRAIN[:3], Shaft("mid", 3, 4, 1e5), *TRAIN[4:]])
    turn = np.array([table.ratios[d.node] for d in model.dofs])
    assert_allclose(turn @ model.mass @ turn, J["motor"] + J["table"], rtol=1e-12)
    assert_allclose(model.stiffness @ turn, 0.0, atol=1e-6)


def test_an_inertia_that_stands_still_counts_nothing():
    """The ring of a planetary stage is held by a spring; with all parts rigid it does not turn."""
    parts = [
        Planetary("stage", 1, 2, 3, teeth=(20, 60), rigid=True),
        Inertia("ring", 2, 1.0),
        Ground("mount", 2, 1e6),
        Ground("load", 3, 10.0),
    ]
    table = reflected(parts, 1)
    assert table.ratios == pytest.approx({1: 1.0, 2: 0.0, 3: 0.25})
    assert table.inertia == 0.0
    assert [(p.value, p.share) for p in table.parts if p.quantity == "inertia"] == [(0.0, None)]


def test_seen_from_the_motor_all_is_less_by_the_square_of_the_ratio():
    at_table, at_motor = reflected(TRAIN, 5), reflected(TRAIN, 1)
    assert at_table.stiffness is None
    assert at_motor.stiffness is None
    assert_allclose(at_motor.inertia * 200**2, at_table.inertia, rtol=1e-12)
    for name, value in values(at_table).items():
        assert_allclose(values(at_motor)[name] * 200**2, value, rtol=1e-9)


def test_a_free_train_names_no_share():
    table = reflected(TRAIN, 5)
    assert all(p.share is None for p in table.parts if p.quantity == "stiffness")
    assert "free to turn" in str(table)


@pytest.mark.parametrize("ring", [Ground("ring", 3, 1e6), Brake("ring", 3), Brake("ring", 3, 1e6)])
def test_through_a_planetary_stage(ring):
    stage = Planetary(
        "stage", 2, 3, 4, (24, 96), module=0.002, sun_mesh=3e8, ring_mesh=5e8, planet_inertia=1e-4
    )
    parts = [
        Motor("m", 1, 1e-3),
        Shaft("in", 1, 2, 1e4),
        stage,
        ring,
        Shaft("out", 4, 5, 1e6),
        Inertia("load", 5, 3.0),
    ]
    table = reflected(parts, 5, held=[1])
    assert_allclose(table.ratios[1], 5.0, rtol=1e-9)
    lever = 0.001 * (24 + 96) * np.cos(np.radians(20))
    k = {
        "in": 25e4,
        "stage sun mesh": 9e8 * lever**2,
        "stage ring mesh": 15e8 * lever**2,
        "out": 1e6,
    }
    if getattr(ring, "stiffness", None):
        k["ring"] = 1e6 * 1.25**2
    assert values(table) == pytest.approx(k, rel=1e-8)
    total = 1 / sum(1 / v for v in k.values())
    assert_allclose(table.stiffness, total, rtol=1e-8)
    assert_allclose(static(parts, 5, [1]), total, rtol=1e-7)


def test_through_rigid_ratios():
    parts = [
        Motor("m", 1, 1e-3, rotor="locked"),
        Shaft("in", 1, 2, 1e4),
        Planetary("stage", 2, 3, 4, (24, 96), rigid=True),
        Brake("ring", 3),
        GearPair("out", 4, 5, ratio=3.0, rigid=True),
        Coupling("end", 5, 6, 4e5),
        Inertia("load", 6, 3.0),
    ]
    table = reflected(parts, 6)
    assert_allclose(table.stiffness, 1 / (1 / (1e4 * 15**2) + 1 / 4e5), rtol=1e-9)
    assert_allclose(table.inertia, 3.0 + 1e-3 * 15**2, rtol=1e-12)


def test_two_ways_to_the_ground_share_the_load():
    dual = DualDrive("pair", 2, 4, 5, ratio=8, torsional_stiffness=1e6)
    parts = [
        *(Motor(f"motor {n}", n, 1e-3, rotor="locked") for n in (1, 3)),
        Shaft("shaft 1", 1, 2, 1e4),
        Shaft("shaft 2", 3, 4, 2e4),
        dual,
        Inertia("gear", 5, 2.0),
    ]
    table = reflected(parts, 5)
    ways = [1 / (1 / (k * 64) + 1 / 1e6) for k in (1e4, 2e4)]
    assert_allclose(table.stiffness, sum(ways), rtol=1e-9)
    springs = [p for p in table.parts if p.quantity == "stiffness"]
    assert_allclose(sum(p.share for p in springs), 1.0, rtol=1e-9)
    assert_allclose([p.value for p in springs], [64e4, 128e4, 1e6, 1e6], rtol=1e-9)


def test_a_branch_beside_the_way_bears_nothing():
    table = reflected([*TRAIN, Shaft("branch", 3, 8, 50.0), Inertia("fan", 8, 0.1)], 5, held=[1])
    (branch,) = (p for p in table.parts if p.group == "branch")
    assert branch.share == pytest.approx(0.0, abs=1e-12)
    assert branch.value == pytest.approx(50.0 * 40**2)
    assert table.stiffness == pytest.approx(reflected(TRAIN, 5, held=[1]).stiffness, rel=1e-9)


def test_a_mesh_on_a_housing_counts_as_one_on_the_ground():
    def train(housing):
        return [
            Motor("motor", 1, 1e-3, rotor="locked", housing=housing),
            Shaft("shaft", 1, 2, 1e4),
            GearPair("mesh", 2, 3, ratio=6.0, torsional_stiffness=1e5, housing=housing),
            Inertia("load", 3, 2.0),
        ]

    plain = reflected(train(None), 3)
    carried = reflected([*train(9), Inertia("house", 9, 40.0)], 3, held=[9])
    assert carried.stiffness == pytest.approx(plain.stiffness, rel=1e-9)
    assert values(carried) == pytest.approx(values(plain), rel=1e-9)
    assert carried.ratios[1] == pytest.approx(-6.0)
    free = reflected(
        [*train(9), Inertia("house", 9, 40.0)], 3
    )  # ratios are those against the housing
    assert free.stiffness is None
    assert free.ratios[1] == pytest.approx(-6.0)
    assert free.ratios[9] == 0.0
    soft = reflected([*train(9), Ground("mount", 9, 3e4)], 3)  # the mount takes the load's torque
    assert soft.stiffness == pytest.approx(1 / (1 / plain.stiffness + 1 / 3e4), rel=1e-9)


def test_the_table():
    text = str(reflected(TRAIN, 5, held=[1]))
    lines = text.splitlines()
    assert lines[0].split() == ["part", "nodes", "own", "unit", "ratio", "at", "node", "5", "share"]
    assert len({line.index("N m/rad") for line in lines if "N m/rad" in line}) == 1
    assert re.search(
        r"^motor shaft +1-2 +900 +N m/rad +200 +3\.6e\+07 +10\.3 %$", text, re.MULTILINE
    )
    assert re.search(r"^total stiffness +N m/rad +3\.7245e\+06$", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("parts", "to", "held", "message"),
    [
        (TRAIN, 7, (), "no part has the node 7"),
        (TRAIN, "5", (), "reflected: to '5'; expected a whole number"),
        (TRAIN, 1, (1,), "node 1 is held; reflect to one that can turn"),
        ([*TRAIN, Inertia("apart", 20, 1.0)], 5, (), "has 2 independent motions"),
        (
            [
                Planetary("p", 1, 2, 3, (20, 80), rigid=True),
                *(Inertia(f"i{n}", n, 1.0) for n in (1, 2, 3)),
            ],
            1,
            (),
            "hold the fixed member of each planetary stage",
        ),
    ],
)
def test_what_cannot_be_reflected(parts, to, held, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        reflected(parts, to, held=held)
