"""The folder of a run: its name, what is written into it, and whether it may be."""

from __future__ import annotations

import os
from pathlib import Path

from updyn.errors import JobError
from updyn.job.resolved import MARK
from updyn.job.schema import OUTPUTS, Job

__all__ = ["check_folder", "check_out", "default_out", "outputs"]

#: Of what a run writes, what each of several tests has in a folder of its own.
OF_A_TEST = ("model.h5", "run.nc", "report.html")


def outputs(job: Job) -> tuple[str, ...]:
    """Return what a run of a job writes, relative to its folder.

    Parameters
    ----------
    job : Job
        The job.

    Returns
    -------
    tuple of str
        Paths, those in folders of tests included.
    """
    more = () if job.output.properties is None else (job.output.properties,)
    if len(job.parts) == 1:
        return (*more, *OUTPUTS)
    own = tuple(f"{part.test.name}/{name}" for part in job.parts for name in OF_A_TEST)
    return (*more, *own, *(name for name in OUTPUTS if name not in ("model.h5", "run.nc")))


def default_out(job: Job) -> Path:
    """Return the folder of a run where none is named.

    Parameters
    ----------
    job : Job
        The job.

    Returns
    -------
    Path
        The job's stem, beside it.
    """
    return job.path.with_suffix("")


def check_folder(job: Job, out: str | Path) -> Path:
    """Check that a folder may be written to.

    Parameters
    ----------
    job : Job
        The job, for the message.
    out : path
        The folder; it need not exist.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    JobError
        If it is a file, or lies in no folder that can be written.
    """
    out = Path(out)
    if out.exists() and not out.is_dir():
        raise JobError(f"the output folder {str(out)!r} is a file; choose another with --out", job.path)
    parent = next(p for p in (out, *out.absolute().parents) if p.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise JobError(f"the output folder {str(out)!r} cannot be written: no permission in {str(parent)!r}", job.path)
    return out


def check_out(job: Job, out: str | Path) -> Path:
    """Check that a run may write to a folder.

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
        If it is a file, lies in no folder that can be written, or a result would replace an input of the job.
    """
    out = check_folder(job, out)
    files = [file for part in job.parts for file in (part.test.file, *(part.test.repeats or ()))]
    files += [part.test.modes for part in job.parts if part.test.modes is not None]
    inputs = [("job file", job.path), *(("measurement", job.beside(file)) for file in files)]
    if job.model.file is not None:
        inputs.append(("model", job.beside(job.model.file)))
    for what, path in inputs:
        for name in outputs(job):
            if path.resolve() == (out / name).resolve():
                raise JobError(f"the run would write over its own {what} {str(path)!r}; choose another --out", job.path)
    there = out / "job.toml"
    if there.is_file() and not there.read_bytes().startswith(f"# {MARK}".encode()):
        text = f"the run would write over {str(there)!r}, a job that updyn did not write; choose another --out"
        raise JobError(text, job.path)
    return out
