"""`list_steps`: the steps of a job from its data to its result, with the state of each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from updyn.text_table import format_count
from updyn.web.looking import JobView, assess_identifiability, check_job
from updyn.web.project import RunFolder
from updyn.web.runs import read_badge
from updyn.web.workspace import Workspace

__all__ = ["STEPS", "State", "Step", "list_steps"]

State = Literal["done", "warning", "active", "open"]
#: The state of a step, and a sentence on it.
_Found = tuple[State, str]

#: Names of the steps by the address of their page.
STEPS: Mapping[str, str] = {
    "/measurement": "Data",
    "/model": "Sensors",
    "/unknowns": "Unknowns",
    "/check": "Check",
    "/run": "Run",
    "/results": "Result",
}
#: Steps of the tables of a job; errors about others are shown by the step Check.
_STEPS_BY_TABLE = {
    "job": "/measurement",
    "test": "/measurement",
    "records": "/measurement",
    "model": "/model",
    "match": "/model",
    "parameter": "/unknowns",
}
_READING: _Found = ("open", "The job is being read.")


@dataclass(frozen=True, slots=True)
class Step:
    """A step of a job: the address of its page, its name, its state, and a sentence on it."""

    place: str
    name: str
    state: State
    text: str


def list_steps(workspace: Workspace) -> list[Step]:
    """Return the steps of the open job by what is known; nothing is read or solved for it."""
    view = workspace.find_view()
    runs = workspace.project.runs_of(workspace.open_document.path)
    states = {
        "/measurement": _assess_data(view),
        "/model": _assess_sensors(view),
        "/unknowns": _assess_unknowns(workspace, view),
        "/check": _assess_check(workspace, view),
        "/run": _assess_run(workspace, view, runs),
        "/results": _assess_result(workspace, runs),
    }
    return [Step(place, name, *states[place]) for place, name in STEPS.items()]


def _find_error(view: JobView, place: str) -> str:
    """Return the error that the step at an address shows; empty if there is none."""
    for table, text in view.errors.items():
        if _STEPS_BY_TABLE.get(table, "/check") == place:
            return text
    return ""


def _assess_data(view: JobView | None) -> _Found:
    if view is None:
        return _READING
    error = _find_error(view, "/measurement")
    if error:
        return "warning", error
    texts = [f"{format_count(len(test.modes), 'measured mode')}" for test in view.modal]
    for test in view.tests:
        n = len(test.responses) * len(test.references)
        used = np.count_nonzero(test.used)
        texts.append(f"{format_count(n, 'FRF')}; lines used: {used} of {len(test.freq)}")
    return "done", f"{'; '.join(texts)}."


def _assess_sensors(view: JobView | None) -> _Found:
    if view is None:
        return _READING
    error = _find_error(view, "/model")
    if error:
        return "warning", error
    if not view.groups:
        return "open", "The model is not read yet, as an earlier step has an error."
    n = sum(len(test.matches) for test in view.tests)
    n += sum(len(test.matches) for test in view.modal)
    return "done", f"{n} sensors and forces on the model, which has {view.model}."


def _assess_unknowns(workspace: Workspace, view: JobView | None) -> _Found:
    if view is None:
        return _READING
    error = _find_error(view, "/unknowns")
    if error:
        return "warning", error
    if not view.groups:
        return "open", "The groups of the model are not known yet, as an earlier step has an error."
    n = format_count(len(view.unknowns), "unknown")
    found = workspace.find_answer(assess_identifiability)
    if found is None:
        return "done", f"{n}."
    if found.rank < found.n:
        return "warning", f"{n}: {found.rank} of {found.n} combinations are identifiable."
    return "done", f"{n}, all identifiable from the data."


def _assess_check(workspace: Workspace, view: JobView | None) -> _Found:
    if view is None:
        return _READING
    if view.errors:
        n = format_count(len(set(view.errors.values())), "error")
        return "warning", f"The job has {n}."
    rows = workspace.find_answer(check_job)
    if rows is None:
        return "open", "Not checked yet: identifiability, modes in common, faults of the data."
    problems = [row.statement for row in rows if row.is_problem]
    if problems:
        more = f" {len(problems) - 1} more below." if len(problems) > 1 else ""
        return "warning", f"{problems[0]}{more}"
    return "done", "No problem was found."


def _assess_run(workspace: Workspace, view: JobView | None, runs: Sequence[RunFolder]) -> _Found:
    run = workspace.worker("run")
    if run is not None and run.active:
        return "active", f"{run.progress}."
    if run is not None and run.state == "failed":
        return "warning", "The last run failed."
    if view is not None and view.errors:
        return "open", "The job cannot run before its errors are corrected; see Check."
    if runs:
        return "done", f"Run {format_count(len(runs), 'time')}."
    return "open", "Not run yet."


def _assess_result(workspace: Workspace, runs: Sequence[RunFolder]) -> _Found:
    if not runs:
        return "open", "No result of this job yet: run it first."
    record = runs[0].record
    status = f"Latest run: {read_badge(record).name}."
    trust = record.get("trust")
    for claim in trust.values() if isinstance(trust, dict) else ():
        if isinstance(claim, dict) and claim.get("holds") is False:
            return "warning", f"{status} {claim.get('why', '')}"
    job = workspace.open_document
    if job.is_changed or job.modified_time > runs[0].modified:
        return "warning", f"{status} The job has been changed since."
    return "done", status
