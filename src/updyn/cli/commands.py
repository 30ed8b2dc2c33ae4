"""The commands of the command line; slow imports are in their bodies."""

from __future__ import annotations

import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from updyn.cli.brief import (
    brief_candidates,
    brief_check,
    brief_comparison,
    brief_head,
    brief_location,
    brief_modes,
    brief_plan,
    brief_start,
)
from updyn.cli.describe import describe_frf, describe_model, describe_modes
from updyn.cli.new_file import check_free, write_new
from updyn.cli.outcome import describe_outcome
from updyn.cli.progress import show_progress
from updyn.cli.reader_options import parse_reader_options
from updyn.cli.reading import FILE_KINDS, read_anything
from updyn.cli.sections import (
    CHECK,
    CORRELATE,
    RUN,
    CheckResult,
    FinishedRun,
    StartComparison,
    describe_job,
    describe_results,
    join_sections,
)
from updyn.cli.settings import LAYOUT, WAITING
from updyn.cli.terminal import (
    DONE,
    NOT_DETERMINED,
    STOPPED,
    output_width,
    print_note,
    print_outcome,
    print_text,
    stderr,
)
from updyn.errors import InputError, OptionError, StoppedError
from updyn.progress import RunStage

if TYPE_CHECKING:
    from distributed import Client

    from updyn.acceptance.result import Acceptance
    from updyn.demos import Demo
    from updyn.engines import Engine
    from updyn.job import Job, JobRun, Prepared
    from updyn.job.proposal import Inputs
    from updyn.job.start import StartAgreement, StartModel
    from updyn.updating.judge.causes.finding import Finding
    from updyn.updating.judge.counterparts import Counterparts
    from updyn.updating.judge.identifiability import Analysis
    from updyn.updating.problem.selection import Selection

__all__ = [
    "check",
    "compare",
    "convert",
    "correlate",
    "demo",
    "info",
    "modes",
    "new",
    "open_engine",
    "plan",
    "run",
]

Verbose = Annotated[bool, Parameter(("--verbose", "-v"), negative=())]


def new(
    model: Path,
    measurement: Path,
    /,
    *,
    out: Path = Path("job.toml"),
    quantity: str | None = None,
    scale: float | None = None,
    unit: str | None = None,
    model_option: list[str] | None = None,
    test_option: list[str] | None = None,
) -> int:
    """Write a commented job file for a model and a measurement, after a look at both.

    It matches sensors to the model by label, else by coordinates, reports mismatches, and proposes
    unknowns and method. An existing file is never replaced.

    Parameters
    ----------
    model
        The model's file.
    measurement
        The file with measured FRFs.
    out
        The job file to write.
    quantity
        Measured quantity if the file does not state it: receptance, mobility or accelerance.
    scale
        Factor that converts the values to SI if the file does not state it: 9.80665 for g/N.
    unit
        Unit of length of the deck of a model: m, mm or in.
    model_option
        KEY=VALUE: an option of the reader of the model, as in [model]: spc=2. Repeat for more.
    test_option
        KEY=VALUE: an option of the reader of the measurement, as in [test].
    """
    from updyn.job.files import check_encodable
    from updyn.job.proposal import describe_inputs, job_text, read_inputs

    check_encodable(out.name)
    if out.exists():
        raise InputError(f"{out}: exists already; choose another name with --out")
    if not out.parent.is_dir():
        raise InputError(f"{out}: the folder {str(out.parent)!r} does not exist")
    of_model = _join_options({"unit": unit}, model_option, "--model-option")
    of_test = _join_options({"quantity": quantity, "scale": scale}, test_option, "--test-option")
    inputs = read_inputs(model, measurement, of_model, of_test)
    text = job_text(inputs, out, describe_model(inputs.model), _describe_measurement(inputs))
    with out.open("x", encoding="utf-8") as file:
        file.write(text)
    next_step = f"updyn check {shlex.quote(str(out))}"
    print_text(f"{out}: written\n{describe_inputs(inputs)}\n\nNext: {next_step}")
    return DONE


def _describe_measurement(inputs: Inputs) -> str:
    """Return a description of the measurement, without an unknown quantity."""
    text = describe_frf(inputs.frf)
    if inputs.has_quantity:
        return text
    return text.replace(f"FRF: {inputs.frf.quantity}, ", "FRF of a quantity that is not stated, ")


