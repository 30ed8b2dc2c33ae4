"""The command line. Thin: it reads words, calls the library and prints; what takes time to load is loaded when used.

Exit codes: 0 the run converged with all unknowns determined; 2 bad input or usage, with one message
on stderr and nothing written over; 3 the run ended without that, with its results written; 130
stopped by the user.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from updyn import __version__
from updyn.cli.comparing import compare
from updyn.control.command import describe_planted, describe_wish, plant
from updyn.errors import InputError, UpdynError, UpdynWarning

if TYPE_CHECKING:
    from rich.console import Console

    from updyn.control.job.plant_result import Planted
    from updyn.engines import Engine
    from updyn.job import Job, Prepared
    from updyn.uncertainty.draws import Draws
    from updyn.uncertainty.profile import Profiles
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["BAD_INPUT", "DONE", "NOT_DETERMINED", "STOPPED", "main"]

DONE, BAD_INPUT, NOT_DETERMINED, STOPPED = 0, 2, 3, 130

app = App(
    name="updyn",
    version=__version__,
    help="Finite-element model updating from measured frequency response functions.",
    help_epilogue=(
        "Exit codes: 0 converged with all unknowns determined; 2 bad input; 3 ended without that,"
        " results written; 130 stopped by the user."
    ),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the program's name; None: those of this process.

    Returns
    -------
    int
        The exit code.
    """
    with _warnings_as_notes():
        try:
            command, bound, _ = app.parse_args(
                sys.argv[1:] if arguments is None else list(arguments),
                exit_on_error=False,
                print_error=False,
            )
            code = command(*bound.args, **bound.kwargs)
            return code if isinstance(code, int) else DONE
        except CycloptsError as error:
            return _complain(f"{error}\nTry: updyn --help")
        except UpdynError as error:
            return _complain(str(error))
        except OSError as error:
            return _complain(
                f"{error.filename}: {error.strerror}" if error.filename else str(error)
            )
        except KeyboardInterrupt:
            _note("stopped; no results were written", "yellow")
            return STOPPED


# -- commands ----------------------------------------------------------------------------------------------
@app.command
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
    from updyn.cli.engine import engine as opened
    from updyn.job import load_job

    loaded = load_job(job)
    with opened(workers, cluster, engine) as chosen:
        return _exit_code(_run(loaded, out, engine=chosen, resume=resume))


@app.command
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

    ready = prepare(loaded := load_job(job))
    out = check_out(loaded, default_out(loaded))
    chosen = job_selection(ready)
    found = job_identifiability(ready, chosen)
    _say(_overview(ready))
    for test in ready.tests:
        _say(f"\n{test.name}\n{test.matching}" if test.name else f"\n{test.matching}")
    _say("")
    _say(describe_parameters(ready.parameters))
    if asked := describe_wish(ready):
        _say(f"\n{asked}")
    if chosen is not None:
        _say(f"\nSelected before the fit:\n{chosen.summary()}")
    _say("\nAt the start of the unknowns:")
    _say(describe_identifiability(found))
    _say(f"\nThe job can be run; results would go to {out}.")
    return DONE if found.complete else NOT_DETERMINED


@app.command
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
        _say("\n".join(f"{d.name:<{width}}  {d.description}" for d in DEMOS.values()))
        return DONE
    chosen = find_demo(name)
    folder = Path("demo", chosen.name) if out is None else out
    if folder.exists() and not folder.is_dir():
        raise InputError(f"the output folder {str(folder)!r} is a file; choose another with --out")
    inputs = folder / "inputs"
    inputs.mkdir(parents=True, exist_ok=True)
    _note(f"demo {chosen.name}: inputs in {inputs}")
    job: Path | None = chosen.write_inputs(inputs)
    out, results = folder, []
    while job is not None:
        results.append(_run(load_job(job), out))
        if results[-1].status == "stopped":
            return STOPPED
        job = chosen.next_job(results, inputs)
        if job is not None:
            out = folder / job.stem
            _say("")
    if text := chosen.epilogue(results, inputs):
        _say("\n" + text)
    return _exit_code(results[-1])


