"""Causes of a misfit in transmissibilities: found with their size, and none of those that need forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.data_alone import detect_data_faults

N = 6
FREQ = np.linspace(3.0, 45.0, 160)
SENSORS = ["1:X", "2:X", "3:X", "4:X", "5:X"]


def between(i: int, j: int, k: float) -> np.ndarray:
    e = np.eye(N)[i] - np.eye(N)[j]
    return k * np.outer(e, e)


def row(*more: updyn.Group) -> updyn.Model:
    """Masses of 1 kg on springs, with further groups; node 0 is the base."""
    groups = {f"s{i}": updyn.Group(between(i - 1, i, 2e4), loss_factor=0.02) for i in range(1, N)}
    groups["mass"] = updyn.Group(mass=np.eye(N))
    groups |= {f"more {i}": group for i, group in enumerate(more)}
    return updyn.Model.from_groups(groups, [f"{i}:X" for i in range(N)])


def measure(model: updyn.Model) -> updyn.FRF:
    true = model.scaled({"s2": {"stiffness": 1.3}, "s4": {"stiffness": 0.8}})
    exact = updyn.response(true, FREQ, SENSORS, ["0:X"], "transmissibility", base=["0:X"])
    real, imaginary = np.random.default_rng(0).standard_normal((2, *exact.values.shape))
    return replace(exact, values=exact.values * (1 + 0.007 * (real + 1j * imaginary)))


def diagnose(data: updyn.FRF) -> list[tuple[str, tuple[str, ...], float]]:
    return [(one.kind, one.channels, one.value) for one in updyn.diagnose(row(), data)]


def test_no_fault() -> None:
    assert diagnose(measure(row())) == []


def test_wrong_unit() -> None:
    data = measure(row())
    ((kind, channels, value),) = diagnose(replace(data, values=9.80665 * data.values))
    assert (kind, channels) == ("scale", ())
    assert value == pytest.approx(9.80665)


def test_delay_of_one_sensor() -> None:
    data = measure(row())
    values = data.values.copy()
    values[:, 1, 0] *= np.exp(-2j * np.pi * FREQ * 1e-3)
    ((kind, channels, value),) = diagnose(replace(data, values=values))
    assert (kind, channels) == ("delay", ("2:X",))
    assert value == pytest.approx(1e-3, rel=0.01)


def test_mass_that_the_model_lacks() -> None:
    lump = updyn.Group(mass=np.diag([0.0, 0.0, 0.0, 0.15, 0.0, 0.0]))
    ((kind, channels, value),) = diagnose(measure(row(lump)))
    assert (kind, channels) == ("missing-mass", ("3:X",))
    assert value == pytest.approx(0.15, rel=0.02)


def test_spring_that_the_model_lacks() -> None:
    tie = updyn.Group(between(2, 5, 6e3), loss_factor=0.02)
    ((kind, channels, value),) = diagnose(measure(row(tie)))
    assert (kind, channels) == ("missing-spring", ("2:X", "5:X"))
    assert value == pytest.approx(6e3, rel=0.03)


def test_a_sensor_on_the_base_is_no_drive_point() -> None:
    """A transmissibility of -1 at the base would violate the passivity of a drive point."""
    data = updyn.FRF(
        FREQ,
        np.full((len(FREQ), 1, 1), -1.0),
        ["0:X"],
        ["0:X"],
        "transmissibility",
        variance=np.full((len(FREQ), 1, 1), 1e-6),
    )
    force = updyn.FRF(FREQ, data.values, ["0:X"], ["0:X"], "mobility", variance=data.variance)
    assert "drive-point" in [one.fault.kind for one in detect_data_faults(force)]
    assert detect_data_faults(data) == []


@pytest.mark.parametrize("kind", ["quantity", "drive-point", "reciprocity", "rigid-body"])
def test_faults_of_forces_do_not_apply(kind: str) -> None:
    assert not CAUSES[kind].applies_to(measure(row()))
