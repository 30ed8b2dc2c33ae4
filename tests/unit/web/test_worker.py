"""A task in a process of its own: by a run of the chain demo, whole, stopped, killed and resumed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.cli import main
from updyn.demos import chain, find_demo
from updyn.dynamics.response import response
from updyn.web import edits
from updyn.web.document import JobDocument
from updyn.web.worker import Worker

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are another thing on Windows")

SHORT = """\
[model]
file = "chain.h5"
[test]
file = "chain.uff"
band = [1.0, 12.0]
[[parameter]]
groups = "part*"
quantity = "stiffness"
[method]
name = "output-error"
max_iterations = {steps}
tolerance = 0.0
[output]
report = false
"""
#: A job whose steps take long enough to be interrupted.
LONG = SHORT.replace("chain.uff", "long.npz").replace("band = [1.0, 12.0]\n", "")


@pytest.fixture
def begun() -> Iterator[Callable[..., Worker]]:
    """Begin tasks; those that a test leaves are killed."""
    workers: list[Worker] = []

    def begin(job: Path, out: str = "out", task: str = "run", *, resume: bool = False) -> Worker:
        worker = Worker(task, job, job.parent / out, job.parent, resume=resume)
        workers.append(worker)
        worker.start()
        return worker

    yield begin
    for worker in workers:
        if worker.active and worker._process is not None:
            worker._process.kill()
            wait(lambda worker=worker: not worker.active)  # type: ignore[misc]


def wait(until: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < end, "it did not come to pass"
        time.sleep(0.02)


def ended(worker: Worker) -> Worker:
    wait(lambda: not worker.active)
    return worker


@pytest.fixture
def short_job(chain_project: Path) -> Path:
    path = chain_project / "short.toml"
    path.write_text(SHORT.format(steps=3))
    return path


@pytest.fixture
def long_job(chain_project: Path) -> Path:
    freq = np.linspace(0.5, 25.0, 2000)
    at = ["2:X", "5:X", "12:X"]
    frf = response(chain.build().scaled(chain.TRUTH), freq, at, ["2:X"], quantity="accelerance")
    updyn.write_frf(frf, chain_project / "long.npz")
    path = chain_project / "long.toml"
    path.write_text(LONG.format(steps=100_000))
    return path


def result(folder: Path) -> updyn.UpdateResult:
    found = updyn.read_result(folder / "run.nc")
    assert isinstance(found, updyn.UpdateResult)
    return found


def test_a_run_is_done_and_says_how_far_it_is(
    short_job: Path, begun: Callable[..., Worker]
) -> None:
    worker = begun(short_job)
    assert worker.active
    assert worker.state == "running"
    before = worker.version
    ended(worker)
    assert (worker.state, worker.status) == ("done", "max-iterations")
    assert worker.version > before
    own = result(short_job.parent / "out")
    assert worker.message.startswith(own.summary()[:40])
    assert not worker.notes
    # The steps are those of the result's own history.
    assert [step["cost"] for step in worker.steps] == pytest.approx(
        [step.cost for step in own.history], rel=1e-12
    )
    assert [step["iteration"] for step in worker.steps] == [0, 1, 2, 3]
    assert worker.steps[0]["values"] == dict.fromkeys(own.values, 1.0)
    assert worker.now["values"] == pytest.approx(own.values, rel=1e-12)
    assert worker.values == own.values
    assert (
        json.loads((short_job.parent / "out" / "result.json").read_text())["status"]
        == "max-iterations"
    )
    worker.stop()
    worker.end()
    assert worker.state == "done"


def test_a_run_that_is_killed_and_stopped_goes_on_to_the_numbers_of_one_that_was_not(
    long_job: Path, begun: Callable[..., Worker]
) -> None:
    out = long_job.parent / "out"
    killed = begun(long_job)
    wait(lambda: len(killed.steps) > 1)
    assert killed._process is not None
    killed._process.kill()
    ended(killed)
    assert (killed.state, killed.status) == ("failed", "")
    assert killed.message == (
        "The process was ended by SIGKILL. What it had saved is kept: Resume goes on from there."
    )
    assert (out / "run.journal").is_file()
    assert not (out / "result.json").exists()

    stopped = begun(long_job, resume=True)
    stopped.stop()  # the process still imports
    assert stopped.active
    assert stopped.state == "stopping"
    stopped.end()  # does not press a second time, and so waits for the results
    ended(stopped)
    assert (stopped.state, stopped.status) == ("done", "stopped"), stopped.message
    before = result(out)
    assert before.status == "stopped"

    steps = len(before.history) + 2
    long_job.write_text(LONG.format(steps=steps))
    resumed = ended(begun(long_job, resume=True))
    assert resumed.state == "done", resumed.message
    fresh = long_job.parent / "fresh"
    main(["run", str(long_job), "--out", str(fresh)])
    one, other = result(out), result(fresh)
    assert one.status == other.status
    assert len(one.history) > len(before.history)
    assert (one.values, one.history) == (other.values, other.history)


def test_a_bad_job_fails_with_its_message(short_job: Path, begun: Callable[..., Worker]) -> None:
    """This one names a file outside the project."""
    short_job.write_text(short_job.read_text().replace("chain.h5", "../secret.h5"))
    worker = ended(begun(short_job))
    assert worker.state == "failed"
    assert worker.message.startswith("short.toml:2: ")
    assert "is outside the folder of the project" in worker.message
    assert "Traceback" not in worker.message
    assert not (short_job.parent / "out").exists()


def test_a_task_that_is_unknown(chain_project: Path, begun: Callable[..., Worker]) -> None:
    worker = ended(begun(chain_project / "job.toml", task="rum"))
    assert worker.state == "failed"
    assert "rum" in worker.message
    assert "did you mean 'run'" in worker.message
    assert "Traceback" not in worker.message


def test_what_a_process_says_that_is_no_progress(tmp_path: Path) -> None:
    """Whatever comes on its output, it is kept for the message and harms nothing."""
    worker = Worker("run", tmp_path, tmp_path, tmp_path)
    for told in ({"kind": "note", "text": f"note {n}"} for n in range(300)):
        worker._handle_event(told)
    assert list(worker.notes) == [f"note {n}" for n in range(100, 300)]
    step = {
        "kind": "progress",
        "stage": "fit",
        "accepted": True,
        "lines_done": 0,
        "n_lines": 1,
        "values": {},
    }
    for iteration, cost in ((0, 4.0), (0, 4.0), (1, None), (1, 3.0), (2, 2.0)):
        worker._handle_event({**step, "iteration": iteration, "cost": cost})
    costs = [(s["iteration"], s["cost"]) for s in worker.steps]
    assert costs[0] == (0, 4.0)
    assert costs[-1] == (2, 2.0)
    assert worker.now["iteration"] == 2
    for code, end in (
        (0, "exit code 0"),
        (1, "exit code 1"),
        (-11, "SIGSEGV"),
        (-200, "signal 200"),
    ):
        worker.message = worker.status = ""
        worker._errors.append("the last line")
        worker._record_end(code)
        assert worker.state == "failed"
        assert end in worker.message.splitlines()[0]
        assert worker.message.splitlines()[-1] == "the last line"


def test_a_task_that_has_nothing_to_write_yet_is_ended(tmp_path):
    job = find_demo("chain").write_inputs(tmp_path)
    document = JobDocument(job)
    for key, value in {"n_sensors": 3, "band": [0.6, 22.0], "robust": 400}.items():
        document.edit(key, edits.set_key("plan", key, value))
    document.save()
    worker = Worker("plan", job, tmp_path / "plan", tmp_path)
    worker.start()
    wait(lambda: bool(worker.stages))
    worker.stop()
    wait(lambda: not worker.active)
    assert (worker.state, worker.message) == ("stopped", "Stopped; nothing was written.")
    assert not (tmp_path / "plan" / "plan.json").exists()


def test_a_run_whose_server_has_ended_writes_its_results(tmp_path):
    job = find_demo("chain").write_inputs(tmp_path)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "updyn.web.work", "run", job, out, tmp_path]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    process.stdout.readline()  # it is at work
    process.stdout.close()
    process.stdin.close()
    assert process.wait(120) == 0
    assert (out / "result.json").is_file()
