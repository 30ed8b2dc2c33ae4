"""One item after the other, in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

__all__ = ["Serial"]

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


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
