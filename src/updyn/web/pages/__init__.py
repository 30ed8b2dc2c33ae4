"""The pages of the app: one module each, and an entry in `PAGES`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape

from fastapi import FastAPI, Query
from fastapi.responses import HTMLResponse
from fastapi.staticfiles import StaticFiles
from nicegui import ui

from updyn.errors import UpdynError
from updyn.style import LOOKS
from updyn.web.look import FIGURE_SCRIPTS
from updyn.web.looking import render_structure
from updyn.web.pages import check, job, measurement, model, results, running, start, table, unknowns
from updyn.web.pages.frame import add_frame
from updyn.web.pages.task import task_page
from updyn.web.settings import WEB_CONNECTION, WEB_PAGE
from updyn.web.steps import STEPS
from updyn.web.workspace import Workspace

__all__ = ["PAGES", "add_pages"]

#: The pages that are no steps of a job, by address: name, and function that fills the page.
PAGES: Mapping[str, tuple[str, Callable[[Workspace], object]]] = {
    "/": ("Start", start.show),
    "/job": ("Job file", job.show),
    "/plan": ("Plan", task_page("plan")),
    "/modes": ("Modes", task_page("modes")),
    "/plant": ("Plant", task_page("plant")),
}
#: Functions that fill the pages of the steps, by address.
_STEP_PAGES: Mapping[str, Callable[[Workspace], object]] = {
    "/measurement": measurement.show,
    "/model": model.show,
    "/unknowns": unknowns.show,
    "/check": check.show,
    "/run": running.show,
    "/results": results.show,
}
#: Pages that another page opens, which the navigation does not list.
_OPENED: Mapping[str, tuple[str, Callable[[Workspace], object]]] = {
    "/table": ("Table", table.show),
    "/correlate": ("Correlation", task_page("correlate")),
    "/compare": ("Methods", task_page("compare")),
}
#: A written page may run its own script only, and cannot send requests to this server.
_SANDBOX = "sandbox allow-scripts allow-downloads allow-popups allow-modals"


def add_pages(app: FastAPI, workspace: Workspace) -> None:
    """Add all pages and embedded pages to an application."""
    # At the end of a transition, a list that was closed takes the focus from the next entry.
    ui.select.default_props("transition-duration=0")
    places = {place: name for place, (name, _) in PAGES.items()}
    steps = {place: (STEPS[place], fill) for place, fill in _STEP_PAGES.items()}
    for place, (name, fill) in {**PAGES, **steps, **_OPENED}.items():
        page = ui.page(place, reconnect_timeout=WEB_CONNECTION.reconnect_seconds)
        page(add_frame(workspace, places, place, name, fill))

    app.mount(FIGURE_SCRIPTS, StaticFiles(packages=[("updyn.report", "assets")]))

    @app.get("/embedded/structure")
    def serve_structure(modes: int = Query(0, ge=0, le=WEB_PAGE.most_modes)) -> HTMLResponse:
        try:
            content = workspace.ask(render_structure, modes)
        except UpdynError as error:
            return _plain(str(error), 200)  # the surrounding page shows the same message
        return _sandbox_page(content, workspace.theme)

    @app.get("/embedded/page/{name:path}")
    def serve_page(name: str) -> HTMLResponse:
        try:
            path = workspace.project.inside(name)
            if path.suffix != ".html":
                return _plain(f"{name}: only pages that a task has written are shown")
            content = path.read_text(encoding="utf-8")
        except (UpdynError, OSError, UnicodeDecodeError) as error:
            return _plain(f"{name}: cannot be shown: {error}")
        return _sandbox_page(content, workspace.theme)


def _sandbox_page(page: str, theme: str) -> HTMLResponse:
    """Return a page of the package, light or dark like the pages of the app."""
    if theme in LOOKS:
        page = page.replace("<html ", f'<html data-look="{theme}" ', 1)
    return HTMLResponse(page, headers={"content-security-policy": _SANDBOX})


def _plain(text: str, status: int = 404) -> HTMLResponse:
    head = (
        '<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>Not shown</title>'
        '<meta name="color-scheme" content="light dark">'
        "<style>p { font-family: sans-serif }</style>"
    )
    return HTMLResponse(f"{head}<p>{escape(text)}</p>", status_code=status)
