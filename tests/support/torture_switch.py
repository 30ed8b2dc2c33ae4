"""Tortures of sets of results: their process is killed between any two calls of the system."""

from __future__ import annotations

import tempfile
from pathlib import Path

import killed
from torture import EQUAL, OTHER, Outcome, Torture


def tortures() -> list[Torture]:
    """Return the kills of a switch from the files of one run to those of the next."""
    return [Torture("set of results", "kills", _killed)]


def _killed(seed: int, folder: Path) -> Outcome:
    """Equal where the folder holds one of the two sets, as a whole, and all files of the user."""
    with tempfile.TemporaryDirectory(dir=folder) as empty:
        found = killed.outcome(seed, Path(empty))
    if found in ("old", "new"):
        return Outcome(EQUAL, found)
    return Outcome(OTHER, found, failed=True)
