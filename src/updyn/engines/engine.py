"""The engine protocol, and the engine of one process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar, runtime_checkable

__all__ = [
    "Engine",
    "EngineKind",
    "Serial",
]

S = TypeVar("S")
T = TypeVar("T")
R = TypeVar("R")


@runtime_checkable
class Engine(Protocol):
    """Engine that maps a function over many items, in one or several processes.

    The results and their order are identical, bit by bit, for all engines.
    """

    @property
    def workers(self) -> int:
        """Number of items processed at the same time."""

    @property
    def name(self) -> str:
        """Name for the record of a run: ``"serial"``, ``"2 processes"``."""

    def map(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(shared, item)`` for every item, in the order of the items.

        A result is yielded as soon as it and its predecessors are available. Closing the iterator
        early cancels items that have not started; the engine can be used again at once.

        Parameters
        ----------
        function : callable
            Module-level function (not a lambda, as it may run in another process).
        shared : object
            Data that all items need, of any size: sent once to each worker, which keeps it,
            including data cached in it by `function`, for later maps with the same object. It must
            not be changed afterwards.
        items : sequence
            Arguments that differ. Items and results should be small.

        Yields
        ------
        object
            Results.

        Raises
        ------
        Exception
            Error of `function`, raised here when the result of its item is due.
        EngineError
            If the workers are lost repeatedly or permanently.
        """

    def close(self) -> None:
        """Release resources that the engine created; a given client stays open."""


class EngineKind(Protocol):
    """A class of engines to register, with the accepted values of ``engine=``."""

    #: Description of the accepted values, for messages.
    expects: str

    def from_option(self, option: object) -> Engine | None:
        """Return the engine for a value of ``engine=``; None if it is for another kind.

        Parameters
        ----------
        option : object
            A value of ``engine=``.

        Returns
        -------
        Engine or None

        Raises
        ------
        OptionError
            If the value is of this kind but invalid.
        """


class Serial:
    """The engine that uses only this process."""

    expects = "None"

    @classmethod
    def from_option(cls, option: object) -> Engine | None:
        """Return the engine for the option None; None for other options.

        Parameters
        ----------
        option : object
            A value of ``engine=``.

        Returns
        -------
        Engine or None
        """
        return cls() if option is None else None

    @property
    def workers(self) -> int:
        """Number of items processed at the same time: one."""
        return 1

    @property
    def name(self) -> str:
        """Name for the record of a run."""
        return "serial"

    def map(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(shared, item)`` for every item in turn; see `Engine.map`.

        Parameters
        ----------
        function : callable
            Module-level function.
        shared : object
            Data that all items need.
        items : sequence
            Arguments that differ.

        Yields
        ------
        object
            Results.
        """
        for item in items:
            yield function(shared, item)

    def close(self) -> None:
        """Do nothing: nothing was started."""
