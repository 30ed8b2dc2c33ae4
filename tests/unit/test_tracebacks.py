"""Tracebacks of uncaught errors: the caller's frames for a wrong input, all frames for a bug."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap

import pytest

import updyn
from updyn.errors import InputError
from updyn.tracebacks import cut_traceback, render_error

SCRIPT = """
import updyn
from updyn.demos import chain
def mine():
    model, frf = chain.build(), chain.measure()
    unknowns = updyn.parameters(model, stiffness="all")
    {call}
mine()
"""
WRONG = 'updyn.update(model, frf, unknowns, method="maximum-likelihod")'


def run(call: str, *options: str, before: str = "") -> str:
    done = subprocess.run(
        [sys.executable, *options, "-c", before + SCRIPT.format(call=call)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    return done.stderr


def frames(shown: str) -> list[str]:
    return re.findall(r'File "([^"]+)", line \d+', shown)


def test_an_error_of_the_input_shows_the_frames_of_the_caller() -> None:
    shown = run(WRONG)
    assert frames(shown) == ["<string>", "<string>"]
    assert shown.endswith("method 'maximum-likelihod': did you mean 'maximum-likelihood'?\n")


def test_an_error_with_a_cause_is_shown_alone() -> None:
    shown = run("updyn.parameters(model, stiffness=5)")
    assert frames(shown) == ["<string>", "<string>"]
    assert shown.count("Traceback") == 1


def test_a_bug_shows_all_frames() -> None:
    shown = run("updyn.modes(5, 2)")  # no error of updyn
    assert "AttributeError" in shown
    assert any("updyn" in name for name in frames(shown))


def test_the_development_mode_shows_all_frames() -> None:
    assert any("updyn" in name for name in frames(run(WRONG, "-X", "dev")))


def test_the_hook_of_another_package_stays() -> None:
    before = "import sys\nsys.excepthook = lambda *about: print('mine', file=sys.stderr)\n"
    assert run(WRONG, before=before) == "mine\n"


def test_a_caught_error_keeps_its_frames() -> None:
    with pytest.raises(InputError) as caught:
        updyn.correlate(1, 2, wrong=3)  # type: ignore[call-overload]
    error = caught.value
    kept = error.__traceback__
    cut = cut_traceback(kept)
    assert cut is not None
    assert cut.tb_next is None
    assert cut.tb_frame.f_code.co_filename == __file__
    assert kept is not None
    assert kept.tb_next is not None
    lines = "".join(render_error(error))
    assert frames(lines) == [__file__]
    assert error.__traceback__ is kept


def test_frames_inside_updyn_alone_are_kept() -> None:
    with pytest.raises(InputError) as caught:
        updyn.correlate(1, 2, wrong=3)  # type: ignore[call-overload]
    assert caught.value.__traceback__ is not None
    inner = caught.value.__traceback__.tb_next
    cut = cut_traceback(inner)
    assert cut is not None
    assert cut.tb_frame is inner.tb_frame  # type: ignore[union-attr]
    assert cut_traceback(None) is None


def test_a_notebook_shows_the_line_of_the_cell() -> None:
    pytest.importorskip("IPython")
    script = textwrap.dedent(
        """
        from IPython.core.interactiveshell import InteractiveShell
        shell = InteractiveShell.instance()
        shell.colors = "NoColor"
        shell.run_cell("import updyn\\nfrom updyn.demos import chain")
        shell.run_cell("updyn.modes(chain.build(), 100)")
        shell.run_cell("updyn.modes(5, 2)")
        """
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    wrong, bug = done.stdout.split("ModelError: ")
    assert "updyn.modes(chain.build(), 100)" in wrong
    assert "File" not in wrong
    assert "dynamics" in bug
