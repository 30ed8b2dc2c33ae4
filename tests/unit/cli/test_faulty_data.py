"""Data that once ended green: exit code 3, and the cause on screen, in result.json and in the report."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pages_read import Page
from updyn.cli import main
from updyn.demos import chain
from updyn.frf import FRF
from updyn.io import write_frf, write_model

JOB = """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[[parameter]]
groups = "part*"
quantity = "mass"
[method]
starts = 0
"""


def mobility_as_accelerance(frf: FRF) -> FRF:
    """The values of mobilities under the name of accelerances."""
    return replace(frf, values=frf.values / (2j * np.pi * frf.freq)[:, None, None])


def exchanged_cables(frf: FRF) -> FRF:
    """The second and the fourth sensor in each other's place."""
    return replace(frf, values=frf.values[:, [0, 3, 2, 1, 4]])


def held_out_sensor_turned(frf: FRF) -> FRF:
    """The third sensor, which the job holds out, the wrong way round."""
    values = frf.values.copy()
    values[:, 2] *= -1.0
    return replace(frf, values=values)


@pytest.mark.parametrize(
    ("spoil", "held", "written", "named"),
    [
        (mobility_as_accelerance, "", "quantity=mobility", "mobility"),
        (exchanged_cables, "", "swapped:5:X,10:X", "5:X and 10:X"),
        (held_out_sensor_turned, 'validation = ["7:X"]\n', "sign:7:X", "7:X"),
    ],
)
def test_what_once_ended_green_ends_with_exit_code_3_and_names_its_cause(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[FRF], FRF],
    held: str,
    written: str,
    named: str,
) -> None:
    write_model(chain.build(), tmp_path / "chain.h5")
    write_frf(spoil(chain.measure()), tmp_path / "chain.npz")
    (tmp_path / "job.toml").write_text(JOB + held, encoding="utf-8")
    assert main(["run", str(tmp_path / "job.toml")]) == 3

    found = json.loads((tmp_path / "job" / "result.json").read_text(encoding="utf-8"))
    assert found["status"] not in ("converged", "not-identifiable")
    assert found["trust"]["plausible"]["holds"] is False
    first = found["findings"][0]
    assert first["written"] == written
    assert named in first["statement"]

    screen = " ".join(capsys.readouterr().out.split())
    assert "plausible no " in screen
    assert "more max_iterations" not in screen  # more steps would not make it true
    page = Page((tmp_path / "job" / "report.html").read_text(encoding="utf-8")).words
    for text in (screen, page):
        assert first["statement"] in text
    assert "What to do next, under [test] of the job: Check this." in screen
    assert f'repair = ["{written}"] ' in screen
    assert f'repair = ["{written}"]' in page
    assert "Plausible no" in page
    assert "Not credible" in page
