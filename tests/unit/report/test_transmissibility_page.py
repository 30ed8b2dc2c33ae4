"""Reports of transmissibilities: the reference is a sensor, and modes and fine lines have a fixed base."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.frf import reference_noun, unit
from updyn.report.data import gather
from updyn.report.scene import sensors_of


def transmissibility(**excitation: object) -> updyn.FRF:
    values = np.ones((2, 1, 1))
    return updyn.FRF([1.0, 2.0], values, ["3:Z"], ["1:Z"], "transmissibility", **excitation)


def test_sensors_and_forces() -> None:
    force = updyn.FRF([1.0, 2.0], np.ones((2, 1, 1)), ["3:Z"], ["1:Z"], "accelerance")
    assert sensors_of([force]) == (["3:Z"], ["1:Z"])
    assert sensors_of([transmissibility(base=["1:Z"])]) == (["3:Z", "1:Z"], [])
    assert sensors_of([transmissibility(force="7:Z")]) == (["3:Z", "1:Z"], ["7:Z"])


def test_units_and_nouns() -> None:
    assert unit("transmissibility", "3:Z", "1:Z") == "1"
    assert unit("transmissibility", "3:RX", "1:Z") == "rad/m"
    assert reference_noun("transmissibility") == "reference"
    assert reference_noun("mobility") == "force"


def test_curves_resolve_resonances_of_the_fixed_base() -> None:
    """The oscillator on its base at 5 Hz, not the free one of two masses at 7.07 Hz."""
    pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
    group = updyn.Group((2 * np.pi * 5.0) ** 2 * pair, np.eye(2), loss_factor=0.002)
    model = updyn.Model.from_groups({"it": group}, ["1:Z", "2:Z"])
    lines = np.linspace(1.0, 20.0, 39)
    data = updyn.response(model, lines, ["2:Z"], ["1:Z"], "transmissibility", base=["1:Z"])
    result = updyn.update(model, data, updyn.parameters(model, loss_factor="all"), starts=0)
    found = gather(result)
    near = [int(np.sum(np.abs(found.grid - f) < 0.02 * f)) for f in (5.0, 5.0 * np.sqrt(2.0))]
    assert near[0] > near[1] + 5
    assert found.after_curve is not None
    assert np.abs(found.after_curve).max() == pytest.approx(1 / 0.002, rel=0.01)
    np.testing.assert_allclose(found.after_curve[0, 0, 0], 1 / (1 - 1 / 25), rtol=1e-3)
