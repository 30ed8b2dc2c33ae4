"""Progress: plain lines, stages and times on the bar, Ctrl-C that is answered at once, colours."""

from __future__ import annotations

import io
import math
import os
import re
import signal
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from overriding import override
from updyn import progress as module
from updyn.cli import main
from updyn.cli.highlight import STATUS_STYLES, STYLES, highlight
from updyn.cli.progress import ProgressDisplay
from updyn.progress import RunStage, StageClock
from updyn.settings import PROGRESS
from updyn.updating.fit.monitor import Progress
from updyn.updating.judge.badge import Badge, Colour
from updyn.updating.result import STATUSES

NAN = float("nan")


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


# -- plain lines -----------------------------------------------------------------------------------------------------
def plain_lines(
    clock: list[float], steps: list[tuple[float, str, int]], *stages: RunStage
) -> list[str]:
    """The lines of a log, for steps at a time, of a stage, with a number of accepted steps."""
    out = io.StringIO()
    clock[0] = 100.0
    show_progress = ProgressDisplay(Console(file=out, width=200), stages)
    for t, stage, step in steps:
        clock[0] = 100.0 + t
        cost = NAN if step < 0 else 5.0
        assert show_progress(Progress(stage, 9, cost, 10, 100, max(step, 0))) is False
    return out.getvalue().splitlines()


def test_lines_are_not_closer_than_they_should_be(clock: list[float]) -> None:
    steps = [
        (0.0, "start", -1),
        (0.9, "log", 0),  # a new stage, but less than a second after the last line
        (1.1, "log", 0),
        (11.0, "log", 1),  # less than ten seconds
        (11.2, "log", 2),
        (12.5, "start", 3),  # no new stage
        (40.0, "log", 4),
        (59.0, "log", 5),  # less than half of the time so far
        (80.5, "log", 6),
    ]
    assert plain_lines(clock, steps) == [
        "start: 0:00 elapsed",
        "log: iteration 0, 0:01 elapsed",
        "log: iteration 2, 0:11 elapsed",
        "log: iteration 4, 0:40 elapsed",
        "log: iteration 6, 1:20 elapsed",
    ]


def test_a_log_of_eight_hours_has_few_lines_and_no_long_silence(clock: list[float]) -> None:
    lines = plain_lines(clock, [(float(t), "fit", t) for t in range(0, 8 * 3600, 5)])
    assert 48 <= len(lines) < 70
    hours = [re.search(r"(\d+):(\d+):(\d+) elapsed", line) for line in lines[-40:]]
    times = [3600 * int(h[1]) + 60 * int(h[2]) + int(h[3]) for h in hours if h]
    assert max(b - a for a, b in pairwise(times)) <= 605


@pytest.mark.parametrize(
    ("field", "value", "steps", "lines"),
    [
        ("stage_interval", 1.0, [(0.0, "a", 0), (1.4, "b", 0)], (2, 1)),
        ("stage_interval", 1.0, [(0.0, "a", 0), (0.7, "b", 0)], (1, 1)),
        ("line_interval", 10.0, [(0.0, "a", 0), (14.0, "a", 1)], (2, 1)),
        ("line_growth", 0.5, [(0.0, "a", 0), (100.0, "a", 1), (220.0, "a", 2)], (3, 2)),
        ("longest_interval", 600.0, [(0.0, "a", 0), (5000.0, "a", 1), (5700.0, "a", 2)], (3, 2)),
    ],
)
def test_pauses_between_plain_lines(
    clock: list[float],
    field: str,
    value: float,
    steps: list[tuple[float, str, int]],
    lines: tuple[int, int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As set, and with twice the pause."""
    assert getattr(PROGRESS, field) == value
    found = [len(plain_lines(clock, steps))]
    override(monkeypatch, PROGRESS, **{field: 2.0 * value})
    assert (*found, len(plain_lines(clock, steps))) == lines


def test_a_line_names_the_stage_of_all_and_the_time_left(clock: list[float]) -> None:
    """200 of at most 1000 lines in 20 s: at most 80 s are left."""
    out = io.StringIO()
    display = ProgressDisplay(
        Console(file=out, width=200), [RunStage("start"), RunStage("fit", 10)]
    )
    for t, stage, lines in ((0.0, "start", 100), (5.0, "fit", 100), (25.0, "fit", 300)):
        clock[0] = 100.0 + t
        display(Progress(stage, 1, 2.0, lines, 100, 3))
    assert out.getvalue().splitlines()[1:] == [
        "stage 2 of 2, fit: iteration 3, 0:05 elapsed",
        "stage 2 of 2, fit: iteration 3, at most 1:20 left in this stage, 0:25 elapsed",
    ]
    assert "lines" not in out.getvalue()
    assert "cost" not in out.getvalue()


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
    # The verdict has a colour, and the status of the fit has none.
    assert re.search(
        r"Chain of twelve masses: converged after \d+ iterations \(output-error\)\.\s", written
    )
    assert "\x1b[1;33mNot known whether credible\x1b[0m." in written
    assert "determined \x1b[1;32myes\x1b[0m, " in written
    assert "\x1b[1munknown " in written
    plain = on_a_terminal(["run", str(job)], NO_COLOR="1")
    assert "Not known whether credible." in re.sub(r"\x1b\[[01]m", "", plain)  # bold may stay
    assert not re.search(r"\x1b\[[0-9;]*3[0-9]m", plain)  # no colours of letters


def test_a_pipe_gets_no_control_codes(
    chain_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    words = ["info", str(chain_folder / "chain.h5")]
    assert main(words) == 0
    assert "\x1b" not in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("colour", "style"), [("good", "good"), ("warn", "warning"), ("bad", "bad")]
)
def test_a_verdict_has_the_colour_of_its_badge(colour: Colour, style: str) -> None:
    """On one line or two, and nowhere else."""
    badge = Badge("Fits, does not predict", colour)
    for gap in (" ", "\n"):
        line = f"Fits: converged after 2 iterations (log). Fits, does{gap}not predict."
        text = highlight(line, badge)
        (span,) = text.spans
        assert text.plain[span.start : span.end] == f"Fits, does{gap}not predict"
        assert span.style == f"updyn.{style}"


@pytest.mark.parametrize(
    ("answer", "style"),
    [("yes", "good"), ("no", "bad"), ("not known", "warning"), ("not asked", "faint")],
)
def test_the_parts_of_a_verdict_have_colours(answer: str, style: str) -> None:
    line = f"  resembles {answer}, converged {answer},\n  validated\n  {answer}"
    text = highlight(line)
    assert [str(span.style) for span in text.spans] == 3 * [f"updyn.{style}"]
    assert {text.plain[span.start : span.end] for span in text.spans} == {answer}


def test_every_status_has_a_colour() -> None:
    assert set(STATUSES) <= set(STATUS_STYLES)
    for status, style in STATUS_STYLES.items():
        text = highlight(f"log  {status}  12 of 12")
        (span,) = text.spans
        assert text.plain[span.start : span.end] == status
        assert span.style == f"updyn.{style}"
        assert span.style in STYLES
