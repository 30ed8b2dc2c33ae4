"""Progress: plain lines, stages and times on the bar, Ctrl-C that is answered at once, colours."""

from __future__ import annotations

import io
import math
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from updyn import progress as module
from updyn.cli import main
from updyn.cli.highlight import STATUS_STYLES, THEME, SummaryHighlighter
from updyn.cli.progress import ProgressDisplay
from updyn.cli.terminal import wrap_text
from updyn.progress import RunStage, StageClock
from updyn.updating.fit.monitor import Progress
from updyn.updating.result import STATUSES

NAN = float("nan")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


# -- plain lines -----------------------------------------------------------------------------------------------------
def test_lines_are_not_closer_than_they_should_be(clock: list[float]) -> None:
    out = io.StringIO()
    show_progress = ProgressDisplay(Console(file=out, width=200))
    for t, stage, step, cost, lines in (
        (0.0, "start", 0, NAN, 10),
        (1.5, "start", 0, NAN, 20),  # within a step: not after 1.5 s
        (2.0, "log", 0, 5.0, 30),  # a new stage, and the first step, at once
        (2.5, "log", 1, 4.0, 40),  # a step: not after 0.5 s
        (3.1, "log", 2, 3.0, 50),
        (12.0, "log", 2, 3.0, 60),
        (13.2, "log", 2, 3.0, 70),
    ):
        clock[0] = 100.0 + t
        assert show_progress(Progress(stage, 9, cost, lines, 100, step)) is False
    assert out.getvalue().splitlines() == [
        "start  10 lines solved (100 a step)",
        "log  iteration 0  cost 5  30 lines solved (100 a step)",
        "log  iteration 2  cost 3  50 lines solved (100 a step)",
        "log  iteration 2  cost 3  70 lines solved (100 a step)",
    ]


def test_it_says_whether_to_stop(clock: list[float]) -> None:
    show_progress = ProgressDisplay(Console(file=io.StringIO()))
    step = Progress("log", 0, 1.0, 1, 1)
    assert show_progress(step) is False
    show_progress.interrupt(2, None)
    assert show_progress(step) is True
    with pytest.raises(KeyboardInterrupt):
        show_progress.interrupt(2, None)


def test_two_signals_while_python_does_not_run_end_the_run(clock: list[float]) -> None:
    """They are answered twice, and are one call of the handler."""
    display = ProgressDisplay(Console(file=io.StringIO()))
    display.answer(2)
    display.answer(2)
    with pytest.raises(KeyboardInterrupt):
        display.interrupt(2, None)
    display.end()


# -- stages and times ------------------------------------------------------------------------------------------------
def test_stage_share_and_time_left(clock: list[float]) -> None:
    """A fit of at most 10 steps of 60 lines: after 6 s and 120 of 600 lines, 24 s are left at most."""
    read = StageClock([RunStage("start"), RunStage("fit", 10), RunStage("bootstrap", 1)]).locate
    assert read(Progress("start", 0, NAN, 60, 60)).number == 1
    clock[0] += 5.0
    begun = read(Progress("fit", 1, 3.0, 120, 60))
    assert (begun.number, begun.of, begun.name) == (2, 3, "fit")
    assert math.isnan(begun.remaining)
    clock[0] += 6.0
    found = read(Progress("fit", 2, 2.0, 240, 60))
    assert found.share == pytest.approx(0.2)
    assert found.remaining == pytest.approx(24.0)
    beyond = read(Progress("fit", 20, 2.0, 1000, 60))  # more steps than were announced
    assert math.isnan(beyond.share)
    assert math.isnan(beyond.remaining)
    other = read(Progress("elsewhere", 21, 2.0, 1060, 60))  # counts with the stage before
    assert (other.number, other.name) == (2, "elsewhere")
    clock[0] += 1.0
    read(Progress("bootstrap 0 of 40", 0, NAN, 0, 40))
    clock[0] += 10.0
    drawn = read(Progress("bootstrap 10 of 40", 10, NAN, 10, 40))
    assert drawn.number == 3
    assert (drawn.share, drawn.remaining) == pytest.approx((0.25, 30.0))


