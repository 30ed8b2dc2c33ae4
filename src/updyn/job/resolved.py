"""The job file that a run leaves behind: defaults written out, files named from where it lies."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from updyn import __version__
from updyn.job.schema import Job

__all__ = ["MARK", "resolved_job"]

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
