"""A Dask cluster as the documentation has users start it: a scheduler and workers, processes of their own."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from distributed import Client

import engine_work
from engine_work import wait_until
from updyn.engines import Engine, Serial, choose_engine

#: Where the functions are that workers have to import.
HERE = Path(engine_work.__file__).parent
DASK = str(Path(sys.executable).with_name("dask"))


class DaskProcesses:
    """A scheduler on loopback and workers that can be killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        about = folder / "scheduler.json"
        # Timeouts: none is left behind where the tests are killed.
        where = [
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--dashboard-address",
            "127.0.0.1:0",
            "--idle-timeout",
            "300",
        ]
        self.scheduler = self._start("scheduler", *where, "--scheduler-file", str(about))
        self.address = ""
        self.workers: list[subprocess.Popen[bytes]] = []

        def started() -> bool:
            with contextlib.suppress(OSError, ValueError):  # not there yet, or half written
                self.address = json.loads(about.read_text(encoding="utf-8"))["address"]
            return bool(self.address)

        wait_until(started)

    def _start(self, *command: str) -> subprocess.Popen[bytes]:
        path = os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])])
        env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path}
        env["DASK_DISTRIBUTED__SCHEDULER__ACTIVE_MEMORY_MANAGER__INTERVAL"] = "100ms"
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(
                [DASK, *command], env=env, cwd=self.folder, stdout=log, stderr=log
            )

    def start_worker(self) -> None:
        options = ["--nthreads", "1", "--no-nanny", "--death-timeout", "60"]
        self.workers.append(self._start("worker", self.address, *options))

    def kill_worker(self) -> None:
        self.end(self.workers.pop(0))

    def end(self, process: subprocess.Popen[bytes]) -> None:
        process.kill()
        process.wait()

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            self.end(process)


# Of a module: the tests of another may come after more minutes than a scheduler waits for work.
@pytest.fixture(scope="module")
def dask_processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    processes = DaskProcesses(tmp_path_factory.mktemp("dask"))
    yield processes
    processes.close()


@pytest.fixture
def client(dask_processes: DaskProcesses) -> Iterator[Client]:
    """A client of two workers, whatever became of those before."""
    while len(dask_processes.workers) < 2:
        dask_processes.start_worker()
    with Client(dask_processes.address, timeout=60) as client:
        client.wait_for_workers(2, timeout=60)
        wait_until(lambda: len(client.nthreads()) == 2)  # a killed one is gone
        yield client


@pytest.fixture(scope="session")
def two_processes() -> Iterator[Engine]:
    engine = choose_engine(2)
    yield engine
    engine.close()


@pytest.fixture(params=["serial", "processes", "dask"])
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    if request.param == "serial":
        yield Serial()
    elif request.param == "processes":
        yield request.getfixturevalue("two_processes")
    else:
        engine = choose_engine(request.getfixturevalue("client"))
        yield engine
        engine.close()
