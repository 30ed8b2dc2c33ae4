"""Gear ratios that may be inverted: a question where the inverse gives plausible frequencies."""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.elements.drivetrain import (
    Belt,
    DualDrive,
    GearPair,
    Inertia,
    Motor,
    Part,
    Shaft,
    Worm,
    drivetrain,
    drivetrain_from_table,
    ratio_questions,
    ratios,
)
from updyn.errors import UpdynWarning

#: Inertias of motor and load in kg m2, stiffness of the mesh at the load in N m/rad.
MOTOR, LOAD, MESH = 3e-4, 60.0, 5e6


def train(ratio: float) -> list[Part]:
    return [
        Motor("motor", 1, MOTOR),
        GearPair("gears", 1, 2, ratio, kind="internal", torsional_stiffness=MESH),
        Inertia("load", 2, LOAD),
    ]


def frequency(ratio: float) -> float:
    """Of two inertias on a mesh, in Hz: the inertia of the motor counts ratio^2 times at the load."""
    return np.sqrt(MESH * (1.0 / LOAD + 1.0 / (ratio**2 * MOTOR))) / (2.0 * np.pi)


def asked(build: Callable[[], Any]) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        build()
    assert all(issubclass(w.category, UpdynWarning) for w in caught)
    return [str(w.message) for w in caught]


def test_an_inverted_ratio_is_asked_about() -> None:
    (question,) = asked(lambda: drivetrain(train(1.0 / 97.0)))
    assert question == (
        "'gears': is the ratio inverted? As stated, node 1 turns 1/97 times as fast as node 2, and"
        f" the train has natural frequencies outside 0.01 to 10000 Hz: {frequency(1 / 97):.5g} Hz;"
        f" with its inverse they are {frequency(97):.5g} Hz"
    )
    assert frequency(1 / 97) > 1e6
    assert 100.0 < frequency(97) < 1000.0


def test_the_right_ratio_is_not() -> None:
    assert asked(lambda: drivetrain(train(97.0))) == []


def test_a_frequency_that_no_ratio_explains_is_not() -> None:
    parts = [*train(97.0), Shaft("stub", 2, 3, stiffness=1e12), Inertia("disc", 3, 1e-3)]
    assert asked(lambda: drivetrain(parts)) == []


def test_two_inverted_stages_are_asked_about_together() -> None:
    def two(first: float, second: float) -> list[Part]:
        return [
            Motor("motor", 1, 1e-3),
            GearPair("one", 1, 2, first, torsional_stiffness=1e5, inertia_b=0.2),
            GearPair("two", 2, 3, second, torsional_stiffness=5e6, inertia_b=100.0),
        ]

    assert asked(lambda: drivetrain(two(12.0, 8.0))) == []
    questions = asked(lambda: drivetrain(two(1.0 / 12.0, 1.0 / 8.0)))
    assert questions
    assert all("inverted?" in question for question in questions)
    assert any("'one'" in question for question in questions)


@pytest.mark.parametrize(
    "part",
    [
        GearPair("g", 1, 2, 4.0, torsional_stiffness=MESH),
        GearPair("g", 1, 2, teeth=(20, 80), module=1e-3, mesh_stiffness=1e8),
        GearPair("g", 1, 2, radii=(0.02, 0.08), kind="internal", mesh_stiffness=1e8),
        GearPair("g", 1, 2, teeth=(20, 80), rigid=True),
        Worm("g", 1, 2, -4.0, stiffness=MESH),
        Belt("g", 1, 2, (0.05, 0.2), stiffness=1e6),
        DualDrive("g", 1, 3, 2, 4.0, torsional_stiffness=MESH),
    ],
)
def test_the_ratio_is_that_of_the_rigid_body_motion(part: Part) -> None:
    for one, size in ((part, 4.0), (part.inverted(), 0.25)):
        first, second, ratio = one.speeds or (0, 0, 0.0)
        assert (first, second) == (1, 2)
        assert abs(ratio) == pytest.approx(size)
        parts = [Inertia("a", 1, 1.0), Inertia("b", 2, 1.0), one]
        if isinstance(one, DualDrive):
            parts.append(Inertia("c", 3, 1.0))
        rigid = drivetrain(parts).n_dofs == 1
        if rigid:
            continue
        found = updyn.modes(drivetrain(parts), 1)
        assert found.frequency[0] == 0.0
        a, b = found.at(["1:RZ", "2:RZ"])[:, 0]
        assert abs(a / b) == pytest.approx(size)


