"""``[plan]`` of a job, and `plan_job`: select sensors and forces before the test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, Field, Strict

from updyn.errors import JobError, key_path
from updyn.job.base import Pair, Table, Texts, is_number
from updyn.job.folder import PLAN_JOURNAL, check_out, default_out, run_journal
from updyn.job.job_table import JobTable
from updyn.job.prepare import prepare_model
from updyn.job.schema import Job
from updyn.outputs.switch import open_folder, replace_files
from updyn.planning import plan
from updyn.planning.settings import PLANNING
from updyn.progress import RunStage
from updyn.store.planning import write_plan_json

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine
    from updyn.planning import Plan
    from updyn.updating.fit.monitor import Progress

__all__ = ["PLAN", "PLAN_FILES", "PlanTable", "plan_job", "stages"]

#: Files that ``updyn plan`` writes.
PLAN_FILES = ("plan.html", "plan.json")


def _parse_bands(given: Any) -> object:
    pairs = given
    if isinstance(given, list | tuple) and given and all(is_number(x) for x in given):
        pairs = [given]
    usable = isinstance(pairs, list | tuple) and bool(pairs)
    if not usable or not all(_is_pair(pair) for pair in pairs):
        raise ValueError(
            "expected two frequencies in Hz, such as [5.0, 400.0], or an array of such pairs to"
            " choose from"
        )
    return tuple((float(low), float(high)) for low, high in pairs)


def _is_pair(given: object) -> bool:
    return isinstance(given, list | tuple) and len(given) == 2 and all(map(is_number, given))


def _parse_lines(given: object) -> object:
    if isinstance(given, int) and not isinstance(given, bool) and given >= 2:
        return given
    if isinstance(given, list | tuple) and given and all(map(is_number, given)):
        return tuple(map(float, given))
    raise ValueError("expected a number of lines of at least 2, or an array of frequencies in Hz")


class PlanTable(Table):
    """``[plan]``: number of sensors and forces, their candidates, and the band."""

    n_sensors: int = Field(ge=1)
    n_references: int = Field(default=1, ge=1)
    band: Annotated[tuple[Pair, ...], BeforeValidator(_parse_bands), Strict(False)]
    candidates: str | Texts | None = None
    reference_candidates: str | Texts | None = None
    criterion: str = "d-optimal"
    quantity: str = "accelerance"
    lines: Annotated[int | tuple[float, ...], BeforeValidator(_parse_lines)] = PLANNING.lines
    noise: dict[str, float] | None = None
    interest: str | Texts | None = None
    robust: int = Field(default=PLANNING.starts, ge=0)
    off: float = Field(default=0.2, gt=0, le=1)
    seed: int = Field(default=0, ge=0)


class _PlanJobTable(JobTable):
    """``[plan]``: the work of ``updyn plan``; an update ignores it."""

    schema = PlanTable

    def outputs(self, table: PlanTable) -> tuple[str, ...]:
        return ()


PLAN = _PlanJobTable()


def plan_job(
    job: Job,
    out: str | Path | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    engine: int | Client | Engine | None = None,
    resume: bool = False,
) -> Plan:
    """Select the sensors and forces of ``[plan]`` of a job; write ``plan.json`` and ``plan.html``.

    The job may lack ``[test]``; measured data are not used. `out` is by default the job's stem with
    ``-plan``. Until the end, it holds ``plan.journal``, from which `resume` continues a stopped
    plan with the same result. Nothing else is written if a `JobError`, `SolverError` or
    `StoppedError` is raised.
    """
    from updyn.report import write_plan

    table = _table(job)
    out = check_out(job, out or default_out(job, "plan"), PLAN_FILES)
    model, unknowns = prepare_model(job)
    options = table.model_dump()
    title = job.find_title(model.title)
    options |= {"engine": engine, "callback": callback, "resume": resume}
    with open_folder(out):
        check_out(job, out, PLAN_FILES)  # again, now that no other run can change the folder
        with run_journal(out, PLAN_JOURNAL) as journal, job.located(), key_path("plan"):
            found = plan(model, unknowns, compare=True, checkpoint=journal, **options)
        with replace_files(out, "plan", PLAN_FILES) as new:
            write_plan(found, new / "plan.html", f"{title}: test plan")
            write_plan_json(found, new / "plan.json", title)
        journal.unlink(missing_ok=True)
    return found


def stages(job: Job) -> list[RunStage]:
    """Return the stages of the plan of a job in order; raise `JobError` without ``[plan]``."""
    starts = 1 + _table(job).robust
    others = ("layout", "comparison", "expectation")
    return [RunStage("information", starts), *map(RunStage, others)]


def _table(job: Job) -> PlanTable:
    """Return ``[plan]`` of a job; raise if the job has a table that a plan does not support."""
    planned = job.table(PlanTable)
    if planned is None:
        raise JobError("missing table [plan] with the number of sensors and the band", job.path)
    with job.located():
        if len(job.parts) > 1:
            raise JobError("a plan is for one test; keep one [[test]]", key=("test", 1))
        for name, table in (("calibration", "[[calibration]]"), ("selection", "[selection]")):
            if getattr(job, name):
                raise JobError(
                    f"{table} needs measured data; leave it out of a job to plan", key=(name,)
                )
    return planned
