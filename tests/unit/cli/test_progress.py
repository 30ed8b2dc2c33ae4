"""Plain progress lines: every stage, steps at most once a second, lines within a step at most every ten."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from updyn.cli import terminal as module
from updyn.cli.terminal import ProgressDisplay
from updyn.updating.fit.monitor import Progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def test_lines_are_not_closer_than_they_should_be(clock: list[float]) -> None:
    out = io.StringIO()
    show_progress = ProgressDisplay(Console(file=out, width=200))
    for t, stage, step, cost, lines in (
        (0.0, "start", 0, float("nan"), 10),
        (1.5, "start", 0, float("nan"), 20),  # within a step: not after 1.5 s
        (2.0, "log", 0, 5.0, 30),  # a new stage, and the first step, at once
        (2.5, "log", 1, 4.0, 40),  # a step: not after 0.5 s
        (3.1, "log", 2, 3.0, 50),
        (12.0, "log", 2, 3.0, 60),
        (13.2, "log", 2, 3.0, 70),
    ):
        clock[0] = 100.0 + t
        # Every second step was refused: the lines count those that were taken.
        progress = Progress(stage, step, cost, lines, 100, made=step // 2)
        assert show_progress(progress) is False
    assert out.getvalue().splitlines() == [
        "start  10 lines solved (100 a step)",
        "log  iteration 0  cost 5  30 lines solved (100 a step)",
        "log  iteration 1  cost 3  50 lines solved (100 a step)",
        "log  iteration 1  cost 3  70 lines solved (100 a step)",
    ]


def test_it_says_whether_to_stop(clock: list[float]) -> None:
    show_progress = ProgressDisplay(Console(file=io.StringIO()))
    step = Progress("log", 0, 1.0, 1, 1)
    assert show_progress(step) is False
    show_progress.interrupt(2, None)
    assert show_progress(step) is True
    with pytest.raises(KeyboardInterrupt):
        show_progress.interrupt(2, None)
