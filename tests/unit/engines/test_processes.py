"""Processes on this machine: their threads, their signals, their end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import engine_work as work
from engine_work import wait_until
from places import SUPPORT
from updyn.engines import processes

posix = pytest.mark.skipif(os.name != "posix", reason="signals and parents are those of POSIX")


@pytest.fixture
def shared(tmp_path):
    return work.Shared(tmp_path)


def pids(engine, shared) -> set[int]:
    return {pid for pid, _ in engine.map(work.call_of, shared, range(20))}


def test_the_cores_are_shared_among_the_processes(two_processes):
    import joblib

    share = max(1, joblib.cpu_count() // 2)
    (found,) = two_processes.map(work.environment, None, ["OMP_NUM_THREADS"])
    assert found == str(min(share, int(os.environ.get("OMP_NUM_THREADS", share))))


@pytest.mark.parametrize(
    ("value", "expected"), [("1", 1), ("3", 3), ("0", 4), ("", 4), ("2,4", 4), ("-1", 4)]
)
def test_a_number_of_threads_set_by_the_user(value, expected, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", value)
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    assert [
        processes._thread_limit(name, 4) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
    ] == [expected] * 2
    monkeypatch.setenv("MKL_NUM_THREADS", "2")
    assert processes._thread_limit("MKL_NUM_THREADS", 4) == 2


@posix
def test_ctrl_c_does_not_reach_the_workers(two_processes, shared):
    before = pids(two_processes, shared)
    for pid in before:
        os.kill(pid, signal.SIGINT)
    assert pids(two_processes, shared) <= set(two_processes._pool._processes)
    assert before <= set(two_processes._pool._processes)


def test_a_worker_that_grows_is_kept(two_processes, shared):
    list(two_processes.map(work.seen_as_leaking, shared, range(10)))
    before = set(two_processes._pool._processes)
    assert pids(two_processes, shared) <= before
    assert set(two_processes._pool._processes) == before


def test_workers_hold_the_latest_two(two_processes, tmp_path):
    several = [work.Shared(tmp_path, n) for n in range(2, 6)]
    for shared in several:
        assert max(two_processes.map(work.objects_held, shared, range(8))) <= 2
    assert len(list(two_processes._folder.glob("shared-*"))) == 2


def test_closing_leaves_nothing_behind(shared):
    engine = processes.Processes(2)
    workers, folder = pids(engine, shared), engine._folder
    assert folder.exists()
    engine.close()
    assert not folder.exists()
    wait_until(lambda: not any(is_running(pid) for pid in workers))


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


SCRIPT = """
import os, sys
sys.path.insert(0, {here!r})
import engine_work as work
from pathlib import Path
from updyn.engines import choose_engine

engine = choose_engine(2)
shared = work.Shared(Path({folder!r}))
print({{pid for pid, _ in engine.map(work.call_of, shared, range(20))}}, engine._folder, flush=True)
{ending}
"""


@posix
@pytest.mark.parametrize("ending", ["", "work.end_process()"], ids=["ends", "is killed"])
def test_a_script_without_main_guard_that(ending, tmp_path):
    """Such a script starts workers, and leaves none behind, nor their files, however it ends."""
    script = tmp_path / "script.py"
    script.write_text(
        SCRIPT.format(here=str(SUPPORT), folder=str(tmp_path), ending=ending), encoding="utf-8"
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == (-signal.SIGKILL if ending else 0), done.stderr
    started, folder = done.stdout.strip().rsplit(" ", 1)
    workers = {int(pid) for pid in started.strip("{}").split(",")}
    wait_until(lambda: not any(is_running(pid) for pid in workers))
    wait_until(lambda: not Path(folder).exists())