def run(
    job: Path,
    /,
    *,
    out: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    engine: str | None = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
    verbose: Verbose = False,
) -> int:
    """Run a job and write its results: result.json, report.html, run.nc, model.h5, job.toml.

    Ctrl-C ends the run after the lines that are being solved and writes the results so far.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder for the results; by default the job's name without its suffix, in the same folder.
    workers
        Number of processes on this machine; the result does not depend on it.
    cluster
        Address of a Dask scheduler, such as tcp://10.0.0.1:8786, to use its workers instead.
    engine
        Engine of another package, by its registered text.
    resume
        Continue a stopped or interrupted run in that folder; the result is the same as that of an
        uninterrupted run. If nothing was saved, the run starts again and reports this.
    verbose
        Print all tables before the outcome.
    """
    from updyn.job import load_job

    loaded = load_job(job)
    with open_engine(workers, cluster, engine) as chosen:
        done = _run_job(loaded, out, engine=chosen, resume=resume)
    _print_run(loaded, done, verbose=verbose)
    return _find_exit_code(done)


def check(job: Path, /, *, out: Path | None = None, verbose: Verbose = False) -> int:
    """Check a job without running it: data, unknowns, identifiability at the start.

    Prints its findings, and writes the page check.html to DIR: the structure, all channels, maps
    of agreement, modes and identifiability before any fit; no page if report = false in [output].
    Exit code 3 if the data cannot determine all unknowns, or no more measured modes have a
    counterpart in the model than those of another structure would.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder DIR; by default the job's name with -check, in the same folder.
    verbose
        Print all tables before the outcome.
    """
    from updyn.job import check_out, job_analysis, job_selection, load_job, prepare
    from updyn.job.start import (
        agreements_at_start,
        choose_noise_once,
        counterparts_at_start,
        start_models,
    )

    loaded = load_job(job)
    ready = choose_noise_once(prepare(loaded))
    folder = check_out(loaded)
    pages = _find_start_folder(loaded, "check", out)
    selection = job_selection(ready)
    starts = start_models(ready, selection or ready.parameters)
    analysis = job_analysis(ready, selection, starts)
    agreements = agreements_at_start(ready, starts)
    figures = {
        test.name: agreements[test.name].figures if test.name in agreements else {}
        for test in ready.tests
    }
    counterparts = counterparts_at_start(ready, starts)
    faults = _find_faults(ready)
    checked = CheckResult(ready, selection, analysis.report, faults, folder, figures, counterparts)
    print_outcome(join_sections(CHECK, checked), brief_check(checked), verbose=verbose)
    _write_start(
        ready, "check", pages, selection, analysis, faults, agreements, starts, counterparts
    )
    return NOT_DETERMINED if checked.has_few_common_modes or not analysis.report.complete else DONE


def _find_start_folder(job: Job, work: str, out: Path | None) -> Path | None:
    """Return the folder for pages before any fit; None if the job disables the page."""
    from updyn.job import start_folder

    if not job.output.report and out is None:
        return None
    return start_folder(job, work, out)


def _accept_start(ready: Prepared) -> Acceptance | None:
    """Return the acceptance of the model at the start; None without a table ``[accept]``."""
    if "accept" not in ready.job.tables:
        return None
    from updyn.job.acceptance import accept_start

    return accept_start(ready)


def _find_faults(ready: Prepared) -> dict[str, tuple[Finding, ...]]:
    """Return the suspected faults in the data of each test, by its name."""
    from updyn.job import job_findings

    return {test.name: job_findings(test, ready.parameters) for test in ready.tests}


def _write_start(
    ready: Prepared,
    work: str,
    folder: Path | None,
    selection: Selection | None,
    analysis: Analysis,
    faults: Mapping[str, tuple[Finding, ...]],
    agreements: Mapping[str, StartAgreement],
    starts: Mapping[str, StartModel],
    counterparts: Mapping[str, Counterparts] | None = None,
) -> None:
    """Write the pages of a job before any fit, and print their paths."""
    from updyn.job import write_start_pages

    if folder is None:
        return
    pages = write_start_pages(
        ready, work, folder, selection, analysis, faults, agreements, counterparts, starts
    )
    print_text("Before the fit, as a page: " + ", ".join(map(str, pages)))


