"""Processes on this machine, by joblib's loky: started afresh everywhere, so scripts need no ``__main__`` guard."""

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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any

import numpy as np

from updyn.engines.engine import Engine, Serial
from updyn.engines.remote import LostError, Remote
from updyn.errors import EngineError, OptionError

__all__ = [
    "EXPECTS",
    "Parcel",
    "Processes",
    "engine_for",
    "open_parcel",
]

EXPECTS = "a number of processes from 1 up"

#: Items submitted for each process: one that runs and enough behind it while the results are used.
_AHEAD = 3
#: What limits the threads of the libraries below numpy and scipy; read when they are loaded.
_THREADS = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "BLIS_NUM_THREADS",
)
#: The C library of Linux gives a block's memory back after every item, and fetches it anew: a fifth
#: of the time.
_MEMORY = {"MALLOC_MMAP_THRESHOLD_": "33554432", "MALLOC_TRIM_THRESHOLD_": "134217728"}

#: Seconds between two looks whether the process that started a worker is still there.
_WATCH = 0.5


def engine_for(given: object) -> Engine | None:
    """Return the engine for a number of processes; None for anything else.

    Raises
    ------
    OptionError
        If the number is below 1.
    """
    if isinstance(given, bool) or not isinstance(given, int):
        return None
    if given < 1:
        raise OptionError(f"engine is {given}; expected {EXPECTS}")
    return Serial() if given == 1 else Processes(given)


@dataclass(frozen=True, slots=True, eq=False)
class _Call:
    """A submitted item: the pool that has it, its future, what it needs, and the file that calls it off."""

    pool: Any
    future: Any
    parcel: Parcel
    called_off: Path


