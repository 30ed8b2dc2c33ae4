"""``[accept]`` of a job: acceptance of the updated model by the limits of a standard."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, Strict

from updyn.acceptance.accept import accept, check_directions
from updyn.acceptance.limits import LIMIT_NAMES, AcceptanceLimits
from updyn.acceptance.requirement import OPEN, Requirement
from updyn.acceptance.result import Acceptance
from updyn.acceptance.standards import find_limits
from updyn.dynamics.excitation import fix_base, hold_base
from updyn.errors import JobError, OptionError, UpdynError
from updyn.job.base import Pair
from updyn.job.job_table import JobTable, check_test_name
from updyn.job.prepared import Prepared
from updyn.job.schema import Job, Table
from updyn.job.start import start_model
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.uncertainty.draws import Draws
from updyn.updating.fit.monitor import Progress
from updyn.updating.modes import identify_modes_for
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["ACCEPT", "AcceptTable", "accept_start"]

#: The output file, next to the report.
FILE = "acceptance.html"
_Limit = Annotated[float | None, Field(gt=0, le=1)]
_Share = Annotated[float | None, Field(gt=0, lt=1)]


class AcceptTable(Table):
    """``[accept]``: limits of the agreement of the updated model with the measured modes."""

    standard: str = ""
    frequency: _Limit = None
    mac: _Limit = None
    frequency_major: _Limit = None
    mac_major: _Limit = None
    frequency_fundamental: _Limit = None
    mac_fundamental: _Limit = None
    mac_off: _Limit = None
    cross: _Limit = None
    cross_off: _Limit = None
    effective_mass: _Limit = None
    mass_met: _Limit = None
    band: Pair | None = None
    leave_out: Annotated[tuple[float, ...], Strict(False)] = ()
    fundamental: Annotated[tuple[int, ...], Strict(False)] | None = None
    directions: str = "XYZ"
    std_frequency: _Share = None
    std_shapes: _Share = None
    least_probability: _Share = None
    test: str = ""

    @property
    def limits(self) -> AcceptanceLimits:
        """The limits of the standard with those that the table states."""
        stated = {name: getattr(self, name) for name in LIMIT_NAMES}
        stated = {name: value for name, value in stated.items() if value is not None}
        if self.standard:
            return find_limits(self.standard).with_changes(**stated)
        return AcceptanceLimits(**stated, source="Stated in the job.")

    @property
    def options(self) -> dict[str, Any]:
        """Options of `accept`."""
        names = ("band", "leave_out", "fundamental", "directions", "std_frequency", "std_shapes")
        return {name: getattr(self, name) for name in (*names, "least_probability")}


class _AcceptJobTable(JobTable):
    """``[accept]``: acceptance after the update."""

    schema = AcceptTable

    def outputs(self, table: AcceptTable) -> tuple[str, ...]:
        return (FILE,)

    def check_text(self, job: Job) -> None:
        table = job.table(AcceptTable)
        assert table is not None
        check_test_name(job, "accept", table.test)
        try:
            check_directions(table.directions)
            limits = table.limits
        except OptionError as error:
            error.key = ("accept", *error.key)
            raise
        if not limits.stated:
            raise JobError(
                'no limits; expected standard = "NASA-STD-5002" or "ECSS-E-ST-32-11C", or limits'
                " such as frequency = 0.05",
                key=("accept",),
            )

    def announce(self, prepared: Prepared) -> str:
        table = prepared.job.table(AcceptTable)
        assert table is not None
        stated = ", ".join(f"{name} {value:g}" for name, value in table.limits.stated.items())
        return f"Acceptance by {table.limits.name}: {stated}"

    def run(
        self,
        prepared: Prepared,
        result: UpdateResult | JointResult,
        found: Mapping[str, Any],
        callback: Callable[[Progress], bool | None] | None,
        engine: Any,
    ) -> Acceptance | None:
        table = prepared.job.table(AcceptTable)
        assert table is not None
        if result.status == "stopped":
            return None
        drawn = found.get("uncertainty")
        source = drawn if isinstance(drawn, Draws) and len(drawn) > 1 else result
        return _accept(table, source, None, table.test or None)

    def write(self, found: Acceptance, job: Job, folder: Path) -> None:
        # Loads the template engine, which a check of a job does not need.
        from updyn.report import write_acceptance

        write_acceptance(found, folder / FILE)

    def summary(self, found: Acceptance) -> str:
        return found.summary()

    def passes(self, found: Acceptance) -> bool:
        return found.accepted


ACCEPT = _AcceptJobTable()


def accept_start(ready: Prepared) -> Acceptance:
    """Return the acceptance of the model at the start of its unknowns, by the table of the job."""
    table = ready.job.table(AcceptTable)
    assert table is not None
    test = next(one for one in ready.tests if one.name == table.test)
    model, modes = start_model(test, ready.parameters), test.modes
    if isinstance(test.data, ModeSet):
        return _accept(table, model, test.data, None)
    if modes is None:
        table = table.model_copy(update={"band": table.band or (test.freq[0], test.freq[-1])})
        try:
            modes = identify_modes_for(*hold_base(model, test.data))
        except UpdynError as error:
            return _leave_open(table, str(error))
    model = fix_base(model, test.data)
    return _accept(table, model, modes, None)


def _accept(
    table: AcceptTable,
    source: UpdateResult | JointResult | Draws | Model,
    modes: ModeSet | None,
    test: str | None,
) -> Acceptance:
    """Return the acceptance; not decidable if it cannot be computed."""
    try:
        return accept(source, modes, table.limits, test=test, **table.options)
    except OptionError as error:
        error.key = ("accept", *error.key)
        raise
    except UpdynError as error:
        return _leave_open(table, str(error))


def _leave_open(table: AcceptTable, why: str) -> Acceptance:
    return Acceptance(table.limits, (Requirement("pair", OPEN, note=why),))
