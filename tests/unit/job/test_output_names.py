"""The names that every command writes are those on whose word a manifest is believed."""

from __future__ import annotations

from updyn.control.job.job_tables import plant_outputs
from updyn.control.job.tables import PlantTable
from updyn.job.acceptance import ACCEPT, AcceptTable
from updyn.job.comparison import COMPARISON_FILES
from updyn.job.identification import MODES_FILES
from updyn.job.levels import LEVELS, LevelsTable
from updyn.job.planning import PLAN_FILES
from updyn.job.population import POPULATION, PopulationTable
from updyn.job.schema import OUTPUTS
from updyn.job.shapes import SHAPES, ShapesTable
from updyn.job.uncertainty import FILE
from updyn.outputs.manifest import OUTPUT_NAMES


def test_the_list_holds_what_the_commands_write_and_nothing_else() -> None:
    plant = {
        name
        for files in (("plant.mat", "plant.json", "plant.h"), ("plant.npz",))
        for sampling in (None, {"dt": 1e-3})
        for name in plant_outputs(
            PlantTable(inputs="1:X", outputs="2:X", files=files, sampling=sampling)
        )
    }
    shapes = SHAPES.outputs(ShapesTable())
    pages = {"check.html", "correlate.html"}
    written = {
        *OUTPUTS,
        FILE,
        *ACCEPT.outputs(AcceptTable()),
        *LEVELS.outputs(LevelsTable()),
        *POPULATION.outputs(PopulationTable()),
        *MODES_FILES,
        *PLAN_FILES,
        *COMPARISON_FILES,
        *pages,
        *plant,
        *shapes,
    }
    assert written == OUTPUT_NAMES