def test_the_stages_of_a_comparison_are_its_methods(clock: list[float]) -> None:
    read = StageClock([RunStage("log"), RunStage("output-error")]).locate
    found = read(Progress("log (1 of 2): search", 1, 2.0, 60, 60))
    assert (found.number, found.name) == (1, "log: search")
    found = read(Progress("output-error (2 of 2): output-error", 1, 2.0, 60, 60))
    assert (found.number, found.name) == (2, "output-error")


# -- Ctrl-C ----------------------------------------------------------------------------------------------------------
BUSY = """
import hashlib
from updyn.cli.progress import show_progress
from updyn.cli.terminal import stderr

with show_progress(stderr()):
    print("busy", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"a", b"b", 2_000_000_000)  # many minutes without Python
"""


@pytest.mark.skipif(os.name == "nt", reason="SIGINT to a child is another thing on Windows")
def test_ctrl_c_is_answered_and_ends_the_process_while_it_does_not_return_to_python() -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", BUSY],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline() == "busy\n"
    process.send_signal(signal.SIGINT)
    assert process.stderr.readline().startswith("Stopping after this step; ")
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    assert process.stderr.readline() == "Leaving at once.\n"
    process.communicate(timeout=60)
    assert process.returncode == 130


# -- on a terminal ---------------------------------------------------------------------------------------------------
def on_a_terminal(words: list[str], **environment: str) -> str:
    """What a command writes to a terminal of 100 columns."""
    pty = pytest.importorskip("pty")
    termios = pytest.importorskip("termios")
    leader, follower = pty.openpty()
    termios.tcsetwinsize(follower, (40, 100))
    plain = {k: v for k, v in os.environ.items() if k not in ("NO_COLOR", "FORCE_COLOR", "COLUMNS")}
    process = subprocess.Popen(
        [sys.executable, "-m", "updyn", *words],
        stdin=follower,
        stdout=follower,
        stderr=follower,
        env={**plain, "OMP_NUM_THREADS": "1", "TERM": "xterm-256color", **environment},
    )
    os.close(follower)
    written = b""
    while True:
        try:
            read = os.read(leader, 65536)
        except OSError:  # Linux: the other end was closed
            break
        if not read:
            break
        written += read
    os.close(leader)
    process.wait(timeout=60)
    return written.decode().replace("\r\n", "\n")


def test_a_run_on_a_terminal(chain_folder: Path) -> None:
    job = chain_folder / "job.toml"
    job.write_text(
        """\
[model]
file = "chain.h5"
[test]
file = "chain.npz"
[[parameter]]
groups = "part*"
quantity = "stiffness"
[method]
name = "output-error"
[output]
report = false
""",
        encoding="utf-8",
    )
    written = on_a_terminal(["run", str(job)])
    assert "\x1b[?25l" in written  # a bar is drawn
    assert "job: \x1b[1;32mconverged\x1b[0m after " in written
    assert "\x1b[1munknown " in written
    plain = on_a_terminal(["run", str(job)], NO_COLOR="1")
    assert "job: converged after " in re.sub(r"\x1b\[[01]m", "", plain)  # bold may stay
    assert not re.search(r"\x1b\[[0-9;]*3[0-9]m", plain)  # no colours of letters


def test_a_pipe_gets_no_control_codes(
    chain_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    words = ["info", str(chain_folder / "chain.h5")]
    assert main(words) == 0
    assert "\x1b" not in "".join(capsys.readouterr())


def test_every_status_has_a_colour() -> None:
    assert set(STATUSES) <= set(STATUS_STYLES)
    for status, style in STATUS_STYLES.items():
        text = SummaryHighlighter()(f"job: {status} after 3 iterations (log)")
        (span,) = text.spans
        assert text.plain[span.start : span.end] == status
        assert span.style == f"updyn.{style}"
        assert span.style in THEME.styles


def test_sentences_are_broken_at_blanks_and_tables_are_not() -> None:
    row = "part1.mass            1       1.09975    0.000382"
    text = f"{row}\n  a sentence of some length in words\nResults/in/one/long/path/stay"
    assert wrap_text(text, 20).splitlines() == [
        row,
        "  a sentence of some",
        "  length in words",
        "Results/in/one/long/path/stay",
    ]
