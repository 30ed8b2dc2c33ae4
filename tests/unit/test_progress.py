"""`progress=True`: a bar where Python runs, beside the caller's callback; the result does not depend on it."""

from __future__ import annotations

import io
import math
import re
import sys
import types

import numpy as np
import pytest

import updyn
from report_case import chain, measured
from updyn import progress
from updyn.progress import NotebookBar, RunStage, display_progress
from updyn.updating.fit.monitor import Progress


class Handle:
    """What `IPython.display.display` returns, with all that was shown."""

    def __init__(self):
        self.shown = []

    def __call__(self, shown, display_id):
        assert display_id is True
        self.update(shown)
        return self

    def update(self, shown):
        self.shown.append(shown._repr_html_())


@pytest.fixture
def clock(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


def small():
    model = chain(n=3)
    data = measured(model, n_lines=12, responses=["1:Z", "3:Z"], references=["3:Z"])
    start = model.scaled({"bay 2": {"stiffness": 1.1}})
    return start, data, updyn.parameters(start, stiffness=["bay 2"])


def test_progress_is_shown_as_lines_where_there_is_no_terminal(capsys):
    seen = []
    found = updyn.update(*small(), starts=0, callback=seen.append, progress=True)
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert re.fullmatch(r"stage \d of \d, [a-z -]+: (iteration \d+, )?0:\d\d elapsed", lines[0])
    assert not any("\x1b" in line for line in lines)
    assert seen
    assert all(isinstance(step, Progress) for step in seen)
    assert found.values == updyn.update(*small(), starts=0).values


def test_a_callback_stops_a_run_whose_progress_is_shown(capsys):
    found = updyn.update(*small(), starts=0, callback=lambda _: True, progress=True)
    assert found.status == "stopped"
    assert capsys.readouterr().err


def test_an_unknown_method_is_told_before_anything_is_shown(capsys):
    with pytest.raises(updyn.UpdynError, match="maximum-likelihod"):
        updyn.update(*small(), method="maximum-likelihod", progress=True)
    assert capsys.readouterr().err == ""


def test_a_terminal_gets_a_bar(monkeypatch):
    class Terminal(io.StringIO):
        encoding = "utf-8"

        def isatty(self):
            return True

    out = Terminal()
    for name, value in {"TERM": "xterm", "COLUMNS": "120"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stderr", out)
    with display_progress([RunStage("fit", 2)]) as show:
        show(Progress("fit", 1, 3.0, 5, 10, 1))
    assert "stage 1 of 1, fit" in out.getvalue()
    assert "iteration 1" in out.getvalue()
    assert "cost" not in out.getvalue()


def test_a_closed_stderr_is_no_error(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    with display_progress() as show:
        show(Progress("fit", 1, 3.0, 5, 10, 1))


def test_a_notebook_gets_a_bar_that_goes_away(monkeypatch, clock):
    handle = Handle()
    shell = types.ModuleType("IPython")
    shell.get_ipython = lambda: types.SimpleNamespace(kernel=object())
    shown = types.ModuleType("IPython.display")
    shown.display = handle
    monkeypatch.setitem(sys.modules, "IPython", shell)
    monkeypatch.setitem(sys.modules, "IPython.display", shown)
    with display_progress([RunStage("<fit>", 10)]) as show:
        show(Progress("<fit>", 0, math.nan, 0, 10, 0))
        clock[0] += 0.1
        show(Progress("<fit>", 1, 2.5, 25, 10, 1))  # too soon after the last
        clock[0] += 0.2
        show(Progress("<fit>", 2, 1.5, 50, 10, 2))
    assert len(handle.shown) == 4
    first, _, third, last = handle.shown
    assert "starting" in first
    assert "stage 1 of 1, &lt;fit&gt;" in third
    assert "width:50%" in third
    assert "iteration 2<" in third
    assert last == ""


def test_a_plain_python_with_ipython_loaded_is_no_notebook(monkeypatch, capsys):
    shell = types.ModuleType("IPython")
    shell.get_ipython = lambda: None
    monkeypatch.setitem(sys.modules, "IPython", shell)
    with display_progress() as show:
        show(Progress("fit", 1, 3.0, 5, 10, 1))
    assert "iteration 1" in capsys.readouterr().err


def test_a_bar_of_unknown_length_is_empty(clock):
    handle = Handle()
    bar = NotebookBar(handle)
    bar.show(Progress("fit", 1, np.nan, 5, 10, 0))
    assert "width:0%" in handle.shown[-1]


# -- what a callback returns -----------------------------------------------------------------------------------
@pytest.mark.parametrize("answer", [True, np.True_])
def test_a_callback_that_returns_true_stops(answer):
    assert progress.asks_to_stop(answer) is True


@pytest.mark.parametrize("answer", [None, False, np.False_])
def test_a_callback_that_returns_nothing_or_false_goes_on(answer):
    assert progress.asks_to_stop(answer) is False


@pytest.mark.parametrize("answer", [0.25, 1, "stop", np.ones(3), [True], np.array(True)])
def test_a_callback_may_return_nothing_else(answer):
    """A cost or an array that a lambda returns by chance would end the fit, or end in a traceback of numpy."""
    frf = measured(chain())
    with pytest.raises(updyn.UpdynError, match=r"callback: it returned .*; expected True to stop"):
        updyn.update(
            chain(), frf, updyn.parameters(chain(), stiffness="all"), callback=lambda step: answer
        )
