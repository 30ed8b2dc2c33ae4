"""`Worker`: a task in a separate process, which continues whether or not a page shows it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from updyn.text_table import format_count
from updyn.web.project import hide_folder
from updyn.web.settings import WEB_TASK
from updyn.web.tasks import TASKS

__all__ = ["Worker"]

#: States in words.
_STATES = {
    "running": "Running",
    "stopping": "Stopping after this step",
    "done": "Ended",
    "stopped": "Stopped",
    "failed": "Failed",
}
#: A task takes one thread unless the environment says otherwise: the pages need a core, too.
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Worker:
    """A task in a process: begun by `start`, ended by itself or by `stop`.

    `plan` has the names of all stages. `steps` have ``stage``, ``iteration``, ``cost``, ``values``
    and the ``position`` in the plan (from 1) with the completed ``share`` of the stage and its
    ``remaining`` seconds, None if not known; `now` is the present one. `levels` has level errors
    of the model in dB by iteration, computed by pages. `values` are the present unknowns, in the
    end the estimates. `stages` describe the work, `notes` are warnings. `state` is "running",
    "stopping", "done", "stopped" or "failed", `message` the summary or the error, `status` that of
    the result. `version` counts all changes.
    """

    def __init__(
        self, task: str, job: Path, out: Path, folder: Path, *, resume: bool = False
    ) -> None:
        self.task, self.job, self.out = task, job, out
        self._folder, self._resume = folder, resume
        self.plan: list[str] = []
        self.levels: dict[int, float] = {}
        self.steps: deque[Mapping[str, Any]] = deque(maxlen=WEB_TASK.kept_steps)
        self.now: Mapping[str, Any] = {}
        self.values: Mapping[str, float] = {}
        self.stages: deque[str] = deque(maxlen=WEB_TASK.kept_notes)
        self.notes: deque[str] = deque(maxlen=WEB_TASK.kept_notes)
        self.state, self.message, self.status, self.version = "running", "", "", 0
        self._process: subprocess.Popen[str] | None = None
        self._errors: deque[str] = deque(maxlen=WEB_TASK.kept_error_lines)

    def start(self) -> None:
        """Begin the process."""
        command = [sys.executable, "-m", "updyn.web.work", self.task]
        command += [str(path) for path in (self.job, self.out, self._folder)]
        if self._resume:
            command.append("--resume")
        threads = {name: os.environ.get(name, "1") for name in _THREADS}
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            errors="replace",
            env={**os.environ, **threads, "PYTHONUTF8": "1"},
            # Ctrl-C in the terminal of the server is for the server.
            start_new_session=sys.platform != "win32",
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        )
        error_reader = threading.Thread(target=self._collect_errors, daemon=True)
        error_reader.start()
        threading.Thread(target=self._read_events, args=(error_reader,), daemon=True).start()

    @property
    def progress(self) -> str:
        """The state in words, with the present stage or the status of the result."""
        text = _STATES[self.state]
        if self.active and self.now:
            text += f": {self.now['stage']}, {format_count(self.now['accepted'], 'step')}"
        elif self.active and self.stages:
            text += f": {self.stages[-1]}"
        elif self.state == "done":
            text += f": {self.status}"
        return text

    @property
    def active(self) -> bool:
        """Whether the task has not ended."""
        return self.state in ("running", "stopping")

    def stop(self) -> None:
        """Request the task to stop and write its results; end one without intermediate results."""
        if self._process is None or not self.active:
            return
        self.state = "stopping"
        self.version += 1
        if not TASKS.find(self.task).stops:
            self._process.kill()  # its files are replaced as one, in the end
            return
        assert self._process.stdin is not None
        with suppress(OSError):  # it has just ended
            self._process.stdin.write("stop\n")
            self._process.stdin.flush()

    def end(self) -> None:
        """Stop the task and wait until its results are written; one that does not end is killed."""
        if self._process is None or not self.active:
            return
        if self.state == "running":  # a second time would end it without its results
            self.stop()
        try:
            self._process.wait(WEB_TASK.stop_seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _collect_errors(self) -> None:
        """Keep the last lines that the process writes on stderr."""
        assert self._process is not None
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                self._errors.append(line.rstrip("\n"))

    def _read_events(self, error_reader: threading.Thread) -> None:
        """Read the lines that the process writes until it ends."""
        assert self._process is not None
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                try:
                    self._handle_event(json.loads(line))
                except (ValueError, KeyError, TypeError):
                    self._errors.append(line.rstrip("\n"))
        code = self._process.wait()
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()
        error_reader.join(WEB_TASK.last_lines_seconds)
        self._record_end(code)

    def _handle_event(self, event: Mapping[str, Any]) -> None:
        kind, text = event["kind"], hide_folder(event.get("text", ""), self._folder)
        self.values = event.get("values") or self.values
        if kind == "progress":
            is_step = event["cost"] is not None and event["iteration"] != self.now.get("iteration")
            if is_step or not self.steps:
                self.steps.append(event)
            self.now = event
        elif kind == "plan":
            self.plan = event["stages"]
        elif kind == "stage":
            self.stages.append(text)
        elif kind == "note":
            self.notes.append(text)
        else:
            self.message = text
            self.status = event.get("status", "")
        self.version += 1

    def _record_end(self, code: int) -> None:
        if code == 0 and self.status:
            self.state = "done"
        elif self.state == "stopping" and not TASKS.find(self.task).stops:
            self.message, self.state = "Stopped; nothing was written.", "stopped"
        else:
            self.message = self.message or _describe_failure(code, list(self._errors))
            self.state = "failed"
        self.version += 1


def _describe_failure(code: int, errors: list[str]) -> str:
    """Return a message about a process that ended without one."""
    if code < 0:
        try:
            name = signal.Signals(-code).name
        except ValueError:
            name = f"signal {-code}"
        how = f"The process was ended by {name}"
    else:
        how = f"The process ended with exit code {code}"
    text = f"{how}. What it had saved is kept: Resume goes on from there."
    return "\n".join([text, *errors[-8:]])
