"""The page Job file: its text and its errors."""

from __future__ import annotations

from typing import Any

from nicegui import events, ui

from updyn.web.looking import JobView
from updyn.web.pages.frame import run_slow, show_errors, watch
from updyn.web.workspace import Workspace

__all__ = ["has_no_job", "show", "show_view_errors"]


def has_no_job(workspace: Workspace) -> bool:
    """Return whether no job is open; if so, show a message."""
    if workspace.document is not None:
        return False
    with ui.row():
        ui.label("No job is open.")
        ui.link("Open one", "/")
    return True


def show_view_errors(view: JobView) -> None:
    """Show errors of reading and matching."""
    for text in dict.fromkeys(view.errors.values()):
        with ui.row().classes("items-start no-wrap"):
            ui.icon("error", color="negative").props('aria-label="Error"')
            ui.label(text).classes("whitespace-pre-wrap")


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if has_no_job(workspace):
        return
    document = workspace.open_document

    def store_text(event: events.ValueChangeEventArguments[Any]) -> None:
        document.type(str(event.value))

    with ui.row().classes("items-center"):
        copy = ui.input("Another name", placeholder="job-2.toml").classes("w-60")

        def save_as() -> None:
            workspace.save_as(copy.value)
            ui.notify(f"Saved as {workspace.project.name_of(document.path)}", type="positive")

        ui.button("Save as", on_click=show_errors(save_as)).props("outline no-caps")
    editor = ui.codemirror(document.text, language="TOML", on_change=store_text)
    editor.classes("w-full").style("height: 60vh")
    watch(lambda: document.text, lambda: editor.set_value(document.text))

    @ui.refreshable
    async def show_check() -> None:
        view = await run_slow(workspace.view)
        if view is None:
            return
        show_view_errors(view)
        if not view.errors:
            ui.label(f"{view.model}; {len(view.unknowns)} unknowns. Nothing is wrong with the job.")

    watch(lambda: workspace.version, show_check.refresh)
    await show_check()
