"""Progress of a run at the command line: display, and handling of Ctrl-C."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

from updyn.cli.settings import WAITING
from updyn.cli.signals import LastResort, watch_signals
from updyn.cli.terminal import print_note
from updyn.progress import ProgressBar, RunStage

if TYPE_CHECKING:
    from rich.console import Console

    from updyn.updating.fit.monitor import Progress

__all__ = ["ProgressDisplay", "show_progress"]

#: Message after a request to stop.
_STOPPING = "Stopping after this step; the results so far will be written."
_AGAIN = "Ctrl-C again to leave at once."
_LEAVING = "Leaving at once."


class ProgressDisplay(ProgressBar):
    """A progress display that Ctrl-C stops; `stopping` describes what happens after that."""

    def __init__(
        self, console: Console, stages: Sequence[RunStage] = (), stopping: str = _STOPPING
    ) -> None:
        super().__init__(console, stages)
        self._stopping = f"{stopping} {_AGAIN}"
        self.stopping = False
        self._answered = 0
        self._handled = threading.Event()
        self._last_resort = LastResort()

    def __call__(self, progress: Progress) -> bool:
        """Show a step, or the lines solved for the next one; return whether to stop."""
        self.show(progress)
        return self.stopping

    def note(self, text: str) -> None:
        """Write a plain line."""
        print_note(text, console=self.console)

    def interrupt(self, _number: int, _frame: FrameType | None) -> None:
        """Ask the run to end after the lines under way; a second time, end at once."""
        # Two signals during a long C call result in one call of this handler.
        if self.stopping or self._answered > 1:
            raise KeyboardInterrupt
        self.stopping = True
        self._handled.set()

    def answer(self, number: int) -> None:
        """Report a signal at once; after the second, end the process after a grace period."""
        self._answered += 1
        if self._answered == 1:
            # After this, a second signal is a second call of the handler.
            self._handled.wait(WAITING.answer_time)
            print_note(self._stopping, "yellow", self.console)
        elif self._answered == 2:
            print_note(_LEAVING, "yellow", self.console)
            self._last_resort.begin(number)

    def end(self) -> None:
        """Cancel the forced end of the process."""
        self._last_resort.cancel()


@contextmanager
def show_progress(
    console: Console, stages: Sequence[RunStage] = (), stopping: str = _STOPPING
) -> Iterator[ProgressDisplay]:
    """Yield a display in a context: Ctrl-C asks the run to stop, a second one ends it."""
    display = ProgressDisplay(console, stages, stopping)
    with display.live_bar():
        try:
            with watch_signals(display.interrupt, display.answer):
                yield display
        finally:
            display.end()
