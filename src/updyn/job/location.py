"""``[locate]`` of a job, and `locate_job`: places and kinds of nonlinear elements."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, Strict

from updyn.candidates.location.kinds import choose_kinds
from updyn.candidates.location.locate import locate_nonlinearity
from updyn.candidates.location.result import LocatedNonlinearities, NonlinearityLocation
from updyn.candidates.location.several import locate_nonlinearities
from updyn.errors import JobError, key_path
from updyn.frf import FRF
from updyn.io.atomic import write_json
from updyn.job.base import Table
from updyn.job.comparison import COMPARISON_FILES
from updyn.job.folder import check_out, default_out
from updyn.job.job_table import JobTable
from updyn.job.prepare import prepare
from updyn.job.run import make_tests
from updyn.job.schema import Job, parse_dofs
from updyn.model import Model
from updyn.nonlinear.cubic import CubicSpring
from updyn.outputs.switch import open_folder, replace_files
from updyn.store.values import plain
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["LOCATE", "LocateTable", "locate_job"]

PlaceText = Annotated[str | tuple[str, ...] | dict[str, float], BeforeValidator(parse_dofs)]


class LocateTable(Table):
    """``[locate]``: candidates of place and kind of nonlinear elements, and their number."""

    places: dict[str, PlaceText] | None = Field(default=None, min_length=1)
    kinds: Annotated[tuple[str, ...], Strict(False)] | None = Field(default=None, min_length=1)
    most: int = Field(default=1, ge=1)


class _LocateJobTable(JobTable):
    """``[locate]``: the work of ``updyn compare``; an update ignores it."""

    schema = LocateTable

    def outputs(self, table: LocateTable) -> tuple[str, ...]:
        return ()


LOCATE = _LocateJobTable()


def locate_job(
    job: Job, out: str | Path | None = None
) -> NonlinearityLocation | LocatedNonlinearities:
    """Locate nonlinear elements and write ``compare.json`` and ``compare.html``.

    `out` is by default the job's stem with ``-compare``. A validation set of the job is left out.
    Nothing is written if a `JobError` or a `SolverError` is raised.
    """
    from updyn.report import write_location

    table = job.table(LocateTable)
    if table is None:
        raise JobError("missing table [locate]", job.path)
    out = check_out(job, out or default_out(job, "compare"), COMPARISON_FILES)
    ready = prepare(job)
    tests = make_tests(ready, held_out=False)
    with job.located():
        _check_tests(tests)
        _check_table(table, tests[0].model)
        frfs = [_select_lines(test) for test in tests]
    with open_folder(out):
        check_out(job, out, COMPARISON_FILES)  # again, now that no other run can change the folder
        with job.located(), key_path("locate"):
            found = _locate(table, tests[0], frfs, ready.parameters)
        with replace_files(out, "compare", COMPARISON_FILES) as new:
            write_location(found, new / "compare.html", job.find_title())
            write_json(plain(found.to_dict()), new / "compare.json")
    return found


def _locate(
    table: LocateTable, test: Test, frfs: list[FRF], unknowns: ParameterSet
) -> NonlinearityLocation | LocatedNonlinearities:
    candidates = test.model, frfs, table.places, table.kinds
    if table.most == 1:
        return locate_nonlinearity(*candidates, unknowns=unknowns, noise=test.noise)
    return locate_nonlinearities(*candidates, unknowns=unknowns, noise=test.noise, most=table.most)


def _check_tests(tests: list[Test]) -> None:
    """Raise if the tests are not FRFs of one linear model with one noise."""
    first = tests[0]
    if any(not isinstance(test.data, FRF) for test in tests):
        raise JobError("locate: it requires FRFs, found modes", key=("locate",))
    if any(test.model.dofs != first.model.dofs for test in tests):
        raise JobError("locate: the tests have different models", key=("locate",))
    if any(test.noise != first.noise for test in tests):
        raise JobError("locate: state the same noise for all tests", key=("locate",))


def _check_table(table: LocateTable, model: Model) -> None:
    """Raise an error with its key if a kind is not known or a place does not fit the model."""
    with key_path("locate", "kinds"):
        choose_kinds(table.kinds)
    for name, dofs in (table.places or {}).items():
        with key_path("locate", "places", name):
            replace(model, nonlinear={}).with_elements({name: (CubicSpring(1.0), dofs)})


def _select_lines(test: Test) -> FRF:
    """Return the FRF of a test at the lines of the job."""
    assert isinstance(test.data, FRF)
    if test.lines is None:
        return test.data
    if isinstance(test.lines, str):
        raise JobError(
            f"locate: it requires lines as an array in Hz, or all; found {test.lines!r}",
            key=("method", "lines"),
        )
    return test.data.select(lines=test.lines)
