"""`new_faults`: faults that an edit would add to the text of a job."""

from __future__ import annotations

import re
from pathlib import Path

from updyn.errors import JobError
from updyn.job import load_job

__all__ = ["new_faults"]

#: Options of `load_job` with which the commands read a job.
_READINGS: tuple[dict[str, bool], ...] = ({}, {"before_test": True}, {"of_test": True})


def new_faults(path: Path, before: str, after: str) -> list[str]:
    """Return the faults of a job's text that the text before does not have, without file and line.

    Empty if every command that could read the text still can.
    """
    found: dict[str, None] = {}
    for reading in _READINGS:
        faults = _faults(path, after, **reading)
        known = _faults(path, before, **reading) if faults else []
        found |= dict.fromkeys(each for each in faults if each not in known)
    return list(found)


def _faults(path: Path, text: str, **reading: bool) -> list[str]:
    """Return the faults of a text, for commands that read a job with these options."""
    try:
        load_job(path, text=text, **reading)
    except JobError as error:
        place = re.compile(rf"^{re.escape(str(path))}(:\d+)?: ")  # an edit moves lines
        return [place.sub("", line) for line in str(error).splitlines()]
    return []
