"""The tutorial on a bolted flange runs as it stands, and its statements hold."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import updyn
from pages import ROOT, blocks, run_console, run_python, save_toml
from updyn.report.element_motion import describe_element, gather_motions

PAGE = ROOT / "docs" / "tutorial-joint.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the run, after all blocks of the page."""
    folder = tmp_path_factory.mktemp("joint")
    namespace: dict[str, Any] = {"__name__": "page"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in blocks(PAGE):
            if block.language == "python":
                run_python(block, PAGE.name, namespace)
            elif block.language == "console":
                run_console(block, PAGE.name)
            elif block.language == "toml":
                save_toml(block)
    assert "typical of a joint that begins to slip" in namespace["change"].statement
    return folder / "flange"


def test_the_verdict_holds_with_the_held_out_sensor(folder: Path) -> None:
    record = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert record["status"] == "converged"
    assert record["trust"]["validated"]["holds"] is True
    assert record["trust"]["plausible"]["holds"] is True


def test_the_joint_softens_as_stated(folder: Path) -> None:
    tests = {f"{F} N m": updyn.read_result(folder / f"{F} N m" / "run.nc") for F in (2, 8, 20)}
    motions, _ = gather_motions(tests)
    shares = []
    for one in motions:
        result = tests[one.test]
        found = describe_element(result, "bolts", np.array([one.amplitude]), one.freq)
        shares.append(found.stiffness[0].real / result.values["bolts.stiffness"])
    assert shares[0] == pytest.approx(0.5, abs=0.1)
    assert shares[2] == pytest.approx(0.01, rel=0.2)


def test_the_report_has_both_sections(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    for name in ("levels-frfs", "element-0-stiffness", "element-0-loop"):
        assert f'data-figure="{name}"' in page
    assert 'id="levels"' in page


def test_the_highest_level_tells_most_of_the_slip_torque(folder: Path) -> None:
    levels = json.loads((folder / "levels.json").read_text(encoding="utf-8"))
    without = {one["name"]: one["without"]["bolts.slip_force"] for one in levels["tests"]}
    assert max(without, key=without.get) == "20 N m"
    gains = {one["level"]: one["gain"] for one in levels["candidates"]}
    assert gains[40.0] > gains[20.0] > gains[4.0]
