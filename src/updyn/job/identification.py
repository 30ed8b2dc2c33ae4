"""``[modes]`` of a job, and `modes_job`: modes identified from the FRFs of its test."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Strict

from updyn.errors import JobError, key_path
from updyn.frf import FRF
from updyn.io import write_modes
from updyn.job.base import Table, is_number
from updyn.job.folder import check_out, default_out
from updyn.job.job_table import JobTable
from updyn.job.prepare import measurement
from updyn.job.schema import Job
from updyn.modal import ModeSet, identify_modes
from updyn.outputs.switch import open_folder, replaced

__all__ = ["MODES", "MODES_FILES", "ModesTable", "modes_job"]

#: What ``updyn modes`` writes.
MODES_FILES = ("modes.html", "modes.unv")
#: A picked frequency is that of the mode nearest to it, up to this share.
_NEAR = 0.02


def _picks(given: Any) -> Any:
    if isinstance(given, list | tuple) and given and all(is_number(x) and x > 0 for x in given):
        return tuple(float(x) for x in given)
    raise ValueError("expected an array of frequencies in Hz, such as [11.9, 23.6]")


class ModesTable(Table):
    """``[modes]``: how modes are identified, and which are picked."""

    damping: Literal["structural", "viscous"] = "structural"
    pick: Annotated[tuple[float, ...], BeforeValidator(_picks), Strict(False)] | None = None


class _ModesJobTable(JobTable):
    """``[modes]``: the work of ``updyn modes``; a run identifies modes by itself."""

    schema = ModesTable

    def outputs(self, table: ModesTable) -> tuple[str, ...]:
        return ()


MODES = _ModesJobTable()


def modes_job(job: Job, out: str | Path | None = None) -> ModeSet:
    """Identify the modes of a job's test, and write them.

    Parameters
    ----------
    job : Job
        From `load_job` (`of_test`), with one test. ``[modes]`` may be left out.
    out : path, optional
        The folder; by default the job's stem with ``-modes``, beside it.

    Returns
    -------
    ModeSet
        In `out`: ``modes.html`` and ``modes.unv``, replaced together.

    Raises
    ------
    JobError
        If the job, a file or the output folder cannot be used, or no mode is near one that is
        picked; nothing is written then.
    DataError
        If no mode is found.
    """
    from updyn.report.identified import write_modes_page

    table = job.table(ModesTable) or ModesTable()
    with job.located():
        if len(job.parts) > 1:
            raise JobError("modes are those of one test; leave one [[test]]", key=("test", 1))
    out = check_out(job, out or default_out(job, "modes"), MODES_FILES)
    with job.located():
        frf: FRF = measurement(job)
        found = identify_modes(frf, damping=table.damping)
        with key_path("modes", "pick"):
            found = _picked(found, table.pick)
    title = job.title or job.path.stem
    with open_folder(out):
        check_out(job, out, MODES_FILES)  # once more: now no other run can change it
        with replaced(out, "modes", MODES_FILES) as new:
            write_modes_page(found, frf, new / "modes.html", f"{title}: modes")
            write_modes(found, new / "modes.unv")
    return found


def _picked(found: ModeSet, pick: tuple[float, ...] | None) -> ModeSet:
    """Return the modes nearest to the frequencies that were picked."""
    if pick is None:
        return found
    chosen = []
    for frequency in pick:
        nearest = int(np.argmin(np.abs(found.frequency - frequency)))
        at = float(found.frequency[nearest])
        if abs(at - frequency) > _NEAR * frequency:
            raise JobError(
                f"no mode is found within {100 * _NEAR:g} % of {frequency:g} Hz; the nearest is at"
                f" {at:.6g} Hz"
            )
        if nearest in chosen:
            raise JobError(f"two picks are nearest to the mode at {at:.6g} Hz; leave one")
        chosen.append(nearest)
    return found.select(sorted(chosen))
