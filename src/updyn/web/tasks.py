"""`JobTask`: work on a job that takes a while, in a separate process; a line in `TASKS` each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from updyn.job import load_job, run_job
from updyn.job.comparison import compare_job
from updyn.job.identification import modes_job
from updyn.job.planning import plan_job
from updyn.job.run import list_stages
from updyn.job.start_pages import StartPages, write_start
from updyn.progress import RunStage
from updyn.registry import Registry
from updyn.text_table import format_count
from updyn.updating.fit.methods import METHODS

if TYPE_CHECKING:
    from updyn.updating.fit.monitor import Progress

__all__ = [
    "CHECK",
    "COMPARE",
    "CORRELATE",
    "MODES",
    "PLAN",
    "RUN",
    "TASKS",
    "Field",
    "JobTask",
    "Reporter",
    "TaskResult",
]


class Reporter(Protocol):
    """Receives the progress of a task."""

    def __call__(self, progress: Progress) -> bool:
        """Receive a step; return True to stop the task."""
        ...

    def announce(self, stages: Sequence[RunStage]) -> None:
        """Receive the stages of the task, before the first one."""
        ...

    def say(self, text: str) -> None:
        """Receive a message."""
        ...


@dataclass(frozen=True, slots=True)
class TaskResult:
    """How a task has ended.

    Attributes
    ----------
    status : str
        In a word or two, such as the status of the result.
    summary : str
        Summary of the results, as on the command line.
    values : mapping of str to float
        The unknowns that were found, where there are some.
    """

    status: str
    summary: str
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Field:
    """A key of the task's table in the job that a page offers to set.

    Attributes
    ----------
    key : str
        Of the table.
    label : str
        For the page, with the unit.
    kind : {"number", "whole", "numbers", "band", "text", "texts", "choice"}
        Kind of value: ``"numbers"``, ``"band"`` (two frequencies) and ``"texts"`` are arrays.
    choices : sequence of str
        For ``"choice"``; the first is the default of a missing key.
    required : bool
        Whether the table needs the key.
    """

    key: str
    label: str
    kind: Literal["number", "whole", "numbers", "band", "text", "texts", "choice"]
    choices: Sequence[str] = ()
    required: bool = False


@dataclass(frozen=True, slots=True)
class JobTask:
    """Work on a job.

    Attributes
    ----------
    do : callable
        Takes job file, folder for the results, reporter and whether to resume; returns a
        `TaskResult`.
    page : str
        The HTML file that it writes.
    suffix : str
        Suffix added to the stem of the job for the folder.
    table : str
        Table of the job; empty if it has no table.
    fields : sequence of Field
        Keys of the table that a page offers.
    about : str
        Description, in a sentence.
    stops : bool
        Whether it can stop with its results so far; otherwise it is ended.
    resumes : bool
        Whether a stopped or ended task can be resumed.
    panel : str
        Function ``"module:attribute"`` that shows a further part of the page of the task; empty
        for none. It takes the `Workspace`, and its module is imported with the page.
    """

    do: Callable[[Path, Path, Reporter, bool], TaskResult]
    page: str
    suffix: str
    table: str = ""
    fields: Sequence[Field] = ()
    about: str = ""
    stops: bool = False
    resumes: bool = False
    panel: str = ""


def _run_job(job: Path, out: Path, reporter: Reporter, resume: bool) -> TaskResult:
    loaded = load_job(job)
    reporter.announce(list_stages(loaded))
    run = run_job(loaded, out, reporter, resume=resume)
    return TaskResult(run.result.status, run.summary(), run.result.values)


def _identify_modes(job: Path, out: Path, reporter: Reporter, _resume: bool) -> TaskResult:
    found = modes_job(load_job(job, of_test=True), out, say=reporter.say)
    return TaskResult(f"{len(found)} modes", "")


def _plan_test(job: Path, out: Path, reporter: Reporter, resume: bool) -> TaskResult:
    stages: list[str] = []

    def show(progress: Progress) -> None:
        if progress.stage not in stages[-1:]:
            stages.append(progress.stage)
            reporter.say(progress.stage)

    made = plan_job(load_job(job, before_test=True), out, show, resume=resume)
    return TaskResult("planned", made.summary())


def _compare_methods(job: Path, out: Path, reporter: Reporter, _resume: bool) -> TaskResult:
    reporter.announce([RunStage(name) for name in METHODS])
    found = compare_job(load_job(job), out, reporter)
    n_converged = sum(row.status == "converged" for row in found)
    return TaskResult(f"{n_converged} of {len(found)} methods converged", found.summary())


def _check(job: Path, out: Path, _reporter: Reporter, _resume: bool) -> TaskResult:
    return _describe_start(write_start(load_job(job), "check", out))


def _correlate(job: Path, out: Path, _reporter: Reporter, _resume: bool) -> TaskResult:
    return _describe_start(write_start(load_job(job), "correlate", out))


def _describe_start(found: StartPages) -> TaskResult:
    known = found.identifiability
    faults = format_count(found.n_findings, "suspected fault")
    status = f"{known.rank} of {known.n_parameters} unknowns could be determined, {faults}"
    return TaskResult(status, "")


RUN = JobTask(_run_job, "report.html", "-run", stops=True, resumes=True)
MODES = JobTask(
    _identify_modes,
    "modes.html",
    "-modes",
    "modes",
    (Field("damping", "damping", "choice", ("structural", "viscous")),),
    "Identifies the modes of the measurement. A click in the diagram leaves a mode out or adds one"
    " for the job.",
)
PLAN = JobTask(
    _plan_test,
    "plan.html",
    "-plan",
    "plan",
    (
        Field("n_sensors", "sensors", "whole", required=True),
        Field("n_references", "forces", "whole"),
        Field("band", "band, from and to (Hz)", "band", required=True),
        Field("quantity", "quantity", "choice", ("accelerance", "mobility", "receptance")),
        Field("criterion", "criterion", "choice", ("d-optimal", "a-optimal")),
        Field("candidates", "candidates (none: all)", "texts"),
    ),
    "Chooses sensors and forces before a test, so that the unknowns of the job are determined"
    " best.",
    resumes=True,
)
COMPARE = JobTask(
    _compare_methods,
    "compare.html",
    "-compare",
    about="Runs every method on the inputs of the job and compares their answers.",
    stops=True,
)
CHECK = JobTask(
    _check,
    "check.html",
    "-check",
    about="Checks model, data and unknowns of the job before a run: agreement at the start,"
    " suspected faults, and which unknowns the data could determine.",
)
CORRELATE = JobTask(
    _correlate,
    "correlate.html",
    "-correlate",
    about="Compares the model of the job at its start with the measurement: FRFs, modes and their"
    " agreement.",
)
#: The tasks by name. A room or another package adds one by a line here, a call of `TASKS.register`,
#: or an entry point of the group ``updyn.tasks``.
TASKS: Registry[Any] = Registry(
    "task",
    "updyn.tasks",
    {
        "run": RUN,
        "compare": COMPARE,
        "check": CHECK,
        "correlate": CORRELATE,
        "modes": MODES,
        "plan": PLAN,
        "plant": "updyn.control.job.task:PLANT",
    },
)