def test_parts_without_a_ratio_stay_as_they_are() -> None:
    shaft = Shaft("s", 1, 2, stiffness=1e3)
    assert shaft.speeds is None
    assert shaft.inverted() is shaft


JOB = """[model]
kind = "drivetrain"
motors = [{ name = "motor", node = 1, inertia = 3e-3 }]
inertias = [{ name = "load", node = 2, value = 6.0 }]
[[model.gear_pairs]]
name = "gearbox"
a = 1
b = 2
ratio = %r
torsional_stiffness = 2e3
[test]
file = "drive.uff"
[[parameter]]
groups = "gearbox"
quantity = "stiffness"
"""


def test_the_band_of_the_test_raises_the_question(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At 1/20 the frequency is plausible, but far from the band in which the train was measured."""

    def built(ratio: float) -> updyn.Model:
        return drivetrain_from_table(tomllib.loads(JOB % ratio)["model"])

    right, wrong = (updyn.modes(built(ratio), 2).frequency[1] for ratio in (20.0, 1.0 / 20.0))
    assert 1.4 * right < 20.0 < wrong < 1e4
    band = np.linspace(0.7 * right, 1.4 * right, 40)
    frf = updyn.response(built(20.0), band, ["1:RZ", "2:RZ"], ["1:RZ"])
    updyn.write_frf(frf, tmp_path / "drive.uff")
    for ratio, count in ((20.0, 0), (1.0 / 20.0, 1)):
        (tmp_path / "job.toml").write_text(JOB % ratio)
        assert main(["check", str(tmp_path / "job.toml")]) != 2
        said = capsys.readouterr()
        assert (said.out + said.err).count("is the ratio inverted?") == count
    text = " ".join((said.out + said.err).split())
    assert "no natural frequency of the train lies within an octave of the band" in text
    assert f"{wrong:.5g} Hz; with its inverse they are {right:.5g} Hz" in text


@pytest.mark.parametrize(("octaves", "count"), [(0.99, 0), (1.01, 1)])
def test_a_frequency_within_an_octave_of_the_band_raises_no_question(
    octaves: float, count: int
) -> None:
    right, wrong = (
        updyn.modes(drivetrain_from_table(tomllib.loads(JOB % ratio)["model"]), 2).frequency[1]
        for ratio in (20.0, 1.0 / 20.0)
    )
    band = (right, wrong / 2.0**octaves)
    assert len(ratio_questions(tomllib.loads(JOB % (1.0 / 20.0))["model"], band)) == count


@pytest.mark.parametrize(("n_dofs", "count"), [(300, 1), (301, 0)])
def test_trains_of_up_to_300_dofs_are_examined(n_dofs: int, count: int) -> None:
    parts = train(1.0 / 97.0)
    for node in range(2, n_dofs):
        parts.append(Shaft(f"shaft{node}", node, node + 1, stiffness=1e5))
        parts.append(Inertia(f"disc{node}", node + 1, 1.0))
    assert len(asked(lambda: drivetrain(parts))) == count


def test_frequencies_are_plausible_from_10_mhz_to_10_khz() -> None:
    found = np.array([0.0099, 0.0101, 9.9e3, 10.1e3])
    np.testing.assert_array_equal(ratios._outside_plausible(found), [0.0099, 10.1e3])
