"""Thresholds of jobs: a case on either side of each."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from updyn.errors import JobError
from updyn.frf import FRF
from updyn.group import Group
from updyn.job import identification, load, proposal
from updyn.model import Model


def found(mode: float = 100.0, stable: float = 200.0, peaks: tuple[float, ...] = ()):
    """Return a mode with a half-power bandwidth of 1 %, a stable pole, and peaks."""
    diagram = SimpleNamespace(frequency=np.array([stable]), stable=np.array([True]))
    return SimpleNamespace(
        frequency=np.array([mode]),
        loss_factor=np.array([0.01]),
        diagram=diagram,
        unexplained=np.array(peaks),
    )


def test_a_pick_is_the_nearest_mode():
    assert identification._find_mode(found(), 102.0) == 100.0
    with pytest.raises(JobError, match="within 2 %"):
        identification._find_mode(found(), 102.1)


@pytest.mark.parametrize(("frequency", "pole"), [(151.0, 150.0), (153.9, None)])
def test_a_pick_is_the_nearest_peak(frequency, pole):
    assert identification._find_pole(found(peaks=(150.0,)), frequency) == pole


@pytest.mark.parametrize(("off", "pole"), [(1.9e-6, 200.0), (2.1e-6, None)])
def test_a_clicked_pole(off, pole):
    assert identification._find_pole(found(), 200.0 / (1.0 + off)) == pole


@pytest.mark.parametrize(("off", "pole"), [(0.24, None), (0.26, 100.0)])
def test_a_clicked_pole_beside_a_mode(off, pole):
    # In half-power bandwidths of the mode, which is 1 Hz wide.
    assert identification._find_pole(found(100.0 + off, stable=100.0), 100.0) == pole


@pytest.mark.parametrize(("length", "repeated"), [(38, True), (39, False)])
def test_a_message_repeats_a_short_value(length, repeated):
    item = {"type": "value_error", "input": "x" * length, "ctx": {"error": "wrong"}}
    assert ("xxx" in load._format_error(item, ("method", "name"), ())) is repeated


def inputs(lines: int = 200, sensors: int = 4, loss: float = 0.0) -> proposal.Inputs:
    labels = [f"{k}:X" for k in range(1, sensors + 1)]
    freq, values = np.arange(1.0, lines + 1.0), np.ones((lines, sensors, 1))
    frf = FRF(freq, values, labels, ["1:X"], "accelerance")
    group = Group(np.eye(sensors), np.eye(sensors), viscous=np.eye(sensors), loss_factor=loss)
    return proposal.Inputs(
        model_file=Path("model.h5"),
        frf_file=Path("test.uff"),
        model=Model.from_groups({"a": group}, labels),
        frf=frf,
        model_options={},
        frf_options={},
        has_quantity=True,
        matching=SimpleNamespace(frf=frf),
    )


@pytest.mark.parametrize(("lines", "mark"), [(199, "# "), (200, "")])
def test_the_most_informative_of_many_lines_are_proposed(lines, mark):
    text = proposal._format_method(inputs(lines))
    assert any(line.startswith(f'{mark}lines = "d-optimal:100"') for line in text)


@pytest.mark.parametrize(("sensors", "held"), [(3, []), (4, ["3:X"])])
def test_a_response_of_four_is_held_out(sensors, held):
    assert proposal._choose_validation_set(inputs(sensors=sensors)) == held


@pytest.mark.parametrize(("sensors", "listed"), [(24, True), (25, False)])
def test_few_sensors_are_listed(sensors, listed):
    text = proposal._format_test(inputs(sensors=sensors), Path("job.toml"))
    assert any(line.startswith("# responses = ") for line in text) is listed


def test_the_bounds_of_unknowns():
    text = "\n".join(proposal._format_parameters(inputs()))
    for bounds in ("[0.2, 5.0]", "[0.0, 0.3]", "[0.01, 100.0]", "[0.5, 2.0]"):
        assert f"bounds = {bounds}" in text
    assert "start = 0.01  # the model has no structural damping" in text
    assert "bounds = [0.0, 0.4]" in "\n".join(proposal._format_parameters(inputs(loss=0.2)))
