"""Errors of what a job names, at the line of the job that they belong to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from updyn.errors import InputError, JobError
from updyn.job.schema import Job

__all__ = ["located"]


@contextmanager
def located(job: Job, *place: str | int) -> Iterator[None]:
    """Give an error the line of the job that it belongs to."""
    try:
        yield
    except JobError:
        raise
    except InputError as error:
        raise job.error(str(error), *place) from error
