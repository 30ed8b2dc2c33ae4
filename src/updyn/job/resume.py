"""Going on with a run that was interrupted: its journal, beside its results."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from updyn.errors import InputError, JobError
from updyn.job.schema import Job

__all__ = ["JOURNAL", "journal_of"]

#: Holds every evaluation of a run that has not finished; see `updyn.updating.fit.journal`.
JOURNAL = "run.journal"


@contextmanager
def journal_of(job: Job, out: Path, *, resume: bool) -> Iterator[Path]:
    """Give the journal of a run; a run that is refused leaves none, one that breaks down does.

    Parameters
    ----------
    job : Job
        The job.
    out : Path
        Folder of the run.
    resume : bool
        Whether there has to be one to go on with.

    Yields
    ------
    Path
        The file; it need not exist otherwise.

    Raises
    ------
    JobError
        If there is nothing to go on with.
    """
    journal = out / JOURNAL
    there = journal.is_file()
    if resume and not there:
        raise JobError(_nothing(out), job.path)
    try:
        yield journal
    except InputError:
        if not there:
            journal.unlink(missing_ok=True)
        raise


def _nothing(out: Path) -> str:
    try:
        status = json.loads((out / "result.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError):
        return f"nothing to resume: {str(out / JOURNAL)!r} does not exist"
    return (
        f"nothing to resume: the run in {str(out)!r} has ended ({status}) and needs no journal;"
        " leave out --resume"
    )
