"""The command line: reads options, calls the library and prints.

Exit codes: 0 the run converged, all requested parts of its verdict hold and its limits are met; 2
bad input or usage, with one message on stderr and no file replaced; 3 the run ended otherwise, with
its results written; 130 stopped by the user, 143 by SIGTERM.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from updyn import __version__
from updyn.cli.settings import WAITING
from updyn.cli.signals import end_on_signal, stop_code
from updyn.cli.terminal import (
    BAD_INPUT,
    DONE,
    NOT_DETERMINED,
    STOPPED,
    TERMINATED,
    encode_anything,
    print_error,
    print_note,
    print_text,
    warnings_as_notes,
)
from updyn.errors import OptionError, UpdynError
from updyn.registry import Registry

if TYPE_CHECKING:
    from cyclopts import App

__all__ = ["BAD_INPUT", "COMMANDS", "DONE", "NOT_DETERMINED", "STOPPED", "TERMINATED", "main"]

#: The commands by name: functions whose signature and docstring `cyclopts` turns into options and
#: help. Another package adds a command with `COMMANDS.register`, or with an entry point of the
#: group ``updyn.commands``; the module is imported when the command is called. A command returns
#: its exit code and prints with `updyn.cli.terminal`.
COMMANDS: Registry[Any] = Registry(
    "command",
    "updyn.commands",
    {
        "new": "updyn.cli.commands:new",
        "run": "updyn.cli.commands:run",
        "check": "updyn.cli.commands:check",
        "demo": "updyn.cli.commands:demo",
        "frf": "updyn.cli.frf:frf",
        "convert": "updyn.cli.commands:convert",
        "info": "updyn.cli.commands:info",
        "correlate": "updyn.cli.commands:correlate",
        "compare": "updyn.cli.commands:compare",
        "modes": "updyn.cli.commands:modes",
        "shapes": "updyn.cli.shapes:shapes",
        "plan": "updyn.cli.commands:plan",
        "plant": "updyn.control.command:plant",
        "serve": "updyn.web.command:serve",
    },
)


#: Descriptions of the commands, to list them without importing the commands.
_ABOUT = {
    "new": "Write a commented job file for a model and a measurement.",
    "run": "Run a job and write its results.",
    "check": "Check a job without running it.",
    "demo": "Run a shipped example.",
    "frf": "Estimate FRFs from time records.",
    "convert": "Convert a measurement or a model to another format.",
    "info": "Print what a file holds.",
    "correlate": "Compare the model of a job at its start with its measurement.",
    "compare": "Run every method on the inputs of a job.",
    "modes": "Identify the modes of a job's test.",
    "shapes": "Write shapes as animation or for other programs.",
    "plan": "Choose sensors and forces before a test.",
    "plant": "Make the plant of a job for control design.",
    "serve": "Open the app: a page in the browser of this machine.",
}


_TITLE = "Finite-element model updating from measured frequency response functions."
_EXIT_CODES = (
    "Exit codes: 0 converged, and the verdict holds in all parts that were asked for; 2 bad input;"
    " 3 ended without that, results written; 130 stopped by the user, 143 by SIGTERM."
)
#: Words that print the list of commands.
_HELP: tuple[list[str], ...] = ([], ["--help"], ["-h"])


def list_commands() -> str:
    """Return the help of the program: its commands by name, without importing them or cyclopts."""
    listed = {name: _ABOUT.get(name, "") for name in sorted(COMMANDS)}
    listed |= {"--help, -h": "Print this list; updyn COMMAND --help prints the options of one."}
    listed |= {"--version": "Print the version."}
    width = max(map(len, listed))
    rows = "\n".join(f"  {name:<{width}}  {about}".rstrip() for name, about in listed.items())
    return f"Usage: updyn COMMAND\n\n{_TITLE}\n\n{rows}\n\n{_EXIT_CODES}"


def app(*, listed: bool = False) -> App:
    """Return the command line, without importing commands; `listed` adds their descriptions."""
    from cyclopts import App

    made = App(name="updyn", version=__version__, help=_TITLE, help_epilogue=_EXIT_CODES)
    for name in COMMANDS:
        about = {"help": _ABOUT[name]} if listed and name in _ABOUT else {}
        made.command(COMMANDS.entry(name), name=name, **about)
    return made


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words after the program's name, by default those of this process.

    Returns
    -------
    int
        The exit code.
    """
    with suppress(KeyboardInterrupt):
        return _run(arguments)
    return stop_code()  # interrupted while a message was printed


@contextmanager
def _collect_rarely() -> Iterator[None]:
    """Search for unreachable objects less often."""
    before = gc.get_threshold()
    gc.set_threshold(WAITING.new_objects, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _run(arguments: Sequence[str] | None) -> int:
    """Run a command, print its error if any, and return the exit code."""
    with warnings_as_notes(), _collect_rarely():
        try:
            with end_on_signal():
                encode_anything()
                code = _call(sys.argv[1:] if arguments is None else list(arguments))
                return stop_code() if code == STOPPED else code
        except UpdynError as error:
            return print_error(str(error))
        except OSError as error:
            return print_error(
                f"{error.filename}: {error.strerror}" if error.filename else str(error)
            )
        except KeyboardInterrupt:
            print_note("stopped; no results were written", "yellow")
            return stop_code()


def _call(words: list[str]) -> int:
    """Call the command with this name, and return its exit code."""
    if words in _HELP:
        print_text(list_commands())
        return DONE
    from cyclopts import CycloptsError

    made = app(listed=not any(word in COMMANDS for word in words))
    try:
        command, bound, _ = made.parse_args(words, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        known = [word for word in words[:1] if word in COMMANDS]
        raise OptionError(f"{error}\nTry: {' '.join(['updyn', *known, '--help'])}") from error
    code = command(*bound.args, **bound.kwargs)
    return code if isinstance(code, int) else DONE
