"""Session of a run: its engine, its cache of evaluations, and the stop request.

Evaluations are pure functions and methods are deterministic, so a run can be repeated exactly with
cached evaluations, after an interruption or from other processes (`Session.remember`).
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import Any, Protocol, TypeAlias, TypeVar

import numpy as np

from updyn.arrays import NumberArray
from updyn.engines import Engine, Serial
from updyn.updating.problem.settings import EVALUATION

__all__ = ["Cache", "RecentCache", "Record", "Session", "Stopped", "digest"]

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

#: The result of an evaluation.
Record: TypeAlias = "tuple[NumberArray, ...]"

_SERIAL = Serial()


class Stopped(Exception):  # noqa: N818
    """Raised if the user stops an evaluation under way; never leaves `updyn.updating`."""


class Cache(Protocol):
    """A cache of the results of evaluations."""

    def get(self, key: bytes) -> Record | None:
        """Return the result for a key, or None."""

    def store(self, key: bytes, record: Record) -> None:
        """Store a result."""


class RecentCache:
    """Cache of the most recent results up to `limit` bytes; the latest is always kept."""

    def __init__(self, limit: float | None = None) -> None:
        self._limit = EVALUATION.cache_bytes if limit is None else limit
        self._bytes = 0
        self._records: OrderedDict[bytes, Record] = OrderedDict()

    def get(self, key: bytes) -> Record | None:
        """Return the result for a key, or None."""
        if key in self._records:
            self._records.move_to_end(key)
        return self._records.get(key)

    def store(self, key: bytes, record: Record) -> None:
        """Store a result."""
        if key in self._records:
            return
        self._records[key] = record
        self._bytes += _size(record)
        while self._bytes > self._limit and len(self._records) > 1:
            self._bytes -= _size(self._records.popitem(last=False)[1])

    @property
    def items(self) -> list[tuple[bytes, Record]]:
        """All stored results, the oldest first."""
        return list(self._records.items())


@dataclass(slots=True, eq=False)
class Session:
    """Engine, cache and stop request of a run; a copy sent to another process is a new one.

    `wants_stop` returns whether to stop and is called between blocks of lines.
    """

    engine: Engine = _SERIAL
    cache: Cache | None = None
    wants_stop: Callable[[], bool] | None = None
    stopped: bool = False
    lines_solved: int = 0
    _stopped_at: float | None = field(default=None, init=False)
    _asked_at: float = field(default_factory=lambda: time.monotonic(), init=False)

    def __reduce__(self) -> tuple[type[Session], tuple[()]]:
        return Session, ()

    def recall(self, key: Iterable[object], compute: Callable[[], Record]) -> Record:
        """Return the cached result for a key (all its inputs), or compute and store it."""
        if self.cache is None:
            return compute()
        at = digest(key)
        found = self.cache.get(at)
        if found is None:
            found = compute()
            for array in found:
                array.flags.writeable = False
            self.cache.store(at, found)
        return found

    def has(self, key: Iterable[object]) -> bool:
        """Return whether a result is cached."""
        return self.cache is not None and self.cache.get(digest(key)) is not None

    def remember(self, found: Iterable[tuple[bytes, Record]]) -> None:
        """Store results that were computed elsewhere."""
        if self.cache is not None:
            for key, record in found:
                self.cache.store(key, record)

    def map(
        self,
        function: Callable[[S, T], R],
        shared: S,
        items: Sequence[T],
        *,
        spread: bool,
        long: bool = False,
    ) -> Generator[R, None, None]:
        """Yield ``function(shared, item)`` in order, with a check for a stop request after each.

        The engine is used if `spread`, with the same results; the function must be importable from
        a module. With `long`, the evaluation does not start after a stop request.
        """
        if self.stopped and (long or self._is_late):
            raise Stopped
        # Short evaluations that start after the request are still shown to the user.
        was_stopped = self.stopped
        if not was_stopped and self._is_time_to_ask and self._poll_stop():
            raise Stopped
        results = (self.engine if spread else _SERIAL).map(function, shared, items)
        try:
            for i, result in enumerate(results, 1):
                yield result
                if i < len(items) and (self._is_late if was_stopped else self._poll_stop()):
                    raise Stopped
        finally:
            close = getattr(results, "close", None)
            if close is not None:
                close()

    def check(self, *, often: bool = False) -> None:
        """Raise if the user wants to stop; with `often`, check at most once a second."""
        if often and not self._is_time_to_ask:
            return
        if self._poll_stop():
            raise Stopped

    @property
    def _is_time_to_ask(self) -> bool:
        """Whether a check for a stop request is due."""
        return time.monotonic() - self._asked_at > EVALUATION.stop_interval

    @property
    def _is_late(self) -> bool:
        """Whether the stop request is so old that nothing more is computed."""
        if not self.stopped:
            return False
        now = time.monotonic()
        if self._stopped_at is None:
            self._stopped_at = now
        return now - self._stopped_at > EVALUATION.finishing_time

    def _poll_stop(self) -> bool:
        self._asked_at = time.monotonic()
        if self.wants_stop is not None and self.wants_stop():
            self.stopped = True
        return self.stopped


def digest(parts: Iterable[object]) -> bytes:
    """Return a hash of 16 bytes of bytes, texts and arrays (with type and shape), in order."""
    hasher = blake2b(digest_size=16)
    for part in parts:
        if isinstance(part, np.ndarray):
            header = f"{part.dtype.str}{part.shape}"
            content: Any = (
                np.ascontiguousarray(part).reshape(-1).view(np.uint8).data if part.size else b""
            )
        else:
            content = part if isinstance(part, bytes) else str(part).encode()
            header = str(len(content))
        hasher.update(header.encode() + b";")
        hasher.update(content)
    return hasher.digest()


def _size(record: Record) -> int:
    return sum(array.nbytes for array in record)