class Processes(Remote):
    """Worker processes on this machine; they start with the first item and stay until `close`.

    Parameters
    ----------
    workers : int
        Number of processes.
    """

    def __init__(self, workers: int) -> None:
        super().__init__()
        self.window = _AHEAD * workers
        self._workers = workers
        self._numbers = itertools.count()
        self._pool: Any = None
        self._folder: Path | None = None

    @property
    def workers(self) -> int:
        """Items that are worked on at the same time."""
        return self._workers

    @property
    def name(self) -> str:
        """What the record of a run says."""
        return f"{self._workers} processes"

    def close(self) -> None:
        """End the processes, whatever they are doing, and remove what was written for them."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, kill_workers=True)
        self._sent = []
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        self._pool = self._folder = None

    # -- what `Remote` asks for ----------------------------------------------------------------------------
    def _send(self, shared: Any) -> Parcel:
        # Nothing is sent: a worker opens the file when it meets its name, a worker that was started
        # later as well.
        return Parcel(shared, self._new_path("shared"))

    def _submit(self, function: Callable[..., Any], handle: Parcel, item: Any) -> _Call:
        from joblib.externals.loky import BrokenProcessPool

        known = tuple(parcel.path for _, parcel in self._sent)
        called_off = self._new_path("off")
        try:
            with _interrupts_held():
                if self._pool is None:
                    self._pool = _new_pool(self._workers, called_off.parent)
                future = self._pool.submit(_work, function, handle.path, known, called_off, item)
        except BrokenProcessPool as error:
            raise self._lost(self._pool, error) from error
        return _Call(self._pool, future, handle, called_off)

    def _result(self, call: _Call) -> Any:
        from joblib.externals.loky import BrokenProcessPool

        try:
            return call.future.result()
        except BrokenProcessPool as error:
            raise self._lost(call.pool, error) from error

    def _is_lost(self, call: _Call) -> bool:
        from joblib.externals.loky import BrokenProcessPool

        return call.future.done() and isinstance(call.future.exception(), BrokenProcessPool)

    def _drop(self, calls: list[_Call]) -> None:
        for call in calls:
            if not call.future.cancel() and not call.future.done():
                # Out of reach of `cancel`, in the queue of the workers: whoever takes it finds this
                # file.
                call.called_off.touch()

    # ------------------------------------------------------------------------------------------------------
    def _lost(self, pool: Any, error: Exception) -> LostError:
        """Give up a pool: where one process dies, loky ends the others; its calls are all settled afterwards."""
        pool.shutdown(wait=True)
        if pool is self._pool:
            self._pool = None
        return LostError(" ".join(str(error.__cause__ or error).split()))

    def _new_path(self, kind: str) -> Path:
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="updyn-"))
            weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        return self._folder / f"{kind}-{next(self._numbers)}"


def _new_pool(workers: int, folder: Path) -> Any:
    from joblib import cpu_count
    from joblib.externals.loky import ProcessPoolExecutor

    share = max(1, cpu_count() // workers)
    limits = {name: str(min(share, _limit(name, share))) for name in _THREADS}
    kept = {name: os.environ.get(name, value) for name, value in _MEMORY.items()}
    environment = limits | kept
    return ProcessPoolExecutor(
        workers, initializer=_start_worker, initargs=(os.getpid(), folder), env=environment
    )


def _limit(name: str, otherwise: int) -> int:
    """Return the number of threads that the user has set, for this or for all; a rule (``"4,2"``) counts as none."""
    value = os.environ.get(name) or os.environ.get("OMP_NUM_THREADS", "")
    return int(value) if value.isdecimal() and int(value) else otherwise


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back: a process started meanwhile inherits that, and never sees one, not even while it starts."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


# -- in the worker -----------------------------------------------------------------------------------------
#: The shared objects of this worker by their files, with whatever was cached in them.
_HELD: dict[Path, Any] = {}


def _start_worker(parent: int, folder: Path) -> None:
    from joblib.externals.loky import process_executor

    # Ctrl-C in a terminal reaches every process of the job; what to do about it is decided by the
    # first.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # loky ends a worker that has grown by 300 MB, as leaking; ours grow by the factors that they
    # keep.
    process_executor._USE_PSUTIL = False
    if os.name == "posix":
        threading.Thread(target=_end_with, args=(parent, folder), daemon=True).start()


def _end_with(parent: int, folder: Path) -> None:
    """Leave nothing behind where the first process was killed: neither this one nor what was written for it."""
    while os.getppid() == parent:
        time.sleep(_WATCH)
    shutil.rmtree(folder, ignore_errors=True)
    os._exit(1)


def _work(
    function: Callable[..., Any], path: Path, known: tuple[Path, ...], called_off: Path, item: Any
) -> Any:
    if called_off.exists():
        called_off.unlink()
        return None
    for gone in _HELD.keys() - {path, *known}:
        del _HELD[gone]
    if path not in _HELD:
        _HELD[path] = open_parcel(path)
    return function(_HELD[path], item)


#: Arrays start at multiples of this many bytes, as vector instructions and cache lines like it.
_ALIGNED = 64


class Parcel:
    """An object, written; the file goes when nothing refers to this any more.

    Parameters
    ----------
    thing : object
        What is sent.
    path : path
        The file, which does not exist yet.

    Raises
    ------
    EngineError
        If there is no room for it.
    """

    def __init__(self, thing: Any, path: Path) -> None:
        buffers: list[Any] = []
        rest = io.BytesIO()
        pickler: Any = ForkingPickler
        pickler(rest, 5, True, buffers.append).dump(thing)  # the arrays kept apart (PEP 574)
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
    """Return the object that was written; its arrays can be changed, which nobody else sees.

    Parameters
    ----------
    path : path
        The file.

    Returns
    -------
    object
    """
    with path.open("rb") as file:
        memory = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY))
    (count,) = np.frombuffer(memory, dtype=np.int64, count=1)
    sizes = np.frombuffer(memory, dtype=np.int64, count=count, offset=8)
    parts, at = [], _padded(8 + 8 * int(count))
    for size in sizes.tolist():
        parts.append(memory[at : at + size])
        at += _padded(size)
    return ForkingPickler.loads(parts[0], buffers=parts[1:])


def _padded(size: int) -> int:
    return -(-size // _ALIGNED) * _ALIGNED


def _remove(path: Path) -> None:
    with contextlib.suppress(
        OSError
    ):  # Windows keeps what a worker still has open; it goes with its folder
        path.unlink()
