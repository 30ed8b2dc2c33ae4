"""Shipped examples: each writes its inputs and a job file, and runs as any job does.

Adding one is a module here with ``write_inputs(folder) -> path of the job file``; where one run is
not all, ``next_job(results, folder) -> path or None``, asked after every run; where there is more
to say than the summaries, ``epilogue(results, folder) -> text``; and one line in `DEMOS`. A module
is loaded when its demo is run.

What a demo comes to is what its last run comes to: an example may well begin with a run that the
data cannot determine.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from updyn.errors import InputError, suggest

__all__ = ["DEMOS", "Demo", "find_demo"]


@dataclass(frozen=True, slots=True)
class Demo:
    """One example.

    Parameters
    ----------
    name : str
        What users call it.
    description : str
        In a line.
    module : str
        Where it is.
    """

    name: str
    description: str
    module: str

    def write_inputs(self, folder: Path) -> Path:
        """Write model, measurement and job file.

        Parameters
        ----------
        folder : Path
            Where to; it exists.

        Returns
        -------
        Path
            The job file.
        """
        return Path(importlib.import_module(self.module).write_inputs(folder))

    def next_job(self, results: Sequence[Any], folder: Path) -> Path | None:
        """Return the job to run next, if the example has another.

        Parameters
        ----------
        results : sequence of UpdateResult or JointResult
            Of the runs so far, in order.
        folder : Path
            Where its inputs are; the job, and what it names, may be written now.

        Returns
        -------
        Path or None
            The job file; None after the last run.
        """
        go_on = getattr(importlib.import_module(self.module), "next_job", None)
        job = None if go_on is None else go_on(results, folder)
        return None if job is None else Path(job)

    def epilogue(self, results: Sequence[Any], folder: Path) -> str:
        """Return what the example has to say about its results beyond their summaries.

        Parameters
        ----------
        results : sequence of UpdateResult or JointResult
            Of all runs, in order.
        folder : Path
            Where its inputs are.

        Returns
        -------
        str
            Text; empty where there is nothing to say.
        """
        speak = getattr(importlib.import_module(self.module), "epilogue", None)
        return "" if speak is None else str(speak(results, folder))


_ALL = (
    Demo("beam", "a free-free steel beam, measured by impact hammer", "updyn.demos.beam"),
    Demo(
        "gear-train",
        "the seven-DOF gear train of Bao, Wang & Cheng (2010), 18 unknowns",
        "updyn.demos.gear_train",
    ),
    Demo(
        "antenna",
        "a 4 m antenna with its drives, rotors locked and free: two tests, one model",
        "updyn.demos.antenna",
    ),
    Demo(
        "chain",
        "a 12-DOF damped chain, synthetic data with 1 % noise: 12 unknowns recovered",
        "updyn.demos.chain",
    ),
)

#: By name, the default first.
DEMOS = {d.name: d for d in _ALL}


def find_demo(name: str) -> Demo:
    """Return a demo by name.

    Parameters
    ----------
    name : str
        Its name.

    Returns
    -------
    Demo
        The one of that name.

    Raises
    ------
    InputError
        If there is none of that name; the nearest are named.
    """
    if name not in DEMOS:
        raise InputError(f"no demo {name!r}; {suggest(name, DEMOS)}")
    return DEMOS[name]
