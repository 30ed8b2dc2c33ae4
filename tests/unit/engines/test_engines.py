"""Every engine gives the same, in the same order, and survives what happens to it."""

from __future__ import annotations

import time

import numpy as np
import pytest
from distributed import Client

import engine_work as work
from engine_work import wait_until
from overriding import override
from updyn.engines import Engine, cluster
from updyn.engines.settings import WORKERS
from updyn.errors import EngineError, SolverError


@pytest.fixture
def shared(tmp_path):
    return work.Shared(tmp_path)


def is_serial(engine: Engine) -> bool:
    return engine.name == "serial"


def test_the_results_are_those_of_a_loop_bit_by_bit(engine, shared):
    found = list(engine.map(work.contract, shared, range(20)))
    assert [f.tobytes() for f in found] == [work.contract(shared, i).tobytes() for i in range(20)]
    assert list(engine.map(work.contract, shared, [])) == []


def test_what_is_shared_is_sent_once_and_stays_with_its_cache(engine, shared):
    calls = [call for _ in range(3) for call in engine.map(work.call_of, shared, range(10))]
    by_process = {pid: sorted(n for p, n in calls if p == pid) for pid, _ in calls}
    assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in by_process.values())
    assert len(by_process) <= engine.workers
    assert shared.received() <= (0 if is_serial(engine) else engine.workers)
    assert is_serial(engine) or shared.received() >= 1


def test_what_is_shared_stays_while_nothing_is_done(engine, shared):
    """Dask's memory manager (here at work every 0.1 s) would leave it on one worker."""
    for _ in range(3):
        list(engine.map(work.call_of, shared, range(10)))
        time.sleep(0.5)
    assert shared.received() <= (0 if is_serial(engine) else engine.workers)


def test_lists_are_shared_as_they_are(engine):
    assert list(engine.map(work.total, [np.ones(3), np.ones(4)], range(3))) == [7.0, 8.0, 9.0]


def test_two_maps_at_a_time(engine, shared, tmp_path):
    other = work.Shared(tmp_path, 20)
    pairs = zip(
        engine.map(work.contract, shared, range(5)),
        engine.map(work.contract, other, range(5)),
        strict=True,
    )
    for i, (a, b) in enumerate(pairs):
        np.testing.assert_array_equal(a, work.contract(shared, i))
        np.testing.assert_array_equal(b, work.contract(other, i))


def test_an_error_comes_as_itself_in_its_turn(engine, shared):
    found = []
    with pytest.raises(SolverError, match=r"^line 3 at 12\.5 Hz cannot be solved$") as caught:
        found.extend(engine.map(work.fail_at_3, shared, range(8)))
    assert type(caught.value) is SolverError
    results = engine.map(work.fail_at_3, shared, range(8))
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    results.close()
    assert list(engine.map(work.fail_at_3, shared, [5, 4])) == [5, 4]


def test_stopping_early_calls_the_rest_off(engine, shared):
    total = 40
    results = engine.map(work.behind_gate, shared, range(total))
    assert next(results) == (0, 0)
    if not is_serial(engine):
        wait_until(lambda: any(shared.folder.glob("started-*")))
    results.close()
    if isinstance(engine, cluster.Cluster):  # the scheduler hears of it a moment later
        wait_until(lambda: not any(engine._client.processing().values()))
    (shared.folder / "gate").touch()
    assert list(engine.map(work.behind_gate, shared, [0, 0, 0])) == [(0, 0)] * 3
    # What ran at that time, and what a Dask worker took up before it heard of it too.
    most = total / 2 if isinstance(engine, cluster.Cluster) else engine.workers
    assert len(list(shared.folder.glob("started-*"))) <= most


def test_an_error_calls_the_rest_off_while_it_is_still_looked_at(client, shared):
    results = cluster.Cluster.from_option(client).map(work.fail_before_gate, shared, range(9))
    with pytest.raises(SolverError) as caught:
        next(results)
    wait_until(lambda: not any(client.processing().values()))
    (shared.folder / "gate").touch()
    assert caught.traceback


