"""``updyn serve``."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from updyn.errors import InputError
from updyn.registry import load_object

__all__ = ["serve"]

#: Imported once the extra is known to be there.
_SERVER = "updyn.web.server:serve"
#: Exit code: it ends by a signal only; the command line has another code for SIGTERM.
_STOPPED = 130


def serve(
    job: Path | None = None,
    /,
    *,
    port: int = 0,
    open_: Annotated[bool, Parameter("--open", negative="--no-open")] = True,
) -> int:
    """Open the app: a page in the browser of this machine, to set up a job, run it and compare.

    The first line printed is its address, with the secret that opens it. Ctrl-C ends it; an active
    run is stopped with its results so far, and can be resumed.

    Parameters
    ----------
    job
        A job file to open; its folder is the project. Without it the current folder is.
    port
        Port of 127.0.0.1; by default any free one.
    open_
        Whether a browser is asked to show the page.
    """
    if find_spec("nicegui") is None:
        raise InputError("updyn serve needs the extra 'app': pip install 'updyn[app]'")
    if job is not None and not job.is_file():
        raise InputError(f"{job}: no such file; expected a job file (TOML)")
    folder = Path.cwd() if job is None else job.resolve().parent
    load_object(_SERVER)(job, folder, port=port, open_browser=open_)
    return _STOPPED
