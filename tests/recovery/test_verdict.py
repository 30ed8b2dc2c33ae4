"""Faults that once ended as converged: the verdict says no, and names the cause."""

from dataclasses import replace

import numpy as np
import pytest

import updyn


@pytest.fixture
def data(chain12_true, add_noise):
    sensors = ["2:X", "5:X", "7:X", "10:X", "12:X"]
    clean = updyn.response(
        chain12_true, np.linspace(0.6, 22.0, 100), sensors, ["5:X", "12:X"], "mobility"
    )
    return add_noise(clean, np.random.default_rng(1), 0.01)


@pytest.fixture
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all")


def exchanged(frf):
    values = frf.values.copy()
    values[:, [1, 3]] = values[:, [3, 1]]
    return replace(frf, values=values)


@pytest.mark.parametrize(
    ("spoilt", "written"),
    [
        (lambda frf: replace(frf, quantity="accelerance"), "quantity=mobility"),
        (exchanged, "swapped:5:X,10:X"),
        (lambda frf: replace(frf, values=frf.values / 9.80665), "scale=0.101971621"),
    ],
)
def test_an_answer_from_faulty_data_is_not_believed(chain12, data, unknowns, spoilt, written):
    bad = spoilt(data)
    result = updyn.update(chain12, bad, unknowns)
    assert not result.ok
    assert result.trust["plausible"].holds is False
    assert result.findings[0].written == written
    assert result.findings[0].statement in result.message
    assert updyn.update(chain12, result.findings[0].repair(bad), unknowns).ok


def test_a_held_out_sensor_of_the_wrong_sign_is_not_validated(chain12, data, unknowns):
    values = data.values.copy()
    values[:, 2] *= -1.0
    result = updyn.update(chain12, replace(data, values=values), unknowns, validation=["7:X"])
    assert result.correlation["validation"]["after"]["frac_min"] > 0.99
    assert result.status == "not-credible"
    assert result.trust["validated"].holds is False
    assert [one.written for one in result.findings] == ["sign:7:X"]


def test_sound_data_are_believed(chain12, data, unknowns):
    result = updyn.update(chain12, data, unknowns, validation=["7:X"])
    assert result.ok
    assert all(result.trust.values())
    assert result.findings == ()
