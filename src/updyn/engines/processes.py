"""Worker processes on this machine, and the file for their shared object.

The processes are those of joblib's loky, started afresh on every platform; scripts therefore need
no ``__main__`` guard.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import mmap
import os
import shutil
import signal
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.engines.engine import Engine, Serial
from updyn.engines.interrupts import block_interrupts
from updyn.engines.remote import LostError, Remote
from updyn.engines.settings import WORKERS
from updyn.errors import EngineError, OptionError

if TYPE_CHECKING:
    from joblib.externals.loky import ProcessPoolExecutor

__all__ = [
    "Parcel",
    "Processes",
    "open_parcel",
]

#: Environment variables that limit the threads of BLAS libraries, which read them when loaded.
_THREADS = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "BLIS_NUM_THREADS",
)
#: By default the C library of Linux returns large blocks to the system after every item and maps
#: them again, which takes a fifth of the time.
_MEMORY = {"MALLOC_MMAP_THRESHOLD_": "33554432", "MALLOC_TRIM_THRESHOLD_": "134217728"}


@dataclass(frozen=True, slots=True, eq=False)
class _Call:
    """A submitted item: its pool, future and shared object, and the file that cancels it."""

    pool: ProcessPoolExecutor
    future: Future[object]
    parcel: Parcel
    cancelled: Path


class Processes(Remote):
    """The engine of worker processes, which start with the first item and end with `close`."""

    expects = "a number of processes from 1 up"

    def __init__(self, workers: int) -> None:
        super().__init__()
        self.window = WORKERS.items_per_process * workers
        self._workers = workers
        self._numbers = itertools.count()
        self._pool: ProcessPoolExecutor | None = None
        self._folder: Path | None = None

    @classmethod
    def from_option(cls, option: object) -> Engine | None:
        """Return the engine for a number of processes (1: this one), None for another type.

        Raises OptionError if the number is below 1, or far above the number of cores.
        """
        if isinstance(option, bool) or not isinstance(option, int):
            return None
        if option < 1:
            raise OptionError(f"engine is {option}; expected {cls.expects}")
        _check_cores(option)
        return Serial() if option == 1 else cls(option)

    @property
    def workers(self) -> int:
        """Number of items processed at the same time."""
        return self._workers

    @property
    def name(self) -> str:
        """Name for the record of a run."""
        return f"{self._workers} processes"

    def close(self) -> None:
        """Terminate the processes immediately, and remove their files."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, kill_workers=True)
        self._sent = []
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        self._pool = self._folder = None

    # -- abstract methods of `Remote` ----------------------------------------------------------
    def _send(self, shared: object) -> Parcel:
        # Workers open the file when an item refers to it, so workers that start later find it,
        # too.
        return Parcel(shared, self._new_path("shared"))

    def _submit(self, function: Callable[..., object], handle: Parcel, item: object) -> _Call:
        from joblib.externals.loky import BrokenProcessPool

        known = tuple(parcel.path for _, parcel in self._sent)
        cancelled = self._new_path("off")
        try:
            with block_interrupts():
                if self._pool is None:
                    self._pool = _new_pool(self._workers, cancelled.parent)
                future = self._pool.submit(_work, function, handle.path, known, cancelled, item)
        except BrokenProcessPool as error:
            raise self._handle_lost(self._pool, error) from error
        return _Call(self._pool, future, handle, cancelled)

    def _result(self, call: _Call) -> object:
        from joblib.externals.loky import BrokenProcessPool

        try:
            return call.future.result()
        except BrokenProcessPool as error:
            raise self._handle_lost(call.pool, error) from error

    def _is_lost(self, call: _Call) -> bool:
        from joblib.externals.loky import BrokenProcessPool

        return call.future.done() and isinstance(call.future.exception(), BrokenProcessPool)

    def _drop(self, calls: list[_Call]) -> None:
        for call in calls:
            if not call.future.cancel() and not call.future.done():
                # The item is in the queue of the workers, which `cancel` does not reach; the
                # worker that takes it finds this file.
                call.cancelled.touch()

    def _handle_lost(self, pool: ProcessPoolExecutor, error: Exception) -> LostError:
        """Shut down a broken pool, which settles all of its calls, and return the error."""
        pool.shutdown(wait=True)
        if pool is self._pool:
            self._pool = None
        return LostError(" ".join(str(error.__cause__ or error).split()))

    def _new_path(self, kind: str) -> Path:
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="updyn-"))
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        return self._folder / f"{kind}-{next(self._numbers)}"


