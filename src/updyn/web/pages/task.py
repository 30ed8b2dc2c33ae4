"""Pages of tasks: begin one, watch it, stop it, see the page that it writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import quote

import tomlkit
from nicegui import events, ui
from tomlkit.exceptions import TOMLKitError

from updyn.web import edits
from updyn.web.pages.frame import embedded, said, watch
from updyn.web.pages.job import no_job
from updyn.web.pages.picks import hear_picks
from updyn.web.tasks import TASKS, Field
from updyn.web.worker import Worker
from updyn.web.workspace import Workspace

__all__ = ["controls", "state_of", "task_page"]

_STATES = {
    "running": "Running",
    "stopping": "Stopping after this step",
    "done": "Ended",
    "stopped": "Stopped",
    "failed": "Failed",
}


def controls(workspace: Workspace, task: str, *, begin: str) -> None:
    """Show the folder for the results, and the buttons.

    Parameters
    ----------
    workspace : Workspace
        What the page shows.
    task : str
        Its name.
    begin : str
        What the button says.
    """
    with ui.row().classes("items-center"):
        folder = ui.input("Folder for the results", value=workspace.proposed_folder(task))
        folder.classes("w-80")
        start = said(lambda: workspace.begin(task, folder.value))
        ui.button(begin, on_click=start).props("no-caps")
        if TASKS.find(task).resumes:
            resume = said(lambda: workspace.begin(task, folder.value, resume=True))
            ui.button("Resume", on_click=resume).props("outline no-caps")

        def stop() -> None:
            worker = workspace.workers.get(task)
            if worker is not None:
                worker.stop()

        ui.button("Stop", on_click=stop).props("outline no-caps")


def state_of(worker: Worker) -> None:
    """Show how it is with a task: in words, with its notes and its summary.

    Parameters
    ----------
    worker : Worker
        Of the task.
    """
    text, now = _STATES[worker.state], worker.now
    if worker.active and now:
        text += f": {now['stage']}, {now['accepted']} steps"
        if now["cost"] is not None:
            text += f", misfit {now['cost']:.6g}"
    elif worker.active and worker.stages:
        text += f": {worker.stages[-1]}"
    if worker.state == "done":
        text += f": {worker.status}"
    with ui.row().classes("items-center"):
        if worker.active:
            ui.spinner()
        ui.label(text).classes("text-lg").mark("state").props("role=status")
    for note in list(worker.notes):
        ui.label(note).classes("opacity-80 whitespace-pre-wrap")
    if worker.message or worker.stages:
        with ui.expansion("Summary", value=worker.state == "failed").classes("w-full"):
            lines = "\n".join([*worker.stages, worker.message])
            ui.label(lines).classes("whitespace-pre font-mono text-sm overflow-auto")


def task_page(task: str) -> Callable[[Workspace], None]:
    """Return a page of a task: its keys in the job, its buttons, and the page that it writes.

    Parameters
    ----------
    task : str
        Its name in `TASKS`.

    Returns
    -------
    callable
        Fills the page.
    """

    def show(workspace: Workspace) -> None:
        if no_job(workspace):
            return
        work = TASKS[task]
        ui.label(work.about)
        _form(workspace, work.table, work.fields)
        controls(workspace, task, begin="Save and begin")
        if task == "modes":
            _pick_poles(workspace)

        @ui.refreshable
        def state() -> None:
            worker = workspace.workers.get(task)
            if worker is None:
                return
            state_of(worker)
            written = worker.out / work.page
            if worker.state == "done" and written.is_file():
                name = quote(workspace.project.name_of(written))
                embedded(f"/embedded/page/{name}?{worker.version}", work.page, "85vh")

        state()
        watch(lambda: _version(workspace.workers.get(task)), state.refresh)

    return show


def _version(worker: Worker | None) -> object:
    return None if worker is None else (id(worker), worker.version)


# -- keys of the table -----------------------------------------------------------------------------
def _form(workspace: Workspace, table: str, fields: tuple[Field, ...]) -> None:
    """Show the keys of the job's table, to be set."""

    @ui.refreshable
    def form() -> None:
        written = _written(workspace.opened.text, table)
        with ui.row().classes("items-center"):
            for field in fields:
                _entry(workspace, table, field, written.get(field.key))

    form()
    watch(lambda: workspace.version, form.refresh)


def _written(text: str, table: str) -> Mapping[str, Any]:
    """Return a table of the job as it is written; an empty one where there is none."""
    try:
        found = tomlkit.parse(text).unwrap().get(table)
    except TOMLKitError:
        return {}
    return found if isinstance(found, dict) else {}


def _entry(workspace: Workspace, table: str, field: Field, value: Any) -> None:
    """Show one key."""

    def take(given: Any) -> None:
        edit = edits.set_key(table, field.key, given)
        workspace.opened.edit(f"{table}.{field.key}", edit)

    if field.kind == "choice":

        def chosen(event: events.ValueChangeEventArguments[Any]) -> None:
            said(take)(event.value)

        default = field.choices[0]
        shown = value if value in field.choices else default
        ui.select(list(field.choices), value=shown, label=field.label, on_change=chosen).classes(
            "min-w-40"
        )
        return
    entry = ui.input(field.label, value=_as_text(value)).classes("min-w-56")

    def typed() -> None:
        text = str(entry.value or "").strip()
        if text != _as_text(value):
            said(take)(edits.as_value(field.kind, text, field.label))

    entry.on("blur", said(typed)).on("keydown.enter", said(typed))


def _as_text(value: Any) -> str:
    """Return a value of the job as it is typed."""
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(map(_as_text, value))
    if isinstance(value, dict):
        return str(value.get("dof", ""))
    return str(value)


def _pick_poles(workspace: Workspace) -> None:
    """Let a click on a pole of the diagram pick it for the job."""

    def take(picked: Mapping[str, Any]) -> None:
        frequency = picked.get("frequency")
        if isinstance(frequency, int | float) and frequency > 0:
            edit = edits.toggle_pick(float(frequency))
            said(workspace.opened.edit)(f"pick {frequency:.6g} Hz", edit)

    hear_picks(take)

    @ui.refreshable
    def picks() -> None:
        found = _written(workspace.opened.text, "modes").get("pick", [])
        text = ", ".join(f"{item:.7g}" for item in found)
        said_ = f"Picked for the job: {text} Hz." if text else "Nothing is picked: all are taken."
        ui.label(said_).mark("picks")

    picks()
    watch(lambda: workspace.version, picks.refresh)
