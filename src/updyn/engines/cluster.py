"""The engine of a Dask cluster."""

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
from updyn.engines.settings import WORKERS
from updyn.errors import EngineError, OptionError

if TYPE_CHECKING:
    from distributed import Client, Future

__all__ = ["Cluster"]


class Cluster(Remote):
    """The engine of the workers of a Dask cluster, including workers that join later.

    The client is left open; the scheduler's active memory manager is stopped while data is on the
    workers, until `close`. Raises EngineError if there is no worker, or a worker lacks updyn or has
    another version of it.
    """

    expects = "a dask.distributed Client"

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._client = client
        self._address = client.scheduler.address
        self._workers = self._count_workers()
        self._check_versions()
        self._managed = False
        self._stop_memory_manager()

    @classmethod
    def from_option(cls, option: object) -> Engine | None:
        """Return the engine for a Client, None for other options.

        Raises OptionError for a Client of asynchronous programs, EngineError for unusable workers.
        """
        distributed = sys.modules.get("distributed")  # a Client implies that the module is loaded
        if distributed is None or not isinstance(option, distributed.Client):
            return None
        if option.asynchronous:
            raise OptionError(
                "engine is an asynchronous Client; expected one made with asynchronous=False"
            )
        return cls(option)

    @property
    def workers(self) -> int:
        """Number of items processed at the same time."""
        return self._workers

    @property
    def name(self) -> str:
        """Name for the record of a run."""
        return f"dask, {self._workers} worker{'s' * (self._workers != 1)}"

    def close(self) -> None:
        """Free the data on the workers; client, scheduler and workers keep running."""
        self._sent = []
        if self._managed and self._client.status == "running":
            self._client.amm.start()
        self._managed = False

    def _stop_memory_manager(self) -> None:
        # Between two maps no task needs the shared object, and Dask's memory manager would keep it
        # on one worker only.
        if self._client.amm.running():
            self._client.amm.stop()
            self._managed = True

    # -- abstract methods of `Remote` ----------------------------------------------------------
    def _send(self, shared: object) -> Future:
        # Every worker gets a copy, which allows others to replace a worker that dies. The list
        # keeps Dask from scattering the elements of `shared`; a hash would read every byte.
        self._check_connection()
        self._stop_memory_manager()  # `close` may have started it
        try:
            (future,) = self._client.scatter(
                [shared], broadcast=True, hash=False, timeout=WORKERS.cluster_patience
            )
        except OSError as error:  # a worker died meanwhile; TimeoutError is an OSError
            raise self._handle_lost(error) from error
        return future

    def _submit(self, function: Callable[..., object], handle: Future, item: object) -> Future:
        self._check_connection()
        name = f"{function.__name__}-{uuid.uuid4().hex}"
        # The item is bound to the function: Dask would search an argument for tasks.
        return self._client.submit(partial(_work, function, item), handle, key=name, pure=False)

    def _result(self, call: Future) -> Any:
        from distributed import wait

        try:
            wait([call])
        except CancelledError as error:
            raise self._handle_lost(error) from error
        if call.status == "error":
            if self._is_lost(call):
                raise self._handle_lost(call.exception())
            return call.result()  # raises
        try:
            return call.result(timeout=WORKERS.cluster_patience)
        except (CancelledError, OSError) as error:  # its worker died before it was fetched
            raise self._handle_lost(error) from error

    def _is_lost(self, call: Future) -> bool:
        from distributed import KilledWorker

        return call.status in ("cancelled", "lost") or (
            call.status == "error" and isinstance(call.exception(), KilledWorker)
        )

    def _drop(self, calls: list[Future]) -> None:
        for call in calls:
            call.release()

    def _check_connection(self) -> None:
        if self._client.status != "running":
            raise self._handle_lost(ConnectionError("the scheduler was out of reach"))

    def _handle_lost(self, error: BaseException) -> LostError:
        """Wait for a scheduler and a worker, forget lost objects, and return the error."""
        until = time.monotonic() + WORKERS.cluster_patience
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
            self._client.wait_for_workers(1, timeout=WORKERS.cluster_patience)
        except TimeoutError as error:
            raise EngineError(
                f"no worker has joined the scheduler {self._address} within"
                f" {WORKERS.cluster_patience:g} s; "
                f"one is started by: dask worker {self._address} --nthreads 1"
            ) from error
        return len(self._client.nthreads())

    def _check_versions(self) -> None:
        """Reject workers with another version, whose results would differ."""
        found = self._client.run(_version, on_error="return")
        try:
            found["the scheduler"] = self._client.run_on_scheduler(_version)
        except ImportError as error:
            found["the scheduler"] = error
        for place, version in found.items():
            if isinstance(version, OSError):  # the worker has just died
                continue
            if version != __version__:
                raise EngineError(
                    f"updyn is {__version__} here and {version} on {place}; install the same on all"
                )


# -- in the worker -----------------------------------------------------------------------------
#: One item at a time for any number of threads: caches in a shared object are not thread-safe.
_ONE = threading.Lock()


def _work(function: Callable[..., object], item: object, shared: object) -> object:
    with _ONE:
        return function(shared, item)


def _version() -> str:
    return __version__
