"""Forces that act elsewhere than their labels say."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.drive_point import DrivePoint
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.problem.problem import FRFPart

SENSORS = ["2:X", "5:X", "7:X", "10:-X", "12:X"]
FREQ = np.linspace(0.6, 22.0, 60)


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


def said_to_be(model, forces, labels):
    """Return data of some forces under other labels."""
    frf = updyn.response(model, FREQ, SENSORS, forces)
    return updyn.FRF(FREQ, frf.values, SENSORS, labels, frf.quantity)


def test_a_moved_force_gets_its_label(chain12):
    wrong = said_to_be(chain12, ["10:-X", "12:X"], ["2:-X", "12:X"])
    repaired = read_fault("moved:force 2:X,force 10:X").repair(wrong)
    assert repaired.references.labels == ["10:-X", "12:X"]
    assert repaired.responses.labels == SENSORS


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("moved:force 5:X,force 12:X", "'12:X' is a reference of the data already"),
        ("moved:force 3:X,force 4:X", "'3:X' is no reference"),
        ("moved:force 5:X,4:X", "two places of a sensor, or of a force"),
    ],
)
def test_what_cannot_be_moved_is_refused(chain12, written, said):
    frf = updyn.response(chain12, FREQ, SENSORS, ["5:X", "12:X"])
    with pytest.raises(OptionError, match=said):
        read_fault(written).repair(frf)


def test_a_force_elsewhere_exchanges_its_columns(chain12, chain12_true):
    """Against the model of the force that moved."""
    frf = updyn.response(chain12_true, FREQ, ["2:X", "7:-X"], ["5:X", "12:X"])
    frf = replace(frf, variance=1e-4 * np.abs(frf.values) ** 2)
    part = FRFPart.build(chain12, frf, updyn.parameters(chain12, stiffness="all", mass="all"))
    evidence = Evidence(part, part.coordinates.start)
    moved = read_fault("moved:force 5:X,force 7:X").repair_with_model(evidence)
    there = part.with_data(moved)
    blocks = [there.block(evidence.x, lines) for lines in there.partition()]
    H, dH = np.concatenate([b.H for b in blocks]), np.concatenate([b.dH for b in blocks], axis=1)
    np.testing.assert_allclose(evidence.model_response(moved), H, rtol=1e-12)
    np.testing.assert_allclose(evidence.model_slopes(moved), dH, rtol=1e-9, atol=1e-20)


@pytest.mark.parametrize(
    ("acts", "called", "others"),
    [
        ("10:X", "5:X", ["12:X"]),  # at another sensor
        ("10:X", "2:X", []),  # the only force
        ("9:X", "8:X", []),  # at the neighbouring mass, which has no sensor
    ],
)
def test_a_moved_force_is_found(chain12, chain12_true, unknowns, add_noise, acts, called, others):
    clean = said_to_be(chain12_true, [acts, *others], [called, *others])
    noisy = add_noise(clean, np.random.default_rng(4), 0.01)
    found = updyn.diagnose(chain12, noisy, unknowns)
    assert [one.channels for one in found] == [(f"force {called}", f"force {acts}")]
    assert found[0].kind == "moved"
    assert f"The force labelled {called} acts at {acts}." in found[0].statement
    assert found[0].repair(noisy).references.labels == [acts, *others]


@pytest.mark.parametrize(("acts", "also"), [("10:X", ""), ("10:-X", " with the opposite sign")])
def test_data_alone_show_where_the_force_puts_energy_in(chain12_true, add_noise, acts, also):
    """Of a single reference the only passive response is the one at the force."""
    sensors = [label.replace("-", "") for label in SENSORS]
    freq = np.linspace(0.6, 22.0, 600)
    frf = updyn.response(chain12_true, freq, sensors, [acts], "accelerance")
    called = updyn.FRF(freq, frf.values, sensors, ["2:X"], frf.quantity)
    noisy = add_noise(called, np.random.default_rng(6), 0.01)
    (shown,) = DrivePoint.detect_faults(replace(noisy, variance=1e-4 * np.abs(noisy.values) ** 2))
    assert f"a force at 10:X, not at 2:X{also and ','}{also}." in shown.fault.statement()
