"""The command that makes the plant of a job."""

from __future__ import annotations

from pathlib import Path

from updyn.cli.commands import Verbose, open_engine
from updyn.cli.terminal import DONE, NOT_DETERMINED, output_width, print_note, print_outcome
from updyn.control.job.job_tables import CONTROL, PLANT_PAGE
from updyn.control.job.messages import brief_plant_result, describe_plant_result
from updyn.control.job.plant_job import check_plant_out, default_plant_out, plant_job
from updyn.control.job.tables import PlantTable
from updyn.job import load_job, prepare

__all__ = ["plant"]


def plant(
    job: Path,
    /,
    *,
    out: Path | None = None,
    run: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    verbose: Verbose = False,
) -> int:
    """Make the plant of a job: plant.mat, plant.json, plant.h, plant.html and control.json.

    The plant is that of the updated model if the job has been run, otherwise of the original model,
    which is reported. Exit code 3 if no plant holds the tolerance: no plant file is written; record
    and page state the error reached.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder DIR; by default that of the job's run. A finished run is searched there, and in the
        job's results folder.
    run
        Folder of the finished run, if it is another.
    workers
        Processes on this machine to spread a family of plants over.
    cluster
        Address of a Dask scheduler to spread it over its workers instead.
    verbose
        Print conversions, servo and notes before the outcome.
    """
    loaded = load_job(job)
    folder = check_plant_out(loaded, default_plant_out(loaded) if out is None else out)
    ready = prepare(loaded)
    with open_engine(workers, cluster) as where:
        result = plant_job(
            loaded,
            folder,
            run=run,
            prepared=ready,
            engine=where,
            say=lambda text: print_note(text, "dim"),
        )
    table = loaded.table(PlantTable)
    assert table is not None
    files = [
        *table.files,
        *(table.sampled_files if result.sampled is not None else ()),
        CONTROL,
    ]
    place = f"Plant in {folder}: {', '.join(files)}; page: {folder / PLANT_PAGE}"
    if not result.holds_tolerance:
        place = (
            f"No plant is written; what was reached: {folder / PLANT_PAGE} and {folder / CONTROL}"
        )
    outcome = brief_plant_result(result, [place], output_width())
    print_outcome(describe_plant_result(result), outcome, verbose=verbose)
    return DONE if result.holds_tolerance else NOT_DETERMINED
