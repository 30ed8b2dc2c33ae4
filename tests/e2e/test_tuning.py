"""Sliders for the controller on the page Plant: by keyboard, with margins, written into the job."""

from __future__ import annotations

import tomllib

import pytest

import updyn
from servo_cases import NAMES, quick, two_masses
from updyn.demos import find_demo
from updyn.outputs.switch import replace_files
from window import browsing, serving, visit

pytest.importorskip("nicegui")
pytest.importorskip("playwright")
pytestmark = [
    pytest.mark.needs("browser"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
TABLES = """
[plant]
inputs = [{ name = "motor", dof = "1:X" }]
outputs = [{ name = "speed", dof = "1:X" }]
quantity = "mobility"
[servo]
velocity = "speed"
[servo.controller]
kp = 100
"""


def test_margins_follow_the_sliders_and_only_writing_changes_the_job(chromium, tmp_path):
    job = find_demo("chain").write_inputs(tmp_path)
    job.write_text(job.read_text() + TABLES)
    folder = tmp_path / "job-plant"
    folder.mkdir()
    with replace_files(folder, "plant", ["plant.html", "plant.json"]) as new:
        (new / "plant.html").write_text("<!DOCTYPE html><p>the page</p>")
        updyn.write_plant(two_masses(), new / "plant.json")

    def phase_margin(kp):
        loop = quick(two_masses(), updyn.Controller(kp), **NAMES).velocity_loop
        return f"{loop.margins.phase_margin:.3g}°"

    with serving(tmp_path, "job.toml") as server, browsing(chromium, server) as (page, heard):
        visit(page, f"{server.base}/plant")
        page.get_by_text(phase_margin(100.0), exact=True).wait_for()
        page.get_by_role("slider", name="kp").locator("[tabindex]").focus()
        for _ in range(10):
            page.keyboard.press("ArrowRight")
        moved = 100.0 * 10.0**0.2
        assert phase_margin(moved) != phase_margin(100.0)
        page.get_by_text(phase_margin(moved), exact=True).wait_for()
        assert tomllib.loads(job.read_text())["servo"]["controller"] == {"kp": 100}
        page.get_by_role("button", name="Write to the job").click()
        page.get_by_role("button", name="Save", exact=True).click()
        page.get_by_text("job.toml", exact=True).wait_for()
        assert heard.wrong == []
    found = tomllib.loads(job.read_text())["servo"]["controller"]
    assert found == {"kp": float(f"{moved:.4g}")}
