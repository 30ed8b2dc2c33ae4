"""What engines with workers of their own have in common: the order of the results, and work that was lost."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from updyn.errors import EngineError

__all__ = ["LostError", "Remote"]

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")

#: So many losses with no result in between, and it is taken to be the work that kills the workers.
MOST_LOSSES = 3
#: So many shared objects are remembered: the latest. More would hold memory in every worker for
#: nothing.
REMEMBERED = 2


class LostError(Exception):
    """The work, or what it needs, was lost with its worker; caught here, never seen outside."""


@dataclass(slots=True, eq=False)
class _Flight:
    """An item on its way; no call: to be submitted (again)."""

    item: Any
    call: Any = None


class Remote(ABC):
    """Maps over workers that may die.

    A subclass says how an object is sent and how a call is submitted, awaited and dropped; where it
    finds a loss, it gets ready for calls again and raises `LostError`. What a call is, is its own
    matter.
    """

    #: Items submitted ahead of the result that is waited for; None for all.
    window: int | None = None

    def __init__(self) -> None:
        self._sent: list[tuple[Any, Any]] = []

    def map(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(shared, item)`` for every item in turn; see `Engine.map`.

        Parameters
        ----------
        function : callable
            What is run.
        shared : object
            What all items need.
        items : sequence
            What differs.

        Yields
        ------
        object
            Results.
        """
        waiting = deque(items)
        total = len(waiting)
        flights: deque[_Flight] = deque()
        unsent: deque[_Flight] = deque()
        losses = 0
        try:
            while waiting or flights:
                while waiting and (self.window is None or len(flights) < self.window):
                    unsent.append(_Flight(waiting.popleft()))
                    flights.append(unsent[-1])
                try:
                    while unsent:
                        unsent[0].call = self._submit(
                            function, self._handle(shared), unsent[0].item
                        )
                        unsent.popleft()
                    result: R = self._result(flights[0].call)
                except LostError as loss:
                    losses += 1
                    if losses > MOST_LOSSES:
                        at = total - len(waiting) - len(flights) + 1
                        raise EngineError(
                            f"workers were lost {losses} times in a row at item {at} of {total}:"
                            f" {loss}"
                        ) from loss
                    unsent = deque(f for f in flights if f.call is None or self._is_lost(f.call))
                    continue
                losses = 0
                flights.popleft()
                yield result
        finally:
            self._drop([f.call for f in flights if f.call is not None])

    def _handle(self, shared: Any) -> Any:
        """Return what stands for an object that was sent; send it where it is not among the latest."""
        for known, handle in self._sent:
            if known is shared:
                return handle
        handle = self._send(shared)
        self._sent = [(shared, handle), *self._sent[: REMEMBERED - 1]]
        return handle

    @abstractmethod
    def _send(self, shared: Any) -> Any:
        """Make an object known to all workers, those to come included; return what stands for it."""

    @abstractmethod
    def _submit(self, function: Callable[..., Any], handle: Any, item: Any) -> Any:
        """Ask for a call, without waiting. Raises LostError."""

    @abstractmethod
    def _result(self, call: Any) -> Any:
        """Wait for a call. Raises LostError, what the function raised, or EngineError where no call can be made."""

    @abstractmethod
    def _is_lost(self, call: Any) -> bool:
        """Tell, without waiting, whether a call will never have a result."""

    @abstractmethod
    def _drop(self, calls: list[Any]) -> None:
        """Forget calls whose results nobody waits for; those not yet started do not start."""
