"""The page Start: jobs of the project, a new job, demos, and files of the project."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import events, run, ui

from updyn.demos import DEMOS
from updyn.errors import UpdynError
from updyn.frf import QUANTITIES, TRANSMISSIBILITY
from updyn.web.pages.frame import complain, navigate_after, show_errors
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
            new(workspace)
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


def _show_new_job(workspace: Workspace) -> None:
    """Show a form that writes a job for a model and a measurement."""
    ui.label("New job").classes("text-lg")
    entries = workspace.new_job
    names = [workspace.project.name_of(path) for path in workspace.project.inputs()]
    if not names:
        ui.label("Add the files of a model and of a measurement first.")
        return

    def show_select(what: str) -> ui.select:
        chosen = getattr(entries, what)
        options = names if chosen in ("", *names) else [chosen, *names]
        entry = ui.select(options, value=chosen or None, label=f"{what} *", with_input=True)
        return entry.classes("w-full")

    def choose_model(event: events.ValueChangeEventArguments[Any]) -> None:
        entries.model = event.value or ""
        update()

    async def choose_measurement(event: events.ValueChangeEventArguments[Any]) -> None:
        entries.measurement, entries.reading = event.value or "", {}
        await read_measurement()

    async def choose_quantity(event: events.ValueChangeEventArguments[Any]) -> None:
        entries.quantity = "" if event.value == _UNKNOWN else event.value
        await read_measurement()

    async def read_measurement() -> None:
        state.refresh(is_reading=bool(entries.measurement))
        try:
            await run.io_bound(workspace.view_new_measurement)
        except UpdynError as error:
            complain(str(error))
        state.refresh(is_reading=False)
        update()

    def set_name(event: events.ValueChangeEventArguments[Any]) -> None:
        entries.name = event.value or ""
        update()

    def update() -> None:
        button.set_enabled(entries.is_complete)

    show_select("model").on_value_change(choose_model)
    show_select("measurement").on_value_change(choose_measurement)

    @ui.refreshable
    def state(is_reading: bool = False) -> None:
        _show_measurement(workspace, is_reading)

    state()
    quantity = ui.select(
        [_UNKNOWN, *QUANTITIES, TRANSMISSIBILITY],
        value=entries.quantity or _UNKNOWN,
        label="measured quantity",
    )
    quantity.classes("w-full").on_value_change(choose_quantity)
    name = ui.input("Name of the job *", value=entries.name).classes("w-full")
    name.on_value_change(set_name)

    async def write() -> None:
        button.disable()
        try:
            await run.io_bound(workspace.create)
        except (UpdynError, OSError) as error:
            complain(str(error))
            update()
            return
        ui.navigate.to("/job")

    button = ui.button("Write", on_click=write).props("outline no-caps")
    update()


def _show_measurement(workspace: Workspace, is_reading: bool) -> None:
    """Show the summary or the error of the measured file, and a button to select its FRFs."""
    view = workspace.new_job.view
    if is_reading:
        with ui.row().classes("items-center"):
            ui.spinner()
            ui.label("Reading …")
        return
    if view is None:
        return

    async def open_table() -> None:
        await navigate_after("/table", workspace.open_new_table)

    with ui.row().classes("items-start no-wrap w-full"):
        if view.error:
            ui.icon("error", color="negative").props('aria-label="Error"')
        else:
            ui.icon("check_circle", color="positive").props('aria-label="Read"')
        text = view.error or view.summary
        if view.error and view.has_items:
            text = f"Select its FRFs, as its layout is not known. {view.error}"
        ui.label(text).classes("text-sm").props("role=status")
    if view.has_items:
        look = "" if view.error else "flat dense"
        ui.button("Select the FRFs", icon="table_chart", on_click=open_table).props(
            f"no-caps {look}"
        )


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