def _check_cores(workers: int) -> None:
    """Reject more processes than the cores of this machine can serve."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    each = WORKERS.processes_per_core
    if workers > each * cores:
        raise OptionError(
            f"{workers} processes; expected at most {each * cores}, {each} for each of the {cores}"
            " cores of this machine"
        )


def _new_pool(workers: int, folder: Path) -> ProcessPoolExecutor:
    from joblib import cpu_count
    from joblib.externals.loky import ProcessPoolExecutor

    share = max(1, cpu_count() // workers)
    limits = {name: str(min(share, _thread_limit(name, share))) for name in _THREADS}
    kept = {name: os.environ.get(name, value) for name, value in _MEMORY.items()}
    environment = limits | kept
    return ProcessPoolExecutor(
        workers, initializer=_start_worker, initargs=(os.getpid(), folder), env=environment
    )


def _thread_limit(name: str, otherwise: int) -> int:
    """Return the number of threads set by the user; a list such as ``"4,2"`` is ignored."""
    value = os.environ.get(name) or os.environ.get("OMP_NUM_THREADS", "")
    return int(value) if value.isdecimal() and int(value) else otherwise


# -- in the worker -----------------------------------------------------------------------------
#: Shared objects of this worker by file, including data cached in them.
_SHARED_OBJECTS: dict[Path, object] = {}


def _start_worker(parent: int, folder: Path) -> None:
    from joblib.externals.loky import process_executor

    # Ctrl-C in a terminal reaches every process of the job; only the parent acts on it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # loky ends a worker that has grown by 300 MB, assuming a leak; these workers cache factors.
    process_executor._USE_PSUTIL = False
    if os.name == "posix":
        threading.Thread(target=_exit_with_parent, args=(parent, folder), daemon=True).start()


def _exit_with_parent(parent: int, folder: Path) -> None:
    """End this worker and remove its files if the parent process was killed."""
    while os.getppid() == parent:
        time.sleep(WORKERS.parent_check_interval)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _work(
    function: Callable[..., object],
    path: Path,
    known: tuple[Path, ...],
    cancelled: Path,
    item: object,
) -> object:
    if cancelled.exists():
        cancelled.unlink()
        return None
    for outdated in _SHARED_OBJECTS.keys() - {path, *known}:
        del _SHARED_OBJECTS[outdated]
    if path not in _SHARED_OBJECTS:
        _SHARED_OBJECTS[path] = open_parcel(path)
    return function(_SHARED_OBJECTS[path], item)


# -- the shared file -------------------------------------------------------------------------
#: Arrays start at multiples of a cache line, in bytes.
_ALIGNED = 64


class Parcel:
    """An object in a file that worker processes map into memory.

    One mapping serves all arrays, so that all processes read the same pages. `joblib.load` with
    ``mmap_mode`` needs a file descriptor for each array: a model of 250 groups exceeds the usual
    limit of 1024, and reading and writing take longer. One run writes and reads the file in its
    temporary folder (files of users are never read this way); it is removed with the last
    reference. Raises EngineError if it cannot be written.
    """

    def __init__(self, thing: object, path: Path) -> None:
        buffers: list[Any] = []
        rest = io.BytesIO()
        pickler: Any = ForkingPickler
        # Protocol 5 hands arrays to the callback instead of copying them (PEP 574).
        pickler(rest, 5, True, buffers.append).dump(thing)
        parts = [rest.getbuffer(), *(b.raw() for b in buffers)]
        sizes = np.array([len(parts), *(p.nbytes for p in parts)], dtype=np.int64)
        self.path = path
        weakref.finalize(self, _remove, path)
        try:
            with path.open("wb") as file:
                for part in (sizes.tobytes(), *parts):
                    file.write(part)
                    file.write(bytes(-file.tell() % _ALIGNED))
        except OSError as error:
            size = sizes[1:].sum() / 2**20
            raise EngineError(
                f"{path}: {size:.0f} MiB for the worker processes cannot be written:"
                f" {error.strerror}; the environment variable TMPDIR names another folder"
            ) from error


def open_parcel(path: Path) -> Any:
    """Return the object in a file; changes to its arrays stay in this process (copy on write)."""
    with path.open("rb") as file:
        memory = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY))
    (count,) = np.frombuffer(memory, dtype=np.int64, count=1)
    sizes = np.frombuffer(memory, dtype=np.int64, count=count, offset=8)
    parts, at = [], _align_size(8 + 8 * int(count))
    for size in sizes.tolist():
        parts.append(memory[at : at + size])
        at += _align_size(size)
    return ForkingPickler.loads(parts[0], buffers=parts[1:])


def _align_size(size: int) -> int:
    return -(-size // _ALIGNED) * _ALIGNED


def _remove(path: Path) -> None:
    # Windows keeps a file that a worker has open; it is removed with its folder.
    with contextlib.suppress(OSError):
        path.unlink()
