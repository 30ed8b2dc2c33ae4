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
    """Maps a function over many items, in one process or in many.

    The results, their order and their bits do not depend on the engine.
    """

    @property
    def workers(self) -> int:
        """Items that are worked on at the same time."""

    @property
    def name(self) -> str:
        """Name for the record of a run: ``"serial"``, ``"2 processes"``."""

    def map(self, function: Callable[[S, T], R], shared: S, items: Sequence[T]) -> Iterator[R]:
        """Yield ``function(shared, item)`` for every item, in the order of the items.

        A result is yielded as soon as it and those before it are there. Closing the iterator early
        cancels the items that have not started; the engine can be used again at once.

        Parameters
        ----------
        function : callable
            A function of a module (not a lambda: it may run in another process).
        shared : object
            Data that all items need, however large: sent once to each worker, which keeps it, with
            whatever `function` caches in it, for later maps with the same object. It must not be
            changed afterwards.
        items : sequence
            Arguments that differ; small, as the results should be.

        Yields
        ------
        object
            Results.

        Raises
        ------
        Exception
            Raised by `function`; it is raised here when the result of its item is due.
        EngineError
            If the workers are lost repeatedly, or for good.
        """

    def close(self) -> None:
        """Release what the engine has started itself; a client that was given stays open."""


class EngineKind(Protocol):
    """A class of engines to register, with the values of ``engine=`` it is made from."""

    #: These values in words, for messages.
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
            If the value is of this kind but not usable.
        """


class Serial:
    """The engine of one process: this one."""

    expects = "None"

    @classmethod
    def from_option(cls, option: object) -> Engine | None:
        """Return the engine where none is asked for; None for anything else.

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
        """Items that are worked on at the same time: one."""
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
            Function of a module.
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
