"""Display of the progress of a fit: a bar in a terminal or notebook, plain lines elsewhere."""

from __future__ import annotations

import html
import io
import math
import re
import reprlib
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from updyn.errors import OptionError
from updyn.registry import load_object
from updyn.settings import PROGRESS
from updyn.style import PAPER
from updyn.text_table import printable

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "LineClock",
    "NotebookBar",
    "ProgressBar",
    "RunPosition",
    "RunProgress",
    "RunStage",
    "StageClock",
    "asks_to_stop",
    "display_progress",
    "format_clock",
]

_BAR_WIDTH = 12


class RunProgress(Protocol):
    """Progress to display; `updyn.updating.fit.monitor.Progress` describes the entries."""

    @property
    def stage(self) -> str:
        """Part of the method."""

    @property
    def cost(self) -> float:
        """Half the sum of squared weighted residuals; nan before the first step."""

    @property
    def lines_done(self) -> int:
        """Lines solved so far in the whole run."""

    @property
    def n_lines(self) -> int:
        """Number of lines solved per step."""

    @property
    def accepted(self) -> int:
        """Accepted steps so far."""


def asks_to_stop(answer: object) -> bool:
    """Return whether a callback's answer is True; OptionError unless True, False or None."""
    if answer is None:
        return False
    if not isinstance(answer, (bool, np.bool_)):
        raise OptionError(
            f"callback: it returned {reprlib.repr(answer)}; expected True to stop, False or None to"
            " go on"
        )
    return bool(answer)


# -- stages ----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True)
class RunStage:
    """A stage of a run: prefix of its progress, and largest number of steps (0 if unknown)."""

    name: str
    most_steps: int = 0


@dataclass(frozen=True, slots=True)
class RunPosition:
    """Position of a run: stage `number` (from 1) `of` stages, and completed share of this stage.

    `remaining` is in s at the rate so far. Unknown numbers are 0, unknown shares and times nan.
    """

    number: int
    of: int
    name: str
    share: float
    remaining: float


class StageClock:
    """Clock that estimates the stage of a run, its completed share and its remaining time.

    Progress of stages that are not listed counts for the preceding one.
    """

    def __init__(self, stages: Sequence[RunStage] = ()) -> None:
        self._stages = tuple(stages)
        self._reached = -1
        self._name = ""
        # Start time of the stage, and the numbers of lines solved then and at the last call.
        self._begun, self._first, self._last = 0.0, 0, 0

    def locate(self, progress: RunProgress) -> RunPosition:
        """Return the position of the run."""
        found = self._find(progress.stage)
        name = progress.stage if found < 0 else self._stages[found].name
        restarted = progress.lines_done < self._last  # parts of other work, counted from 0
        if name != self._name or restarted:
            self._name, self._begun = name, time.monotonic()
            self._first = 0 if restarted else progress.lines_done
        self._last = progress.lines_done
        self._reached = max(self._reached, found)
        share, remaining = self._estimate(progress, found)
        return RunPosition(
            self._reached + 1, len(self._stages), _shorten_name(progress.stage), share, remaining
        )

    def _find(self, text: str) -> int:
        """Return the index of a stage; -1 if it is unknown."""
        for number, stage in enumerate(self._stages):
            if re.match(rf"{re.escape(stage.name)}(?:[ :,]|$)", text):
                return number
        return -1

    def _estimate(self, progress: RunProgress, found: int) -> tuple[float, float]:
        """Return the completed share of the stage and its remaining time in s; nan if unknown."""
        lines = progress.n_lines * self._stages[found].most_steps if found >= 0 else 0
        done = progress.lines_done - self._first
        if not 0 < done <= lines:
            return math.nan, math.nan
        share, passed = done / lines, time.monotonic() - self._begun
        if passed < PROGRESS.estimate_delay:
            return share, math.nan
        return share, passed * (1.0 - share) / share


def _shorten_name(stage: str) -> str:
    """Return the name of a stage without its count and without repetition."""
    name, _, inner = re.sub(r" \(\d+ of \d+\)", "", stage).partition(": ")
    return name if inner in ("", name) else f"{name}: {inner}"


