"""`write_start`: the whole of ``check`` or ``correlate`` of a job, from the job to its pages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from updyn.job.findings import job_findings
from updyn.job.prepare import prepare
from updyn.job.run import job_analysis, job_selection
from updyn.job.schema import Job
from updyn.job.start import (
    agreements_at_start,
    choose_noise_once,
    counterparts_at_start,
    start_folder,
    start_models,
    write_start_pages,
)

if TYPE_CHECKING:
    from updyn.updating.judge.identifiability import Identifiability

__all__ = ["StartPages", "write_start"]


@dataclass(frozen=True, slots=True)
class StartPages:
    """The pages written by `write_start`, with the identifiability and the number of findings."""

    pages: list[Path]
    identifiability: Identifiability
    n_findings: int


def write_start(job: Job, work: str, out: str | Path | None = None) -> StartPages:
    """Write the pages of ``check`` or ``correlate`` of a job.

    `work` and `out` are those of `start_folder`. A `JobError` is raised, and nothing written, if
    the job or the folder cannot be used.
    """
    folder = start_folder(job, work, None if out is None else Path(out))
    ready = choose_noise_once(prepare(job))
    selection = job_selection(ready)
    unknowns = selection or ready.parameters
    findings = {test.name: job_findings(test, ready.parameters) for test in ready.tests}
    starts = start_models(ready, unknowns)
    analysis = job_analysis(ready, selection, starts)
    agreements = agreements_at_start(ready, starts)
    counterparts = counterparts_at_start(ready, starts) if work == "check" else None
    pages = write_start_pages(
        ready, work, folder, selection, analysis, findings, agreements, counterparts, starts
    )
    return StartPages(pages, analysis.report, sum(map(len, findings.values())))
