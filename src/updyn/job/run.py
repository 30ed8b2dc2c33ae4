"""`run_job`: run a job and replace its output folder as a whole when the run has finished."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from updyn.errors import InputError, JobError, UpdynError, UpdynWarning
from updyn.frf import FRF
from updyn.io import write_model, write_properties
from updyn.job.folder import (
    can_resume,
    check_out,
    earlier_outputs,
    format_resolved_job,
    outputs,
    run_journal,
)
from updyn.job.job_table import JOB_TABLES
from updyn.job.modes import modal_texts, with_modes
from updyn.job.prepare import prepare
from updyn.job.prepared import Prepared
from updyn.job.schema import Job
from updyn.job.start import StartModel
from updyn.modal import ModeSet
from updyn.outputs.switch import open_folder, replace_files
from updyn.progress import RunStage, asks_to_stop
from updyn.store.netcdf import load_libraries
from updyn.store.result import write_result, write_result_json
from updyn.updating.fit.methods import make_method, options_of
from updyn.updating.fit.monitor import CAUSES, JUDGE, Progress
from updyn.updating.judge.selection import cluster_jointly, select_jointly
from updyn.updating.judge.settings import SEPARATION
from updyn.updating.problem.data import Test
from updyn.updating.problem.selection import Selection
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.update import start_analysis, update, update_jointly

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine
    from updyn.updating.judge.identifiability import Analysis, Identifiability

__all__ = [
    "JobRun",
    "job_analysis",
    "job_identifiability",
    "job_selection",
    "list_stages",
    "locate_update_errors",
    "make_tests",
    "run_job",
]

#: Statuses after which a run can be resumed.
_UNFINISHED = ("stopped", "max-iterations")
#: Keys of ``[selection]`` for the arguments of `updyn.cluster` and `updyn.select`.
_SELECTION_KEYS: Mapping[str | int, tuple[str, ...]] = {
    "threshold": ("selection", "cluster"),
    "n": ("selection", "n"),
    "max_collinearity": ("selection", "max_collinearity"),
}


@dataclass(frozen=True, slots=True, eq=False)
class JobRun:
    """A finished run of a job.

    Attributes
    ----------
    result : UpdateResult or JointResult
        The update; a `JointResult` for several tests.
    further : mapping of str to object
        Results of tables such as ``[uncertainty]`` and ``[plant]``, by table name.
    folder : Path
        The output folder.
    stopped : bool
        Whether the caller stopped the run; `further` then holds the results obtained so far.
    """

    result: UpdateResult | JointResult
    further: Mapping[str, Any]
    folder: Path
    stopped: bool = False

    @property
    def passes(self) -> bool:
        """Whether the update is usable and the results of all further tables pass."""
        tables = (JOB_TABLES[name].passes(found) for name, found in self.further.items())
        return self.result.usable and all(tables)

    def summary(self) -> str:
        """Return the update and the results of further tables as text."""
        texts = [self.result.summary(), *modal_texts(self.result)]
        texts += [JOB_TABLES[name].summary(found) for name, found in self.further.items()]
        return "\n\n".join(text for text in texts if text)


def list_stages(job: Job) -> list[RunStage]:
    """Return the stages of a run of a job in order, as its progress names them."""
    stages = [RunStage("start")]
    for name, most_steps in make_method(job.method.name, job.method.options).stages:
        stages.append(RunStage(name, most_steps))
    stages += [RunStage(JUDGE), RunStage(CAUSES)]
    for name, table in job.tables.items():
        # Progress of a table counts its pieces of work as lines of one step.
        stages += [RunStage(begin, 1) for begin in JOB_TABLES[name].stages(table)]
    if job.output.report:
        stages.append(RunStage("report"))
    return stages


@dataclass(slots=True)
class _StopTracker:
    """Progress callback of a run that remembers whether the caller asked to stop."""

    callback: Callable[[Progress], bool | None] | None
    stopped: bool = False

    def __call__(self, progress: Progress) -> bool:
        """Report the progress; return whether to stop."""
        if self.callback is not None:
            self.stopped = asks_to_stop(self.callback(progress)) or self.stopped
        return self.stopped


def run_job(
    job: Job,
    out: str | Path | None = None,
    callback: Callable[[Progress], bool | None] | None = None,
    *,
    prepared: Prepared | None = None,
    engine: int | Client | Engine | None = None,
    resume: bool = False,
) -> JobRun:
    """Run a job and write its folder.

    Parameters
    ----------
    job : Job
        From `load_job`.
    out : path, optional
        The output folder; by default the job's stem, next to the job. Files of earlier runs
        (listed in its ``manifest.json``) are replaced together when this run has finished; other
        files stay.
    callback : callable, optional
        Called with a `Progress` after every step and between blocks of lines; returning True stops
        the run.
    prepared : Prepared, optional
        From `prepare`, if already called.
    engine : None, int, dask.distributed Client or Engine
        Engine of the computations, as for `updyn.update`.
    resume : bool
        Resume the run in `out` that was stopped or interrupted, or ended at the largest number of
        steps. The result equals that of an uninterrupted run. A further table that was stopped is
        computed again. If nothing was saved, the run starts from the beginning, with a warning.

    Returns
    -------
    JobRun
        Files in `out`: ``result.json``, ``run.nc``, ``model.h5``, ``job.toml`` (with all defaults;
        can be run from there), the files of ``[uncertainty]``, ``[plant]`` and ``[output]
        properties`` and, unless the job turns it off, ``report.html``. With several tests, each
        has ``model.h5``, ``run.nc`` and ``report.html`` in a folder of its name. Until the run has
        finished, the folder also holds ``run.journal``, which `resume` needs.

    Raises
    ------
    InputError
        If the job, a file or the output folder cannot be used, another process is writing to the
        folder, or the saved journal belongs to another run; nothing is written then.
    SolverError
        If the model cannot be solved at its start values; nothing is written.

    Warns
    -----
    UpdynWarning
        If the job asks for an uncertainty or a plant that cannot be computed, or there is nothing
        to resume.
    """
    out = check_out(job, out)
    ready = prepare(job) if prepared is None else prepared
    caller = _StopTracker(callback)
    with open_folder(out):
        check_out(job, out)  # again, now that no other run can change the folder
        names = (*outputs(job), *earlier_outputs(job, out))
        resume = resume and can_resume(out)
        load_libraries()
        with run_journal(out) as journal:
            result = _run_update(ready, caller, engine=engine, checkpoint=journal, resume=resume)
            result = with_modes(result)
            further = _run_further_tables(ready, result, caller, engine)
        with replace_files(out, "run", names) as new:
            _write_files(result, job, out, new)
            for name, found in further.items():
                JOB_TABLES[name].write(found, job, new)
            if job.output.report:
                _announce(callback, "report", result)
                _write_reports(result, new, further)
        if not (caller.stopped or result.status in _UNFINISHED):
            journal.unlink(missing_ok=True)
    return JobRun(result, further, out, caller.stopped)


def job_selection(prepared: Prepared) -> Selection | None:
    """Cluster and select the unknowns of a job as in its ``[selection]``.

    Parameters
    ----------
    prepared : Prepared
        From `prepare`.

    Returns
    -------
    Selection or None
        None if the job has no such table; all unknowns are fitted then.

    Raises
    ------
    JobError
        If the table does not fit the unknowns, or lines or noise do not fit the data.
    SolverError
        If the model cannot be solved at a line.
    """
    table = prepared.job.selection
    if table is None:
        return None
    tests = make_tests(prepared, held_out=False)
    selection = Selection(prepared.parameters)
    with locate_update_errors(prepared.job):
        if table.cluster is not None:
            selection = cluster_jointly(tests, selection, table.cluster)
        if table.n is not None or table.max_collinearity is not None:
            limit = table.max_collinearity or SEPARATION.most_collinearity
            selection = select_jointly(tests, selection, table.n, limit)
    return selection


def job_identifiability(prepared: Prepared, selection: Selection | None = None) -> Identifiability:
    """Return the identifiability of the unknowns from the job's data, at their start values.

    Parameters
    ----------
    prepared : Prepared
        From `prepare`.
    selection : Selection, optional
        From `job_selection`, if only some of the unknowns are fitted.

    Returns
    -------
    Identifiability

    Raises
    ------
    JobError
        If the lines or the noise of ``[method]`` do not fit the data.
    SolverError
        If the model cannot be solved at a line.
    """
    return job_analysis(prepared, selection).report


def job_analysis(
    prepared: Prepared,
    selection: Selection | None = None,
    starts: Mapping[str, StartModel] = MappingProxyType({}),
) -> Analysis:
    """Return the matrices behind `job_identifiability`.

    Parameters
    ----------
    prepared, selection
        As for `job_identifiability`.
    starts : mapping of str to StartModel, optional
        From `start_models`, whose reduced models are used.

    Returns
    -------
    Analysis

    Raises
    ------
    JobError, SolverError
        As `job_identifiability`.
    """
    tests = make_tests(prepared, held_out=False)
    noises = {test.name: test.noise for test in prepared.tests if test.noise is not None}
    reduced = {name: one.reduced for name, one in starts.items() if one.reduced is not None}
    with locate_update_errors(prepared.job):
        return start_analysis(tests, selection or prepared.parameters, noises, reduced)


def make_tests(prepared: Prepared, *, held_out: bool = True) -> list[Test]:
    """Return the tests as arguments of the update, with or without their validation sets."""
    tests = []
    for test in prepared.tests:
        job = test.job
        data: FRF | ModeSet = test.data
        validation = job.validation
        if not held_out:
            data, validation = test.fitted, None
        lines = None if job.has_modes else job.lines_to_fit
        tests.append(Test(test.model, data, test.name, lines, job.noise, validation))
    return tests


def _run_update(
    ready: Prepared, callback: Callable[[Progress], bool | None] | None, **running: object
) -> UpdateResult | JointResult:
    """Run the update; `running` holds engine, checkpoint and whether to resume."""
    job, method = ready.job, ready.job.method
    options: dict[str, Any] = {
        "method": method.name,
        "callback": callback,
        "title": ready.title,
    }
    options |= running | method.options | method.settings
    if ready.modes:
        _check_fits_modes(ready)
        options["modes"] = ready.modes_option
    tests, unknowns = make_tests(ready), job_selection(ready) or ready.parameters
    with locate_update_errors(job):
        if len(tests) > 1:
            return update_jointly(tests, unknowns, **options)
        (test,) = tests
        options |= {"lines": test.lines, "noise": test.noise, "validation": test.validation}
        return update(test.model, test.data, unknowns, **options)


def _check_fits_modes(ready: Prepared) -> None:
    """Raise if the method does not fit modes."""
    method = ready.job.method.name
    if "modes" in options_of(method):
        return
    part = next(test.job for test in ready.tests if test.modes is not None)
    with part.located():
        text = f"test.modes: method {method!r} fits FRFs and takes no modes; leave them out"
        raise JobError(text, key=("test", "modes"))


@contextmanager
def locate_update_errors(job: Job) -> Iterator[None]:
    """Add file and line of the key of ``[method]`` or ``[selection]`` to errors of the update."""
    with job.located():
        try:
            yield
        except JobError:
            raise
        except InputError as error:
            if error.key and error.key[0] in _SELECTION_KEYS:
                error.key = _SELECTION_KEYS[error.key[0]]
            else:
                error.key = ("method", *error.key)
            raise


def _run_further_tables(
    ready: Prepared,
    result: UpdateResult | JointResult,
    caller: _StopTracker,
    engine: object,
) -> dict[str, object]:
    further: dict[str, object] = {}
    for name in ready.job.tables:
        try:
            found = JOB_TABLES[name].run(ready, result, further, caller, engine)
        except UpdynError as error:
            text = f"{ready.job.path}: [{name}] is left out: {error}"
            warnings.warn(text, UpdynWarning, stacklevel=3)
            continue
        if found is not None:
            further[name] = found
        if caller.stopped:
            break
    return further


def _write_files(result: UpdateResult | JointResult, job: Job, out: Path, folder: Path) -> None:
    for target, one in _pair_with_folders(result, folder):
        target.mkdir(exist_ok=True)
        write_model(one.model, target / "model.h5")
        write_result(one, target / "run.nc")
    if job.output.properties is not None and job.model.file is not None:
        source = job.beside(job.model.file)
        target = folder / job.output.properties
        write_properties(one, source, target, format=job.model.format)
    (folder / "job.toml").write_text(format_resolved_job(job, out, result.title), encoding="utf-8")
    write_result_json(result, folder / "result.json")


def _announce(
    callback: Callable[[Progress], bool | None] | None,
    stage: str,
    result: UpdateResult | JointResult,
) -> None:
    """Report the start of a stage after the update that cannot be stopped."""
    if callback is not None:
        steps = result.first.iterations
        callback(Progress(stage, len(result.first.history), math.nan, 0, 0, steps))


def _pair_with_folders(
    result: UpdateResult | JointResult, folder: Path
) -> list[tuple[Path, UpdateResult]]:
    if isinstance(result, UpdateResult):
        return [(folder, result)]
    return [(folder / name, one) for name, one in result.results.items()]


def _write_reports(
    result: UpdateResult | JointResult, folder: Path, further: Mapping[str, Any]
) -> None:
    from updyn.report import write_report
    from updyn.report.section import list_shown_objects

    shown = {name: found for name, found in further.items() if name in list_shown_objects()}
    write_report(result, folder / "report.html", **shown)
    for target, one in _pair_with_folders(result, folder):
        if target != folder:
            write_report(one, target / "report.html")
