"""Progress of long work to whoever waits for it, and the wish to stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from updyn.updating.problem.session import Session

__all__ = ["Progress", "WorkCounter"]


@dataclass(frozen=True, slots=True)
class Progress:
    """What a callback is shown.

    Attributes
    ----------
    stage : str
        ``"profile"``, ``"bootstrap"`` or ``"sampling"``.
    done, total : int
        Pieces of work done, and in all (for sampling: as far as is known).
    note : str
        What has been reached so far; may be empty.
    """

    stage: str
    done: int
    total: int
    note: str = ""


@dataclass(slots=True)
class WorkCounter:
    """Counts pieces of work and asks the caller whether to go on.

    Parameters
    ----------
    stage : str
        What is done.
    total : int
        Pieces of work.
    callback : callable, optional
        Called with a `Progress` after every piece, and between blocks of lines of long ones;
        returning True stops.
    """

    stage: str
    total: int
    callback: Callable[[Progress], bool | None] | None = None
    done: int = field(default=0, init=False)
    note: str = field(default="", init=False)
    stopped: bool = field(default=False, init=False)

    def attach(self, session: Session) -> Session:
        """Have a session ask between blocks of lines."""
        if self.callback is not None:
            session.wants_stop = self.asks
        return session

    def step(self, note: str = "") -> bool:
        """Count one piece; return whether to stop."""
        self.done, self.note = self.done + 1, note or self.note
        return self.asks()

    def asks(self) -> bool:
        """Show where the work is; return whether to stop."""
        if self.callback is not None:
            self.stopped = (
                bool(self.callback(Progress(self.stage, self.done, self.total, self.note)))
                or self.stopped
            )
        return self.stopped
