"""The folder of a run: its name, its files, the job file and the journal in it, and checks before it is written."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from updyn import __version__
from updyn.errors import InputError, JobError
from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import OUTPUTS, Job

__all__ = [
    "JOURNAL",
    "MARK",
    "check_folder",
    "check_inputs",
    "check_no_folder",
    "check_out",
    "default_out",
    "journal_of",
    "made_folder",
    "outputs",
    "put_in_place",
    "resolved_job",
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


#: Holds every evaluation of a run that has not finished; see `updyn.updating.fit.journal`.
JOURNAL = "run.journal"


@contextmanager
def journal_of(job: Job, out: Path, *, resume: bool) -> Iterator[Path]:
    """Give the journal of a run; a run that is refused leaves none, one that breaks down does.

    Parameters
    ----------
    job : Job
        The job.
    out : Path
        Folder of the run.
    resume : bool
        Whether there has to be one to go on with.

    Yields
    ------
    Path
        The file; it need not exist otherwise.

    Raises
    ------
    JobError
        If there is nothing to go on with.
    """
    journal = out / JOURNAL
    there = journal.is_file()
    if resume and not there:
        raise JobError(_nothing(out), job.path)
    try:
        yield journal
    except InputError:
        if not there:
            journal.unlink(missing_ok=True)
        raise


def _nothing(out: Path) -> str:
    try:
        status = json.loads((out / "result.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError):
        return f"nothing to resume: {str(out / JOURNAL)!r} does not exist"
    return (
        f"nothing to resume: the run in {str(out)!r} has ended ({status}) and needs no journal;"
        " leave out --resume"
    )


#: How the comment in the first line begins, by which a folder knows its own.
MARK = "Written by updyn"


def resolved_job(job: Job, out: Path) -> str:
    """Return the text of a job file that repeats `job` from the folder `out`.

    Parameters
    ----------
    job : Job
        The job as it was run.
    out : Path
        Folder in which the text will lie; files are named relative to it.

    Returns
    -------
    str
        TOML, with every default written out.
    """
    import tomlkit

    from updyn.updating.fit.methods import options_of

    content = job.model_dump(exclude_none=True, mode="python")
    output = content.pop("output")
    for name, table in job.tables.items():
        content[name] = table.model_dump(exclude_none=True, mode="python")
    content["output"] = output
    content["title"] = job.title or job.path.stem
    tests = [part.test.model_dump(exclude_none=True, mode="python") for part in job.parts]
    for table, key in (
        (content["model"], "file"),
        (content["match"], "geometry"),
        *((t, "file") for t in tests),
    ):
        if key in table:
            table[key] = _from(out, job.beside(table[key]))
    for test in tests:
        if "modes" in test:
            test["modes"] = _from(out, job.beside(test["modes"]))
        if "repeats" in test:
            test["repeats"] = [_from(out, job.beside(file)) for file in test["repeats"]]
    content["test"] = tests if len(tests) > 1 else tests[0]
    defaults = {
        k: v
        for k, v in options_of(job.method.name).items()
        if isinstance(v, bool | int | float | str)
    }
    content["method"] |= {k: v for k, v in defaults.items() if k not in content["method"]}
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{MARK} {__version__} from {_from(out, job.path)}"))
    for key, value in content.items():
        if value not in ({}, (), {"table": {}}):
            document.add(key, _item(value))
    return tomlkit.dumps(document).rstrip("\n") + "\n"


def _from(folder: Path, path: Path) -> str:
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive: there is no relative path
        return path.resolve().as_posix()


def _item(value: Any) -> Any:
    """Return a value as tomlkit writes it: tables as tables, lists of tables as arrays of tables."""
    import tomlkit

    if isinstance(value, Mapping):
        table = tomlkit.table()
        for key, item in value.items():
            if item != {}:
                table.add(key, _item(item))
        return table
    if isinstance(value, list | tuple):
        if value and all(isinstance(x, Mapping) for x in value):
            tables = tomlkit.aot()
            for x in value:
                tables.append(_item(x))
            return tables
        return [_item(x) for x in value]
    return value
