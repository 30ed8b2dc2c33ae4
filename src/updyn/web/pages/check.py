"""The page Check: what is known of a job before a run, with a button for each repair."""

from __future__ import annotations

from nicegui import ui

from updyn.web import edits
from updyn.web.looking import CheckRow, check_job
from updyn.web.pages.frame import run_slow, show_errors, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.pages.task import task_page
from updyn.web.workspace import Workspace

__all__ = ["show"]


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if has_no_job(workspace):
        return

    @ui.refreshable
    async def content() -> None:
        view = await run_slow(workspace.view)
        if view is None:
            return
        show_view_errors(view)
        if view.errors:
            ui.link("Correct the text of the job", "/job")
            return
        for row in await run_slow(workspace.ask, check_job, note="Checking …") or ():
            _show_row(workspace, row)

    watch(lambda: workspace.version, content.refresh)
    await content()
    ui.separator()
    task_page("check")(workspace)


def _show_row(workspace: Workspace, row: CheckRow) -> None:
    with ui.card().classes("w-full"):
        with ui.row().classes("items-start no-wrap"):
            if row.is_problem:
                ui.icon("warning", color="warning", size="sm").props('aria-label="Problem"')
            else:
                ui.icon("check_circle", color="positive", size="sm").props('aria-label="In order"')
            ui.label(row.statement).classes("whitespace-pre-wrap")
        if row.remedy:
            ui.label(row.remedy).classes("opacity-80 whitespace-pre-wrap")
        if row.repair:
            repair = edits.add_repair(row.repair, row.test)
            ui.button(
                f"Repair: {row.repair}",
                on_click=show_errors(lambda: workspace.edit(f"repair {row.repair}", repair)),
            ).props("no-caps")
