"""Progress of long work, reported to the caller, who may stop it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from updyn.progress import asks_to_stop
from updyn.updating.problem.session import Session

__all__ = ["WorkCounter", "WorkProgress"]


@dataclass(frozen=True, slots=True)
class WorkProgress:
    """The argument of a callback: `done` of `total` pieces of work (for sampling an estimate).

    `stage` is ``"profile"``, ``"bootstrap"`` or ``"sampling"``; `note` is the result so far.
    """

    stage: str
    done: int
    total: int
    note: str = ""


@dataclass(slots=True)
class WorkCounter:
    """Counts pieces of work and asks the caller whether to continue.

    `callback` is called with a `WorkProgress` after every piece, and between blocks of lines of
    long ones; returning True stops.
    """

    stage: str
    total: int
    callback: Callable[[WorkProgress], bool | None] | None = None
    done: int = field(default=0, init=False)
    note: str = field(default="", init=False)
    stopped: bool = field(default=False, init=False)

    def attach(self, session: Session) -> Session:
        """Ask between blocks of lines of a session, too; return the session."""
        if self.callback is not None:
            session.wants_stop = self.report
        return session

    def step(self, note: str = "") -> bool:
        """Count one piece; return whether to stop."""
        self.done, self.note = self.done + 1, note or self.note
        return self.report()

    def report(self) -> bool:
        """Report the progress; return whether to stop."""
        if self.callback is not None:
            progress = WorkProgress(self.stage, self.done, self.total, self.note)
            self.stopped = asks_to_stop(self.callback(progress)) or self.stopped
        return self.stopped
