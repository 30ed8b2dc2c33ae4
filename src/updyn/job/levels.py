"""``[levels]`` of a job: information of each force level, and of further ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from updyn.errors import JobError, OptionError
from updyn.io.atomic import write_json
from updyn.job.job_table import JobTable
from updyn.job.prepared import Prepared
from updyn.job.schema import Job, Table
from updyn.uncertainty.level_result import LevelAssessment
from updyn.uncertainty.levels import assess_levels, check_candidates
from updyn.uncertainty.restored import LIKELIHOOD
from updyn.updating.fit.methods import methods_with
from updyn.updating.fit.monitor import Progress
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["LEVELS", "LevelsTable"]

#: The output file, next to the results.
FILE = "levels.json"


class LevelsTable(Table):
    """``[levels]``: force levels of further tests, in N (N m)."""

    candidates: list[float] | None = Field(default=None, min_length=1)


class _LevelsJobTable(JobTable):
    """``[levels]``: information of each force level, after the update."""

    schema = LevelsTable

    def outputs(self, table: LevelsTable) -> tuple[str, ...]:
        return (FILE,)

    def check(self, prepared: Prepared) -> None:
        table = prepared.job.table(LevelsTable)
        assert table is not None
        if table.candidates is not None:
            try:
                check_candidates(table.candidates)
            except OptionError as error:
                raise JobError(str(error), key=("levels", "candidates")) from None
        if not any(test.model.nonlinear for test in prepared.tests):
            raise JobError(
                "the model has no nonlinear elements, and its FRFs are equal at all levels;"
                " expected an [[element]]",
                key=("levels",),
            )
        methods = methods_with(LIKELIHOOD)
        if prepared.job.method.name not in methods:
            raise JobError(
                f"levels: requires a fit by {' or '.join(map(repr, methods))}; [method] name is"
                f" {prepared.job.method.name!r}",
                key=("levels",),
            )

    def announce(self, prepared: Prepared) -> str:
        return "Levels: information of each force level, and of further ones"

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, Any],
        callback: Callable[[Progress], bool | None] | None,
        engine: Any,
    ) -> LevelAssessment | None:
        table = prepared.job.table(LevelsTable)
        assert table is not None
        if result.status == "stopped":
            return None
        return assess_levels(result, table.candidates)

    def write(self, found: LevelAssessment, job: Job, folder: Path) -> None:
        write_json(found.to_dict(), folder / FILE)

    def summary(self, found: LevelAssessment) -> str:
        return found.summary()


LEVELS = _LevelsJobTable()
