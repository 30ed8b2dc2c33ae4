"""`plant_job`: make and write the plant of a finished run, or of a model as it stands."""

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
    is_of_a_run,
    resolved_job,
)
from updyn.job.prepare import prepare
from updyn.job.prepared import Prepared
from updyn.job.schema import Job
from updyn.modal import ModeSet
from updyn.outputs.switch import open_folder, recover, replaced

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine
    from updyn.uncertainty.draws import Draws
    from updyn.updating.result import UpdateResult

__all__ = ["check_plant_out", "default_plant_out", "plant_job"]

#: Tables that do not change the update.
_LATER = ("title", "plant", "servo", "uncertainty", "output")


def default_plant_out(job: Job) -> Path:
    """Return the folder of a plant where none is named.

    Parameters
    ----------
    job : Job
        The job.

    Returns
    -------
    Path
        That of the job's run; of a job file that a run has written, its own folder.
    """
    if _written_by_run(job):
        return job.path.parent
    return default_out(job)


def _written_by_run(job: Job) -> bool:
    """Whether a run wrote the job file."""
    return is_of_a_run(job.path)


def check_plant_out(job: Job, out: str | Path) -> Path:
    """Check that a plant may be written to a folder, and that the job asks for one.

    Parameters
    ----------
    job : Job
        The job.
    out : path
        The folder; it need not exist.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    JobError
        If the job has no ``[plant]``, or the folder is a file, cannot be written, or holds an input
        of the job under the name of a file of the plant.
    """
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
    """Make the plant of a job and write its files.

    It is that of the updated model where the job has been run: by default the result is sought in
    `out`, and in the job's own folder of results. Where there is none, it is that of the model as
    it stands, and says so.

    Parameters
    ----------
    job : Job
        From `load_job`, with ``[plant]``.
    out : path, optional
        The folder; by default that of the job's run.
    run : path, optional
        The folder of the finished run, where it is another.
    prepared : Prepared, optional
        From `prepare`, where it was called before.
    engine : None, int, dask.distributed Client or Engine
        Where a family of plants is made, as for `updyn.update`.
    say : callable, optional
        Called with the name of each stage.

    Returns
    -------
    PlantResult
        In `out`: the files that ``[plant]`` names, ``control.json`` and ``plant.html``, replaced
        together. Where no plant holds the tolerance, no file of a plant is there
        afterwards, not even of an earlier one; record and page say what was reached.

    Raises
    ------
    InputError
        If the job, a file or the folder cannot be used, or the run is of another job; nothing is
        written then.
    SolverError
        If the model has no answer at a line; nothing is written.
    """
    out = check_plant_out(job, default_plant_out(job) if out is None else out)
    table = job.table(PlantTable)
    assert table is not None
    ready = prepare(job) if prepared is None else prepared
    with open_folder(out):
        check_plant_out(job, out)  # once more: now no other run can change it
        with job.located():
            found = _finished(ready, out, run)
        if found is None:
            result = draws = None
            source = "The model as it stands, NOT updated: there is no finished run of the job."
        else:
            result, draws, where = found
            source = f"The updated model of the run in {str(where)!r} ({result.status})."
        with job.located():
            plant_result = make_plant(ready, result, source, draws=draws, engine=engine, say=say)
        with replaced(out, "plant", plant_outputs(table)) as new:
            write_plant_files(plant_result, job, new)
            write_plant_page(plant_result, new / PLANT_PAGE)
    return plant_result


# -- the finished run -----------------------------------------------------------------------------
def _finished(
    ready: Prepared, out: Path, run: str | Path | None
) -> tuple[UpdateResult, Draws | None, Path] | None:
    """Return the result of the finished run, draws of its unknowns, and its folder.

    Raises
    ------
    JobError
        If there is none in the folder that was named, or the run is of another job or other data.
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
                f"the {what} is not that of the run in {str(folder)!r} any more; run the job again",
                job.path,
            )
        return result, _draws(folder, result), folder
    if run is not None:
        raise JobError(
            f"there is no finished run in {str(run)!r}: no {inside.as_posix()!r}", job.path
        )
    return None


def _folders(job: Job, out: Path) -> Iterator[Path]:
    """Yield the folders that may hold a finished run of the job."""
    yield out
    yield default_out(job)
    if _written_by_run(job):
        yield job.path.parent


def _check_same(job: Job, folder: Path) -> None:
    """Check that a run was one of this job, as far as the update goes.

    Raises
    ------
    JobError
        If a table differs; it is named.
    """
    try:
        then = parse_toml((folder / "job.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise JobError(
            f"the run in {str(folder)!r} has no job.toml that can be read; run the job again",
            job.path,
        ) from error
    now = parse_toml(resolved_job(job, folder))
    for table in dict.fromkeys([*now, *then]):
        if table not in _LATER and now.get(table) != then.get(table):
            text = (
                f"[{table}] is not that of the run in {str(folder)!r}; run the job again, or choose"
                " another --out"
            )
            raise JobError(text, key=(table,))


def _draws(folder: Path, result: UpdateResult) -> Draws | None:
    """Return the draws of a bootstrap or a sampling; None without usable ones."""
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
    """Whether two measurements hold the same values."""
    if isinstance(a, FRF) and isinstance(b, FRF):
        return a.values.shape == b.values.shape and np.array_equal(a.values, b.values)
    return isinstance(a, ModeSet) and isinstance(b, ModeSet) and a.digest == b.digest
