"""The steps of a job state what is known of it, and say why a step cannot be done."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from updyn.web.looking import CheckRow, assess_identifiability, check_job
from updyn.web.steps import STEPS, Step, list_steps
from updyn.web.worker import Worker
from updyn.web.workspace import Workspace

DATA, SENSORS, UNKNOWNS, CHECK, RUN, RESULT = STEPS


@pytest.fixture
def workspace(chain_project: Path) -> Iterator[Workspace]:
    found = Workspace(chain_project)
    found.open_job("job.toml")
    yield found
    found.close()


def steps_of(workspace: Workspace, *, is_read: bool = True) -> dict[str, Step]:
    if is_read:
        workspace.view()
    return {step.place: step for step in list_steps(workspace)}


def edit(workspace: Workspace, before: str, after: str) -> None:
    text = workspace.open_document.text
    assert before in text
    workspace.open_document.replace("typing", text.replace(before, after))


def write_run(
    workspace: Workspace, name: str, holds: bool | None = True, seconds_later: float = 5.0
) -> None:
    """Write the record of a run of the open job that ended some time after its last change."""
    job = workspace.open_document.path
    folder = job.parent / name
    folder.mkdir()
    record = {"status": "converged", "trust": {"plausible": {"holds": holds, "why": "Because."}}}
    (folder / "result.json").write_text(json.dumps(record), encoding="utf-8")
    (folder / "job.toml").write_text("# Written by updyn 0.1.0 from ../job.toml\n")
    at = job.stat().st_mtime + seconds_later
    os.utime(folder / "result.json", (at, at))


def test_nothing_is_known_before_the_job_is_read(workspace: Workspace) -> None:
    found = steps_of(workspace, is_read=False)
    assert [step.name for step in found.values()] == [
        "Data", "Sensors", "Unknowns", "Check", "Run", "Result",
    ]  # fmt: skip
    assert {step.state for step in found.values()} == {"open"}


def test_steps_of_a_job_in_order(workspace: Workspace) -> None:
    found = steps_of(workspace)
    assert {place: step.state for place, step in found.items()} == {
        DATA: "done", SENSORS: "done", UNKNOWNS: "done", CHECK: "open", RUN: "open", RESULT: "open",
    }  # fmt: skip
    assert found[DATA].text == "10 FRFs; lines used: 60 of 60."
    assert (
        found[SENSORS].text == "5 sensors and forces on the model, which has 12 DOFs in 4 groups."
    )
    assert found[UNKNOWNS].text == "12 unknowns."
    assert found[RESULT].text == "No result of this job yet: run it first."


def test_the_check_is_that_of_the_present_text(workspace: Workspace) -> None:
    workspace.ask(check_job)
    workspace.ask(assess_identifiability)
    found = steps_of(workspace)
    assert (found[CHECK].state, found[CHECK].text) == ("done", "No problem was found.")
    assert found[UNKNOWNS].text == "12 unknowns, all identifiable from the data."
    edit(workspace, "bounds = [0.3, 3.0]", "bounds = [0.2, 3.0]")
    found = steps_of(workspace)
    assert (found[CHECK].state, found[UNKNOWNS].text) == ("open", "12 unknowns.")


def test_the_step_states_the_first_problem(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        CheckRow("All is determined.", False),
        CheckRow("5:X is upside down.", True),
        CheckRow("A mode is missing.", True),
    ]
    known = Workspace.find_answer
    for shown, text in (
        (rows, "5:X is upside down. 1 more below."),
        (rows[:2], "5:X is upside down."),
    ):

        def answer(self: Workspace, ask: object, shown: list[CheckRow] = shown) -> object:
            return shown if ask is check_job else known(self, ask)

        monkeypatch.setattr(Workspace, "find_answer", answer)
        found = steps_of(workspace)[CHECK]
        assert (found.state, found.text) == ("warning", text)


@pytest.mark.parametrize(
    ("before", "after", "place"),
    [
        ("[test]", "[test", DATA),
        ("chain.uff", "none.uff", DATA),
        ("[test]", "[test]\nband = [1e5, 2e5]", DATA),
        ("chain.h5", "none.h5", SENSORS),
        ("[test]", '[match.table]\n"5:X" = "99:X"\n[test]', SENSORS),
        ('"part*"', '"nix*"', UNKNOWNS),
    ],
    ids=["no TOML", "no file", "no line", "no model", "no node", "no group"],
)
def test_an_error_is_at_its_step_and_prevents_a_run(
    workspace: Workspace, before: str, after: str, place: str
) -> None:
    edit(workspace, before, after)
    found = steps_of(workspace)
    assert [step.place for step in found.values() if step.state == "warning"] == [place, CHECK]
    assert found[place].text.startswith("job.toml:")
    assert found[CHECK].text == "The job has 1 error."
    assert found[RUN].text == "The job cannot run before its errors are corrected; see Check."
    assert str(workspace.project.folder) not in "".join(step.text for step in found.values())


def test_the_result_is_that_of_the_latest_run(workspace: Workspace) -> None:
    write_run(workspace, "first", holds=False)
    found = steps_of(workspace)
    assert (found[RUN].state, found[RUN].text) == ("done", "Run 1 time.")
    assert (found[RESULT].state, found[RESULT].text) == (
        "warning", "Latest run: converged. Because.",
    )  # fmt: skip
    write_run(workspace, "second", seconds_later=9.0)
    assert steps_of(workspace)[RESULT] == Step(
        RESULT, "Result", "done", "Latest run: converged."
    )  # fmt: skip
    edit(workspace, "[0.3, 3.0]", "[0.2, 3.0]")
    assert steps_of(workspace)[RESULT].text == (
        "Latest run: converged. The job has been changed since."
    )


def test_a_run_older_than_the_job_is_no_longer_its_result(workspace: Workspace) -> None:
    write_run(workspace, "first", seconds_later=-5.0)
    assert steps_of(workspace)[RESULT].state == "warning"


def test_an_active_run_shows_its_progress(workspace: Workspace) -> None:
    job = workspace.open_document.path
    run = Worker("run", job, job.parent / "out", job.parent)
    workspace.workers["run"] = run
    run._handle_event(
        {"kind": "progress", "stage": "search", "iteration": 3, "accepted": 2, "cost": 1.5}
    )
    assert steps_of(workspace)[RUN] == Step(RUN, "Run", "active", "Running: search, 2 steps.")
    run._record_end(2)
    assert steps_of(workspace)[RUN].state == "warning"
