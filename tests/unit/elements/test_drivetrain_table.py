"""A drive train declared in a job file: the same model as in Python, and what is refused."""

import re
import tomllib

import numpy as np
import pytest
from numpy.testing import assert_allclose

import updyn
from updyn.elements.drivetrain import (
    PARTS,
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
    drivetrain_from_table,
)
from updyn.errors import JobError, ModelError
from updyn.job import load_job, prepare

EVERY = """
kind = "drivetrain"
title = "All of them"
held = [12]
keep = [3]

[[motors]]
name = "motor"
node = 1
inertia = 0.01
viscous = 0.2

[[brakes]]
name = "brake"
node = 1
closed = false
inertia = 0.002

[[inertias]]
name = "load"
node = 9
rho = 7850
outer_diameter = 0.4
length = 0.03

[[shafts]]
name = "shaft"
a = 1
b = 2
G = 80e9
outer_diameter = 0.03
length = 0.5
rho = 7850
n_elements = 3
loss_factor = 0.01

[[couplings]]
name = "coupling"
a = 6
b = 7
stiffness = 4e4

[[gear_pairs]]
name = "pinion"
a = 2
b = 3
teeth = [20, 60]
rigid = true
inertia_b = 0.02

[[planetaries]]
name = "stage"
sun = 3
ring = 12
carrier = 4
teeth = [20, 80]
module = 0.002
sun_mesh = 2e8
ring_mesh = 3e8
planets = [21, 22, 23]
planet_inertia = 1e-4

[[worms]]
name = "worm"
worm = 4
wheel = 5
ratio = -30
stiffness = 2e6

[[belts]]
name = "belt"
a = 5
b = 6
radii = [0.1, 0.3]
stiffness = 1e6

[[dual_drives]]
name = "dual"
first = 7
second = 8
gear = 9
ratio = 8.0
torsional_stiffness = 3e6
inertia_a = 1e-3

[[grounds]]
name = "bearing"
node = 9
viscous = 3.0
"""


def test_every_kind_of_part():
    data = tomllib.loads(EVERY)
    assert set(PARTS) < set(data)
    found = drivetrain_from_table(data)
    expected = drivetrain(
        [
            Motor("motor", 1, 0.01, viscous=0.2),
            Brake("brake", 1, closed=False, inertia=0.002),
            Inertia("load", 9, rho=7850, outer_diameter=0.4, length=0.03),
            Shaft(
                "shaft",
                1,
                2,
                G=80e9,
                outer_diameter=0.03,
                length=0.5,
                rho=7850,
                n_elements=3,
                loss_factor=0.01,
            ),
            Coupling("coupling", 6, 7, 4e4),
            GearPair("pinion", 2, 3, teeth=(20, 60), rigid=True, inertia_b=0.02),
            Planetary(
                "stage",
                3,
                12,
                4,
                (20, 80),
                module=0.002,
                sun_mesh=2e8,
                ring_mesh=3e8,
                planets=(21, 22, 23),
                planet_inertia=1e-4,
            ),
            Worm("worm", 4, 5, -30, 2e6),
            Belt("belt", 5, 6, (0.1, 0.3), 1e6),
            DualDrive("dual", 7, 8, 9, ratio=8.0, torsional_stiffness=3e6, inertia_a=1e-3),
            Ground("bearing", 9, viscous=3.0),
        ],
        held=[12],
        keep=[3],
        title="All of them",
    )
    assert list(found.groups) == list(expected.groups)
    assert found.dofs == expected.dofs
    assert found.title == "All of them"
    # 2 follows 3, 12 is held, the two inner nodes of the shaft come after all that are named
    assert [d.node for d in found.dofs] == [1, 3, 4, 5, 6, 7, 8, 9, 21, 22, 23, 24, 25]
    for name, group in expected.groups.items():
        other = found.groups[name]
        assert other.loss_factor == group.loss_factor
        for what in ("stiffness", "mass", "viscous"):
            one, two = getattr(group, what), getattr(other, what)
            assert (one is None) == (two is None)
            if one is not None:
                assert_allclose(two.toarray(), one.toarray(), rtol=0, atol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "beam"}, "model: kind 'beam'; expected 'drivetrain'"),
        ({"shaft": []}, "model: no key 'shaft'; did you mean 'shafts'?"),
        (
            {"shafts": {"name": "s"}},
            "model: shafts holds dict; expected an array of tables, [[model.shafts]]",
        ),
        ({"shafts": [3]}, "model.shafts, number 1: expected a table, found 3"),
        ({"shafts": [{"name": "s", "a": 1}]}, "model.shafts, number 1: 'b' is missing"),
        (
            {"shafts": [{"name": "s", "a": 1, "b": 2, "stifness": 3.0}]},
            "model.shafts, number 1: no key 'stifness'; did you mean 'stiffness'?",
        ),
        (
            {"shafts": [{"name": "s", "a": 1, "b": 2, "stiffness": "3"}]},
            "shaft 's': stiffness '3'; expected a finite",
        ),
        (
            {"gear_pairs": [{"name": "g", "a": 1, "b": 2, "teeth": 3, "rigid": True}]},
            "teeth 3; expected two numbers",
        ),
        ({}, "a drive train has no parts; expected [[model.shafts]] or others of motors"),
    ],
)
def test_bad_tables(change, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        drivetrain_from_table(change)


JOB = """
[model]
kind = "drivetrain"
held = [1]
[[model.shafts]]
name = "shaft"
a = 1
b = 2
stiffness = 1e4
[[model.inertias]]
name = "load"
node = 2
value = 2.0
[test]
file = "test.npz"
[[parameter]]
groups = "shaft"
quantity = "stiffness"
"""


def test_a_job_updates_a_drive_train(tmp_path):
    true = drivetrain([Shaft("shaft", 1, 2, 1.2e4), Inertia("load", 2, 2.0)], held=[1])
    frf = updyn.response(true, np.linspace(1.0, 20.0, 15), ["2:RZ"], ["2:RZ"])
    updyn.write_frf(frf, tmp_path / "test.npz")
    job = tmp_path / "job.toml"
    job.write_text(JOB, encoding="utf-8")
    ready = prepare(load_job(job))
    result = updyn.update(ready.model, ready.frf, ready.parameters)
    assert result.values["shaft.stiffness"] == pytest.approx(1.2, rel=1e-6)


def test_an_error_in_the_job_names_file_and_line(tmp_path):
    job = tmp_path / "job.toml"
    job.write_text(JOB.replace('kind = "drivetrain"', 'kind = "drivtrain"'), encoding="utf-8")
    with pytest.raises(JobError, match=r"job\.toml:3: .*did you mean 'drivetrain'"):
        prepare(load_job(job))
    job.write_text(JOB.replace("stiffness = 1e4", "stifness = 1e4"), encoding="utf-8")
    with pytest.raises(JobError, match=r"job\.toml:9: .*shafts, number 1: no key 'stifness'"):
        prepare(load_job(job))
