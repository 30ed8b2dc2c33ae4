"""``[uncertainty]`` of a job: profile likelihood, bootstrap or sampling after the update."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, model_validator

from updyn.errors import OptionError, key_path
from updyn.job.job_table import JobTable
from updyn.job.prepared import Prepared
from updyn.job.schema import Job, Table, Texts
from updyn.store.uncertainty import write_uncertainty
from updyn.uncertainty.bootstrap import bootstrap
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Profiles, profile
from updyn.uncertainty.restored import LIKELIHOOD, STATES_NOISE, find_positions
from updyn.uncertainty.sampling import sample
from updyn.uncertainty.settings import COUNT_LIMITS
from updyn.updating.fit.methods import methods_with
from updyn.updating.fit.monitor import Progress

if TYPE_CHECKING:
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["UNCERTAINTY", "UncertaintyTable", "wrap_callback"]

#: The output file, next to the results.
FILE = "uncertainty.nc"


class UncertaintyTable(Table):
    """``[uncertainty]``: uncertainty of the estimate beyond its standard deviations."""

    kind: Literal["profile", "bootstrap", "sampling"]
    names: Texts | None = Field(default=None, min_length=1)  # of a profile; default: all unknowns
    n: int | None = Field(default=None, ge=2, le=COUNT_LIMITS.most_draws)
    seed: int = Field(default=0, ge=0)
    level: float = Field(default=0.95, gt=0, lt=1)

    @model_validator(mode="after")
    def _check_kind(self) -> UncertaintyTable:
        if self.kind == "profile" and self.n is not None:
            raise ValueError("n is the number of draws; a profile makes none")
        if self.kind != "profile" and self.names is not None:
            raise ValueError(f"names choose unknowns to profile; kind {self.kind!r} draws all")
        return self


class _UncertaintyJobTable(JobTable):
    """``[uncertainty]``: profile likelihood, bootstrap or sampling after the update."""

    schema = UncertaintyTable

    def outputs(self, table: UncertaintyTable) -> tuple[str, ...]:
        return (FILE,)

    def check(self, prepared: Prepared) -> None:
        job = prepared.job
        table = job.table(UncertaintyTable)
        assert table is not None
        # A selection may cluster unknowns under new names.
        if table.names is not None and job.selection is None:
            with key_path("uncertainty", "names"):
                find_positions(table.names, prepared.parameters.names)
        methods = methods_with(STATES_NOISE if table.kind == "bootstrap" else LIKELIHOOD)
        if job.method.name not in methods:
            valid = " or ".join(repr(m) for m in methods)
            raise OptionError(
                f"uncertainty: kind {table.kind!r} requires a fit by {valid}; [method] name is"
                f" {job.method.name!r}",
                key=("uncertainty", "kind"),
            )

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, Any],
        callback: Callable[[Progress], bool | None] | None,
        engine: Any,
    ) -> Draws | Profiles | None:
        table = prepared.job.table(UncertaintyTable)
        assert table is not None
        if result.status == "stopped":
            return None
        options: dict[str, Any] = {
            "seed": table.seed,
            "engine": engine,
            "callback": wrap_callback(callback),
        }
        if table.kind == "profile":
            return profile(result, table.names, level=table.level, **options)
        if table.n is not None:
            options["n"] = table.n
        draw = bootstrap if table.kind == "bootstrap" else sample
        draws = draw(result, **options)
        return replace(draws, options={**draws.options, "level": table.level})

    def stages(self, table: Any) -> tuple[str, ...]:
        return (table.kind,)

    def write(self, found: Draws | Profiles, job: Job, folder: Path) -> None:
        write_uncertainty(found, folder / FILE)

    def summary(self, found: Draws | Profiles) -> str:
        if isinstance(found, Profiles):
            return found.summary()
        return found.summary(found.options["level"])


UNCERTAINTY = _UncertaintyJobTable()


def wrap_callback(callback: Callable[[Progress], bool | None] | None) -> Any:
    """Return the callback of work of many pieces that shows it as progress of a run."""
    if callback is None:
        return None

    def show(progress: Any) -> bool | None:
        stage = f"{progress.stage} {progress.done} of {progress.total}"
        if progress.note:
            stage += f", {progress.note}"
        return callback(Progress(stage, progress.done, float("nan"), progress.done, progress.total))

    return show
