"""Run the examples in the docstrings of the public names.

    python tools/doctests.py

Each docstring in an empty folder of its own, with `updyn` imported; what it shows has to come out.
"""

from __future__ import annotations

import doctest
import importlib
import inspect
import io
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import updyn

NAMES = Path(__file__).parents[1] / "docs" / "public-names.txt"


def public_objects() -> Iterator[tuple[str, Any]]:
    """Return every public function and class, by its name."""
    for name in NAMES.read_text(encoding="utf-8").split():
        room, _, short = name.rpartition(".")
        thing = getattr(importlib.import_module(room), short)
        if inspect.isclass(thing) or inspect.isroutine(thing):
            yield name, thing


def examples(name: str, thing: Any) -> list[doctest.DocTest]:
    """Return the examples of a function, or of a class and its methods."""
    found = doctest.DocTestFinder(exclude_empty=True).find(
        thing, name, module=False, globs={"updyn": updyn}
    )
    return [test for test in found if test.examples]


def failure(test: doctest.DocTest) -> str:
    """Run the examples of a docstring; return what went wrong, nothing where all came out."""
    said = io.StringIO()
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            doctest.DocTestRunner(verbose=False).run(test, out=said.write)
        finally:
            os.chdir(here)
    return said.getvalue()


def main() -> int:
    """Run all; the exit code is 1 where an example does not hold."""
    failed = ran = 0
    for name, thing in public_objects():
        for test in examples(name, thing):
            ran += 1
            if text := failure(test):
                failed += 1
                print(text)
    print(f"{ran} docstrings with examples, {failed} of them wrong")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
