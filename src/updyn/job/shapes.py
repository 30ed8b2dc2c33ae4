"""``[shapes]`` of a job: modes of the updated structure and measured shapes, at all DOFs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from updyn.errors import UpdynError
from updyn.geometry import Geometry
from updyn.io import write_modes
from updyn.job.job_table import JobTable, check_test_name
from updyn.job.prepared import Prepared
from updyn.job.schema import Job, Table
from updyn.modal import ModeSet
from updyn.text_table import text_table
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.expansion import Expansion, expand_modes
from updyn.uncertainty.mode_prediction import predict_modes
from updyn.updating.fit.monitor import Progress
from updyn.updating.result import JointResult, UpdateResult, find_result

__all__ = ["SHAPES", "ShapesTable"]

_UPDATED, _EXPANDED = "modes-updated", "modes-expanded"
#: The files of a set: exact with standard deviations, and for other programs.
_SUFFIXES = (".nc", ".unv")


class ShapesTable(Table):
    """``[shapes]``: modes of the updated structure, and measured shapes, at all DOFs."""

    n: int | None = Field(default=None, ge=1)
    expand: Literal["local", "serep", "none"] = "local"
    test: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedShapes:
    """Modes of the updated structure and expanded measured shapes, at all DOFs of the model.

    `note` is the reason if the measured shapes could not be expanded.
    """

    modes: ModeSet
    expansion: Expansion | None
    note: str
    geometry: Geometry | None


class _ShapesJobTable(JobTable):
    """``[shapes]``: modes at all DOFs after the update."""

    schema = ShapesTable

    def outputs(self, table: ShapesTable) -> tuple[str, ...]:
        names = (_UPDATED,) if table.expand == "none" else (_UPDATED, _EXPANDED)
        return tuple(name + suffix for name in names for suffix in _SUFFIXES)

    def check_text(self, job: Job) -> None:
        table = job.table(ShapesTable)
        assert table is not None
        check_test_name(job, "shapes", table.test)

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, Any],
        callback: Callable[[Progress], bool | None] | None,
        engine: Any,
    ) -> PredictedShapes | None:
        table = prepared.job.table(ShapesTable)
        assert table is not None
        if result.status == "stopped":
            return None
        drawn = found.get("uncertainty")
        source = drawn if isinstance(drawn, Draws) and len(drawn) > 1 else result
        test = table.test or None
        modes = predict_modes(source, table.n, test=test)
        expansion, note = None, ""
        if table.expand != "none":
            try:
                expansion = expand_modes(source, method=table.expand, test=test)
            except UpdynError as error:
                note = f"The measured shapes are not expanded: {error}"
        return PredictedShapes(modes, expansion, note, find_result(result, test).model.geometry)

    def write(self, found: PredictedShapes, job: Job, folder: Path) -> None:
        written = {_UPDATED: found.modes}
        if found.expansion is not None:
            written[_EXPANDED] = found.expansion.modes
        for name, modes in written.items():
            write_modes(modes, folder / f"{name}.nc")
            write_modes(modes, folder / f"{name}.unv", geometry=found.geometry)

    def summary(self, found: PredictedShapes) -> str:
        texts = [_format_modes(found.modes)]
        if found.expansion is not None:
            texts.append(found.expansion.summary())
        return "\n\n".join([*texts, *filter(None, [found.note])])


SHAPES = _ShapesJobTable()


def _format_modes(modes: ModeSet) -> str:
    """Return frequencies and damping of the updated structure as text."""
    rows = [
        [str(k + 1), f"{f:.6g}", _format_std(std), f"{loss:.4g}", _format_std(std_loss)]
        for k, (f, std, loss, std_loss) in enumerate(
            zip(
                modes.frequency,
                modes.std_frequency,
                modes.loss_factor,
                modes.std_loss_factor,
                strict=True,
            )
        )
    ]
    header = ["mode", "frequency (Hz)", "std", "loss factor", "std"]
    return f"Modes of the updated structure at {len(modes.dofs)} DOFs\n" + text_table(header, rows)


def _format_std(std: float) -> str:
    return f"{std:.2g}" if np.isfinite(std) else "not determined"
