"""The folder of a run: its files, checks before it is written, journal and ``job.toml``."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from updyn import __version__
from updyn.errors import InputError, JobError, UpdynWarning
from updyn.job.files import check_encodable, list_measured_files
from updyn.job.job_table import JOB_TABLES
from updyn.job.schema import OUTPUTS, Job
from updyn.outputs.lock import LOCK
from updyn.outputs.manifest import MANIFEST, Manifest, find_obstacles, is_output
from updyn.outputs.switch import PLAN, recover
from updyn.updating.fit.methods import options_of

__all__ = [
    "HEADER",
    "JOURNAL",
    "PLAN_JOURNAL",
    "RESERVED",
    "can_resume",
    "check_out",
    "default_out",
    "earlier_outputs",
    "format_resolved_job",
    "is_run_job",
    "outputs",
    "relative_path",
    "run_journal",
]

#: Journal of an unfinished run with all its evaluations; see `updyn.updating.fit.checkpoint`.
JOURNAL = "run.journal"
#: Journal of an unfinished plan with the information about each of its starts.
PLAN_JOURNAL = "plan.journal"
#: File names that no output may have.
RESERVED = (MANIFEST, JOURNAL, PLAN_JOURNAL, LOCK, PLAN)
#: The job as run, in the folder of the results; user jobs often have this name, too.
JOB_FILE = "job.toml"
#: Start of the comment in the first line of a job file that a run wrote.
HEADER = "Written by updyn"
#: Commands whose files the next run replaces.
_RUN_COMMANDS = ("run", "plant")
_MOVE_ADVICE = "move them away, or choose another --out"
#: Files that each of several tests has in a folder of its name.
_TEST_FILES = ("model.h5", "run.nc", "report.html")


# -- files of a run --------------------------------------------------------------------------------
def outputs(job: Job) -> tuple[str, ...]:
    """Return the paths that a run may write, relative to its folder, in order of creation."""
    names: list[str] = []
    if job.output.properties is not None:
        names.append(job.output.properties)
    for name, table in job.tables.items():
        names += JOB_TABLES[name].outputs(table)
    if len(job.parts) == 1:
        return (*names, *OUTPUTS)
    for part in job.parts:
        names += [f"{part.test.name}/{name}" for name in _TEST_FILES]
    names += [name for name in OUTPUTS if name not in ("model.h5", "run.nc")]
    return tuple(names)


def earlier_outputs(job: Job, out: Path) -> tuple[str, ...]:
    """Return the files of an earlier run in a folder that a new run removes or replaces.

    These are listed in the folder's manifest, have a fixed output name (`is_output`), and are not
    inputs of the job. An `UpdynWarning` lists files of an earlier run with other names: chosen by
    its job, or the manifest is forged.
    """
    inputs = {_resolve_links(path) for path in _list_inputs(job)}
    now = outputs(job)
    entries = Manifest.read(out).entries
    listed = [name for name, entry in entries.items() if entry.command in _RUN_COMMANDS]
    earlier = [name for name in listed if os.path.realpath(out / name) not in inputs]
    foreign = [name for name in earlier if not is_output(name) and name not in now]
    if foreign:
        names = ", ".join(map(repr, sorted(foreign)))
        text = (
            f"{str(out)!r} lists files of an earlier run under other names: {names}; this run"
            " neither replaces nor removes them"
        )
        warnings.warn(text, UpdynWarning, stacklevel=3)
    return tuple(name for name in earlier if is_output(name))


def default_out(job: Job, work: str = "") -> Path:
    """Return the default folder of a run, or of another command, for a job.

    Parameters
    ----------
    job : Job
        The job.
    work : str
        The command, such as "plan"; empty for a run.

    Returns
    -------
    Path
        The job's stem followed by the command, next to the job.
    """
    if not work:
        return job.path.with_suffix("")
    return job.path.with_name(f"{job.path.stem}-{work}")


def check_out(job: Job, out: str | Path | None = None, names: Iterable[str] | None = None) -> Path:
    """Check that files may be written to a folder.

    Parameters
    ----------
    job : Job
        The job.
    out : path, optional
        The folder; it need not exist. By default that of the job's run.
    names : iterable of str, optional
        Files to be written; by default those of a run.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    JobError
        If the folder is a file or cannot be written, or a file would be replaced that is an input
        of the job, was not written by updyn, or was changed since.
    """
    out = default_out(job) if out is None else Path(out)
    if "\0" in str(out):
        raise JobError(f"{str(out)!r}: no folder can have that name", job.path)
    names = outputs(job) if names is None else tuple(names)
    if out.exists() and not out.is_dir():
        text = f"the output folder {str(out)!r} is a file; choose another with --out"
        raise JobError(text, job.path)
    if out.is_symlink() and not out.exists():
        text = f"the output folder {str(out)!r} is a link that leads to no folder; remove the link"
        raise JobError(f"{text}, or choose another --out", job.path)
    parent = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        text = f"the output folder {str(out)!r} cannot be written: no permission in {str(parent)!r}"
        raise JobError(text, job.path)
    targets = [out / name for name in names]
    for target in targets:
        if "\0" in str(target):
            raise JobError(f"{str(target)!r}: no file can have that name", job.path)
        if target.is_dir():
            raise JobError(f"{str(target)!r} is a folder; choose another --out", job.path)
    written = {os.path.realpath(target) for target in targets}
    for path, what in _list_inputs(job).items():
        whole = _resolve_links(path)
        if whole is None:
            continue  # the reader of the file refuses it, with the line of its key
        relative_path(path, out)  # which job.toml will state
        if whole in written:
            text = f"the run would overwrite its {what} {str(path)!r}; choose another --out"
            raise JobError(text, job.path)
    recover(out)
    kept = find_obstacles(out, names)
    if JOB_FILE in names and (out / JOB_FILE).is_file() and not is_run_job(out / JOB_FILE):
        kept.setdefault(JOB_FILE, "was not written by a run")
    if kept:
        reasons = ", ".join(f"{str(out / name)!r} {why}" for name, why in kept.items())
        text = f"the run would overwrite files that it did not write: {reasons}; {_MOVE_ADVICE}"
        raise JobError(text, job.path)
    return out


def is_run_job(path: Path) -> bool:
    """Return whether a job file was written by a run."""
    return path.read_bytes().startswith(f"# {HEADER}".encode())


def _list_inputs(job: Job) -> dict[Path, str]:
    found = {job.path: "job file"}
    for part in job.parts:
        files = [*(part.test.repeats or ())]
        if part.test.file is not None:
            files.append(part.test.file)
        if part.test.modes is not None:
            files.append(part.test.modes)
        for file in files:
            found |= dict.fromkeys(list_measured_files(job.beside(file)), "measurement")
    if job.records is not None:
        for setup in job.records.setups:
            for file in setup.file or ():
                found[job.beside(file)] = "records"
    if job.model.file is not None:
        found[job.beside(job.model.file)] = "model"
    for name, table in job.tables.items():
        for file in JOB_TABLES[name].inputs(table):
            found[job.beside(file)] = f"file of [{name}]"
    if job.match.geometry is not None:
        found[job.beside(job.match.geometry)] = "geometry"
    return found


# -- the journal -----------------------------------------------------------------------------------
@contextmanager
def run_journal(out: Path, name: str = JOURNAL) -> Iterator[Path]:
    """Yield the path of a run's journal; remove it if an `InputError` occurs before it existed."""
    journal = out / name
    existed = journal.is_file()
    try:
        yield journal
    except InputError:
        if not existed:
            journal.unlink(missing_ok=True)
        raise


