"""Code blocks of the pages, in order, and how each is run."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from places import ROOT
from updyn.cli import main
from window import serving

__all__ = ["ROOT", "Block", "blocks", "run_console", "run_python", "save_toml"]


_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_EXIT = re.compile(r"\s+# exit (\d+)$")
#: Lines of a console block that are not run, by their first words: they install, and run these very
#: tests.
SKIPPED = ("make demo", "make test", "pip install .")


@dataclass(frozen=True)
class Block:
    """A code block: its language, its text, and the line on which it starts."""

    language: str
    text: str
    line: int


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for found in _FENCE.finditer(text):
        yield Block(found[1], found[2], text.count("\n", 0, found.start()) + 2)


def run_console(block: Block, where: str) -> int:
    """Run each line in the current folder; return how many were run.

    In this process: to start Python and load the libraries takes as long as most commands.
    `tests/unit/cli/test_process.py` has commands in processes of their own.
    """
    done = 0
    for number, line in enumerate(block.text.splitlines(), block.line):
        if line in SKIPPED:
            continue
        expected = _EXIT.search(line)
        words = shlex.split(_EXIT.sub("", line))
        assert words[0] == "updyn", f"{where}:{number}: do not know how to run {line!r}"
        if words[1] == "serve":
            with serving(Path.cwd(), *words[2:]) as server:
                assert server.shows("updyn"), f"{where}:{number}: {line}"
            done += 1
            continue
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(words[1:])
        said = f"{where}:{number}: {line}\n{out.getvalue()}\n{err.getvalue()}"
        assert code == (int(expected[1]) if expected else 0), said
        assert out.getvalue(), said
        done += 1
    return done


def run_python(block: Block, where: str, namespace: dict[str, Any]) -> None:
    """Run a block in the namespace of its page, with the page's own line numbers."""
    code = compile("\n" * (block.line - 1) + block.text, where, "exec")
    exec(code, namespace)  # the page is ours


def save_toml(block: Block) -> Path | None:
    """Save a block under the name in its first line; None where it has none."""
    name = re.match(r"# (\S+\.toml)\n", block.text)
    if name is None:
        return None
    path = Path(name[1])
    path.write_text(block.text, encoding="utf-8")
    return path
