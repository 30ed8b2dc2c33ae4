"""Sensors of a job to DOFs of its model: `updyn.matching` with the lines of ``[match]``."""

from __future__ import annotations

from updyn.errors import InputError, JobError, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.job.schema import Job
from updyn.matching import MatchError, Matching, match
from updyn.model import Model

__all__ = ["matched"]


def matched(job: Job, model: Model, frf: FRF) -> Matching:
    """Match the measurement of a job to its model.

    Parameters
    ----------
    job : Job
        The job; its ``[match]`` says how.
    model : Model
        The model as it was read.
    frf : FRF
        The measurement as it was read.

    Returns
    -------
    Matching

    Raises
    ------
    JobError
        If the geometry cannot be read, a sensor is not a DOF of the model, or the like; the message says on which line.
    """
    table = job.match
    geometry = None if table.geometry is None else _geometry(job, table.geometry)
    alignment = table.alignment
    try:
        return match(
            model,
            frf,
            geometry,
            by=table.by,
            tolerance=table.tolerance,
            unit=table.unit,
            alignment={int(a): b for a, b in alignment.items()} if isinstance(alignment, dict) else alignment,
            angle=table.angle,
            table=table.table,
            directions=table.directions,
        )
    except MatchError as error:
        raise _at_its_line(job, error) from error


def _at_its_line(job: Job, error: MatchError) -> JobError:
    message = str(error).replace("the measurement", job.test.file).replace(" in table", " in [match.table]")
    if error.lost:
        message += (
            f'\nGive each its label in the model under [match.table] ("{error.lost[0]}" = "..."), or keep only those '
            "that are, with responses and references in [test]"
        )
    return job.error(message, *(("match", *error.place) if error.place else ("test", "file")))


def _geometry(job: Job, file: str) -> Geometry:
    from updyn.io import read_geometry

    path = job.beside(file)
    if not path.is_file():
        siblings = [p.name for p in path.parent.iterdir() if p.is_file()] if path.parent.is_dir() else []
        hint = suggest(path.name, siblings) if siblings else "its folder is empty or does not exist"
        raise job.error(f"match.geometry = {file!r}: no such file; {hint}", "match", "geometry")
    try:
        return read_geometry(path)
    except InputError as error:
        raise job.error(str(error), "match", "geometry") from error
