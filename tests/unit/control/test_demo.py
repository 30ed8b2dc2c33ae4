"""The azimuth servo of the antenna demo: its tables in the job are its settings; margins tell drawings from truth."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

import updyn
from places import ROOT
from updyn.control import demo
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.demos.antenna import TRUTH

pytest.importorskip("pyfe3d")

from updyn.demos.antenna_model import antenna


def test_the_tables_of_the_job_ask_for_this_plant_and_this_controller() -> None:
    tables = tomllib.loads(demo.job_tables())
    plant = PlantTable.model_validate(tables["plant"])
    assert (plant.input_ports, plant.output_ports) == (demo.INPUTS, demo.OUTPUTS)
    assert (plant.quantities, plant.band) == (demo.QUANTITIES, demo.BAND)
    servo = ServoTable.model_validate(tables["servo"])
    assert servo.controller is not None
    assert servo.controller.settings == {
        name: getattr(demo.CONTROLLER, name)
        for name in ("kp", "ti", "kv", "low_pass", "dead_time", "feed_forward", "notches")
    }
    assert (servo.motor, servo.load, servo.ratio) == (demo.MOTOR, demo.TURNTABLE, demo.RATIO)


def test_the_drawings_promise_what_the_truth_does_not_hold() -> None:
    drawings = antenna()
    truth = drawings.scaled(TRUTH)
    plants = [demo.azimuth_plant(model) for model in (drawings, truth)]
    servos = [demo.azimuth_servo(p) for p in plants]
    promised, held = (s.velocity_loop.margins for s in servos)
    assert promised.stable
    assert held.stable
    assert promised.phase_margin > 55.0
    assert held.phase_margin < 0.55 * promised.phase_margin
    # The same from the response of the true model itself, without a plant: phase where |L| = 1.
    f = held.phase_margin_at
    s = 2j * np.pi * f
    H = updyn.response(truth, [f], [demo.MOTOR], [demo.MOTOR]).values[0, 0, 0]
    L = demo.CONTROLLER.torque(s) * s * H / demo.RATIO**2
    assert abs(L) == pytest.approx(1.0, abs=0.02)
    assert np.degrees(np.angle(-L)) == pytest.approx(held.phase_margin, abs=1.5)
    figures = updyn.drive_figures(
        drawings, demo.MOTOR, demo.TURNTABLE, ratio=demo.RATIO, band=demo.BAND
    )
    assert demo.CONTROLLER.notches[0].frequency == pytest.approx(
        figures.pairs[-1].resonance, abs=0.01
    )
    assert demo.CONTROLLER.kp == pytest.approx(
        2 * np.pi * 7.0 * figures.inertia * demo.RATIO**2, rel=0.01
    )
    page = (ROOT / "docs" / "antenna.md").read_text(encoding="utf-8").splitlines()
    for at, loop in enumerate(("velocity", "position")):
        for what, _, attribute in demo.FIGURES:
            (row,) = [line.split() for line in page if line.startswith(f"{loop} loop, {what}")]
            found = [getattr(s.loops[at].margins, attribute) for s in servos]
            assert [float(row[-3]), float(row[-1])] == pytest.approx(found, rel=2e-3)
