"""Another package extends updyn by one object and one entry point for each kind of extension.

The package stands in ``toy``; its metadata is found as that of an installed one. Everything is run
in processes of its own, by the command line and a job file.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import updyn

TOY = Path(__file__).parent / "toy"

JOB = """
[model]
kind = "structure"
grounded = ["3:X"]
[model.nodes]
1 = [0.0, 0.0, 0.0]
2 = [1.0, 0.0, 0.0]
3 = [2.0, 0.0, 0.0]
[[model.rod]]
name = "left"
connectivity = [[1, 2]]
stiffness = 1e4
mass = 1.0
loss_factor = 0.02
[[model.rod]]
name = "right"
connectivity = [[2, 3]]
stiffness = 2e4
mass = 1.0
loss_factor = 0.02
[test]
file = "test.toy"
[[parameter]]
groups = ["left", "right"]
quantity = "stiffness"
[method]
name = "METHOD"
tier = "sparse"
backend = "toy"
[toy]
file = "values.json"
"""
TRUTH = {"left.stiffness": 1.3, "right.stiffness": 0.8}


def python(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python where the package is installed."""
    path = os.pathsep.join([str(TOY), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measurement in the format of the package: receptance of two masses in a row."""
    folder = tmp_path_factory.mktemp("toy")
    freq = np.linspace(2.0, 40.0, 30)
    k1, k2 = 1.3e4 * (1 + 0.02j), 1.6e4 * (1 + 0.02j)
    lines = ["TOY 1:X 1:X 2:X"]
    for f in freq:
        omega2 = (2 * np.pi * f) ** 2
        Z = np.array([[k1 - omega2, -k1], [-k1, k1 + k2 - 2 * omega2]])
        H = np.linalg.solve(Z, [1.0, 0.0])
        numbers = [f, H[0].real, H[0].imag, H[1].real, H[1].imag]
        lines.append(" ".join(f"{number:.17g}" for number in numbers))
    (folder / "test.toy").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


@pytest.mark.parametrize("method", ["toy-residual", "toy-method"])
def test_a_job_uses_all_of_them(folder: Path, method: str) -> None:
    (folder / "job.toml").write_text(JOB.replace("METHOD", method), encoding="utf-8")
    words = ("-m", "updyn", "run", "job.toml", "--out", method, "--engine", "backwards")
    done = python(folder, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Toy: 2 values." in done.stdout
    found = json.loads((folder / method / "result.json").read_text(encoding="utf-8"))
    assert found["method"] == method
    assert found["status"] == "converged"
    values = json.loads((folder / method / "values.json").read_text(encoding="utf-8"))
    assert values == pytest.approx(TRUTH, rel=1e-6)
    page = (folder / method / "report.html").read_text(encoding="utf-8")
    assert "<li>left.stiffness: 1.300000</li>" in page
    assert 'id="toy"' in page
    record = updyn.read_result(folder / method / "run.nc")
    assert record.options["backend"] == "toy"
    again = python(folder, "-m", "updyn", "check", f"{method}/job.toml")
    assert again.returncode == 0, again.stderr


def test_a_file_is_known_by_content_and_suffix(folder: Path) -> None:
    done = python(folder, "-m", "updyn", "info", "test.toy")
    assert done.returncode == 0, done.stderr
    assert "30 lines" in done.stdout
    done = python(folder, "-m", "updyn", "convert", "test.toy", "test.npz")
    assert done.returncode == 0, done.stderr


def test_a_table_is_checked_as_all_are(folder: Path) -> None:
    text = JOB.replace("METHOD", "log").replace('file = "values.json"', 'fil = "values.json"')
    (folder / "wrong.toml").write_text(text, encoding="utf-8")
    done = python(folder, "-m", "updyn", "check", "wrong.toml")
    line = text.splitlines().index('fil = "values.json"') + 1
    assert done.returncode == 2
    assert f"wrong.toml:{line}:" in done.stderr
    assert "'file'" in done.stderr


def test_without_the_package_its_names_are_refused(folder: Path) -> None:
    (folder / "job.toml").write_text(JOB.replace("METHOD", "toy-method"), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "updyn", "check", "job.toml"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_registration_by_hand(folder: Path) -> None:
    """What the entry points do, by `Registry.register` in a script."""
    code = (
        "import updyn\n"
        "from updyn.updating.problem.residuals import RESIDUALS\n"
        "RESIDUALS.register('mine', 'toy_updyn.residual:InverseError')\n"
        "from updyn.updating.fit.methods import METHODS\n"
        "print(METHODS.find('mine').name)\n"
    )
    done = python(folder, "-c", code)
    assert (done.returncode, done.stdout.strip()) == (0, "mine"), done.stderr
