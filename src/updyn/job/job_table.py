"""`JobTable`: a table of the job file that requests work after the update, and their registry.

Examples are ``[uncertainty]``, ``[plant]`` and ``[servo]``; ``[plan]`` and ``[candidates]`` are the
work of other commands. To add a table, define an object of a class derived from `JobTable` in a
separate module, and register it: a line in `JOB_TABLES`, a call of `JOB_TABLES.register`, or an
entry point of the group ``updyn.job_tables``. Only the name of a table is known until a job uses
it; then the module is imported and the attributes of the object are used in this order:

``schema``
    by `load_job`: the pydantic class, derived from `updyn.job.schema.Table`, that validates the
    table. Its errors are reported with line and nearest key, as for the other tables. The
    validated table is in `Job.tables` by its name; `Job.table` returns it by its class.
``check_text``
    by `load_job`: checks that need only the text of the job.
``check``
    by `prepare`: checks that need model and data.
``announce``
    by ``updyn check``: text lines that describe the requested work.
``inputs``, ``resolve``
    files that it names, and the table in ``job.toml`` of the results.
``outputs``
    names of the files that it may write into the folder of the run.
``run``
    by `run_job`, after the update and the tables before it in `JOB_TABLES`: returns an object, or
    None if there is no result. An `UpdynError` becomes a warning; the update is kept.
``write``
    by `run_job`: writes the files of the object into a temporary folder.
``summary``
    by ``updyn run``: the object as text.
``passes``
    by ``updyn run``: whether its exit code may be 0.

The object is also passed to the report, which shows it if a section for it is registered.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from updyn.errors import JobError, suggest
from updyn.registry import Registry

if TYPE_CHECKING:
    from updyn.job.prepared import Prepared
    from updyn.job.schema import Job, Table
    from updyn.updating.fit.monitor import Progress
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["JOB_TABLES", "JobTable", "check_test_name"]


class JobTable(ABC):
    """A table of the job file that requests work after the update; see the module."""

    schema: ClassVar[type[Table]]

    @abstractmethod
    def outputs(self, table: Any) -> tuple[str, ...]:
        """Return the names of the files that it may write into the folder of the run.

        Parameters
        ----------
        table : Table
            The validated table.
        """

    def inputs(self, table: Any) -> tuple[str, ...]:
        """Return the files that the table names, relative to the job file.

        Parameters
        ----------
        table : Table
            The validated table.
        """
        return ()

    def resolve(self, table: Any, job: Job, relocate: Callable[[str], str]) -> dict[str, Any]:
        """Return the table as it is written with the job into the folder of the results.

        Parameters
        ----------
        table : Table
            The validated table.
        job : Job
            The job.
        relocate : callable
            Function from a file relative to the job to the same file relative to that folder.
        """
        found: dict[str, Any] = table.model_dump(exclude_none=True, mode="python")
        return found

    def check_text(self, job: Job) -> None:  # noqa: B027
        """Check the table against the text of a job.

        Parameters
        ----------
        job : Job
            The job with all its tests.

        Raises
        ------
        JobError
            If the table contradicts itself or another table.
        """

    def check(self, prepared: Prepared) -> None:  # noqa: B027
        """Check the table against model and data of a job, before anything is computed.

        Parameters
        ----------
        prepared : Prepared
            The job with model, data and unknowns.

        Raises
        ------
        JobError
            If the table does not fit them.
        """

    def stages(self, table: object) -> tuple[str, ...]:
        """Return the prefixes of its progress stages; empty if it shows no progress.

        Parameters
        ----------
        table : Table
            The validated table.
        """
        return ()

    def announce(self, prepared: Prepared) -> str:
        """Return a description of the requested work; empty if another table describes it.

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
        """Return the result that the table requests; None if there is no result.

        Parameters
        ----------
        prepared : Prepared
            The job with model, data and unknowns.
        result : UpdateResult or JointResult
            The update.
        found : mapping of str to object
            Results of the tables before it, by table name.
        callback : callable or None
            As for `run_job`.
        engine : object
            As for `run_job`.

        Raises
        ------
        UpdynError
            If the result cannot be computed; the run continues with a warning.
        """
        return None

    def write(self, found: Any, job: Job, folder: Path) -> None:  # noqa: B027
        """Write the files of a result of `run`.

        Parameters
        ----------
        found : object
            From `run`, not None.
        job : Job
            The job.
        folder : Path
            Temporary folder, from which `outputs` are moved into the folder of the run.
        """

    def summary(self, found: Any) -> str:
        """Return a result of `run` as text; may be empty.

        Parameters
        ----------
        found : object
            From `run`, not None.
        """
        return ""

    def passes(self, found: Any) -> bool:
        """Return whether a result of `run` passes; if not, ``updyn run`` ends with exit code 3.

        Parameters
        ----------
        found : object
            From `run`, not None.
        """
        return True


def check_test_name(job: Job, table: str, test: str) -> None:
    """Raise JobError if `test`, a key of a table, does not select one test of a job."""
    names = [part.test.name or "" for part in job.parts]
    if len(names) > 1 and test not in names:
        problem = f"test {test!r}" if test else "state test, to select its model"
        raise JobError(f"{problem}; {suggest(test, names)}", key=(table, "test"))
    if len(names) == 1 and test:
        raise JobError("the job has one test only; leave test out", key=(table, "test"))


#: The tables, in the order of their execution.
JOB_TABLES: Registry[JobTable] = Registry(
    "job table",
    "updyn.job_tables",
    {
        "plan": "updyn.job.planning:PLAN",
        "candidates": "updyn.job.candidates:CANDIDATES",
        "locate": "updyn.job.location:LOCATE",
        "modes": "updyn.job.identification:MODES",
        "uncertainty": "updyn.job.uncertainty:UNCERTAINTY",
        "levels": "updyn.job.levels:LEVELS",
        "shapes": "updyn.job.shapes:SHAPES",
        "population": "updyn.job.population:POPULATION",
        "accept": "updyn.job.acceptance:ACCEPT",
        "plant": "updyn.control.job.job_tables:PLANT",
        "servo": "updyn.control.job.job_tables:SERVO",
    },
)
