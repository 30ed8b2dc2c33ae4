"""Pages of tasks: start and stop a task, and show its progress and the page that it writes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeGuard
from urllib.parse import quote

from nicegui import ui

from updyn.group import is_number
from updyn.registry import load_object
from updyn.web import edits
from updyn.web.entry import TextEntry
from updyn.web.form import written_table
from updyn.web.pages.frame import embed_page, show_errors, show_fault, watch
from updyn.web.pages.job import has_no_job
from updyn.web.pages.picks import listen_for_picks
from updyn.web.pages.watch import ValueChange
from updyn.web.tasks import TASKS, Field
from updyn.web.worker import Worker
from updyn.web.workspace import Workspace

__all__ = ["show_controls", "show_worker", "task_page"]


def show_controls(workspace: Workspace, task: str, *, begin: str) -> None:
    """Show the results folder and the buttons of a task; `begin` labels the start button."""
    with ui.row().classes("items-center"):
        folder = TextEntry("Folder for the results", value=workspace.proposed_folder(task))
        folder.classes("w-80")
        start = show_errors(lambda: workspace.begin(task, folder.value))
        buttons = [ui.button(begin, on_click=start).props("no-caps")]
        if TASKS.find(task).resumes:
            resume = show_errors(lambda: workspace.begin(task, folder.value, resume=True))
            buttons.append(ui.button("Resume", on_click=resume).props("outline no-caps"))

        def stop() -> None:
            worker = workspace.workers.get(task)
            if worker is not None:
                worker.stop()

        stop_button = ui.button("Stop", on_click=stop).props("outline no-caps")

    def update() -> None:
        ready = workspace.document is not None and not workspace.faults(task)
        for button in buttons:
            button.set_enabled(ready and not workspace.is_busy)

    def update_stop() -> None:
        worker = workspace.workers.get(task)
        stop_button.set_enabled(worker is not None and worker.state == "running")

    update()
    update_stop()
    watch(lambda: (workspace.version, _state_of_form(workspace, task), workspace.is_busy), update)
    watch(lambda: _version(workspace.workers.get(task)), update_stop)


def show_worker(worker: Worker, workspace: Workspace, place: str = "") -> None:
    """Show the state of a task in words, with its notes and its summary.

    `place` is the address of the page of its results, if there is a separate one.
    """
    with ui.row().classes("items-center"):
        if worker.active:
            ui.spinner()
        ui.label(worker.progress).classes("text-lg").mark("state").props("role=status")
        if place and worker.state == "done":
            ui.link("Results", place)
    if not workspace.is_of_open_job(worker):
        ui.label(f"Of another job: {workspace.project.name_of(worker.job)}")
    for note in list(worker.notes):
        ui.label(note).classes("opacity-80 whitespace-pre-wrap")
    if worker.message or worker.stages:
        with ui.expansion("Summary", value=worker.state == "failed").classes("w-full"):
            lines = "\n".join([*worker.stages, worker.message])
            ui.label(lines).classes("whitespace-pre font-mono text-sm overflow-auto")


def task_page(task: str) -> Callable[[Workspace], None]:
    """Return a page of a task: its keys in the job, its buttons, and the page that it writes."""

    def show(workspace: Workspace) -> None:
        if has_no_job(workspace):
            return
        ui.label(TASKS.find(task).about)
        with ui.row().classes("items-center gap-x-8"):
            if TASKS.find(task).fields:
                _show_form(workspace, task)
            show_controls(workspace, task, begin="Save and begin")
        if TASKS.find(task).panel:
            load_object(TASKS.find(task).panel)(workspace)
        known: dict[str, str] = {}
        if task == "modes":
            _pick_modes(workspace, known)

        @ui.refreshable
        def state() -> None:
            worker = workspace.worker(task)
            with ui.row().classes("w-full items-center gap-x-8"):
                if worker is not None:
                    show_worker(worker, workspace)
                if worker is None or not worker.active:
                    _show_pages(workspace, task, known)

        state()
        watch(lambda: _version(workspace.worker(task)), state.refresh)

    return show


def _show_pages(workspace: Workspace, task: str, known: dict[str, str]) -> None:
    """Show the latest page that the task wrote for the job, with a selection of other pages.

    `known` receives the ``picks`` of the job as shown on the written page.
    """
    pages, latest = workspace.pages(task)
    if not pages:
        return

    def picks() -> str:
        return _format_picks(workspace) if task == "modes" else ""

    @ui.refreshable
    def page() -> None:
        if chosen.value:
            known["picks"] = picks()
            path = workspace.project.inside(chosen.value)
            stamp = path.stat().st_mtime_ns if path.is_file() else 0
            place = f"/embedded/page/{quote(chosen.value)}?{stamp}{known['picks']}"
            embed_page(place, TASKS.find(task).page, "85vh")

    def follow() -> None:
        if picks() != known.get("picks", ""):  # changed elsewhere, such as by Undo
            page.refresh()

    chosen = ui.select(pages, value=latest or None, label="Results", on_change=page.refresh)
    chosen.classes("w-96 max-w-full")
    watch(lambda: workspace.version, follow)
    page()


def _version(worker: Worker | None) -> object:
    return None if worker is None else (id(worker), worker.version)


# -- keys of the table -----------------------------------------------------------------------------
def _show_form(workspace: Workspace, task: str) -> None:
    """Show entries for the keys of the job's table.

    The entries are never rebuilt while the job changes, because text typed meanwhile would be lost.
    """
    shown: dict[str, Any] = {}
    with ui.row().classes("items-center"):
        for field in TASKS.find(task).fields:
            shown[field.key] = _show_entry(workspace, task, field)
    with ui.row().classes("items-center") as error_row:
        reason = ui.label().classes("text-negative whitespace-pre-wrap").mark("form")
        reason.props("role=alert")
        discard = ui.button("Discard entries", on_click=lambda: workspace.form(task).discard())
        discard.props("flat dense no-caps")

    def update() -> None:
        if workspace.document is None:
            return
        for key, text in workspace.entries(task).items():
            entry = shown[key]
            if isinstance(entry, ui.select) and text not in entry.options:
                entry.set_options([*entry.options, text])
            entry.set_value(text)
        form, faults = workspace.form(task), workspace.faults(task)
        for key, entry in shown.items():
            show_fault(entry, faults.get(key, ""))
        error_row.set_visibility(bool(form.reason))
        reason.set_text(f"Not in the job yet: {form.reason}")

    update()
    watch(lambda: (workspace.version, _state_of_form(workspace, task)), update)


def _state_of_form(workspace: Workspace, task: str) -> object:
    """Return a value that changes with the content of a form."""
    form = workspace.form(task)
    return tuple(form.pending.items()), tuple(form.proposed.items()), form.reason


def _show_entry(workspace: Workspace, task: str, field: Field) -> Any:
    text = workspace.entries(task)[field.key]
    label = f"{field.label} *" if field.required else field.label

    if field.kind == "choice":

        def commit_choice(event: ValueChange) -> None:
            show_errors(workspace.enter)(task, field.key, str(event.value or ""))

        choices = list(dict.fromkeys([*field.choices, text]))
        select = ui.select(choices, value=text, label=label, on_change=commit_choice)
        return select.classes("min-w-40")

    def store_entry(event: ValueChange) -> None:
        show_errors(workspace.note)(task, field.key, str(event.value or ""))

    def commit_entry() -> None:
        show_errors(workspace.enter)(task, field.key, str(entry.value or ""))

    entry = TextEntry(label, value=text, on_change=store_entry).classes("min-w-56")
    return entry.on("blur", commit_entry).on("keydown.enter", commit_entry)


def _pick_modes(workspace: Workspace, known: dict[str, str]) -> None:
    """Let the page of modes set the picks of the job; `known` receives those on the page."""

    def take(message: Mapping[str, Any]) -> None:
        pick, poles = message.get("pick"), message.get("poles")
        if _are_frequencies(pick) and _are_frequencies(poles):
            show_errors(workspace.edit)("pick modes", edits.set_picks(pick, poles))
            known["picks"] = _format_picks(workspace)

    listen_for_picks(take)

    @ui.refreshable
    def picks() -> None:
        table = written_table(workspace.open_document.text, "modes")
        pick, poles = (", ".join(_format_frequencies(table.get(key))) for key in ("pick", "poles"))
        text = f"Modes for the job: {f'those at {pick} Hz' if pick else 'all that are found'}"
        if poles:
            text += f", and new ones at {poles} Hz"
        ui.label(f"{text}.").mark("picks")

    picks()
    watch(lambda: workspace.version, picks.refresh)


def _format_picks(workspace: Workspace) -> str:
    """Return the picks of the open job as a URL fragment."""
    if workspace.document is None:
        return ""
    table = written_table(workspace.open_document.text, "modes")
    parts = [f"{key}={','.join(_format_frequencies(table.get(key)))}" for key in ("pick", "poles")]
    return f"#{'&'.join(parts)}"


def _are_frequencies(given: object) -> TypeGuard[list[float]]:
    """Whether a value sent by a page is a list of positive frequencies in Hz."""
    return isinstance(given, list) and all(is_number(f) and 0 < f < math.inf for f in given)


def _format_frequencies(given: object) -> list[str]:
    items = given if isinstance(given, list) else [given]
    return [f"{item:.7g}" for item in items if is_number(item)]
