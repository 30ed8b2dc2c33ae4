"""Base class of engines with workers that may die: ordered results, and restart of lost work."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from updyn.engines.settings import WORKERS
from updyn.errors import EngineError

__all__ = ["LostError", "Remote"]

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


class LostError(Exception):
    """A call, or its data, was lost with its worker; never raised outside this package."""


@dataclass(slots=True, eq=False)
class _Pending:
    """An item with a pending result; without a call it is not yet submitted."""

    item: object
    call: object = None


class Remote(ABC):
    """Engine that maps over workers that may die.

    A subclass sends objects and submits, awaits and drops calls. When it finds that a call is lost,
    it prepares for new calls and raises `LostError`.
    """

    #: Largest number of items pending at a time; None for all.
    window: int | None = None

    def __init__(self) -> None:
        self._sent: list[tuple[object, Any]] = []

    def map(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(shared, item)`` for every item in turn; see `Engine.map`."""
        waiting = deque(items)
        total = len(items)
        pending: deque[_Pending] = deque()
        unsent: deque[_Pending] = deque()
        losses = 0
        try:
            while waiting or pending:
                while waiting and (self.window is None or len(pending) < self.window):
                    unsent.append(_Pending(waiting.popleft()))
                    pending.append(unsent[-1])
                try:
                    while unsent:
                        unsent[0].call = self._submit(
                            function, self._handle(shared), unsent[0].item
                        )
                        unsent.popleft()
                    result: R = self._result(pending[0].call)
                except LostError as loss:
                    losses += 1
                    if losses > WORKERS.most_losses:
                        at = total - len(waiting) - len(pending) + 1
                        raise EngineError(
                            f"workers were lost {losses} times in a row at item {at} of {total}:"
                            f" {loss}"
                        ) from loss
                    unsent = deque(p for p in pending if p.call is None or self._is_lost(p.call))
                    continue
                losses = 0
                pending.popleft()
                yield result
        finally:
            self._drop([p.call for p in pending if p.call is not None])

    def _handle(self, shared: object) -> Any:
        """Return the handle of a shared object; send it if it is not among the latest objects."""
        for known, handle in self._sent:
            if known is shared:
                return handle
        handle = self._send(shared)
        self._sent = [(shared, handle), *self._sent[: WORKERS.kept_objects - 1]]
        return handle

    @abstractmethod
    def _send(self, shared: object) -> object:
        """Send an object to all present and later workers; return its handle."""

    @abstractmethod
    def _submit(self, function: Callable[..., object], handle: Any, item: object) -> object:
        """Submit a call without waiting for it; may raise `LostError`."""

    @abstractmethod
    def _result(self, call: Any) -> Any:
        """Return the result of a call, or raise its error, `LostError` or `EngineError`."""

    @abstractmethod
    def _is_lost(self, call: Any) -> bool:
        """Return immediately whether a call will never have a result."""

    @abstractmethod
    def _drop(self, calls: list[Any]) -> None:
        """Cancel calls whose results are no longer needed."""
