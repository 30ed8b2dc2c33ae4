"""The command line as a process of its own: start, light import, Ctrl-C."""

from __future__ import annotations

import gc
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import updyn
from command_line import updyn_process
from updyn.cli import COMMANDS, main
from updyn.cli.settings import WAITING
from updyn.demos import chain
from updyn.dynamics.response import response

LONG = """\
[model]
file = "chain.h5"
[test]
file = "long.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[[parameter]]
groups = "part*"
quantity = "mass"
[method]
name = "output-error"
max_iterations = 100000
tolerance = 0.0
[output]
report = false
"""


def test_help_is_light() -> None:
    code = (
        "import sys; from updyn.cli import main; code = main(['--help']); heavy = {'xarray',"
        " 'pandas', 'plotly', 'pyuff', 'h5py', 'h5netcdf', 'pydantic', 'tomlkit',"
        " 'scipy.optimize'}; print(sorted(heavy & set(sys.modules)), code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[] 0"


def test_a_command_searches_rarely_for_unreachable_objects(monkeypatch) -> None:
    seen = []

    def command() -> int:
        seen.append(gc.get_threshold()[0])
        return 0

    monkeypatch.setitem(COMMANDS._entries, "look", command)
    before = gc.get_threshold()
    assert main(["look"]) == 0
    assert seen == [WAITING.new_objects]
    assert gc.get_threshold() == before


def test_what_writes_results_is_loaded_before_the_fit(chain_folder: Path) -> None:
    """Else a run that is stopped goes on for the second that it takes."""
    (chain_folder / "job.toml").write_text(LONG.replace("long.npz", "chain.npz"), encoding="utf-8")
    code = (
        "import sys; from updyn.job import load_job, run_job; seen = []; "
        "run_job(load_job('job.toml'), callback=lambda p: seen.append('h5netcdf' in sys.modules) or True); "
        "print(seen[0])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=chain_folder, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "True"


def test_bad_input_in_a_process(tmp_path: Path) -> None:
    (tmp_path / "job.toml").write_text("[model\n")
    process = updyn_process("run", "job.toml", cwd=tmp_path)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert out == ""
    assert err.splitlines() == [
        "error: job.toml:1: not TOML: Expected ']' at the end of a table declaration at column 7"
    ]


@pytest.fixture
def long_job(chain_folder: Path) -> Path:
    """A job whose steps take long enough to be interrupted."""
    freq = np.linspace(0.5, 25.0, 250)
    labels = [f"{i}:X" for i in range(1, 13)]
    frf = response(chain.build().scaled(chain.TRUTH), freq, labels, labels, quantity="accelerance")
    updyn.write_frf(frf, chain_folder / "long.npz")
    job = chain_folder / "job.toml"
    job.write_text(LONG, encoding="utf-8")
    return job


@pytest.mark.usefixtures("no_causes")
@pytest.mark.skipif(os.name == "nt", reason="SIGINT to a child is another thing on Windows")
def test_ctrl_c_stops_after_the_step_and_writes(long_job: Path) -> None:
    process = updyn_process("run", str(long_job))
    assert process.stderr is not None
    assert any("iteration" in line for line in process.stderr)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert "Stopping after this step" in err
    assert "To continue: updyn run JOB.toml --resume" in out
    assert out.startswith("Chain of twelve masses: stopped after ")
    found = json.loads((long_job.parent / "job" / "result.json").read_text(encoding="utf-8"))
    assert found["status"] == "stopped"
    assert updyn.read_result(long_job.parent / "job" / "run.nc").status == "stopped"

    few = long_job.read_text(encoding="utf-8").replace(
        "max_iterations = 100000", "max_iterations = 4"
    )
    long_job.write_text(few, encoding="utf-8")
    assert main(["run", str(long_job), "--resume"]) == 3
    assert main(["run", str(long_job), "--out", str(long_job.parent / "fresh")]) == 3
    resumed, fresh = (
        updyn.read_result(long_job.parent / name / "run.nc") for name in ("job", "fresh")
    )
    assert resumed.status == "max-iterations"
    assert (resumed.values, resumed.history) == (fresh.values, fresh.history)


@pytest.mark.skipif(os.name == "nt", reason="SIGINT to a child is another thing on Windows")
def test_a_second_ctrl_c_leaves_at_once_and_writes_no_results(long_job: Path) -> None:
    process = updyn_process("run", str(long_job))
    assert process.stderr is not None
    assert any("iteration" in line for line in process.stderr)
    process.send_signal(signal.SIGINT)
    assert any("Stopping after this step" in line for line in process.stderr)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert out == ""
    assert "no results were written" in err
    assert "Traceback" not in err
    assert [p.name for p in (long_job.parent / "job").iterdir()] == ["run.journal"]


@pytest.mark.usefixtures("no_causes")
@pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL on Windows")
def test_a_killed_run_is_resumed_to_the_result_of_one_that_was_not(long_job: Path) -> None:
    job = long_job.read_text(encoding="utf-8").replace(
        "max_iterations = 100000", "max_iterations = 12"
    )
    long_job.write_text(job, encoding="utf-8")
    process = updyn_process("run", str(long_job))
    assert process.stderr is not None
    assert any("iteration" in line for line in process.stderr)
    process.kill()
    process.communicate(timeout=120)
    left = sorted(p.name for p in (long_job.parent / "job").iterdir())
    assert left == [".updyn.lock", "run.journal"]
    for more in (["--resume"], ["--out", str(long_job.parent / "fresh")]):
        assert main(["run", str(long_job), *more]) == 3
    resumed, fresh = (
        updyn.read_result(long_job.parent / name / "run.nc") for name in ("job", "fresh")
    )
    assert (resumed.values, resumed.std, resumed.history) == (
        fresh.values,
        fresh.std,
        fresh.history,
    )
    assert resumed.correlation == fresh.correlation


@pytest.mark.skipif(os.name == "nt", reason="SIGINT to a group is another thing on Windows")
def test_ctrl_c_reaches_workers_too_and_stops_them_in_order(long_job: Path) -> None:
    """A terminal sends Ctrl-C to every process of the job."""
    process = updyn_process("run", str(long_job), "--workers", "2", start_new_session=True)
    assert process.stderr is not None
    assert any("iteration" in line for line in process.stderr)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert out.startswith("Chain of twelve masses: stopped after ")
    found = json.loads((long_job.parent / "job" / "result.json").read_text(encoding="utf-8"))
    assert found["status"] == "stopped"
