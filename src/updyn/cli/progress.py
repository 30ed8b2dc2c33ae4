"""The progress of a run: a bar on a terminal, plain lines elsewhere; and what Ctrl-C does."""

from __future__ import annotations

import math
import re
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any

from updyn.cli.signals import LastResort, watched
from updyn.cli.terminal import print_note, printable

if TYPE_CHECKING:
    from rich.console import Console

    from updyn.updating.fit.monitor import Progress

__all__ = ["ProgressDisplay", "Stage", "StageClock", "Where", "show_progress"]

_STOPPING = (
    "Stopping after this step; the results so far will be written. Ctrl-C again to leave at once."
)
_LEAVING = "Leaving at once."
#: Shortest time between plain lines of a stage, in s: between steps, and within one.
_BETWEEN_STEPS = 1.0
_WITHIN_STEP = 10.0
#: How long a stage has to run before the time that it needs is estimated, in s.
_BEFORE_ESTIMATE = 1.0
#: How long the answer to a Ctrl-C waits for its handler, in s.
_ANSWER = 0.2
_BAR_WIDTH = 12


# -- stages ----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class Stage:
    """A stage of a run, as far as it is known beforehand.

    Parameters
    ----------
    name : str
        How the stage of its progress begins.
    most_steps : int
        Largest number of steps; 0 where it is not known.
    """

    name: str
    most_steps: int = 0


@dataclass(frozen=True, slots=True)
class Where:
    """Where a run is.

    Attributes
    ----------
    number, of : int
        Which stage, counted from 1, of how many; 0 where it is not known.
    name : str
        Of the stage.
    share : float
        Share of the stage that is done, 0 to 1, if it takes its largest number of steps; nan where
        that is not known.
    left : float
        Time that it needs then, in s; nan where that is not known.
    """

    number: int
    of: int
    name: str
    share: float
    left: float


class StageClock:
    """Says in which stage a run is, how much of it is done and how long it takes at most.

    Parameters
    ----------
    stages : sequence of Stage
        In their order. What is not among them counts with the stage before.
    """

    def __init__(self, stages: Sequence[Stage] = ()) -> None:
        self._stages = tuple(stages)
        self._reached = -1
        self._name = ""
        # When the stage began, and the lines that had been solved then and at the last call.
        self._begun, self._first, self._last = 0.0, 0, 0

    def read(self, progress: Progress) -> Where:
        """Return where the run is.

        Parameters
        ----------
        progress : Progress
            What a callback is shown.
        """
        found = self._find(progress.stage)
        name = progress.stage if found < 0 else self._stages[found].name
        restarted = progress.lines_done < self._last  # pieces of other work, counted from 0
        if name != self._name or restarted:
            self._name, self._begun = name, time.monotonic()
            self._first = 0 if restarted else progress.lines_done
        self._last = progress.lines_done
        self._reached = max(self._reached, found)
        share, left = self._estimate(progress, found)
        return Where(self._reached + 1, len(self._stages), _short(progress.stage), share, left)

    def _find(self, text: str) -> int:
        """Return the place of a stage; -1 where it is none of those known."""
        for number, stage in enumerate(self._stages):
            if re.match(rf"{re.escape(stage.name)}(?:[ :,]|$)", text):
                return number
        return -1

    def _estimate(self, progress: Progress, found: int) -> tuple[float, float]:
        """Return the share of the stage that is done, and the time left, in s; nan if unknown."""
        lines = progress.n_lines * self._stages[found].most_steps if found >= 0 else 0
        done = progress.lines_done - self._first
        if not 0 < done <= lines:
            return math.nan, math.nan
        share, passed = done / lines, time.monotonic() - self._begun
        if passed < _BEFORE_ESTIMATE:
            return share, math.nan
        return share, passed * (1.0 - share) / share


def _short(stage: str) -> str:
    """Return the name of a stage without its count, which stands before it, and said once."""
    name, _, inner = re.sub(r" \(\d+ of \d+\)", "", stage).partition(": ")
    return name if inner in ("", name) else f"{name}: {inner}"


