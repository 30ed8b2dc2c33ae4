"""`PLANT`: the plant of a job as a task of the window."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from updyn.control.job.job_tables import PLANT_PAGE
from updyn.control.job.messages import describe_plant_result, name_plant_outcome
from updyn.control.job.plant_job import plant_job
from updyn.job import load_job
from updyn.web.tasks import Field, JobTask, TaskResult

if TYPE_CHECKING:
    from updyn.web.tasks import Reporter

__all__ = ["PLANT"]


def _plant(job: Path, out: Path, reporter: Reporter, _resume: bool) -> TaskResult:
    result = plant_job(load_job(job), out, say=reporter.say)
    return TaskResult(name_plant_outcome(result), describe_plant_result(result))


PLANT = JobTask(
    _plant,
    PLANT_PAGE,
    "-plant",
    "plant",
    (
        Field("inputs", "inputs (labels)", "texts", required=True),
        Field("outputs", "outputs (labels)", "texts", required=True),
        Field("band", "band, from and to (Hz)", "band"),
        Field("tolerance", "tolerance (1)", "number"),
        Field("error", "error", "choice", ("relative", "peak")),
    ),
    "Makes the plant of the latest run of this job, or of its model without a run, with the"
    " margins of the loops of [servo].",
    panel="updyn.control.job.tuning_page:show_tuning",
)
