"""The process of a task: ``python -m updyn.web.work TASK JOB OUT FOLDER``; reports its progress.

It writes lines of JSON objects with a `kind`. A line on its standard input requests it to stop and
to write its results so far.
"""

from __future__ import annotations

import json
import math
import os
import sys
import threading
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from updyn.errors import UpdynError, UpdynWarning
from updyn.foreign.confinement import confine
from updyn.progress import RunStage, StageClock
from updyn.web.settings import WEB_TASK
from updyn.web.tasks import TASKS

if TYPE_CHECKING:
    from updyn.updating.fit.monitor import Progress

__all__ = ["main"]


class _StopFlag:
    """Whether to stop: set by a line on stdin, or by its end, which is the server's end.

    Not every system can send a signal to another process.
    """

    def __init__(self) -> None:
        self.stop = False
        threading.Thread(target=self._wait_for_stop, daemon=True).start()

    def _wait_for_stop(self) -> None:
        os.read(sys.stdin.fileno(), 1)  # no buffer, which could not be left at the end
        self.stop = True


class _Reporter:
    """Writes the progress of a task, and returns whether to stop."""

    def __init__(self, flag: _StopFlag) -> None:
        self._flag = flag
        self._clock = StageClock()
        self._last = ("", -1, -math.inf)

    def __call__(self, progress: Progress) -> bool:
        stage, step, at = self._last
        now, where = time.monotonic(), self._clock.locate(progress)
        is_new = (progress.stage, progress.iteration) != (stage, step)
        if is_new or now - at >= WEB_TASK.message_interval:
            self._last = progress.stage, progress.iteration, now
            write(
                "progress",
                stage=progress.stage,
                iteration=progress.iteration,
                accepted=progress.accepted,
                cost=_finite(progress.cost),
                lines_done=progress.lines_done,
                n_lines=progress.n_lines,
                values=dict(progress.values),
                position=where.number,
                share=_finite(where.share),
                remaining=_finite(where.remaining),
            )
        return self._flag.stop

    def announce(self, stages: Sequence[RunStage]) -> None:
        self._clock = StageClock(stages)
        write("plan", stages=[stage.name for stage in stages])

    def say(self, text: str) -> None:
        write("stage", text=text)


def _finite(value: float) -> float | None:
    return None if math.isnan(value) else value


def write(kind: str, **content: object) -> None:
    """Write a line with plain data; `kind` is plan, progress, stage, note, error or done."""
    with suppress(BrokenPipeError):  # the server has ended; the results are written all the same
        sys.stdout.write(json.dumps({"kind": kind, **content}) + "\n")
        sys.stdout.flush()


def main(task: str, job: str, out: str, folder: str, *, resume: bool = False) -> int:
    """Do a task in a project; return 0, or 2 for bad input. Files outside `folder` are not read."""
    flag = _StopFlag()
    warnings.showwarning = _write_warning
    warnings.simplefilter("always", UpdynWarning)
    confine(Path(folder))
    try:
        ended = TASKS.find(task).do(Path(job), Path(out), _Reporter(flag), resume)
    except UpdynError as error:
        write("error", text=str(error))
        return 2
    except OSError as error:
        write("error", text=f"{error.filename or out}: {error.strerror or error}")
        return 2
    write("done", status=ended.status, text=ended.summary, values=dict(ended.values))
    return 0


def _write_warning(
    message: Warning | str, category: type[Warning], *_where: object, **_more: object
) -> None:
    if issubclass(category, UpdynWarning):
        write("note", text=str(message))


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:5], resume="--resume" in sys.argv[5:]))
