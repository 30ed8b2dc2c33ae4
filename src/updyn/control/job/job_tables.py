"""The job tables ``[plant]`` and ``[servo]``, and the files of a plant."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from updyn.control.files.plant_file import write_plant
from updyn.control.job.checks import (
    check_control,
    check_control_tables,
    check_servo_table,
    part_of_plant,
)
from updyn.control.job.messages import describe_plant_result, describe_request
from updyn.control.job.plant_result import PlantResult, make_plant
from updyn.control.job.record import write_control_record
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.errors import UpdynWarning
from updyn.job.job_table import JobTable
from updyn.job.prepared import Prepared
from updyn.job.schema import Job

if TYPE_CHECKING:
    from updyn.updating.fit.monitor import Progress
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["CONTROL", "PLANT", "PLANT_PAGE", "SERVO", "plant_outputs", "write_plant_files"]

#: Page and record of a plant.
PLANT_PAGE = "plant.html"
CONTROL = "control.json"


def plant_outputs(table: PlantTable) -> tuple[str, ...]:
    """Return the names of the files that ``updyn plant`` writes; a run omits the page."""
    return (*table.files, *table.sampled_files, PLANT_PAGE, CONTROL)


class _PlantJobTable(JobTable):
    """``[plant]``."""

    schema = PlantTable

    def outputs(self, table: PlantTable) -> tuple[str, ...]:
        return plant_outputs(table)

    def check_text(self, job: Job) -> None:
        check_control_tables(job)

    def check(self, prepared: Prepared) -> None:
        check_control(
            prepared.job,
            [test.model for test in prepared.tests],
            [test.freq for test in prepared.tests],
        )

    def announce(self, prepared: Prepared) -> str:
        return describe_request(prepared)

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, object],
        callback: Callable[[Progress], bool | None] | None,
        engine: object,
    ) -> PlantResult | None:
        """Return the plant, None without a finished update; warn if the tolerance is not held."""
        from updyn.uncertainty.draws import Draws

        if result.status in ("stopped", "failed"):
            return None
        draws = found.get("uncertainty")
        if not isinstance(draws, Draws) or len(draws) < 2:
            draws = None
        of_test = list(result.results.values())[part_of_plant(prepared.job)]
        with prepared.job.located():
            plant_result = make_plant(
                prepared,
                of_test,
                f"The updated model ({result.status}).",
                draws=draws,
                engine=engine,
                say=_shown(callback),
                strict=False,
            )
        if not plant_result.holds_tolerance:
            text = f"{prepared.job.path}: no plant is written: {plant_result.message}"
            warnings.warn(text, UpdynWarning, stacklevel=4)
        return plant_result

    def write(self, found: PlantResult, job: Job, folder: Path) -> None:
        write_plant_files(found, job, folder)

    def summary(self, found: PlantResult) -> str:
        return describe_plant_result(found)


class _ServoJobTable(JobTable):
    """``[servo]``: checked here, evaluated with ``[plant]``."""

    schema = ServoTable

    def outputs(self, table: ServoTable) -> tuple[str, ...]:
        return ()

    def check_text(self, job: Job) -> None:
        check_servo_table(job)


PLANT = _PlantJobTable()
SERVO = _ServoJobTable()


def _shown(callback: Callable[[Progress], bool | None] | None) -> Callable[[str], object] | None:
    """Return a function that reports the name of a stage as progress of the run."""
    if callback is None:
        return None
    from updyn.updating.fit.monitor import Progress as Step

    return lambda stage: callback(Step(stage, 0, float("nan"), 0, 0))


def write_plant_files(plant_result: PlantResult, job: Job, folder: Path) -> None:
    """Write the files that ``[plant]`` names, and the record."""
    table = job.table(PlantTable)
    assert table is not None
    for made, names in (
        (plant_result.plant, table.files),
        (plant_result.sampled, table.sampled_files),
    ):
        if made is not None:
            for name in names:
                write_plant(made, folder / name)
    write_control_record(plant_result, folder / CONTROL)