def demo(
    name: str = "beam",
    /,
    *,
    out: Path | None = None,
    list_: Annotated[bool, Parameter("--list", negative=())] = False,
    verbose: Verbose = False,
) -> int:
    """Run a shipped example: write its inputs to DIR/inputs, run the job, write the results to DIR.

    Where an example has further jobs, their results go to folders in DIR, and the exit code is that
    of the last one. The file demo.txt in DIR compares the results with what is known.

    Parameters
    ----------
    name
        Which example; see --list.
    out
        Folder DIR; by default demo/NAME in the current one.
    list_
        List the examples and do nothing.
    verbose
        Print all tables of each run, and demo.txt, before the outcome.
    """
    from updyn.demos import DEMOS, find_demo
    from updyn.job import load_job

    if list_:
        width = max(len(each) for each in DEMOS)
        for each in DEMOS.values():
            print_text(f"{each.name:<{width}}  {each.description}")
        return DONE
    chosen = find_demo(name)
    folder = Path("demo", chosen.name) if out is None else out
    if folder.exists() and not folder.is_dir():
        raise InputError(f"the output folder {str(folder)!r} is a file; choose another with --out")
    inputs = folder / "inputs"
    job = _write_inputs(inputs, chosen.write_inputs)
    print_note(f"demo {chosen.name}: inputs in {inputs}")
    out, results = folder, []
    while True:
        assert job is not None
        loaded = load_job(job)
        done = _run_job(loaded, out)
        results.append(done.result)
        following = None
        if not done.stopped:
            following = _write_inputs(inputs, lambda at: chosen.next_job(results, at), more=True)
        if following is None:
            break
        _print_step(loaded, done, verbose=verbose)
        job, out = following, folder / following.stem
    if not done.stopped:
        _print_demo(chosen, results, folder, verbose=verbose)
    _print_run(loaded, done, verbose=verbose)
    return _find_exit_code(done)


def _print_step(job: Job, done: JobRun, *, verbose: bool) -> None:
    """Print the verdict of a run that another one follows."""
    from updyn.updating.result import describe_ending

    ran = FinishedRun(job, done)
    outcome = " ".join([describe_ending(done.result), *describe_results(ran)])
    badge = done.result.first.badge
    print_outcome(join_sections(RUN, ran), outcome, verbose=verbose, badge=badge)


def _print_demo(chosen: Demo, results: Sequence[object], folder: Path, *, verbose: bool) -> None:
    """Write what a demo knows about its results to demo.txt, and print the main points."""
    from updyn.outputs.switch import open_folder, replace_files

    text = chosen.epilogue(results, folder / "inputs")
    name = "demo.txt"
    with open_folder(folder), replace_files(folder, "demo", (name,)) as new:
        (new / name).write_text(text + "\n", encoding="utf-8")
    headline = f"{chosen.headline(results)}\nDetails: {folder / name}"
    print_outcome(text, f"{headline}\n", verbose=verbose)


def _write_inputs(
    folder: Path, write: Callable[[Path], Path | None], *, more: bool = False
) -> Path | None:
    """Write inputs of a demo into its folder, with the earlier inputs `more`; return the job."""
    from updyn.outputs.manifest import Manifest, find_obstacles
    from updyn.outputs.switch import PLAN, open_folder, replace_files

    with open_folder(folder), replace_files(folder, "demo") as new:
        before = Manifest.read(folder).entries if more else ()
        for name in before:
            shutil.copyfile(folder / name, new / name)
        job = write(new)
        changed = find_obstacles(folder, [p.name for p in new.iterdir() if p.name != PLAN])
        if changed:
            reasons = ", ".join(f"{str(folder / name)!r} {why}" for name, why in changed.items())
            raise InputError(f"{reasons}; move it away, or choose another folder with --out")
    return None if job is None else folder / job.relative_to(new)


