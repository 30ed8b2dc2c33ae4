"""What every engine offers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar, runtime_checkable

__all__ = [
    "Engine",
    "Serial",
]

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


@runtime_checkable
class Engine(Protocol):
    """Runs one function over many items, somewhere; it knows nothing of what the function does.

    The results, their order and their bits do not depend on the engine.
    """

    @property
    def workers(self) -> int:
        """Items that are worked on at the same time."""

    @property
    def name(self) -> str:
        """What the record of a run says, as ``"serial"`` or ``"2 processes"``."""

    def map(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(shared, item)`` for every item, in the order of the items, each as soon as it is there.

        Closing the iterator early abandons what has not been started; the engine can be used again
        at once.

        Parameters
        ----------
        function : callable
            A function of a module (not a lambda: it may run in another process).
        shared : object
            What all items need, however large: sent once to each worker, which keeps it, with
            whatever `function` caches in it, for later maps with the same object. It must not be
            changed afterwards.
        items : sequence
            What differs; small, as the results should be.

        Yields
        ------
        object
            Results.

        Raises
        ------
        Exception
            What `function` raised, as itself, when its item's turn comes.
        EngineError
            If the workers are lost again and again, or for good.
        """

    def close(self) -> None:
        """Give back what the engine has started itself; an engine that was handed in is left running."""


class Serial:
    """The engine of one process: this one."""

    @property
    def workers(self) -> int:
        """Items that are worked on at the same time: one."""
        return 1

    @property
    def name(self) -> str:
        """What the record of a run says."""
        return "serial"

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
        for item in items:
            yield function(shared, item)

    def close(self) -> None:
        """Do nothing: nothing was started."""
