"""``[population]`` of a job: mean and scatter of the unknowns over the specimens of its tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from updyn.errors import JobError
from updyn.io.atomic import write_json
from updyn.job.job_table import JobTable
from updyn.job.prepared import Prepared
from updyn.job.run import make_tests
from updyn.job.schema import Job, Table
from updyn.job.uncertainty import wrap_callback
from updyn.population.result import PopulationResult
from updyn.population.update import update_population
from updyn.updating.fit.monitor import Progress
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["POPULATION", "PopulationTable"]

#: The output file, next to the results.
FILE = "population.json"


class PopulationTable(Table):
    """``[population]``: each test is that of another specimen."""

    level: float = Field(default=0.95, gt=0, lt=1)


class _PopulationJobTable(JobTable):
    """``[population]``: mean and scatter over specimens, after the joint update."""

    schema = PopulationTable

    def outputs(self, table: PopulationTable) -> tuple[str, ...]:
        return (FILE,)

    def check_text(self, job: Job) -> None:
        if len(job.parts) < 2:
            raise JobError(
                "the job has one test; expected a [[test]] for each specimen, at least two",
                key=("population",),
            )
        if job.selection is not None:
            raise JobError(
                "[selection] chooses other unknowns for each specimen; leave it out",
                key=("selection",),
            )

    def check(self, prepared: Prepared) -> None:
        if prepared.modes:
            raise JobError(
                "a specimen has FRFs or modes; leave out modes next to FRFs", key=("population",)
            )

    def announce(self, prepared: Prepared) -> str:
        return f"Population: mean and scatter over {len(prepared.tests)} specimens"

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, Any],
        callback: Callable[[Progress], bool | None] | None,
        engine: Any,
    ) -> PopulationResult | None:
        if result.status == "stopped":
            return None
        method = prepared.job.method
        return update_population(
            make_tests(prepared),
            prepared.parameters,
            method.name,
            engine,
            wrap_callback(callback),
            title=prepared.title,
            **method.options,
            **method.settings,
        )

    def stages(self, table: object) -> tuple[str, ...]:
        return ("population",)

    def write(self, found: PopulationResult, job: Job, folder: Path) -> None:
        table = job.table(PopulationTable)
        assert table is not None
        write_json(found.to_dict(table.level), folder / FILE)

    def summary(self, found: PopulationResult) -> str:
        return found.summary()


POPULATION = _PopulationJobTable()