def can_resume(out: Path) -> bool:
    """Return whether a folder holds a run to resume; otherwise warn that the run starts anew."""
    if (out / JOURNAL).exists():
        return True
    try:
        status = json.loads((out / "result.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        why = f"{str(out / JOURNAL)!r} does not exist; the run begins anew"
    else:
        why = f"the run in {str(out)!r} has ended ({status}); it begins anew"
    warnings.warn(f"nothing to resume: {why}", UpdynWarning, stacklevel=3)
    return False


# -- job.toml --------------------------------------------------------------------------------------
def format_resolved_job(job: Job, out: Path, title: str = "") -> str:
    """Return a job file with all defaults that repeats the job from the folder `out`.

    `title` is that of the result, by default that of the job or the name of its file.
    """
    import tomlkit

    content = job.model_dump(exclude_none=True, mode="python")
    content["title"] = title or job.find_title()
    output = content.pop("output")
    for name, table in job.tables.items():
        content[name] = JOB_TABLES[name].resolve(
            table, job, lambda file: relative_path(job.beside(file), out)
        )
    content["output"] = output
    tests = [part.test.model_dump(exclude_none=True, mode="python") for part in job.parts]
    content["test"] = tests if len(tests) > 1 else tests[0]
    _make_files_relative(content["model"], "file", job, out)
    _make_files_relative(content["match"], "geometry", job, out)
    records = content.get("records", {})
    for table in (records, *records.get("setup", ())):
        _make_files_relative(table, "file", job, out)
    for test in tests:
        for key in ("file", "repeats", "modes"):
            _make_files_relative(test, key, job, out)
    for key, value in options_of(job.method.name).items():
        if isinstance(value, bool | int | float | str):
            content["method"].setdefault(key, value)
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{HEADER} {__version__} from {relative_path(job.path, out)}"))
    for key, value in content.items():
        if value not in ({}, (), {"table": {}}):
            document.add(key, _toml_item(value))
    return tomlkit.dumps(document).rstrip("\n") + "\n"


def _make_files_relative(table: dict[str, Any], key: str, job: Job, out: Path) -> None:
    if key not in table:
        return
    named = table[key]
    if isinstance(named, str):
        table[key] = relative_path(job.beside(named), out)
    else:
        table[key] = [relative_path(job.beside(file), out) for file in named]


def _resolve_links(path: Path) -> str | None:
    """Return the path of a file without links; None if it is not a valid file name."""
    try:
        return os.path.realpath(path)
    except ValueError:  # a null character
        return None


def relative_path(path: Path, folder: Path) -> str:
    """Return a path relative to a folder, with slashes; absolute if there is no relative path."""
    whole = Path(os.path.realpath(path))
    try:
        named = Path(os.path.relpath(whole, os.path.realpath(folder))).as_posix()
    except ValueError:  # on another drive
        named = whole.as_posix()
    check_encodable(named)
    return named


def _toml_item(value: object) -> object:
    """Return a value as tomlkit writes it; mappings become tables."""
    import tomlkit

    if isinstance(value, Mapping):
        table = tomlkit.table()
        for key, item in value.items():
            if item != {}:
                table.add(key, _toml_item(item))
        return table
    if not isinstance(value, list | tuple):
        return value
    if value and all(isinstance(item, Mapping) for item in value):
        tables = tomlkit.aot()
        for item in value:
            tables.append(_toml_item(item))
        return tables
    return [_toml_item(item) for item in value]
