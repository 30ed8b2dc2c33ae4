"""The folder of a run: its name, what is written into it, and whether it may be."""

from __future__ import annotations

import os
import shutil
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pydantic import ValidationError

from updyn.errors import JobError
from updyn.job.job_table import JOB_TABLES
from updyn.job.resolved import MARK
from updyn.job.schema import OUTPUTS, Job

__all__ = [
    "check_folder",
    "check_inputs",
    "check_no_folder",
    "check_out",
    "default_out",
    "made_folder",
    "outputs",
    "put_in_place",
    "stale_outputs",
    "unfinished",
]

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
    own = () if job.output.properties is None else (job.output.properties,)
    further = [
        file for name, table in job.tables.items() for file in JOB_TABLES[name].outputs(table)
    ]
    if len(job.parts) == 1:
        return (*own, *further, *OUTPUTS)
    tests = [f"{part.test.name}/{name}" for part in job.parts for name in OF_A_TEST]
    common = [name for name in OUTPUTS if name not in ("model.h5", "run.nc")]
    return (*own, *further, *tests, *common)


def stale_outputs(job: Job, out: Path) -> list[str]:
    """Return files of tables that an earlier run in a folder had and the job has not.

    Parameters
    ----------
    job : Job
        The job.
    out : Path
        The folder.
    """
    earlier = out / "job.toml"
    if not earlier.is_file():
        return []
    try:
        document = tomllib.loads(earlier.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return []
    found: list[str] = []
    for name in document:
        if name in Job.model_fields or name in job.tables or name not in JOB_TABLES:
            continue
        table = JOB_TABLES[name]
        with suppress(ValidationError):  # by another version: what it wrote is not known
            found += table.outputs(table.schema.model_validate(document[name]))
    return [name for name in found if name not in outputs(job)]


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
        raise JobError(
            f"the output folder {str(out)!r} is a file; choose another with --out", job.path
        )
    parent = next(p for p in (out, *out.absolute().parents) if p.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise JobError(
            f"the output folder {str(out)!r} cannot be written: no permission in {str(parent)!r}",
            job.path,
        )
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
        If it is a file, lies in no folder that can be written, or a result would replace an input
        of the job.
    """
    out = check_folder(job, out)
    check_inputs(job, out, outputs(job))
    there = out / "job.toml"
    if there.is_file() and not there.read_bytes().startswith(f"# {MARK}".encode()):
        text = (
            f"the run would write over {str(there)!r}, a job that updyn did not write; choose"
            " another --out"
        )
        raise JobError(text, job.path)
    return out


def check_no_folder(job: Job, out: Path, names: Iterable[str]) -> None:
    """Check that no file to be written to a folder is a folder itself.

    Parameters
    ----------
    job : Job
        The job.
    out : Path
        Where they would go.
    names : iterable of str
        Of the files.

    Raises
    ------
    JobError
        If one is.
    """
    for name in names:
        if (out / name).is_dir():
            raise JobError(f"{str(out / name)!r} is a folder; choose another --out", job.path)


def check_inputs(job: Job, out: Path, names: Iterable[str]) -> None:
    """Check that no file of a folder is one that the job reads.

    Parameters
    ----------
    job : Job
        The job.
    out : Path
        The folder.
    names : iterable of str
        What is to be written into it.

    Raises
    ------
    JobError
        If one is.
    """
    names = list(names)
    files = [file for part in job.parts for file in (part.test.file, *(part.test.repeats or ()))]
    files += [part.test.modes for part in job.parts if part.test.modes is not None]
    inputs = [("job file", job.path), *(("measurement", job.beside(file)) for file in files)]
    if job.model.file is not None:
        inputs.append(("model", job.beside(job.model.file)))
    for what, path in inputs:
        for name in names:
            if path.resolve() == (out / name).resolve():
                raise JobError(
                    f"the run would write over its own {what} {str(path)!r}; choose another --out",
                    job.path,
                )


@contextmanager
def made_folder(out: Path) -> Iterator[None]:
    """Make a folder; take what was made for it away again when the block raises and has left nothing in it."""
    made = [p for p in (out, *out.absolute().parents) if not p.exists()]
    out.mkdir(parents=True, exist_ok=True)
    finished = False
    try:
        yield
        finished = True
    finally:
        with suppress(OSError):  # not empty: the journal of a run that broke down
            for folder in [] if finished else made:
                folder.rmdir()


@contextmanager
def unfinished(out: Path) -> Iterator[Path]:
    """Make a temporary folder in `out`, gone at the end."""
    temporary = Path(tempfile.mkdtemp(prefix=".unfinished-", dir=out))
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def put_in_place(names: Iterable[str], temporary: Path, out: Path) -> None:
    """Move what was written into a folder; what was not, but is there, is of an earlier run and would pass for it.

    Parameters
    ----------
    names : iterable of str
        Paths relative to both folders, in the order in which they appear.
    temporary, out : Path
        From where, and to where.
    """
    for name in names:
        if (temporary / name).exists():
            (out / name).parent.mkdir(exist_ok=True)
            (temporary / name).replace(out / name)
        else:
            (out / name).unlink(missing_ok=True)
