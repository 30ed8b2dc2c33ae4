"""The page Start: a place to drop files, the new job that they make, jobs, and demos."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from nicegui import events, run, ui

from updyn.demos import DEMOS, Demo
from updyn.errors import UpdynError
from updyn.frf import QUANTITIES, TRANSMISSIBILITY
from updyn.web.entry import TextEntry
from updyn.web.pages.frame import complain, navigate_after, show_errors, show_fault
from updyn.web.pages.watch import ValueChange
from updyn.web.project import describe_error
from updyn.web.recognition import Recognised
from updyn.web.workspace import Workspace

__all__ = ["show"]

_UNKNOWN = "as in the file"
_DROP = """<div class="updyn-drop" @click="props.pickFiles">
  <div class="text-h6">Drop a model and a measurement here</div>
  <div>or a job; or click to choose files. They are recognised by their content.</div>
  <q-uploader-add-trigger />
</div>"""
_NOUNS = {"job": "job", "model": "model", "measurement": "measurement", "table": "measurement"}


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    with ui.row().classes("w-full items-start max-md:flex-col md:flex-nowrap"):
        with ui.card().classes("w-full md:flex-1 min-w-0"):
            await _NewJobCard(workspace).show()
        with ui.card().classes("w-full md:w-96"):
            _show_jobs(workspace)
    ui.label("Or start from a demo").classes("text-lg")
    with ui.row().classes("w-full items-stretch"):
        for demo in DEMOS.values():
            _show_demo(workspace, demo)


def _show_jobs(workspace: Workspace) -> None:
    folder = ui.label(f"Jobs in {workspace.project.folder.name}").classes("text-lg")
    with folder:
        ui.tooltip(str(workspace.project.folder))
    found = workspace.jobs()
    if not found:
        ui.label("None yet.")
    for path in found:
        name = workspace.project.name_of(path)

        def open_job(name: str = name) -> None:
            workspace.open_job(name)
            ui.navigate.to("/measurement")

        title = _read_title(path)
        button = ui.button(on_click=show_errors(open_job)).props("flat no-caps align=left")
        with button, ui.column().classes("gap-0 items-start text-left"):
            if title:
                ui.label(title)
            ui.label(name).classes("text-sm opacity-80" if title else "")


def _read_title(path: Path) -> str:
    """Return the title that a job states; empty if there is none."""
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8")).get("title")
    except (OSError, ValueError, RecursionError):
        return ""
    return found if isinstance(found, str) else ""


def _show_demo(workspace: Workspace, demo: Demo) -> None:
    """Show the picture of a demo, and buttons to open it and to run it."""

    def open_demo() -> None:
        workspace.open_demo(demo.name)
        ui.navigate.to("/measurement")

    def run_demo() -> None:
        workspace.open_demo(demo.name)
        workspace.begin("run", workspace.proposed_folder("run"))
        ui.navigate.to("/run")

    with ui.card().classes("flex-1 min-w-40 gap-1 justify-between"):
        picture = _read_picture(demo.name)
        if picture:
            ui.html(picture, sanitize=False).classes("w-full updyn-demo")
        ui.label(f"{demo.description[:1].upper()}{demo.description[1:]}")
        with ui.row().classes("gap-1"):
            for word, action in (("Open", open_demo), ("Run", run_demo)):
                button = ui.button(f"{word} {demo.name}", on_click=show_errors(action))
                button.props("flat dense no-caps")


@cache
def _read_picture(name: str) -> str:
    """Return the picture of a shipped demo as SVG; empty if there is none."""
    picture = files("updyn.web") / "pictures" / f"{name}.svg"
    return picture.read_text(encoding="utf-8") if picture.is_file() else ""


class _NewJobCard:
    """A place to drop files, and the form of a job for a model and a measurement.

    The form appears once there are files, and its entries are kept while files are added.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._is_reading = False

    async def show(self) -> None:
        """Build this part of the page."""
        ui.label("New job").classes("text-lg")
        self._show_drop()
        self._dropped = ui.column().classes("w-full gap-1")
        self._form = ui.column().classes("w-full")
        with self._form:
            self._show_form()
        job = self._workspace.new_job
        if not (job.model or job.measurement or self._workspace.jobs()):
            ui.timer(0.0, self._take_inputs, once=True)

    # -- files -------------------------------------------------------------------------------------
    def _show_drop(self) -> None:
        workspace = self._workspace

        def too_large() -> None:
            self._report("", f"the file is too large: at most {workspace.most_upload // 2**20} MB")

        drop = ui.upload(
            on_upload=self._take_upload,
            on_rejected=too_large,
            auto_upload=True,
            multiple=True,
            max_file_size=workspace.most_upload,
        )
        drop.classes("w-full").props("flat bordered").add_slot("header", _DROP)
        ui.label("Files are copied into the folder; no file is overwritten.").classes("text-sm")

    async def _take_upload(self, event: events.UploadEventArguments) -> None:
        """Keep an added file and use it for the new job, by its content."""
        workspace, name = self._workspace, event.file.name
        content = await event.file.read()
        try:
            stored = await run.io_bound(workspace.project.keep_upload, name, content)
            if stored is None:  # the server is shutting down
                return
            found = await self._wait(workspace.take_file, workspace.project.name_of(stored))
        except (UpdynError, OSError) as error:
            self._report(name, describe_error(error))
            return
        if found is not None:
            self._show_dropped(name, found)
        self._update()

    async def _take_inputs(self) -> None:
        """Look for a model and a measurement among the files of the folder."""
        if not self._workspace.project.inputs():
            return
        try:
            await self._wait(self._workspace.take_inputs)
        except UpdynError as error:
            self._report("", describe_error(error))
        self._update()

    async def _wait(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Call a function that reads files; meanwhile the page shows that it reads."""
        self._is_reading = True
        self._update()
        try:
            return await run.io_bound(function, *arguments)
        finally:
            self._is_reading = False

    def _show_dropped(self, name: str, found: Recognised) -> None:
        """Show what an added file is."""
        if not found.kind:
            self._report(name, found.text)
            return

        def open_job() -> None:
            self._workspace.open_job(name)
            ui.navigate.to("/measurement")

        with self._dropped, ui.row().classes("items-center gap-2"):
            ui.icon("check_circle", color="positive").props("aria-hidden=true")
            ui.label(f"{name}: {_NOUNS[found.kind]}").props("role=status")
            if found.kind == "job":
                ui.button("Open", on_click=show_errors(open_job)).props("no-caps dense")

    def _report(self, name: str, text: str) -> None:
        """Show an error about an added file."""
        with self._dropped, ui.row().classes("items-start gap-2 no-wrap"):
            ui.icon("error", color="negative").props("aria-hidden=true")
            ui.label(text if text.startswith(name) else f"{name}: {text}").props("role=alert")

    # -- form --------------------------------------------------------------------------------------
    def _show_form(self) -> None:
        workspace = self._workspace

        async def choose_model(event: ValueChange) -> None:
            if (event.value or "") != workspace.new_job.model:
                workspace.new_job.model = event.value or ""
                await self._read(workspace.recognise_new_model)

        async def choose_measurement(event: ValueChange) -> None:
            job = workspace.new_job
            if (event.value or "") != job.measurement:
                job.measurement, job.reading = event.value or "", {}
                await self._read(workspace.view_new_measurement)

        async def choose_quantity(event: ValueChange) -> None:
            quantity = "" if event.value == _UNKNOWN else event.value
            if quantity != workspace.new_job.quantity:
                workspace.new_job.quantity = quantity
                await self._read(workspace.view_new_measurement)

        def set_name(event: ValueChange) -> None:
            workspace.new_job.name = event.value or ""
            self._update()

        async def open_table() -> None:
            await navigate_after("/table", workspace.open_new_table)

        with ui.row().classes("w-full items-start"):
            self._model = ui.select([], label="model *", with_input=True)
            self._model.classes("flex-1 min-w-56").on_value_change(choose_model)
            self._measurement = ui.select([], label="measurement *", with_input=True)
            self._measurement.classes("flex-1 min-w-56").on_value_change(choose_measurement)
        self._table = ui.button("Select the FRFs", icon="table_chart", on_click=open_table)
        self._table.props("no-caps")
        with ui.row().classes("w-full items-start"):
            quantities = [_UNKNOWN, *QUANTITIES, TRANSMISSIBILITY]
            self._quantity = ui.select(quantities, value=_UNKNOWN, label="measured quantity")
            self._quantity.classes("flex-1 min-w-56").on_value_change(choose_quantity)
            self._name = TextEntry("Name of the job *", value=workspace.new_job.name)
            self._name.classes("flex-1 min-w-56").on_value_change(set_name)
        with ui.row().classes("items-center"):
            self._create = ui.button("Create the job", on_click=self._write).props("no-caps")
            self._spinner = ui.spinner()
            self._missing = ui.label().props("role=status")
        self._update()

    async def _read(self, function: Callable[[], None]) -> None:
        try:
            await self._wait(function)
        except UpdynError as error:
            complain(describe_error(error))
        self._update()

    def _update(self) -> None:
        """Show the entries of the new job, with their faults."""
        workspace, job = self._workspace, self._workspace.new_job
        if self._form.is_deleted:
            return
        names = [workspace.project.name_of(path) for path in workspace.project.inputs()]
        self._form.set_visibility(bool(names))
        for entry, chosen in ((self._model, job.model), (self._measurement, job.measurement)):
            options = names if chosen in ("", *names) else [chosen, *names]
            if (entry.options, entry.value) != (options, chosen or None):
                entry.set_options(options, value=chosen or None)
        self._quantity.set_value(job.quantity or _UNKNOWN)
        faults = workspace.find_new_job_faults()
        recognised, view = job.recognised, job.view
        hint = "" if recognised is None else recognised.text
        show_fault(self._model, faults.get("model", ""), hint)
        show_fault(
            self._measurement, faults.get("measurement", ""), "" if view is None else view.summary
        )
        show_fault(self._quantity, faults.get("quantity", ""))
        show_fault(self._name, faults.get("name", ""))
        has_items = view is not None and view.has_items
        self._table.set_visibility(has_items)
        is_needed = view is not None and bool(view.error)
        self._table.props(
            "" if is_needed else "flat dense", remove="flat dense" if is_needed else ""
        )
        self._create.set_enabled(not faults and not self._is_reading)
        self._spinner.set_visibility(self._is_reading)
        missing = [what for what in ("model", "measurement") if not getattr(job, what)]
        text = f"Still missing: {' and '.join(missing)}." if missing else ""
        self._missing.set_text("Reading …" if self._is_reading else text)

    async def _write(self) -> None:
        self._create.disable()
        try:
            await run.io_bound(self._workspace.create)
        except (UpdynError, OSError) as error:
            complain(describe_error(error))
            self._update()
            return
        ui.navigate.to("/measurement")
