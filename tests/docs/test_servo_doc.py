"""The page on servos runs as it stands, and says the truth about what it prints."""

from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest

from pages import ROOT, blocks, run_python
from updyn.control.job.tables import ServoTable

PAGE = ROOT / "docs/servo.md"


@pytest.fixture(scope="module")
def page() -> dict[str, Any]:
    namespace: dict[str, Any] = {"__name__": "page"}
    ran = 0
    for block in blocks(PAGE):
        if block.language == "python":
            run_python(block, "docs/servo.md", namespace)
            ran += 1
    assert ran == 9
    return namespace


def test_the_first_antiresonance_is_that_of_two_inertias_nearly(page: dict[str, Any]) -> None:
    """The rim moves more than the hub, so that the frequency is a little below sqrt(k / J_L)."""
    simple = np.sqrt(3.2e5 / 43.2) / (2 * np.pi)
    assert 0.9 * simple < page["first"].antiresonance < simple


def test_the_loop_is_stable_and_its_crossover_is_near_the_rule(page: dict[str, Any]) -> None:
    servo = page["servo"]
    assert servo.stable
    assert servo.velocity_loop.margins.crossover == pytest.approx(4.0, rel=0.05)
    assert servo.velocity_loop.margins.phase_margin > 45.0
    assert len(servo.velocity_loop.margins.gain_crossings) == 3


def test_sampling_takes_phase_as_the_hold_and_the_delay_do(page: dict[str, Any]) -> None:
    """The controller's dead time of 1 ms is that of the delay; the hold takes half an interval more."""
    continuous, sampled = page["servo"].velocity_loop.margins, page["m"]
    lost = 360.0 * continuous.gain_crossings * 0.5e-3
    off = sampled.phase_margins - (continuous.phase_margins - lost)
    assert (np.abs(off) < 0.1 * lost).all()


def test_the_windy_dish_errs_as_its_spectrum_says(page: dict[str, Any]) -> None:
    wind = page["windy"].wind
    assert wind.std == pytest.approx(wind.rms_expected, rel=0.1)


def test_backlash_hunts_as_predicted_within_what_the_page_says(page: dict[str, Any]) -> None:
    cycle, run = page["cycle"], page["run"]
    assert cycle.stable
    assert "half gaps" in cycle.doubt
    assert run.verdict == "limit cycle"
    assert 0.02 < abs(cycle.frequency / run.frequency - 1.0) < 0.15
    assert abs(cycle.amplitude / run.amplitude - 1.0) < 0.15


def test_the_job_is_read() -> None:
    (block,) = [b for b in blocks(PAGE) if b.language == "toml"]
    table = ServoTable.model_validate(tomllib.loads(block.text)["servo"])
    assert table.controller is not None
    table.controller.check()
    assert table.wind is not None


def test_the_table_is_that_of_the_benchmark() -> None:
    own = PAGE.read_text(encoding="utf-8")
    readme = (ROOT / "benchmarks/README.md").read_text(encoding="utf-8")
    rows = [
        line
        for line in own.splitlines()
        if line.startswith(("| velocity loop, ", "| position loop, "))
    ]
    assert len(rows) == 5
    for row in rows:
        name, drawings, updated, exact = [c.strip() for c in row.strip("|").split("|")]
        there = next(line for line in readme.splitlines() if line.startswith(f"| {name} |"))
        cells = [c.strip() for c in there.strip("|").split("|")]
        assert [drawings, updated, exact] == [cells[1], cells[2], cells[4]], name
        assert float(updated) == pytest.approx(float(exact), rel=0.05), name


def test_the_robust_margin_is_that_of_the_error(page: dict[str, Any]) -> None:
    """Both channels off by d at once, in phase: mu = d (|K G_v| + |K kv G_p|) / |1 + L|."""
    plant, controller, margin = page["plant"], page["controller"], page["error"]
    w = 2 * np.pi * np.geomspace(*plant.band, 20_000)
    G = plant.at(1j * w)[:, :, 0]
    K = controller.torque(1j * w)
    velocity, position = K * G[:, 0], controller.kv * K * G[:, 1]
    mu = (np.abs(velocity) + np.abs(position)) / np.abs(1 + velocity + position)
    assert margin.margin == pytest.approx(1.0 / (plant.relative_error * mu.max()), rel=1e-3)
