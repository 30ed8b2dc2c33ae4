"""SIGINT and SIGTERM at awkward moments of the command line: it ends at once, without a traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are other things on Windows")

HEAD = """\
import signal, sys, time
import updyn.cli
from updyn.cli import COMMANDS, main
SIGNAL = signal.{name}
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs of a shell
def command() -> int:
    "Wait."
    {body}
    time.sleep(30)
    return 0
COMMANDS.register("wait", command)
sys.exit(main(["wait"]))
"""
#: What a command does when the signal comes.
MOMENTS = {
    "in the command": "signal.raise_signal(SIGNAL)",
    "in a destructor, whose exceptions are printed and lost": """
    class Late:
        def __del__(self):
            signal.raise_signal(SIGNAL)
            sum(range(1000))
    Late()""",
    "in two destructors": """
    class Late:
        def __del__(self):
            signal.raise_signal(SIGNAL)
            time.sleep(0.2)
    Late(), Late()""",
    "in a callback of a weak reference": """
    import weakref
    class Thing:
        pass
    def gone(_):
        signal.raise_signal(SIGNAL)
        sum(range(1000))
    thing = Thing()
    kept = weakref.ref(thing, gone)
    del thing""",
    "where a library turns it into an error of its own": """
    try:
        signal.raise_signal(SIGNAL)
        time.sleep(1)
    except BaseException as error:
        raise ImportError("numpy.core.multiarray failed to import") from error""",
    "while an error of the user is handled": """
    try:
        raise updyn.errors.FormatError("bad")
    finally:
        signal.raise_signal(SIGNAL)
        time.sleep(1)""",
}
CODES = {"SIGINT": 130, "SIGTERM": 143}


def ended(words: list[str], **options: object) -> tuple[int, str]:
    begun = time.monotonic()
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, **options)  # type: ignore[call-overload]
    assert time.monotonic() - begun < 25
    assert "Traceback" not in done.stderr
    assert "KeyboardInterrupt" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done.returncode, done.stderr


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_signal_ends_a_command_at_any_moment(name: str, moment: str) -> None:
    code, err = ended([sys.executable, "-c", HEAD.format(name=name, body=MOMENTS[moment])])
    assert code == CODES[name]
    assert err == "stopped; no results were written\n"


@pytest.mark.parametrize("name", CODES)
def test_a_signal_while_the_message_is_printed(name: str) -> None:
    body = """
    def print_error(text):
        signal.raise_signal(SIGNAL)
        time.sleep(0.2)
        return 2
    updyn.cli.print_error = print_error
    raise updyn.errors.FormatError("bad")"""
    code, err = ended([sys.executable, "-c", HEAD.format(name=name, body=body)])
    assert code in (CODES[name], -getattr(signal, name))
    assert err == ""


HOOK = """\
import atexit, signal, sys
MOMENT = {moment!r}
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == MOMENT:
            signal.raise_signal(signal.{name})
sys.meta_path.insert(0, Finder())
if MOMENT == "the end":
    atexit.register(signal.raise_signal, signal.{name})
"""


@pytest.mark.parametrize("name", CODES)
@pytest.mark.parametrize(
    "moment", ["updyn.registry", "updyn.cli.signals", "cyclopts", "updyn.cli.commands", "the end"]
)
def test_a_signal_at_the_start_and_at_the_end_of_the_process(
    name: str, moment: str, tmp_path: Path
) -> None:
    (tmp_path / "sitecustomize.py").write_text(HOOK.format(moment=moment, name=name))
    code, _ = ended(
        [sys.executable, "-m", "updyn", "info", str(tmp_path / "none.h5")],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert code in (CODES[name], -getattr(signal, name))


def test_handlers_are_those_of_before_once_a_command_has_ended() -> None:
    code = (
        "import signal, sys; from updyn.cli import main; before = [signal.getsignal(n) for n in"
        " (signal.SIGINT, signal.SIGTERM)]; hook = sys.unraisablehook; main(['--version']);"
        " assert before == [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)];"
        " assert sys.unraisablehook is hook; assert signal.set_wakeup_fd(-1) == -1"
    )
    assert ended([sys.executable, "-c", code])[0] == 0
