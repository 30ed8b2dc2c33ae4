"""The commands of the command line; what takes time to load is loaded when it is used."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from updyn.cli.terminal import DONE, NOT_DETERMINED, STOPPED, note, say, stderr, watch
from updyn.errors import InputError, OptionError

if TYPE_CHECKING:
    from distributed import Client

    from updyn.engines import Engine
    from updyn.job import Job, Prepared
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["check", "compare", "convert", "correlate", "demo", "info", "open_engine", "run"]


def run(
    job: Path,
    /,
    *,
    out: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    engine: str | None = None,
    resume: Annotated[bool, Parameter(negative=())] = False,
) -> int:
    """Run a job and write its results: result.json, report.html, run.nc, model.h5, job.toml.

    Ctrl-C ends the run after the lines that are being solved and writes the results so far.

    Parameters
    ----------
    job
        The job file (TOML).
    out
        Folder for the results; by default the job's name without its suffix, beside it.
    workers
        Processes on this machine to spread the work over; the result does not depend on it.
    cluster
        Address of a Dask scheduler, such as tcp://10.0.0.1:8786, to spread the work over its
        workers instead.
    engine
        Engine of another package, by the text that it is registered for.
    resume
        Go on with the run in that folder that was stopped or interrupted, with the same result as
        if it had not been.
    """
    from updyn.job import load_job

    loaded = load_job(job)
    with open_engine(workers, cluster, engine) as chosen:
        return _exit_code(_run(loaded, out, engine=chosen, resume=resume))


def check(job: Path, /) -> int:
    """Say all that can be known about a job without running it, identifiability at the start included.

    Exit code 3 if the data cannot determine all unknowns.

    Parameters
    ----------
    job
        The job file (TOML).
    """
    from updyn.cli.describe import describe_identifiability, describe_parameters
    from updyn.job import (
        check_out,
        default_out,
        job_identifiability,
        job_selection,
        load_job,
        prepare,
    )
    from updyn.job.job_table import JOB_TABLES

    ready = prepare(loaded := load_job(job))
    out = check_out(loaded, default_out(loaded))
    chosen = job_selection(ready)
    found = job_identifiability(ready, chosen)
    say(_overview(ready))
    for test in ready.tests:
        say(f"\n{test.name}\n{test.matching}" if test.name else f"\n{test.matching}")
    say("")
    say(describe_parameters(ready.parameters))
    for name in loaded.tables:
        announced = JOB_TABLES[name].announce(ready)
        if announced:
            say(f"\n{announced}")
    if chosen is not None:
        say(f"\nSelected before the fit:\n{chosen.summary()}")
    say("\nAt the start of the unknowns:")
    say(describe_identifiability(found))
    say(f"\nThe job can be run; results would go to {out}.")
    return DONE if found.complete else NOT_DETERMINED


def demo(
    name: str = "beam",
    /,
    *,
    out: Path | None = None,
    list_: Annotated[bool, Parameter("--list")] = False,
) -> int:
    """Run a shipped example: write its inputs to DIR/inputs, run the job there, put the results in DIR.

    Where an example has further jobs, their results go to folders in DIR, and the last one says the
    exit code.

    Parameters
    ----------
    name
        Which example; see --list.
    out
        Folder DIR; by default demo/NAME in the current one.
    list_
        List the examples and do nothing.
    """
    from updyn.demos import DEMOS, find_demo
    from updyn.job import load_job

    if list_:
        width = max(len(n) for n in DEMOS)
        say("\n".join(f"{d.name:<{width}}  {d.description}" for d in DEMOS.values()))
        return DONE
    chosen = find_demo(name)
    folder = Path("demo", chosen.name) if out is None else out
    if folder.exists() and not folder.is_dir():
        raise InputError(f"the output folder {str(folder)!r} is a file; choose another with --out")
    inputs = folder / "inputs"
    inputs.mkdir(parents=True, exist_ok=True)
    note(f"demo {chosen.name}: inputs in {inputs}")
    job: Path | None = chosen.write_inputs(inputs)
    out, results = folder, []
    while job is not None:
        results.append(_run(load_job(job), out))
        if results[-1].status == "stopped":
            return STOPPED
        job = chosen.next_job(results, inputs)
        if job is not None:
            out = folder / job.stem
            say("")
    if text := chosen.epilogue(results, inputs):
        say("\n" + text)
    return _exit_code(results[-1])


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
    """Convert a measurement or a model to another format. What IN is, is told by its content.

    Parameters
    ----------
    source
        File to read.
    target
        File to write; its suffix says the format.
    from_, to
        Format names, where content or suffix do not tell.
    quantity
        What was measured, where the file does not say: receptance, mobility or accelerance.
    duplicates
        What to do with functions that stand twice; the reader's default is to refuse them.
    scalar_direction
        Direction of functions whose file names none.
    scale
        Factor that turns the values into SI, where the file does not: 9.80665 for g/N.
    unit
        Unit of length of a model's deck, which does not say it: m, mm or in.
    force
        Write over OUT where it exists.
    """
    from updyn.cli.reading import read_anything
    from updyn.io import write_frf, write_model

    if target.exists() and (not force or target.resolve() == source.resolve()):
        same = target.resolve() == source.resolve()
        raise InputError(
            f"{target}:"
            f" {'is the file to read' if same else 'exists already; --force writes over it'}"
        )
    reading = {
        "quantity": quantity,
        "duplicates": duplicates,
        "scalar_direction": scalar_direction,
        "scale": scale,
    }
    reading = {k: v for k, v in reading.items() if v is not None}
    modelled = {} if unit is None else {"unit": unit}
    kinds = ("model",) if modelled else ("frf",) if reading else ("frf", "model")
    if reading and modelled:
        raise InputError(
            f"--unit is about a model, --{next(iter(reading)).replace('_', '-')} about a"
            " measurement"
        )
    options: dict[str, dict[str, Any]] = {
        "frf": {"format": from_, **reading},
        "model": {"format": from_, **modelled},
    }
    kind, content = read_anything(source, kinds, options)
    (write_frf if kind == "frf" else write_model)(content, target, format=to)
    say(f"{target}: {content!r}")
    return DONE


def info(file: Path, /, *, quantity: str | None = None, unit: str | None = None) -> int:
    """Say what is in a file: a measurement, a model, the record of a run, modes, a geometry or a plant.

    Parameters
    ----------
    file
        The file.
    quantity
        What was measured, where the file does not say.
    unit
        Unit of length of a model's deck, which does not say it: m, mm or in.
    """
    from updyn.cli.reading import FILE_KINDS, read_anything

    if quantity is not None and unit is not None:
        raise InputError("--unit is about a model, --quantity about a measurement")
    kinds = ("frf",) if quantity is not None else ("model",) if unit is not None else None
    stated = {"frf": {"quantity": quantity}, "model": {"unit": unit}}
    options = {
        kind: {k: v for k, v in given.items() if v is not None} for kind, given in stated.items()
    }
    kind, content = read_anything(file, kinds, options)
    say(FILE_KINDS[kind].describe(content))
    return DONE


def correlate(job: Path, /) -> int:
    """Compare the model of a job with its measurement as they are, without updating.

    Parameters
    ----------
    job
        The job file (TOML).
    """
    from updyn.correlation import correlate as compare
    from updyn.job import load_job, prepare
    from updyn.text_table import text_table

    ready = prepare(load_job(job))
    say(_overview(ready))
    for test in ready.tests:
        found = compare(test.model, test.frf)
        say(f"\n{test.name}" if test.name else "")
        say(text_table(("figure", "value"), [[k, f"{v:.4g}"] for k, v in found.figures().items()]))
        rows = found.by_response()
        names = list(next(iter(rows.values())))
        said = [[label, *(f"{v:.4g}" for v in r.values())] for label, r in rows.items()]
        say("\n" + text_table(("response", *names), said))
    return DONE


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
) -> int:
    """Run every method on the inputs of a job: one table here, compare.html and compare.json in DIR.

    A method that does not apply has a row that says why. Ctrl-C ends it with the rows so far.

    Parameters
    ----------
    job
        The job file (TOML). Its method's options go to that method.
    methods
        Names with commas between them; by default every method.
    truth
        TOML or JSON file with true values of unknowns, where they are known: the errors are shown,
        too.
    fewest
        Seek the fewest lines with which each method still recovers; takes several fits a method.
    tolerance
        How close counts as recovered, as a share (of a loss factor: as it is).
    chosen
        How the fewest lines are chosen: d-optimal or even.
    out
        Folder DIR; by default the job's name with -compare, beside it.
    workers
        Processes on this machine to spread the work over.
    cluster
        Address of a Dask scheduler to spread the work over its workers instead.
    engine
        Engine of another package, by the text that it is registered for.
    list_
        List the methods, what they cannot update and where they come from, and do nothing.
    """
    from updyn.comparison.table import listing
    from updyn.job import load_job, prepare
    from updyn.job.comparison import check_comparison_out, compare_job, default_comparison_out

    if list_:
        say(listing())
        return DONE
    if job is None:
        raise InputError(
            "which job? updyn compare JOB.toml, or updyn compare --list for the methods"
        )
    loaded = load_job(job)
    names = (
        None if methods is None else [name.strip() for name in methods.split(",") if name.strip()]
    )
    folder = check_comparison_out(loaded, default_comparison_out(loaded) if out is None else out)
    ready = prepare(loaded)
    with open_engine(workers, cluster, engine) as where, watch(stderr()) as watching:
        found = compare_job(
            loaded,
            folder,
            watching,
            methods=names,
            truth=truth,
            prepared=ready,
            engine=where,
            fewest=fewest,
            tolerance=tolerance,
            chosen=chosen,
        )
    say(found.summary())
    say(f"\nComparison in {folder}: {folder / 'compare.html'}")
    if found.stopped:
        return STOPPED
    return (
        DONE
        if any(row.status in ("converged", "not-identifiable") for row in found)
        else NOT_DETERMINED
    )


# -- what they share ---------------------------------------------------------------------------------------
def _run(
    job: Job, out: Path | None, *, engine: Engine | None = None, resume: bool = False
) -> UpdateResult | JointResult:
    from updyn.job import check_out, default_out, prepare, run_job

    folder = check_out(job, default_out(job) if out is None else out)
    ready = prepare(job)
    with watch(stderr()) as watching:
        done = run_job(job, folder, watching, prepared=ready, engine=engine, resume=resume)
    result = done.result
    say(done.summary())
    first = "report.html" if job.output.report else "result.json"
    say(f"\nResults in {folder}: {folder / first}")
    if result.status in ("stopped", "max-iterations"):
        more = "" if result.status == "stopped" else ", with more max_iterations"
        say(f"To go on from here{more}: updyn run JOB.toml --resume (with the same --out)")
    return result


def _exit_code(result: UpdateResult | JointResult) -> int:
    return {"converged": DONE, "stopped": STOPPED}.get(result.status, NOT_DETERMINED)


def _overview(ready: Prepared) -> str:
    job = ready.job
    lines = [f"{job.title or job.path.stem}: {job.method.name}"]
    for test in ready.tests:
        held, fitted = test.job.validation, test.fitted
        lines += [
            *([f"{test.name}:"] if test.name else []),
            f"model: {test.model!r}",
            f"test: {test.frf!r}, all matched to DOFs of the model",
            f"fit: {len(fitted.freq)} lines, {len(fitted.responses)} responses, lines to use: "
            + (
                job.method.lines
                if isinstance(job.method.lines, str)
                else str(len(job.method.lines or fitted.freq))
            )
            + ("" if held is None else f"; held out: {', '.join(str(h) for h in held)}"),
        ]
    return "\n".join(lines)


_PATIENCE_S = 10


@contextmanager
def open_engine(
    workers: int | None, cluster: str | None, registered: str | None = None
) -> Iterator[Engine]:
    """Open the engine that the options name, and close it afterwards.

    Parameters
    ----------
    workers : int, optional
        Number of processes.
    cluster : str, optional
        Address of a Dask scheduler.
    registered : str, optional
        Text that an engine of another package is registered for.

    Raises
    ------
    OptionError
        If more than one is given, the number is not one of processes, no scheduler answers, or no
        engine is registered for the text.
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
            option = ending.enter_context(_client(cluster))
        made = choose_engine(option)
        ending.callback(made.close)
        yield made


def _client(address: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise OptionError(
            "--cluster needs dask.distributed: pip install 'updyn[cluster]'"
        ) from error
    try:
        # Not as the default: xarray would ask the scheduler, perhaps gone by then, for a lock
        # before it writes a file.
        return Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:  # TimeoutError is one of these
        raise OptionError(
            f"--cluster {address!r}: no scheduler answers ({' '.join(str(error).split())}); `dask"
            " scheduler` starts one and says its address"
        ) from error
