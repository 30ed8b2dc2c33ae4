"""``[candidates]`` of a job, and `compare_candidates_job`: several models with the same data."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator, ConfigDict, Field, Strict, model_validator

from updyn.candidates.compare import Candidate, compare_candidates
from updyn.candidates.result import ModelComparison
from updyn.errors import JobError, key_path
from updyn.io.atomic import write_json
from updyn.job.base import Table, tables_of
from updyn.job.comparison import COMPARISON_FILES
from updyn.job.folder import check_out, default_out
from updyn.job.job_table import JobTable
from updyn.job.load import check_model
from updyn.job.prepare import prepare
from updyn.job.run import job_selection, make_tests
from updyn.job.schema import DampingTable, ElementTable, Job, ModelTable, ParameterTable
from updyn.outputs.switch import open_folder, replace_files
from updyn.progress import RunStage
from updyn.store.values import plain
from updyn.updating.problem.selection import Selection
from updyn.updating.setup import RunOptions

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine
    from updyn.updating.fit.monitor import Progress

__all__ = ["CANDIDATES", "CandidateTable", "CandidatesTable", "compare_candidates_job", "stages"]

_METHOD = "maximum-likelihood"


class CandidateTable(Table):
    """``[candidates.NAME]``: tables of one candidate, in place of those of the job."""

    model: ModelTable | None = None
    parameter: Annotated[
        tuple[ParameterTable, ...],
        BeforeValidator(tables_of("candidates.NAME.parameter")),
        Strict(False),
    ] = Field(default=(), min_length=1)
    element: Annotated[
        tuple[ElementTable, ...],
        BeforeValidator(tables_of("candidates.NAME.element")),
        Strict(False),
    ] = ()
    damping: Annotated[
        tuple[DampingTable, ...],
        BeforeValidator(tables_of("candidates.NAME.damping")),
        Strict(False),
    ] = ()

    @property
    def given(self) -> dict[str, Any]:
        """The tables that differ from those of the job, by name."""
        return {name: getattr(self, name) for name in self.model_fields_set}


class CandidatesTable(Table):
    """``[candidates]``: two or more candidates by name, and the number of bands held out."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, CandidateTable]
    of_any_name = CandidateTable

    bands: int | None = Field(default=None, ge=2)

    @property
    def by_name(self) -> Mapping[str, CandidateTable]:
        """The candidates by name."""
        return self.__pydantic_extra__

    @model_validator(mode="after")
    def _require_two(self) -> CandidatesTable:
        if len(self.by_name) < 2:
            raise ValueError(
                "expected at least two candidates, such as [candidates.rigid] and"
                " [candidates.elastic]"
            )
        return self


class _CandidatesJobTable(JobTable):
    """``[candidates]``: the work of ``updyn compare``; an update ignores it."""

    schema = CandidatesTable

    def outputs(self, table: CandidatesTable) -> tuple[str, ...]:
        return ()

    def inputs(self, table: CandidatesTable) -> tuple[str, ...]:
        models = [one.model for one in table.by_name.values()]
        return tuple(model.file for model in models if model is not None and model.file)

    def resolve(
        self, table: CandidatesTable, job: Job, relocate: Callable[[str], str]
    ) -> dict[str, Any]:
        """Return the tables of the candidates with relocated files of models."""
        found: dict[str, Any] = table.model_dump(exclude_unset=True, exclude_none=True)
        for name in table.by_name:
            # An empty table would be left out.
            one = found[name] or {"model": job.model.model_dump(exclude_none=True)}
            if "file" in one.get("model", {}):
                one["model"]["file"] = relocate(one["model"]["file"])
            found[name] = one
        return found

    def check_text(self, job: Job) -> None:
        """Check the model of each candidate as that of the job."""
        for name, one in _table(job).by_name.items():
            if one.model is not None:
                with key_path("candidates", name):
                    check_model(one.model)


CANDIDATES = _CandidatesJobTable()


def compare_candidates_job(
    job: Job,
    out: str | Path | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    engine: int | Client | Engine | None = None,
) -> ModelComparison:
    """Compare the candidates of a job and write ``compare.json`` and ``compare.html``.

    `out` is by default the job's stem with ``-compare``. A validation set of the job is left out.
    Nothing is written if a `JobError`, `SolverError` or `StoppedError` is raised.
    """
    from updyn.report import write_candidates

    table, settings = _table(job), _check_method(job)
    out = check_out(job, out or default_out(job, "compare"), COMPARISON_FILES)
    listed = [_prepare_candidate(job, name, one) for name, one in table.by_name.items()]
    options = RunOptions(_METHOD, job.method.options, engine=engine, **settings)
    with open_folder(out):
        check_out(job, out, COMPARISON_FILES)  # again, now that no other run can change the folder
        with job.located(), key_path("candidates"):
            found = compare_candidates(
                listed, options, callback, bands=table.bands, title=job.find_title()
            )
        with replace_files(out, "compare", COMPARISON_FILES) as new:
            write_candidates(found, new / "compare.html")
            write_json(plain(found.to_dict()), new / "compare.json")
    return found


def stages(job: Job) -> list[RunStage]:
    """Return the stages of the comparison of candidates in order."""
    return [*map(RunStage, _table(job).by_name), RunStage("bands")]


def _table(job: Job) -> CandidatesTable:
    table = job.table(CandidatesTable)
    if table is None:
        raise JobError("missing table [candidates] with two or more models", job.path)
    return table


def _check_method(job: Job) -> dict[str, Any]:
    """Return the settings of ``[method]``; raise for a method without a likelihood."""
    with job.located():
        if job.method.name != _METHOD:
            text = f"method.name = {job.method.name!r}: candidates are fitted by {_METHOD!r}"
            raise JobError(text, key=("method", "name"))
        if job.method.regularise is not None:
            text = (
                "method.regularise: it replaces the priors, which the evidence needs; leave it out"
            )
            raise JobError(text, key=("method", "regularise"))
    return job.method.settings


def _prepare_candidate(job: Job, name: str, table: CandidateTable) -> Candidate:
    ready = prepare(job.with_tables(table.given, ("candidates", name)))
    unknowns = Selection.of(job_selection(ready) or ready.parameters)
    return Candidate(name, tuple(make_tests(ready, held_out=False)), unknowns)
