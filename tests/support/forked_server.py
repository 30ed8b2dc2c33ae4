"""Processes forked from one that has imported their modules, which takes a second or two: `updyn serve`, desks."""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from typing import TextIO

#: Modules that `updyn serve` and the processes of its desks import.
_IMPORTED = [
    "updyn.cli.commands",
    "updyn.job",
    "updyn.updating.diagnose",
    "updyn.updating.update",
    "updyn.web.command",
    "updyn.web.looking",
    "updyn.web.server",
]


def forked_context() -> ForkServerContext:
    """Return the context whose processes have imported these modules."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_IMPORTED)
    return context


def start_server(folder: Path, arguments: Sequence[str]) -> tuple[ForkServerProcess, TextIO]:
    """Start the command in a folder; return the process, and what it prints."""
    context = forked_context()
    printed, out = context.Pipe(duplex=False)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    process = context.Process(target=_serve, args=(folder, arguments, environment, out))
    process.start()
    out.close()
    return process, os.fdopen(os.dup(printed.fileno()), encoding="utf-8")


def _serve(
    folder: Path, arguments: Sequence[str], environment: Mapping[str, str], out: Connection
) -> None:
    """Run the command; both streams go to the pipe."""
    from updyn.cli import main

    os.environ.update(environment)
    os.chdir(folder)
    for stream in (1, 2):
        os.dup2(out.fileno(), stream)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    sys.exit(main(["serve", *arguments]))
