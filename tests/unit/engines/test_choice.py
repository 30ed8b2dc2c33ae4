"""Which engine is meant."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys

import pytest
from distributed import Client

from updyn.engines import KINDS, Engine, Serial, choose_engine
from updyn.engines.cluster import Cluster
from updyn.engines.processes import Processes
from updyn.errors import EngineError, OptionError


def test_none_is_this_process():
    engine = choose_engine(None)
    assert isinstance(engine, Serial)
    assert (engine.workers, engine.name) == (1, "serial")


def test_an_engine_is_itself():
    engine = Serial()
    assert isinstance(engine, Engine)
    assert choose_engine(engine) is engine


@pytest.mark.parametrize("given", ["two", 2.0, Serial, [], True])
def test_anything_else_is_refused_by_name(given):
    expected = "None, a number of processes from 1 up, a dask.distributed Client or an engine"
    with pytest.raises(
        OptionError, match=rf"^engine is .* \((str|float|type|list|bool)\); expected {expected}$"
    ):
        choose_engine(given)


def test_a_number_is_so_many_processes():
    assert isinstance(choose_engine(1), Serial)
    engine = choose_engine(3)
    assert isinstance(engine, Processes)
    assert (engine.workers, engine.name) == (3, "3 processes")


@pytest.mark.parametrize("given", [0, -1])
def test_a_number_below_one_is_refused(given):
    with pytest.raises(
        OptionError, match=rf"^engine is {given}; expected a number of processes from 1 up$"
    ):
        choose_engine(given)


def test_more_processes_than_the_cores_can_serve_are_refused():
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert choose_engine(8 * cores).workers == 8 * cores
    for given in (8 * cores + 1, 100_000):
        message = (
            f"^{given} processes; expected at most {8 * cores}, 8 for each of the {cores} cores"
        )
        with pytest.raises(OptionError, match=message):
            choose_engine(given)


def test_a_client_is_its_cluster(client):
    engine = choose_engine(client)
    assert isinstance(engine, Cluster)
    assert (engine.workers, engine.name) == (2, "dask, 2 workers")
    engine.close()
    assert client.status == "running"


def test_a_cluster_with_another_version_is_refused(client, monkeypatch):
    monkeypatch.setattr("updyn.engines.cluster.__version__", "9.9")
    with pytest.raises(
        EngineError,
        match=r"^updyn is 9\.9 here and \d+\.\d+\.\d+ on tcp://.*; install the same on all$",
    ):
        choose_engine(client)


def test_a_client_of_an_asynchronous_program_is_refused(dask_processes):
    async def choose() -> None:
        async with Client(dask_processes.address, asynchronous=True) as client:
            with pytest.raises(OptionError, match="asynchronous=False"):
                choose_engine(client)

    asyncio.run(choose())


def test_what_an_engine_needs_is_loaded_with_it():
    code = "import sys, updyn.engines as e; e.choose_engine(None); e.choose_engine(2)"
    code += "; assert not {'joblib', 'dask', 'distributed'} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60).returncode == 0


class Backwards(Serial):
    """An engine as another package may add one: the last item first."""

    expects = "'backwards'"

    @classmethod
    def from_option(cls, option: object) -> Engine | None:
        return cls() if isinstance(option, str) and option == "backwards" else None

    @property
    def name(self) -> str:
        return "backwards"

    def map(self, function, shared, items):
        results = [function(shared, item) for item in reversed(items)]
        yield from reversed(results)


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(KINDS, "_entries", dict(KINDS._entries))
    KINDS.register("backwards", Backwards)


def test_an_engine_of_another_package_is_one_registration(registered):
    engine = choose_engine("backwards")
    assert isinstance(engine, Backwards)
    assert list(engine.map(divmod, 7, [2, 3])) == [(3, 1), (2, 1)]
    with pytest.raises(OptionError, match=r"expected None, .*, 'backwards' or an engine"):
        choose_engine("forwards")