def test_every_dask_worker_has_what_is_shared_before_it_is_used(client, shared):
    engine = cluster.Cluster.from_option(client)
    held = client.who_has(engine._handle(shared))
    assert [len(workers) for workers in held.values()] == [2]


def test_an_engine_can_be_used_after_it_was_closed(engine, shared):
    engine.close()
    assert list(engine.map(work.fail_at_3, shared, [1, 2])) == [1, 2]


# -- losses ------------------------------------------------------------------------------------------------
def test_a_killed_process_costs_no_result(two_processes, shared):
    assert list(two_processes.map(work.die_once, shared, range(12))) == [7 * i for i in range(12)]
    assert (shared.folder / "died").exists()


def test_work_that_kills_every_process_is_named(two_processes, shared, monkeypatch):
    override(monkeypatch, WORKERS, most_losses=1)
    results = two_processes.map(work.die_always, shared, range(4, 7))
    with pytest.raises(
        EngineError, match=r"^workers were lost 2 times in a row at item 1 of 3: .*SIGKILL"
    ):
        next(results)
    assert list(two_processes.map(work.die_always, shared, [1, 2])) == [1, 2]


def test_a_killed_dask_worker_costs_no_result(client, dask_processes, shared):
    engine = cluster.Cluster.from_option(client)
    results = engine.map(work.behind_gate, shared, range(12))
    assert next(results) == (0, 0)
    wait_until(lambda: len(list(shared.folder.glob("started-*"))) == 2)
    dask_processes.kill_worker()
    (shared.folder / "gate").touch()
    assert list(results) == [(i, 7 * i) for i in range(1, 12)]


def test_all_dask_workers_killed_and_another_started(client, dask_processes, shared):
    engine = cluster.Cluster.from_option(client)
    results = engine.map(work.behind_gate, shared, range(12))
    assert next(results) == (0, 0)
    while dask_processes.workers:
        dask_processes.kill_worker()
    (shared.folder / "gate").touch()
    dask_processes.start_worker()
    assert list(results) == [(i, 7 * i) for i in range(1, 12)]
    assert engine.name == "dask, 1 worker"
    assert list(engine.map(work.fail_at_3, shared, [1, 2])) == [1, 2]


def test_no_worker_and_then_no_scheduler(dask_processes, shared, monkeypatch, tmp_path):
    processes = type(dask_processes)(tmp_path)
    try:
        with Client(processes.address, timeout=5) as client:
            with monkeypatch.context() as hurried:
                override(hurried, WORKERS, cluster_patience=0.2)
                with pytest.raises(
                    EngineError,
                    match=rf"no worker has .* dask worker {processes.address} --nthreads 1",
                ):
                    cluster.Cluster.from_option(client)
            processes.start_worker()
            engine = cluster.Cluster.from_option(client)
            results = engine.map(work.behind_gate, shared, range(3))
            assert next(results) == (0, 0)
            processes.end(processes.scheduler)
            with pytest.raises(
                EngineError, match=f"connection to the scheduler {processes.address} is lost"
            ):
                next(results)
            for known in (shared, [1]):
                with pytest.raises(EngineError, match="is lost"):
                    list(engine.map(work.fail_at_3, known, [1]))
    finally:
        processes.close()


def test_a_cluster_is_left_as_it_was(client):
    client.amm.start()  # an engine before this one may not have been closed
    engine = cluster.Cluster(client)
    assert not client.amm.running()
    engine.close()
    assert client.amm.running()


def test_a_closed_cluster_that_is_used_again_keeps_its_data_on_all_workers(client, shared):
    """Dask's memory manager would remove copies while they are used."""
    client.amm.start()
    engine = cluster.Cluster(client)
    engine.close()
    assert list(engine.map(work.fail_at_3, shared, [1, 2])) == [1, 2]
    assert not client.amm.running()
    engine.close()
    assert client.amm.running()