@app.command
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
    _say(f"{target}: {content!r}")
    return DONE


@app.command
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
    from updyn.cli.describe import describe
    from updyn.cli.reading import KINDS, read_anything

    if quantity is not None and unit is not None:
        raise InputError("--unit is about a model, --quantity about a measurement")
    kinds = ("frf",) if quantity is not None else ("model",) if unit is not None else tuple(KINDS)
    stated = {"frf": {"quantity": quantity}, "model": {"unit": unit}}
    options = {
        kind: {k: v for k, v in given.items() if v is not None} for kind, given in stated.items()
    }
    _, content = read_anything(file, kinds, options)
    _say(describe(content))
    return DONE


@app.command
def correlate(job: Path, /) -> int:
    """Compare the model of a job with its measurement as they are, without updating.

    Parameters
    ----------
    job
        The job file (TOML).
    """
    from updyn.cli.describe import table
    from updyn.correlation import correlate as compare
    from updyn.job import load_job, prepare

    ready = prepare(load_job(job))
    _say(_overview(ready))
    for test in ready.tests:
        found = compare(test.model, test.frf)
        _say(f"\n{test.name}" if test.name else "")
        _say(table(("figure", "value"), [[k, f"{v:.4g}"] for k, v in found.figures().items()]))
        rows = found.by_response()
        names = list(next(iter(rows.values())))
        said = [[label, *(f"{v:.4g}" for v in r.values())] for label, r in rows.items()]
        _say("\n" + table(("response", *names), said))
    return DONE


app.command(compare)
app.command(plant)


# -- what they share ---------------------------------------------------------------------------------------
def _run(
    job: Job, out: Path | None, *, engine: Engine | None = None, resume: bool = False
) -> UpdateResult | JointResult:
    from updyn.cli.progress import watch
    from updyn.job import check_out, default_out, prepare, run_job
    from updyn.report import write_report

    folder = check_out(job, default_out(job) if out is None else out)
    ready = prepare(job)
    besides: list[str] = []
    with watch(_stderr()) as watching:
        result = run_job(
            job,
            folder,
            watching,
            report=write_report,
            prepared=ready,
            engine=engine,
            resume=resume,
            further=lambda found, planted: besides.extend(_further(found, planted)),
        )
    _say("\n\n".join([result.summary(), *besides]))
    first = "report.html" if job.output.report else "result.json"
    _say(f"\nResults in {folder}: {folder / first}")
    if result.status in ("stopped", "max-iterations"):
        more = "" if result.status == "stopped" else ", with more max_iterations"
        _say(f"To go on from here{more}: updyn run JOB.toml --resume (with the same --out)")
    return result


def _further(found: Draws | Profiles | None, planted: Planted | None) -> Iterator[str]:
    """Yield what a run found beside its result, as text."""
    if found is not None:
        from updyn.report.uncertain import level_of
        from updyn.uncertainty.draws import Draws

        yield found.summary(level_of(found)) if isinstance(found, Draws) else found.summary()
    if planted is not None:
        yield describe_planted(planted)


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


def _stderr() -> Console:
    from rich.console import Console

    return Console(stderr=True)


def _note(text: str, style: str | None = None) -> None:
    _stderr().print(text, style=style, markup=False, emoji=False, highlight=False, soft_wrap=True)


def _complain(message: str) -> int:
    _note(f"error: {message}", "red")
    return BAD_INPUT


def _say(text: str) -> None:
    """Print to stdout; a reader that has gone away (``updyn info FILE | head``) is not an error."""
    try:
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _warnings_as_notes() -> Iterator[None]:
    """Show each `UpdynWarning` once, as a short note; leave other warnings as they are."""
    seen: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", UpdynWarning)
        others = warnings.showwarning

        def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
            if not issubclass(category, UpdynWarning):
                others(message, category, *where, **more)
            elif str(message) not in seen:
                seen.add(str(message))
                _note(f"note: {message}", "yellow")

        warnings.showwarning = show
        yield
