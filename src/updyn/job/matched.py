"""Sensors of a job to DOFs of its model: `updyn.matching` with the lines of ``[match]``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

from updyn.dofs import Dof, DofSet
from updyn.errors import DofError, InputError, JobError, suggest
from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.job.schema import Job
from updyn.matching import MatchError, Matching, match
from updyn.modal import ModeSet
from updyn.model import Model

__all__ = ["matched", "matched_modes"]

T = TypeVar("T")


def matched(job: Job, model: Model, frf: FRF, others: Sequence[FRF] = ()) -> Matching:
    """Match the measurement of a job to its model.

    Parameters
    ----------
    job : Job
        The job; its ``[match]`` says how.
    model : Model
        The model as it was read.
    frf : FRF
        The measurement as it was read.
    others : sequence of FRF
        Those of the job's other tests: what ``[match]`` says of their sensors is not about this
        one.

    Returns
    -------
    Matching

    Raises
    ------
    JobError
        If the geometry cannot be read, a sensor is not a DOF of the model, or the like; the message
        says on which line.
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
            alignment=(
                {int(a): b for a, b in alignment.items()}
                if isinstance(alignment, dict)
                else alignment
            ),
            angle=table.angle,
            table=_here(table.table, frf, others),
            directions=_here(table.directions, frf, others),
        )
    except MatchError as error:
        raise _at_its_line(job, error) from error


def matched_modes(matching: Matching, modes: ModeSet) -> ModeSet:
    """Name the DOFs of modes as the model names them.

    What the FRFs have too goes where their sensors and forces went; all else has to be labelled as
    in the model.

    Parameters
    ----------
    matching : Matching
        Of the FRFs of the same test.
    modes : ModeSet
        As the file labels them.

    Returns
    -------
    ModeSet
        The same shapes.

    Raises
    ------
    DofError
        If a DOF is not in the model, or lies where a sensor has turned the DOFs of its node, or two
        are one.
    """
    seats = {row.sensor: row for row in matching.table}
    new = []
    for dof in modes.dofs:
        row = seats.get(str(Dof(dof.node, dof.direction)))
        if row is not None and row.turned:
            raise DofError(
                f"DOF {dof} of the modes: the sensor at it points obliquely, and the model has"
                " turned with it"
            )
        own = dof if row is None else Dof.parse(row.dof)
        new.append(own if row is None or dof.sign > 0 else -own)
    named = DofSet(new)
    matching.model.dofs.match(named, "DOF of the modes")
    parts = (modes.loss_factor, modes.scaled, modes.quality, modes.source)
    return ModeSet(modes.frequency, modes.shapes, named, *parts)


def _here(told: Mapping[str, T], frf: FRF, others: Sequence[FRF]) -> dict[str, T]:
    """Return what is told of sensors, without those that only other tests have."""
    here = _named(frf)
    elsewhere = {name for other in others for name in _named(other)} - here
    return {
        label: about
        for label, about in told.items()
        if label.replace("+", "").replace("-", "") not in elsewhere
    }


def _named(frf: FRF) -> set[str]:
    """Return by what names the sensors and forces may be called: with their direction, and by their node."""
    dofs = [*frf.responses, *frf.references]
    return {f"{d.node}:{d.direction}" for d in dofs} | {str(d.node) for d in dofs}


def _at_its_line(job: Job, error: MatchError) -> JobError:
    message = (
        str(error)
        .replace("the measurement", job.test.file)
        .replace(" in table", " in [match.table]")
    )
    if error.lost:
        message += (
            f'\nGive each its label in the model under [match.table] ("{error.lost[0]}" = "..."),'
            " or keep only those that are, with responses and references in [test]"
        )
    return job.error(message, *(("match", *error.place) if error.place else ("test", "file")))


def _geometry(job: Job, file: str) -> Geometry:
    from updyn.io import read_geometry

    path = job.beside(file)
    if not path.is_file():
        siblings = (
            [p.name for p in path.parent.iterdir() if p.is_file()] if path.parent.is_dir() else []
        )
        hint = suggest(path.name, siblings) if siblings else "its folder is empty or does not exist"
        raise job.error(f"match.geometry = {file!r}: no such file; {hint}", "match", "geometry")
    try:
        return read_geometry(path)
    except InputError as error:
        raise job.error(str(error), "match", "geometry") from error
