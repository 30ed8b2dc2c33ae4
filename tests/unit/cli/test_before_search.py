"""A model that is not that of the test: said by `updyn new` and `updyn check`, and in the window."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from pages_read import Page
from turned_chain import TURNED, measured, model
from updyn.cli import main
from updyn.io import write_frf, write_model
from updyn.web import looking

FEW = "1 of 8 measured modes has a counterpart in the model: as few as shapes of another structure"

ALL = r"(\d) of \1 resonance peaks of the test have a counterpart in the model\."


@pytest.fixture
def files(tmp_path: Path) -> Callable[[bool], Path]:
    def write(alien: bool) -> Path:
        write_model(model((1.3, 0.8)), tmp_path / "chain.h5")
        write_frf(measured(TURNED) if alien else measured(), tmp_path / "chain.npz")
        return tmp_path

    return write


def new(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Propose a job; return what is printed."""
    names = [str(folder / name) for name in ("chain.h5", "chain.npz")]
    assert main(["new", *names, "--out", str(folder / "job.toml")]) == 0
    return capsys.readouterr().out


def test_few_counterparts_are_said_before_any_search(files, capsys):
    folder = files(alien=True)
    assert FEW in new(folder, capsys)
    job = folder / "job.toml"
    text = job.read_text()
    assert "# Before the search:" in text
    assert "1 of 8 measured modes has a counterpart" in text
    assert main(["check", str(job)]) == 3
    said = capsys.readouterr().out
    assert FEW in said
    assert "Compare model and test first" in said
    assert "its search would end after its first tries" in said
    page = " ".join(Page((folder / "job-check" / "check.html").read_text("utf-8")).text)
    assert "Look at the model first" in page
    assert FEW in page
    assert "most faults show only against a model of the tested structure" in page
    assert FEW in looking.count_counterparts(job, text)[0]


def test_all_counterparts_are_said_before_any_search(files, capsys):
    folder = files(alien=False)
    assert re.search(ALL, new(folder, capsys))
    job = folder / "job.toml"
    assert main(["check", str(job)]) == 0
    said = capsys.readouterr().out
    assert re.search(ALL, said)
    assert "Compare model and test first" not in said
    assert "The job can be run; results" in said
