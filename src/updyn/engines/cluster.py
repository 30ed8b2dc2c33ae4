"""The workers of a Dask cluster, on as many machines as it has."""

from __future__ import annotations

import sys
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import CancelledError
from functools import partial
from typing import TYPE_CHECKING, Any

from updyn import __version__
from updyn.engines.engine import Engine
from updyn.engines.remote import LostError, Remote
from updyn.errors import EngineError, OptionError

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["EXPECTS", "Cluster", "engine_for"]

EXPECTS = "a dask.distributed Client"

#: Seconds for which a cluster may be without a worker, or without an answer, before it counts as
#: lost.
PATIENCE = 60.0


def engine_for(given: object) -> Engine | None:
    """Return the engine for a Client; None for anything else.

    Raises
    ------
    OptionError
        If it is one for asynchronous programs.
    EngineError
        If its workers cannot be used.
    """
    distributed = sys.modules.get("distributed")  # who has a Client has loaded it
    if distributed is None or not isinstance(given, distributed.Client):
        return None
    if given.asynchronous:
        raise OptionError(
            "engine is an asynchronous Client; expected one made with asynchronous=False"
        )
    return Cluster(given)


class Cluster(Remote):
    """The workers of a Dask cluster, those included that come later.

    Parameters
    ----------
    client : distributed.Client
        A connected client; it is left open. Until `close`, the scheduler's active memory manager
        rests.

    Raises
    ------
    EngineError
        If there is no worker, or one has another version of updyn or none.
    """

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._client = client
        self._address = client.scheduler.address
        self._workers = self._count_workers()
        self._check_versions()
        # Between two maps no task needs the model, and Dask's memory manager would leave it on one
        # worker only.
        self._managed = bool(client.amm.running())
        if self._managed:
            client.amm.stop()

    @property
    def workers(self) -> int:
        """Items that are worked on at the same time."""
        return self._workers

    @property
    def name(self) -> str:
        """What the record of a run says."""
        return f"dask, {self._workers} worker{'s' * (self._workers != 1)}"

    def close(self) -> None:
        """Free what the workers hold; client, scheduler and workers go on."""
        self._sent = []
        if self._managed and self._client.status == "running":
            self._client.amm.start()
        self._managed = False

    # -- what `Remote` asks for ----------------------------------------------------------------------------
    def _send(self, shared: Any) -> Future:
        # To all workers, bound to none: where one dies, any other can do its work. In a list, lest
        # a list be taken apart; without a hash, which would read every byte.
        self._check_connection()
        try:
            (future,) = self._client.scatter([shared], broadcast=True, hash=False, timeout=PATIENCE)
        except (
            OSError
        ) as error:  # a worker went while it was sent something; TimeoutError is one of these
            raise self._lost(error) from error
        return future

    def _submit(self, function: Callable[..., Any], handle: Future, item: Any) -> Future:
        self._check_connection()
        name = f"{function.__name__}-{uuid.uuid4().hex}"
        # The item inside the function: as an argument, Dask would look into it for tasks.
        return self._client.submit(partial(_work, function, item), handle, key=name, pure=False)

    def _result(self, call: Future) -> Any:
        from distributed import wait

        try:
            wait([call])
        except CancelledError as error:
            raise self._lost(error) from error
        if call.status == "error":
            if self._is_lost(call):
                raise self._lost(call.exception())
            return call.result()  # raises
        try:
            return call.result(timeout=PATIENCE)
        except (CancelledError, OSError) as error:  # its worker went before it was fetched
            raise self._lost(error) from error

    def _is_lost(self, call: Future) -> bool:
        from distributed import KilledWorker

        return call.status in ("cancelled", "lost") or (
            call.status == "error" and isinstance(call.exception(), KilledWorker)
        )

    def _drop(self, calls: list[Future]) -> None:
        for call in calls:
            call.release()

    # ------------------------------------------------------------------------------------------------------
    def _check_connection(self) -> None:
        if self._client.status != "running":
            raise self._lost(ConnectionError("the scheduler was out of reach"))

    def _lost(self, error: BaseException) -> LostError:
        """Wait until there are a scheduler and a worker again, and forget what no worker has any more."""
        until = time.monotonic() + PATIENCE
        while self._client.status == "connecting" and time.monotonic() < until:
            time.sleep(0.1)
        if self._client.status != "running":
            raise EngineError(f"the connection to the scheduler {self._address} is lost") from error
        self._workers = self._count_workers()
        self._sent = [
            (shared, future) for shared, future in self._sent if future.status == "finished"
        ]
        return LostError(" ".join(str(error).split()))

    def _count_workers(self) -> int:
        try:
            self._client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise EngineError(
                f"no worker has joined the scheduler {self._address} within {PATIENCE:g} s; "
                f"one is started by: dask worker {self._address} --nthreads 1"
            ) from error
        return len(self._client.nthreads())

    def _check_versions(self) -> None:
        """Other code would give other numbers, or none, with an error that does not say why."""
        found = self._client.run(_version, on_error="return")
        try:
            found["the scheduler"] = self._client.run_on_scheduler(_version)
        except ImportError as error:
            found["the scheduler"] = error
        for place, version in found.items():
            if version != __version__ and not isinstance(
                version, OSError
            ):  # a worker that has just gone
                raise EngineError(
                    f"updyn is {__version__} here and {version} on {place}; install the same on all"
                )


# -- in the worker -----------------------------------------------------------------------------------------
#: One item at a time, however many threads the worker has: what is cached in a shared object is for
#: one.
_ONE = threading.Lock()


def _work(function: Callable[..., Any], item: Any, shared: Any) -> Any:
    with _ONE:
        return function(shared, item)


def _version() -> str:
    return __version__
