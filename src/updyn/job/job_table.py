"""`JobTable`: a table of the job file that asks for work after the update, and their registry.

``[uncertainty]``, ``[plant]`` and ``[servo]`` are such tables; ``[plan]`` asks for work before it.
A room or another package adds one by an object of a class derived from `JobTable`, in a module of
its own, and one line in `JOB_TABLES`, a call of `JOB_TABLES.register`, or an entry point of the
group ``updyn.job_tables``. Only the name of a table is known until a job has it; then the module is
imported and the object is used in this order:

``schema``
    by `load_job`: the pydantic class, derived from `updyn.job.schema.Table`, that the table is
    validated by. What it refuses is reported with line and nearest key, as for the other tables.
    The validated table is in `Job.tables` by its name; `Job.table` returns it by its class.
``check_text``
    by `load_job`: what the text of the whole job tells.
``check``
    by `prepare`: what model and data tell.
``announce``
    by ``updyn check``: text lines on what the job asks for.
``outputs``
    names of the files that it may write into the folder of the run.
``run``
    by `run_job`, after the update and the tables before it in `JOB_TABLES`: returns an object, or
    None where there is nothing. An `UpdynError` here becomes a warning; the update is kept.
``write``
    by `run_job`: writes the files of the object into a temporary folder.
``summary``
    by ``updyn run``: the object as text.

The object is also handed to the report, which shows it where a section for it is registered.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from updyn.registry import Registry

if TYPE_CHECKING:
    from updyn.job.prepared import Prepared
    from updyn.job.schema import Job, Table
    from updyn.updating.fit.monitor import Progress
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["JOB_TABLES", "JobTable"]


class JobTable(ABC):
    """A table of the job file that asks for work after the update; see the module."""

    schema: ClassVar[type[Table]]

    @abstractmethod
    def outputs(self, table: Any) -> tuple[str, ...]:
        """Return the names of the files that it may write into the folder of the run.

        Parameters
        ----------
        table : Table
            The validated table.
        """

    def check_text(self, job: Job) -> None:  # noqa: B027
        """Check what the text of a job tells.

        Parameters
        ----------
        job : Job
            All its tests included.

        Raises
        ------
        JobError
            If the table contradicts itself or another table.
        """

    def check(self, prepared: Prepared) -> None:  # noqa: B027
        """Check what model and data of a job tell, before anything is computed.

        Parameters
        ----------
        prepared : Prepared
            The job with model, data and unknowns.

        Raises
        ------
        JobError
            If the table does not fit them.
        """

    def stages(self, table: Any) -> tuple[str, ...]:
        """Return how the stages of its progress begin; none where it shows no progress.

        Parameters
        ----------
        table : Table
            The validated table.
        """
        return ()

    def announce(self, prepared: Prepared) -> str:
        """Return what the job asks for as text; empty where another table says it.

        Parameters
        ----------
        prepared : Prepared
            The job with model, data and unknowns.
        """
        return ""

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, Any],
        callback: Callable[[Progress], bool | None] | None,
        engine: Any,
    ) -> Any:
        """Return what the table asks for; None where there is nothing.

        Parameters
        ----------
        prepared : Prepared
            The job with model, data and unknowns.
        result : UpdateResult or JointResult
            The update.
        found : mapping of str to object
            What the tables before it gave, by their names.
        callback : callable or None
            As for `run_job`.
        engine : object
            As for `run_job`.

        Raises
        ------
        UpdynError
            If it cannot be had; the run goes on with a warning.
        """
        return None

    def write(self, found: Any, job: Job, folder: Path) -> None:  # noqa: B027
        """Write the files of what `run` gave.

        Parameters
        ----------
        found : object
            From `run`, not None.
        job : Job
            The job.
        folder : Path
            Temporary folder, from which `outputs` are moved into that of the run.
        """

    def summary(self, found: Any) -> str:
        """Return what `run` gave as text; empty for nothing.

        Parameters
        ----------
        found : object
            From `run`, not None.
        """
        return ""


#: The tables, in the order in which they are run.
JOB_TABLES: Registry[JobTable] = Registry(
    "job table",
    "updyn.job_tables",
    {
        "plan": "updyn.job.planning:PLAN",
        "modes": "updyn.job.identification:MODES",
        "uncertainty": "updyn.job.uncertainty:UNCERTAINTY",
        "plant": "updyn.control.job.job_tables:PLANT",
        "servo": "updyn.control.job.job_tables:SERVO",
    },
)
