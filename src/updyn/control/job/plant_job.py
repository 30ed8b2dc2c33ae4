"""`plant_job`: make and write the plant of a finished run, or of a model without a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from updyn.control.job.checks import part_of_plant
from updyn.control.job.job_tables import PLANT_PAGE, plant_outputs, write_plant_files
from updyn.control.job.plant_result import PlantResult, make_plant
from updyn.control.job.tables import PlantTable
from updyn.control.report.page import write_plant_page
from updyn.errors import InputError, JobError
from updyn.frf import FRF
from updyn.io.toml_text import parse_toml
from updyn.job.folder import (
    check_out,
    default_out,
    format_resolved_job,
    is_run_job,
)
from updyn.job.prepare import prepare
from updyn.job.prepared import Prepared
from updyn.job.schema import Job
from updyn.modal import ModeSet
from updyn.outputs.switch import open_folder, recover, replace_files

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine
    from updyn.uncertainty.draws import Draws
    from updyn.updating.result import UpdateResult

__all__ = ["check_plant_out", "default_plant_out", "plant_job"]

#: Tables that do not affect the update.
_LATER = ("title", "plant", "servo", "uncertainty", "output")


def default_plant_out(job: Job) -> Path:
    """Return the folder of the job's run, that of the job file if a run has written it."""
    if _written_by_run(job):
        return job.path.parent
    return default_out(job)


def _written_by_run(job: Job) -> bool:
    return is_run_job(job.path)


def check_plant_out(job: Job, out: str | Path) -> Path:
    """Return the folder of a plant; raises JobError if the plant cannot be written there."""
    table = job.table(PlantTable)
    if table is None:
        raise JobError("the job has no [plant]; add one with inputs and outputs", job.path)
    return check_out(job, out, plant_outputs(table))


def plant_job(
    job: Job,
    out: str | Path | None = None,
    *,
    run: str | Path | None = None,
    prepared: Prepared | None = None,
    engine: int | Client | Engine | None = None,
    say: Callable[[str], object] | None = None,
) -> PlantResult:
    """Make the plant of a job and write its files, ``control.json`` and ``plant.html``.

    Without `run`, a finished run is searched in `out` and in the job's results folder; without one
    the plant is that of the original model. Files are replaced together; without a plant that holds
    the tolerance, no plant file remains.
    """
    out = check_plant_out(job, default_plant_out(job) if out is None else out)
    table = job.table(PlantTable)
    assert table is not None
    ready = prepare(job) if prepared is None else prepared
    with open_folder(out):
        check_plant_out(job, out)  # again, now that no other run can change the folder
        with job.located():
            found = _read_finished_run(ready, out, run)
        if found is None:
            result = draws = None
            source = "The original model, NOT updated: the job has no finished run."
        else:
            result, draws, where = found
            source = f"The updated model of the run in {str(where)!r} ({result.status})."
        with job.located():
            plant_result = make_plant(ready, result, source, draws=draws, engine=engine, say=say)
        with replace_files(out, "plant", plant_outputs(table)) as new:
            write_plant_files(plant_result, job, new)
            write_plant_page(plant_result, new / PLANT_PAGE)
    return plant_result


# -- the finished run -----------------------------------------------------------------------------
def _read_finished_run(
    ready: Prepared, out: Path, run: str | Path | None
) -> tuple[UpdateResult, Draws | None, Path] | None:
    """Return the result of the finished run, draws of its parameters, and its folder; None without.

    Raises JobError if a named folder contains no run, or the run is of another job or other data.
    """
    from updyn.store.result import read_result

    job, number = ready.job, part_of_plant(ready.job)
    inside = Path(job.parts[number].test.name, "run.nc") if len(job.parts) > 1 else Path("run.nc")
    for folder in _folders(job, out) if run is None else [Path(run)]:
        recover(folder)
        if not (folder / inside).is_file():
            continue
        _check_same(job, folder)
        result = read_result(folder / inside)
        test = ready.tests[number]
        same = _same(result.data, test.data)
        if not same or result.model.dofs.labels != test.model.dofs.labels:
            what = "model" if same else "measurement"
            raise JobError(
                f"the {what} differs from that of the run in {str(folder)!r}; run the job again",
                job.path,
            )
        return result, _draws(folder, result), folder
    if run is not None:
        raise JobError(
            f"no finished run in {str(run)!r}: expected the file {inside.as_posix()!r}", job.path
        )
    return None


def _folders(job: Job, out: Path) -> Iterator[Path]:
    """Yield the folders that may hold a finished run of the job."""
    yield out
    yield default_out(job)
    if _written_by_run(job):
        yield job.path.parent


def _check_same(job: Job, folder: Path) -> None:
    """Raise JobError if a table that affects the update differs between a job and a run."""
    try:
        then = parse_toml((folder / "job.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise JobError(
            f"the run in {str(folder)!r} has no readable job.toml; run the job again",
            job.path,
        ) from error
    now = parse_toml(format_resolved_job(job, folder))
    for table in dict.fromkeys([*now, *then]):
        if table not in _LATER and now.get(table) != then.get(table):
            text = (
                f"[{table}] differs from that of the run in {str(folder)!r}; run the job again, or"
                " choose another --out"
            )
            raise JobError(text, key=(table,))


def _draws(folder: Path, result: UpdateResult) -> Draws | None:
    """Return the draws of a bootstrap or a sampling; None without usable draws."""
    from updyn.store.uncertainty import read_uncertainty
    from updyn.uncertainty.draws import Draws

    if not (folder / "uncertainty.nc").is_file():
        return None
    try:
        found = read_uncertainty(folder / "uncertainty.nc", result)
    except InputError:
        return None
    if isinstance(found, Draws) and len(found) > 1:
        return found
    return None


def _same(a: FRF | ModeSet, b: FRF | ModeSet) -> bool:
    """Return whether two measurements have the same values."""
    if isinstance(a, FRF) and isinstance(b, FRF):
        return a.values.shape == b.values.shape and np.array_equal(a.values, b.values)
    return isinstance(a, ModeSet) and isinstance(b, ModeSet) and a.digest == b.digest