def _clock(seconds: float) -> str:
    """Return a time as text."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


# -- display ---------------------------------------------------------------------------------------
class ProgressDisplay:
    """Shows the progress of a run: a bar on a terminal, plain lines elsewhere.

    Parameters
    ----------
    console : rich.console.Console
        Where to write, usually stderr.
    stages : sequence of Stage
        Of the run, as far as they are known.
    """

    def __init__(self, console: Console, stages: Sequence[Stage] = ()) -> None:
        self.console = console
        self.stopping = False
        self._clock = StageClock(stages)
        # Stage, step and time of the last plain line.
        self._shown = "", -1, 0.0
        self._bar: Any = None
        self._task: Any = None
        self._answered = 0
        self._handled = threading.Event()
        self._last_resort = LastResort()

    def __call__(self, progress: Progress) -> bool:
        """Show a step, or the lines solved for the next one; return whether to stop."""
        if self._bar is not None:
            self._draw(progress)
        else:
            self._print(progress)
        return self.stopping

    # -- a bar
    def _draw(self, progress: Progress) -> None:
        """Bring the bar up to date."""
        where = self._clock.read(progress)
        name = where.name
        if where.of and where.number:
            name = f"stage {where.number} of {where.of} {name}"
        figures = []
        if not math.isnan(progress.cost):
            figures = [f"iteration {progress.accepted}", f"cost {progress.cost:.3g}"]
        if not math.isnan(where.left):
            figures.append(f"up to {_clock(where.left)}")
        known = not math.isnan(where.share)
        self._bar.update(
            self._task,
            description=printable(name),
            total=1.0 if known else None,
            completed=where.share if known else 0.0,
            figures="  ".join(figures),
        )

    # -- plain lines
    def _print(self, progress: Progress) -> None:
        """Print a plain line, where one is due."""
        step = -1 if math.isnan(progress.cost) else progress.accepted
        if not self._is_due(progress.stage, step):
            return
        self._shown = progress.stage, step, time.monotonic()
        text = progress.stage
        if step >= 0:
            text += f"  iteration {step}  cost {progress.cost:.6g}"
        if progress.n_lines:
            text += f"  {progress.lines_done} lines solved ({progress.n_lines} a step)"
        print_note(text, console=self.console)

    def _is_due(self, stage: str, step: int) -> bool:
        """Return whether a plain line is printed: the first of a stage, or after a pause."""
        shown_stage, shown_step, shown_at = self._shown
        if stage != shown_stage or shown_step < 0 <= step:
            return True
        pause = _WITHIN_STEP if step == shown_step else _BETWEEN_STEPS
        return time.monotonic() - shown_at >= pause

    # -- Ctrl-C
    def interrupt(self, _number: int, _frame: FrameType | None) -> None:
        """Ask the run to end after the lines under way; a second time, end at once."""
        # Two signals while Python does not run are one call of this handler.
        if self.stopping or self._answered > 1:
            raise KeyboardInterrupt
        self.stopping = True
        self._handled.set()

    def answer(self, number: int) -> None:
        """Say at once what a signal does; after the second, end the process in a while."""
        self._answered += 1
        if self._answered == 1:
            # A second signal after the answer is then a second call of the handler.
            self._handled.wait(_ANSWER)
            print_note(_STOPPING, "yellow", self.console)
        elif self._answered == 2:
            print_note(_LEAVING, "yellow", self.console)
            self._last_resort.begin(number)

    def end(self) -> None:
        """Take back what would end the process."""
        self._last_resort.cancel()

    @contextmanager
    def shown(self) -> Iterator[ProgressDisplay]:
        """Draw a bar where the console is a terminal that can."""
        if not self.console.is_terminal or self.console.is_dumb_terminal:
            yield self
            return
        from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as Bar

        columns = (
            SpinnerColumn("dots" if self.console.encoding.startswith("utf") else "line"),
            TextColumn("{task.description}", markup=False),
            BarColumn(_BAR_WIDTH),
            TextColumn("{task.fields[figures]}", markup=False),
            TimeElapsedColumn(),
        )
        with Bar(*columns, console=self.console, transient=True) as self._bar:
            self._task = self._bar.add_task("starting", total=None, figures="")
            yield self
        self._bar = None


@contextmanager
def show_progress(console: Console, stages: Sequence[Stage] = ()) -> Iterator[ProgressDisplay]:
    """Return a display as a context: Ctrl-C asks the run to stop, a second one ends it.

    Parameters
    ----------
    console : rich.console.Console
        Where to write.
    stages : sequence of Stage
        Of the run, as far as they are known.

    Yields
    ------
    ProgressDisplay
    """
    display = ProgressDisplay(console, stages)
    with display.shown():
        try:
            with watched(display.interrupt, display.answer):
                yield display
        finally:
            display.end()