def convert(
    source: Annotated[Path, Parameter("IN")],
    target: Annotated[Path, Parameter("OUT")],
    /,
    *,
    from_: Annotated[str | None, Parameter("--from")] = None,
    to: str | None = None,
    quantity: str | None = None,
    duplicates: str | None = None,
    scalar_direction: str | None = None,
    scale: float | None = None,
    unit: str | None = None,
    force: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Convert a measurement or a model to another format.

    Parameters
    ----------
    source
        File to read; its content decides whether it is a measurement or a model.
    target
        File to write; its suffix decides the format.
    from_
        Format of IN, if its content is ambiguous.
    to
        Format of OUT, if its suffix is ambiguous.
    quantity
        Measured quantity if the file does not state it: receptance, mobility or accelerance.
    duplicates
        Treatment of functions that occur twice; by default the reader refuses them.
    scalar_direction
        Direction of functions without direction in the file.
    scale
        Factor that converts the values to SI if the file does not state it: 9.80665 for g/N.
    unit
        Unit of length of the deck of a model: m, mm or in.
    force
        Replace OUT if it exists.
    """
    from updyn.io import write_frf, write_model

    if target.exists() and os.path.realpath(target) == os.path.realpath(source):
        raise InputError(f"{target}: is the file to read")
    check_free([target], force=force)
    of_frf = {
        "quantity": quantity,
        "duplicates": duplicates,
        "scalar_direction": scalar_direction,
        "scale": scale,
    }
    kinds, options = _select_kinds(("frf", "model"), {"frf": of_frf, "model": {"unit": unit}})
    if from_ is not None:
        options = {kind: {"format": from_, **stated} for kind, stated in options.items()}
    kind, content = read_anything(source, kinds, options)
    write = write_frf if kind == "frf" else write_model
    write_new(target, lambda path: write(content, path, format=to), force=force)
    print_text(f"{target}: {content!r}")
    return DONE


def info(
    file: Path,
    /,
    *,
    quantity: str | None = None,
    unit: str | None = None,
    model_option: list[str] | None = None,
    test_option: list[str] | None = None,
) -> int:
    """Print what a file holds: a measurement, a model, a run, records, modes, a geometry, a plant.

    Parameters
    ----------
    file
        The file.
    quantity
        Measured quantity if the file does not state it.
    unit
        Unit of length of the deck of a model: m, mm or in.
    model_option
        KEY=VALUE: an option of the reader of a model, as in [model]: spc=2. Repeat for more.
    test_option
        KEY=VALUE: an option of the reader of a measurement, as in [test].
    """
    from updyn.outputs.switch import recover

    with suppress(InputError, OSError):  # each file is complete, independent of the others
        recover(file.parent)
    of_unit = {"unit": unit}
    stated: dict[str, Mapping[str, object]] = {
        "contents": of_unit,
        "frf": _join_options({"quantity": quantity}, test_option, "--test-option"),
        "model": _join_options(of_unit, model_option, "--model-option"),
    }
    kinds, options = _select_kinds(tuple(FILE_KINDS), stated)
    kind, content = read_anything(file, kinds, options)
    print_text(FILE_KINDS[kind].describe(content))
    return DONE


def correlate(job: Path, /, *, out: Path | None = None, verbose: Verbose = False) -> int:
    """Compare the model of a job at the start of its unknowns with its measurement.

    Prints the figures of agreement with the data of the fit, and writes the page correlate.html to
    DIR, as updyn check does; no page if report = false in [output]. The limits of a table
    [accept] are applied to the model at the start, and the exit code is 3 if one is not met.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder DIR; by default the job's name with -correlate, in the same folder.
    verbose
        Print all tables before the outcome.
    """
    from updyn.job import job_analysis, job_selection, load_job, prepare
    from updyn.job.modes import correlation_at_start, start_modes, start_modes_text
    from updyn.job.start import (
        StartAgreement,
        choose_noise_once,
        compute_start_frf,
        start_correlation,
        start_models,
    )
    from updyn.modal import ModeSet

    loaded = load_job(job)
    ready = choose_noise_once(prepare(loaded))
    pages = _find_start_folder(loaded, "correlate", out)
    faults = _find_faults(ready)
    selection = None if pages is None else job_selection(ready)
    starts = start_models(ready, selection or ready.parameters)
    agreements = {}
    details, outcome = [describe_job(ready)], [brief_head(ready)]
    for test in ready.tests:
        table = start_modes(test, starts[test.name].modes)
        modes = correlation_at_start(table)
        if isinstance(test.data, ModeSet):
            text = start_modes_text(modes)
            details.append("\n".join(filter(None, [test.name, text])))
            brief = brief_modes(modes, LAYOUT.table_rows, output_width())
            outcome.append("\n".join(filter(None, [test.name, brief])))
            continue
        computed = compute_start_frf(test, starts[test.name])
        found = start_correlation(test, computed)
        agreement = agreements[test.name] = StartAgreement.of(test, computed, table)
        compared = StartComparison(ready, test.name, agreement.figures, found, faults, modes)
        details.append(join_sections(CORRELATE, compared))
        outcome.append(brief_start(compared, output_width()))
    acceptance = _accept_start(ready)
    if acceptance is not None:
        details.append(acceptance.summary())
        outcome.append(acceptance.statement)
    print_outcome("\n\n".join(details), "\n\n".join([*outcome, ""]), verbose=verbose)
    if pages is not None:
        analysis = job_analysis(ready, selection, starts)
        _write_start(ready, "correlate", pages, selection, analysis, faults, agreements, starts)
    return DONE if acceptance is None or acceptance.accepted else NOT_DETERMINED


def compare(
    job: Path | None = None,
    /,
    *,
    methods: str | None = None,
    truth: Path | None = None,
    fewest: Annotated[bool, Parameter(negative=())] = False,
    tolerance: float = 0.01,
    chosen: str = "d-optimal",
    out: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    engine: str | None = None,
    list_: Annotated[bool, Parameter("--list", negative=())] = False,
    verbose: Verbose = False,
) -> int:
    """Run every method on the inputs of a job; write compare.html and compare.json to DIR.

    The row of a method that does not apply gives the reason. Ctrl-C ends the comparison with the
    rows so far. If the job has the table [candidates], its models are compared in place of methods;
    with the table [locate], places and kinds of a nonlinear element.

    Parameters
    ----------
    job
        The job file (TOML). Its method's options go to that method.
    methods
        Names with commas between them; by default every method.
    truth
        TOML or JSON file with known true values of unknowns, to show the errors.
    fewest
        Find the smallest number of lines with which each method still recovers the true values;
        takes several fits per method.
    tolerance
        Largest error of a recovered value, relative; of a loss factor absolute.
    chosen
        Selection of these lines: d-optimal or even.
    out
        Folder DIR; by default the job's name with -compare, in the same folder.
    workers
        Number of processes on this machine.
    cluster
        Address of a Dask scheduler, to use its workers instead.
    engine
        Engine of another package, by its registered text.
    list_
        List the methods, their limitations and sources, and do nothing.
    verbose
        Print all columns and notes before the outcome.
    """
    from updyn.comparison.table import format_methods
    from updyn.job import check_out, load_job, prepare
    from updyn.job.comparison import COMPARISON_FILES, compare_job
    from updyn.job.folder import default_out
    from updyn.updating.fit.methods import METHODS

    if list_:
        print_text(format_methods())
        return DONE
    if job is None:
        raise InputError(
            "which job? updyn compare JOB.toml, or updyn compare --list for the methods"
        )
    loaded = load_job(job)
    compared = [name for name in ("candidates", "locate") if name in loaded.tables]
    if len(compared) > 1:
        raise OptionError(
            f"{job} has [candidates] and [locate]; one of them is compared: leave out the other"
        )
    if compared:
        if methods is not None or truth is not None or fewest:
            raise OptionError(
                f"{job} has [{compared[0]}], which is compared; leave out --methods, --truth and"
                " --fewest, which belong to a comparison of methods"
            )
        if compared == ["locate"]:
            if workers is not None or cluster is not None or engine is not None:
                raise OptionError(
                    f"{job} has [locate], which runs in this process; leave out --workers,"
                    " --cluster and --engine"
                )
            return _locate(loaded, out, verbose=verbose)
        with open_engine(workers, cluster, engine) as opened:
            return _compare_models(loaded, out, opened, verbose=verbose)
    names = None
    if methods is not None:
        names = [name.strip() for name in methods.split(",") if name.strip()]
    folder = check_out(loaded, out or default_out(loaded, "compare"), COMPARISON_FILES)
    ready = prepare(loaded)
    stages = [RunStage(name) for name in names or METHODS]
    with (
        open_engine(workers, cluster, engine) as opened,
        show_progress(stderr(), stages) as display,
    ):
        found = compare_job(
            loaded,
            folder,
            display,
            methods=names,
            truth=truth,
            prepared=ready,
            engine=opened,
            fewest=fewest,
            tolerance=tolerance,
            chosen=chosen,
        )
    outcome = brief_comparison(found, output_width())
    place = f"Comparison in {folder}: {folder / 'compare.html'}"
    print_outcome(found.summary(), f"{outcome}\n{place}", verbose=verbose)
    if found.stopped:
        return STOPPED
    if any(row.status in ("converged", "not-identifiable") for row in found):
        return DONE
    return NOT_DETERMINED


def _compare_models(job: Job, out: Path | None, engine: Engine | None, *, verbose: bool) -> int:
    """Compare the models of ``[candidates]``; return the exit code."""
    from updyn.job.candidates import compare_candidates_job, stages
    from updyn.job.folder import default_out

    folder = out or default_out(job, "compare")
    try:
        with show_progress(stderr(), stages(job), "Stopping after these lines.") as display:
            found = compare_candidates_job(job, folder, display, engine=engine)
    except StoppedError as stopped:
        print_text(f"compare: {stopped}; no results were written")
        return STOPPED
    outcome = brief_candidates(found, output_width())
    place = f"Comparison in {folder}: {folder / 'compare.html'}"
    print_outcome(found.summary(), f"{outcome}\n{place}", verbose=verbose)
    return DONE if found[0].is_fitted else NOT_DETERMINED


def _locate(job: Job, out: Path | None, *, verbose: bool) -> int:
    """Compare the places and kinds of ``[locate]``; return the exit code."""
    from updyn.job.folder import default_out
    from updyn.job.location import locate_job

    folder = out or default_out(job, "compare")
    print_note("Fitting elements to all levels", "dim")
    found = locate_job(job, folder)
    place = f"Comparison in {folder}: {folder / 'compare.html'}"
    outcome = brief_location(found, output_width())
    print_outcome(found.summary(), f"{outcome}\n{place}", verbose=verbose)
    return DONE


def modes(job: Path, /, *, out: Path | None = None, verbose: Verbose = False) -> int:
    """Identify the modes of the job's test; write modes.html and modes.unv to DIR.

    The page shows the stabilisation diagram, in which modes can be picked for the table [modes] of
    the job. An update reads the file by [test] modes. [model] and [[parameter]] may be left out.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder DIR; by default the job's name with -modes, in the same folder.
    verbose
        Print all modes with all columns before the outcome.
    """
    from updyn.job import load_job
    from updyn.job.folder import default_out
    from updyn.job.identification import modes_job

    loaded = load_job(job, of_test=True)
    folder = out or default_out(loaded, "modes")
    found = modes_job(loaded, folder, say=lambda text: print_note(text, "dim"))
    outcome = describe_modes(found, LAYOUT.table_rows, output_width())
    place = f"Modes in {folder}: {folder / 'modes.html'}"
    print_outcome(describe_modes(found), f"{outcome}\n{place}", verbose=verbose)
    return DONE


def plan(
    job: Path,
    /,
    *,
    out: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    engine: str | None = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
    verbose: Verbose = False,
) -> int:
    """Choose sensors and forces before a test; write plan.html and plan.json to DIR.

    The table [plan] of the job defines their numbers, the candidates and the band. [test] may be
    left out. Ctrl-C ends the plan after the lines that are being solved; nothing is chosen then,
    and --resume continues from there.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder DIR; by default the job's name with -plan, in the same folder.
    workers
        Number of processes on this machine; the plan does not depend on it.
    cluster
        Address of a Dask scheduler, to use its workers instead.
    engine
        Engine of another package, by its registered text.
    resume
        Continue a stopped or interrupted plan in that folder; the result is the same as that of an
        uninterrupted one. If nothing was saved, it starts again and reports this.
    verbose
        Print all tables before the outcome.
    """
    from updyn.job import load_job
    from updyn.job.folder import default_out
    from updyn.job.planning import plan_job, stages

    loaded = load_job(job, before_test=True)
    folder = out or default_out(loaded, "plan")
    stopping = "Stopping after these lines; updyn plan --resume goes on from there."
    try:
        with (
            open_engine(workers, cluster, engine) as opened,
            show_progress(stderr(), stages(loaded), stopping) as display,
        ):
            made = plan_job(loaded, folder, display, engine=opened, resume=resume)
    except StoppedError as stopped:
        again = "updyn plan JOB.toml --resume (with the same --out)"
        print_text(f"plan: {stopped}\nTo continue: {again}")
        return STOPPED
    outcome = brief_plan(made, output_width())
    place = f"Plan in {folder}: {folder / 'plan.html'}"
    print_outcome(made.summary(), f"{outcome}\n{place}", verbose=verbose)
    return DONE


# -- parts that several commands use ---------------------------------------------------------------
def _run_job(
    job: Job, out: Path | None, *, engine: Engine | None = None, resume: bool = False
) -> JobRun:
    """Run a job with a display of its progress."""
    from updyn.job import check_out, prepare, run_job
    from updyn.job.run import list_stages

    folder = check_out(job, out)
    ready = prepare(job)
    with show_progress(stderr(), list_stages(job)) as display:
        return run_job(job, folder, display, prepared=ready, engine=engine, resume=resume)


def _print_run(job: Job, done: JobRun, *, verbose: bool) -> None:
    """Print the outcome of a run, and the place of its results."""
    ran, result = FinishedRun(job, done), done.result
    outcome = describe_outcome(result, describe_results(ran), output_width())
    print_outcome(join_sections(RUN, ran), outcome, verbose=verbose, badge=result.first.badge)


def _find_exit_code(done: JobRun) -> int:
    if done.stopped:
        return STOPPED
    return DONE if done.passes else NOT_DETERMINED


def _join_options(
    stated: Mapping[str, object], texts: list[str] | None, flag: str
) -> dict[str, object]:
    """Return the options of a reader: those with a flag of their own, and ``KEY=VALUE``."""
    further = parse_reader_options(texts, flag)
    known = {name: value for name, value in stated.items() if value is not None}
    for name in known.keys() & further.keys():
        raise InputError(f"{name} is given twice, by --{name} and by {flag}")
    return known | further


def _select_kinds(
    kinds: tuple[str, ...], options: Mapping[str, Mapping[str, object]]
) -> tuple[tuple[str, ...], dict[str, dict[str, object]]]:
    """Return the kinds (of `FILE_KINDS`) that a file may have, and the stated options by kind."""
    stated: dict[str, dict[str, object]] = {}
    for kind, values in options.items():
        stated[kind] = {name: value for name, value in values.items() if value is not None}
    if stated["frf"] and stated["model"]:
        of_model, of_frf = (next(iter(stated[kind])) for kind in ("model", "frf"))
        raise InputError(f"{of_model} is an option of a model, {of_frf} of a measurement")
    chosen = tuple(kind for kind in stated if stated[kind])
    return chosen or kinds, stated


_HOST_AND_PORT = re.compile(r".+:[0-9]{1,5}")


@contextmanager
def open_engine(
    workers: int | None, cluster: str | None, registered: str | None = None
) -> Iterator[Engine]:
    """Open the engine of the options, and close it afterwards; `cluster` is a Dask scheduler.

    An `OptionError` is raised if more than one is given, the number is not valid, no scheduler
    answers, or no engine is registered for the text.
    """
    from updyn.engines import choose_engine

    if workers is not None and cluster is not None:
        raise OptionError(
            "--workers and --cluster exclude each other: the work is done here or there"
        )
    if workers is not None and workers < 1:
        raise OptionError(f"--workers {workers}: expected a number of processes from 1 up")
    if registered is not None and not (workers is None and cluster is None):
        raise OptionError("--engine excludes --workers and --cluster")
    with ExitStack() as ending:
        option: int | str | Client | None = workers
        if registered is not None:
            option = registered
        elif cluster is not None:
            option = ending.enter_context(_connect_client(cluster))
        try:
            made = choose_engine(option)
        except OptionError as error:
            if registered is None:
                raise
            raise OptionError(
                f"--engine {registered!r}: no package that is installed registers an engine for"
                " this text; --workers 4 takes processes of this machine, --cluster ADDRESS those"
                " of a Dask cluster"
            ) from error
        ending.callback(made.close)
        yield made


def _connect_client(address: str) -> Client:
    scheme, _, place = address.rpartition("://")
    if scheme in ("", "tcp", "tls") and not _HOST_AND_PORT.fullmatch(place):
        # A client that cannot read its address leaves a thread that ends with a traceback.
        raise OptionError(
            f"--cluster {address!r}: expected host and port, such as tcp://10.0.0.1:8786"
        )
    try:
        from distributed import Client
    except ImportError as error:
        raise OptionError(
            "--cluster needs dask.distributed: pip install 'updyn[cluster]'"
        ) from error
    try:
        # Not the default client: xarray would request a lock from the scheduler, which may have
        # ended, before it writes a file.
        return Client(address, timeout=WAITING.scheduler_time, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is one of these
        raise OptionError(
            f"--cluster {address!r}: no scheduler answers ({' '.join(str(error).split())}); `dask"
            " scheduler` starts one and says its address"
        ) from error
