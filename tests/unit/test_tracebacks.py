"""Tracebacks in notebooks: the caller's frames for a wrong input, all frames for a bug."""

from __future__ import annotations

import re
import subprocess
import sys
import textwrap

import pytest

import updyn
from updyn.errors import InputError
from updyn.tracebacks import cut_traceback, render_error


def frames(shown: str) -> list[str]:
    return re.findall(r'File "([^"]+)", line \d+', shown)


def test_the_hook_of_python_stays() -> None:
    assert sys.excepthook is sys.__excepthook__


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


@pytest.mark.parametrize("is_dev", [False, True])
def test_a_notebook_shows_the_line_of_the_cell(is_dev: bool) -> None:
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
    options = ["-X", "dev"] if is_dev else []
    done = subprocess.run(
        [sys.executable, *options, "-c", script], capture_output=True, text=True, check=True
    )
    wrong, bug = done.stdout.split("ModelError: ")
    assert "updyn.modes(chain.build(), 100)" in wrong
    assert ("dynamics" in wrong) == is_dev
    assert "dynamics" in bug
