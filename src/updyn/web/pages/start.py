"""The page Start: jobs of the project, a new job, demos, and files of the project."""

from __future__ import annotations

from collections.abc import Callable

from nicegui import events, run, ui

from updyn.demos import DEMOS
from updyn.errors import UpdynError
from updyn.frf import QUANTITIES, TRANSMISSIBILITY
from updyn.web.pages.frame import complain, show_errors
from updyn.web.settings import WEB_PAGE
from updyn.web.workspace import Workspace

__all__ = ["show"]

_UNKNOWN = "as in the file"


def show(workspace: Workspace) -> None:
    """Fill the page."""
    ui.label(str(workspace.project.folder)).classes("text-sm opacity-70")
    with ui.row().classes("w-full items-stretch"):
        with ui.card().classes("flex-1 min-w-72"):
            _show_jobs(workspace)
        with ui.card().classes("flex-1 min-w-72"):
            _show_demos(workspace)
        with ui.card().classes("flex-1 min-w-72"):
            new = ui.refreshable(_show_new_job)
            new(workspace, _NewJob())
        with ui.card().classes("flex-1 min-w-72"):
            _show_files(workspace, new.refresh)


def _show_jobs(workspace: Workspace) -> None:
    ui.label("Jobs of this folder").classes("text-lg")
    found = workspace.jobs()
    if not found:
        ui.label("None yet: open a demo, or write a new one.")
    for path in found:
        name = workspace.project.name_of(path)

        def open_job(name: str = name) -> None:
            workspace.open_job(name)
            ui.navigate.to("/measurement")

        ui.button(name, on_click=show_errors(open_job)).props("flat no-caps align=left")


def _show_demos(workspace: Workspace) -> None:
    ui.label("Demos").classes("text-lg")
    for demo in DEMOS.values():

        def open_demo(name: str = demo.name) -> None:
            workspace.open_demo(name)
            ui.navigate.to("/measurement")

        def run_demo(name: str = demo.name) -> None:
            workspace.open_demo(name)
            workspace.begin("run", workspace.proposed_folder("run"))
            ui.navigate.to("/run")

        with ui.column().classes("gap-0"):
            ui.label(f"{demo.description[:1].upper()}{demo.description[1:]}")
            with ui.row().classes("gap-1"):
                ui.button(f"Open {demo.name}", on_click=show_errors(open_demo)).props(
                    "flat dense no-caps"
                )
                ui.button(f"Run {demo.name}", on_click=show_errors(run_demo)).props(
                    "flat dense no-caps"
                )


class _NewJob:
    """Selections for a new job, kept when a file is added."""

    def __init__(self) -> None:
        self.model: str | None = None
        self.measurement: str | None = None
        self.quantity, self.name = _UNKNOWN, "job.toml"


def _show_new_job(workspace: Workspace, entries: _NewJob) -> None:
    """Show a form that writes a job for a model and a measurement."""
    ui.label("New job").classes("text-lg")
    names = [workspace.project.name_of(path) for path in workspace.project.inputs()]
    if not names:
        ui.label("Add the files of a model and of a measurement first.")
        return
    for what in ("model", "measurement"):
        entry = ui.select(names, label=what, with_input=True).classes("w-full")
        entry.bind_value(entries, what)
    choices = [_UNKNOWN, *QUANTITIES, TRANSMISSIBILITY]
    quantity = ui.select(choices, label="measured quantity").classes("w-full")
    quantity.bind_value(entries, "quantity")
    ui.input("Name of the job").classes("w-full").bind_value(entries, "name")

    async def write() -> None:
        if not entries.model or not entries.measurement:
            complain("choose a model file and a measurement file")
            return
        options: dict[str, object] = {
            "quantity": None if entries.quantity == _UNKNOWN else entries.quantity,
            "scale": None,
            "unit": None,
        }
        button.disable()
        try:
            await run.io_bound(
                workspace.create, entries.model, entries.measurement, entries.name.strip(), options
            )
        except (UpdynError, OSError) as error:
            complain(str(error))
            button.enable()
            return
        ui.navigate.to("/job")

    button = ui.button("Write", on_click=write).props("outline no-caps")


def _show_files(workspace: Workspace, on_added: Callable[[], object]) -> None:
    """Show the files of the folder and an upload; `on_added` is called for each new file."""
    ui.label("Files").classes("text-lg")
    ui.label("Added files are copied into the folder; no file is overwritten.")

    async def store_upload(event: events.UploadEventArguments) -> None:
        content = await event.file.read()
        try:
            stored = await run.io_bound(workspace.project.keep_upload, event.file.name, content)
        except (UpdynError, OSError) as error:
            complain(str(error))
            return
        if stored is not None:  # None: the server is shutting down
            ui.notify(f"{workspace.project.name_of(stored)} added", type="positive")
            show_files.refresh()
            on_added()

    def too_large() -> None:
        complain(f"the file is too large: at most {workspace.most_upload // 2**20} MB")

    ui.upload(
        on_upload=store_upload,
        on_rejected=too_large,
        auto_upload=True,
        label="Add files",
        max_file_size=workspace.most_upload,
    ).classes("w-full")

    @ui.refreshable
    def show_files() -> None:
        with ui.column().classes("gap-0"):
            found = workspace.project.inputs()
            for path in found[: WEB_PAGE.listed_files]:
                ui.label(workspace.project.name_of(path)).classes("text-sm")
            if len(found) > WEB_PAGE.listed_files:
                ui.label(f"and {len(found) - WEB_PAGE.listed_files} more").classes("text-sm")

    show_files()
