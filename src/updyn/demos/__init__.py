"""Shipped demos: each writes its inputs and a job file, and runs like any other job.

A demo is a module with ``write_inputs(folder) -> path of the job file``, and optionally
``next_job(results, folder) -> path or None``, called after each run, ``headline(results) -> text``
of a few lines, and ``epilogue(results, folder) -> text`` with all details. The outcome of a demo is
that of its last run: an earlier run may have unknowns that the data do not determine.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from updyn.registry import Registry

__all__ = ["DEMOS", "Demo", "find_demo"]


@dataclass(frozen=True, slots=True)
class Demo:
    """A shipped example.

    Parameters
    ----------
    name : str
        Name on the command line.
    description : str
        One line for the list of demos.
    module : str
        Dotted name of its module.
    """

    name: str
    description: str
    module: str

    def write_inputs(self, folder: Path) -> Path:
        """Write model, measurement and job file.

        Parameters
        ----------
        folder : Path
            Folder to write to; it exists.

        Returns
        -------
        Path
            The job file.
        """
        return Path(importlib.import_module(self.module).write_inputs(folder))

    def next_job(self, results: Sequence[object], folder: Path) -> Path | None:
        """Return the job to run next, or None after the last run.

        Parameters
        ----------
        results : sequence of UpdateResult or JointResult
            Results of the previous runs, in order.
        folder : Path
            Folder of its inputs, to which the job and its files may be written.

        Returns
        -------
        Path or None
            The job file; None after the last run.
        """
        module = importlib.import_module(self.module)
        if not hasattr(module, "next_job"):
            return None
        job: Path | None = module.next_job(results, folder)
        return job

    def headline(self, results: Sequence[object]) -> str:
        """Return a few lines about the results in addition to their verdicts.

        Parameters
        ----------
        results : sequence of UpdateResult or JointResult
            Results of all runs, in order.

        Returns
        -------
        str
            Text, possibly empty.
        """
        module = importlib.import_module(self.module)
        return str(module.headline(results)) if hasattr(module, "headline") else ""

    def epilogue(self, results: Sequence[object], folder: Path) -> str:
        """Return text about the results in addition to their summaries.

        Parameters
        ----------
        results : sequence of UpdateResult or JointResult
            Results of all runs, in order.
        folder : Path
            Folder of its inputs.

        Returns
        -------
        str
            Text, possibly empty.
        """
        module = importlib.import_module(self.module)
        if not hasattr(module, "epilogue"):
            return ""
        return str(module.epilogue(results, folder))


#: Demos by name, the default first.
DEMOS: Registry[Demo] = Registry("demo", "updyn.demos", {})

for _demo in (
    Demo("beam", "a free-free steel beam, measured by impact hammer", "updyn.demos.beam"),
    Demo(
        "gear-train",
        "the seven-DOF gear train of Bao, Wang & Cheng (2010), 18 unknowns",
        "updyn.demos.gear_train",
    ),
    Demo(
        "backlash",
        "the gear train with a gap in a mesh and friction at the motor: three torques, one model",
        "updyn.control.backlash_demo",
    ),
    Demo(
        "antenna",
        "a 4 m antenna with its drives, rotors locked and free: two tests, one model",
        "updyn.control.demo",
    ),
    Demo(
        "chain",
        "a 12-DOF damped chain, synthetic data with 1 % noise: 12 unknowns recovered",
        "updyn.demos.chain",
    ),
):
    DEMOS.register(_demo.name, _demo)


def find_demo(name: str) -> Demo:
    """Return a demo by name.

    Parameters
    ----------
    name : str
        Its name in `DEMOS`.

    Returns
    -------
    Demo

    Raises
    ------
    OptionError
        If no demo has that name; the message gives the nearest.
    """
    return DEMOS.find(name)
