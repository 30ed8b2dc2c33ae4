"""The command that runs every method on one job."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from updyn.errors import InputError

__all__ = ["compare"]


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
    from updyn.cli import DONE, NOT_DETERMINED, STOPPED, _say, _stderr
    from updyn.cli.engine import engine as opened
    from updyn.cli.progress import watch
    from updyn.comparison.table import listing
    from updyn.job import load_job, prepare
    from updyn.job.comparing import check_comparison_out, compare_job, default_comparison_out
    from updyn.report import write_comparison

    if list_:
        _say(listing())
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
    with opened(workers, cluster, engine) as where, watch(_stderr()) as watching:
        found = compare_job(
            loaded,
            folder,
            watching,
            methods=names,
            truth=truth,
            report=write_comparison,
            prepared=ready,
            engine=where,
            fewest=fewest,
            tolerance=tolerance,
            chosen=chosen,
        )
    _say(found.summary())
    _say(f"\nComparison in {folder}: {folder / 'compare.html'}")
    if found.stopped:
        return STOPPED
    return (
        DONE
        if any(row.status in ("converged", "not-identifiable") for row in found)
        else NOT_DETERMINED
    )
