"""The plant of a job beside the results of its run: made after the update, written into the same folder."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from updyn.control.job.plant_record import write_control_record
from updyn.control.job.plant_result import Planted, planted_of
from updyn.errors import UpdynError, UpdynWarning
from updyn.job.folder import CONTROL
from updyn.job.prepare import Prepared
from updyn.job.schema import Job

if TYPE_CHECKING:
    from updyn.uncertainty.draws import Draws
    from updyn.uncertainty.profile import Profiles
    from updyn.updating.fit.monitor import Progress
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["plant_after", "write_plant_files"]


def plant_after(
    ready: Prepared,
    result: UpdateResult | JointResult,
    found: Draws | Profiles | None,
    callback: Callable[[Progress], bool | None] | None,
    engine: Any,
) -> Planted | None:
    """Return the plant that a job asks for; None where it asks for none, was stopped, or it cannot be had.

    Parameters
    ----------
    ready : Prepared
        The job.
    result : UpdateResult or JointResult
        The update.
    found : Draws or Profiles or None
        What ``[uncertainty]`` gave; draws make the family.
    callback : callable or None
        As for `run_job`.
    engine : object
        As for `run_job`.

    Warns
    -----
    UpdynWarning
        If it cannot be had, or does not hold its tolerance, with the reason; the update is not lost
        for that.
    """
    from updyn.uncertainty.draws import Draws

    job = ready.job
    if job.plant is None or result.status in ("stopped", "failed"):
        return None
    draws = found if isinstance(found, Draws) and len(found) > 1 else None
    try:
        planted = planted_of(
            ready,
            result,
            f"The updated model ({result.status}).",
            draws=draws,
            engine=engine,
            say=_shown(callback),
            strict=False,
        )
    except UpdynError as error:
        warnings.warn(f"{job.path}: [plant] is left out: {error}", UpdynWarning, stacklevel=3)
        return None
    if not planted.met:
        warnings.warn(
            f"{job.path}: no plant is written: {planted.message}", UpdynWarning, stacklevel=3
        )
    return planted


def _shown(callback: Callable[[Progress], bool | None] | None) -> Callable[[str], object] | None:
    """Return what shows a stage as progress of the run is shown."""
    if callback is None:
        return None
    from updyn.updating.fit.monitor import Progress as Step

    return lambda stage: callback(Step(stage, 0, float("nan"), 0, 0))


def write_plant_files(planted: Planted, job: Job, folder: Path) -> None:
    """Write the files that ``[plant]`` names, and the record.

    Parameters
    ----------
    planted : Planted
        What was made.
    job : Job
        Its job.
    folder : Path
        Where to.
    """
    from updyn.control.files.plant_file import write_plant

    assert job.plant is not None
    for made, names in (
        (planted.plant, job.plant.files),
        (planted.sampled, job.plant.sampled_files),
    ):
        if made is not None:
            for name in names:
                write_plant(made, folder / name)
    write_control_record(planted, folder / CONTROL)