def format_clock(seconds: float) -> str:
    """Return a duration as minutes and seconds, from an hour on with hours."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


class LineClock:
    """Clock that decides when a plain line is due: first of a stage, or after a growing pause."""

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._stages: set[str] = set()
        self._printed_at = -math.inf

    @property
    def elapsed(self) -> float:
        """Time since the start in s."""
        return time.monotonic() - self._begun

    def is_due(self, where: RunPosition) -> bool:
        """Return whether to print a line now, and count it as printed."""
        stage = str(where.number) if where.of and where.number else where.name
        if stage in self._stages:
            growing = max(PROGRESS.line_interval, PROGRESS.line_growth * self.elapsed)
            pause = min(growing, PROGRESS.longest_interval)
        else:
            pause = PROGRESS.stage_interval
        now = time.monotonic()
        if now - self._printed_at < pause:
            return False
        self._stages.add(stage)
        self._printed_at = now
        return True


# -- display ---------------------------------------------------------------------------------------
class ProgressBar:
    """Display of the progress of a fit: a bar in a terminal, plain lines elsewhere."""

    def __init__(self, console: Console, stages: Sequence[RunStage] = ()) -> None:
        self.console = console
        self._clock = StageClock(stages)
        self._lines = LineClock()
        self._bar: Any = None
        self._task: Any = None

    def show(self, progress: RunProgress) -> None:
        """Display a step, or the lines solved for the next step."""
        where = self._clock.locate(progress)
        if self._bar is not None:
            self._draw(progress, where)
        elif self._lines.is_due(where):
            elapsed = f"{format_clock(self._lines.elapsed)} elapsed"
            self.note(f"{_name(where)}: {', '.join([*_figures(progress, where), elapsed])}")

    def note(self, text: str) -> None:
        """Write a plain line."""
        self.console.file.write(printable(text) + "\n")
        self.console.file.flush()

    # -- a bar
    def _draw(self, progress: RunProgress, where: RunPosition) -> None:
        known = not math.isnan(where.share)
        self._bar.update(
            self._task,
            description=printable(_name(where)),
            total=1.0 if known else None,
            completed=where.share if known else 0.0,
            figures="  ".join(_figures(progress, where)),
        )

    @contextmanager
    def live_bar(self) -> Iterator[None]:
        """Draw a bar if the console is a terminal that supports it."""
        if not self.console.is_terminal or self.console.is_dumb_terminal:
            yield
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
            yield
        self._bar = None


def _name(where: RunPosition) -> str:
    if where.of and where.number:
        return f"stage {where.number} of {where.of}, {where.name}"
    return where.name


def _figures(progress: RunProgress, where: RunPosition) -> list[str]:
    """Return iteration and remaining time of the stage, if known, as texts."""
    figures = []
    if not math.isnan(progress.cost):
        figures = [f"iteration {progress.accepted}"]
    if not math.isnan(where.remaining):
        figures.append(f"at most {format_clock(where.remaining)} left in this stage")
    return figures


class NotebookBar:
    """Display of the progress of a fit below the cell of a notebook."""

    def __init__(self, display: Callable[..., Any], stages: Sequence[RunStage] = ()) -> None:
        self._clock = StageClock(stages)
        self._handle = display(_Html(_bar("starting", math.nan, "")), display_id=True)
        self._last = -math.inf

    def show(self, progress: RunProgress) -> None:
        """Display a step, or the lines solved for the next step."""
        where = self._clock.locate(progress)
        now = time.monotonic()
        if now - self._last >= PROGRESS.bar_interval:
            self._last = now
            figures = "  ".join(_figures(progress, where))
            self._handle.update(_Html(_bar(_name(where), where.share, figures)))

    def end(self) -> None:
        """Remove the bar."""
        self._handle.update(_Html(""))


@dataclass(frozen=True, slots=True)
class _Html:
    """A text that a notebook shows as HTML."""

    text: str

    def _repr_html_(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return ""


def _bar(name: str, share: float, figures: str) -> str:
    """Return a bar as HTML; empty if the share is unknown."""
    done = 0.0 if math.isnan(share) else 100.0 * min(max(share, 0.0), 1.0)
    bar = (
        f'<span style="display:inline-block;width:10em;height:0.7em;margin:0 0.8em;'
        f'border:1px solid {PAPER["faint"]};border-radius:4px">'
        f'<span style="display:block;width:{done:.0f}%;height:100%;border-radius:3px;'
        f'background:{PAPER["after"]}"></span></span>'
    )
    return f"<div>{html.escape(name)}{bar}{html.escape(figures)}</div>"


@contextmanager
def display_progress(stages: Sequence[RunStage] = ()) -> Iterator[Callable[[RunProgress], None]]:
    """Yield a function that displays steps in a notebook, on stderr or as lines of a log."""
    display = _notebook_display()
    if display is not None:
        bar = NotebookBar(display, stages)
        try:
            yield bar.show
        finally:
            bar.end()
        return
    from rich.console import Console

    stream = io.StringIO() if sys.stderr is None else None  # stderr is closed
    shown = ProgressBar(Console(stderr=stream is None, file=stream), stages)
    with shown.live_bar():
        yield shown.show


def _notebook_display() -> Callable[..., Any] | None:
    """Return the display function of a notebook; None outside a notebook kernel."""
    shell = sys.modules.get("IPython")
    if shell is None or not hasattr(shell.get_ipython(), "kernel"):
        return None
    found: Callable[..., Any] = load_object("IPython.display:display")
    return found
