"""Going on from where an earlier run of the same job ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from updyn.errors import JobError
from updyn.job.prepare import Prepared
from updyn.updating.parameters import ParameterSet

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["resumed"]


def resumed(prepared: Prepared, out: Path) -> tuple[Prepared, NDArray[np.float64]]:
    """Return a job that starts where the run in `out` ended.

    Parameters
    ----------
    prepared : Prepared
        The job.
    out : Path
        Folder of the earlier run.

    Returns
    -------
    prepared : Prepared
        The same with its unknowns starting at the values of ``run.nc``.
    lines : ndarray of float
        Lines of the earlier run, in Hz: a choice made at the first start would turn out otherwise at the new one.

    Raises
    ------
    JobError
        If there is no earlier run there, it was of another problem, or the job has priors, which are about the start.
    """
    from updyn.io import read_result

    job, record = prepared.job, out / "run.nc"
    if not record.is_file():
        raise JobError(f"nothing to resume: {str(record)!r} does not exist", job.path)
    for number, given in enumerate(job.parameter):
        if given.prior_std is not None:
            raise job.error(
                "a prior is about the start; a run with priors cannot be resumed", "parameter", number, "prior_std"
            )
    earlier = read_result(record)
    then, now = (set(p.names) for p in (earlier.parameters, prepared.parameters))
    if then != now:
        odd = ", ".join(sorted(then ^ now)[:6])
        raise JobError(f"{str(record)!r} is of another job: the unknowns differ ({odd})", job.path)
    absent = np.setdiff1d(earlier.lines, prepared.fitted.freq)
    if absent.size:
        raise JobError(
            f"{str(record)!r} is of another job: it fitted {absent[0]:g} Hz, which is not fitted now", job.path
        )
    items = [replace(p, start=float(np.clip(earlier.values[p.name], p.lower, p.upper))) for p in prepared.parameters]
    return replace(prepared, parameters=ParameterSet(tuple(items))), earlier.lines
