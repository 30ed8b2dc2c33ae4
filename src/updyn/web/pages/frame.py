"""What all pages have: the way to the others, the open job with undo and save, and messages."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeVar

from nicegui import run, ui

from updyn.errors import UpdynError
from updyn.style import PAPER
from updyn.web.document import JobDocument
from updyn.web.look import HEAD, THEMES
from updyn.web.workspace import Workspace

__all__ = ["asked", "complain", "embedded", "framed", "redraw", "said", "watch"]

T = TypeVar("T")

#: How often a page looks whether something has changed, in s.
_PERIOD = 0.5
_DARK = {"auto": None, "light": False, "dark": True}


def framed(
    workspace: Workspace, places: Mapping[str, str], here: str, fill: Callable[[Workspace], Any]
) -> Callable[[], Awaitable[None]]:
    """Return a page with its frame.

    Parameters
    ----------
    workspace : Workspace
        What it shows.
    places : mapping of str to str
        Names of the pages by their place.
    here : str
        The place of this one.
    fill : callable
        Makes its content.

    Returns
    -------
    callable
        Makes the page.
    """

    async def page() -> None:
        ui.add_head_html(HEAD)
        ui.colors(primary=PAPER["after"], negative=PAPER["bad"], positive=PAPER["good"])
        ui.dark_mode(_DARK[workspace.theme])
        ui.query(".nicegui-content").classes("w-full max-w-screen-2xl mx-auto")
        with ui.header(elevated=False).classes("items-center gap-1 py-1 updyn-nav"):
            ui.label("updyn").classes("text-lg font-bold mr-4")
            with ui.element("nav").classes("flex gap-1").props('aria-label="Pages"'):
                for place, name in places.items():
                    link = ui.link(name, place).classes("px-2 py-1 rounded no-underline")
                    if place == here:
                        link.props("aria-current=page")
            ui.space()
            _job_bar(workspace)
            _theme(workspace)
        result = fill(workspace)
        if isinstance(result, Awaitable):
            await result

    return page


def _theme(workspace: Workspace) -> None:
    """Offer the look of the pages."""

    def chosen(theme: str) -> Callable[[], None]:
        def choose() -> None:
            workspace.theme = theme
            ui.navigate.reload()

        return choose

    with ui.button(icon="contrast").props('flat dense aria-label="Light or dark"'), ui.menu():
        for theme, name in THEMES.items():
            ui.menu_item(name, on_click=chosen(theme))


def _job_bar(workspace: Workspace) -> None:
    """Show the open job, with undo, redo and save.

    The buttons stay the same while the job changes: a click on one that is made anew meanwhile
    would be lost.
    """

    def on_document(action: Callable[[JobDocument], None]) -> Callable[[], None]:
        return said(lambda: action(workspace.opened))

    def saved() -> None:
        said(workspace.save)()
        update()

    with ui.row().classes("items-center gap-1"):
        name = ui.label().mark("job")
        buttons = ui.row().classes("items-center gap-1")
        with buttons:
            undo = ui.button(icon="undo", on_click=on_document(JobDocument.undo))
            redo = ui.button(icon="redo", on_click=on_document(JobDocument.redo))
            for button, word in ((undo, "Undo"), (redo, "Redo")):
                button.props(f"flat dense aria-label={word}")
            with undo:
                undo_tip = ui.tooltip("")
            with redo:
                redo_tip = ui.tooltip("")
            save = ui.button("Save", on_click=saved)
            save.props("flat dense no-caps")

    def update() -> None:
        document = workspace.document
        buttons.set_visibility(document is not None)
        if document is None:
            name.set_text("no job open")
            return
        edited = " (edited)" if workspace.unsaved else ""
        name.set_text(workspace.project.name_of(document.path) + edited)
        last, following = document.last_edit, document.next_edit
        undo_tip.set_text(f"Undo: {last}" if last else "Nothing to undo")
        redo_tip.set_text(f"Redo: {following}" if following else "Nothing to redo")
        undo.set_enabled(bool(last))
        redo.set_enabled(bool(following))
        save.set_enabled(workspace.unsaved)

    update()
    watch(lambda: (workspace.version, workspace.unsaved), update)


def watch(version: Callable[[], object], refresh: Callable[[], Any]) -> None:
    """Do something whenever a value has changed: what another tab or a run has done is seen so.

    To be called before what shows the value: a change while that is being made is seen, too.

    Parameters
    ----------
    version : callable
        Returns the value.
    refresh : callable
        What is done.
    """
    last = version()

    def look() -> None:
        nonlocal last
        now = version()
        if now != last:
            last = now
            refresh()

    ui.timer(_PERIOD, look)


def redraw(chart: ui.echart, options: Mapping[str, Any]) -> None:
    """Show other options in a chart that is there.

    A chart that is made anew instead may be gone before the browser has drawn it, which ends in an
    error of the browser.

    Parameters
    ----------
    chart : echart
        The chart.
    options : mapping
        From `updyn.web.charts`.
    """
    chart.options.clear()
    chart.options.update(options)
    chart.update()


def said(action: Callable[..., Any]) -> Callable[..., None]:
    """Return an action whose error is shown as a message.

    Parameters
    ----------
    action : callable
        May raise an `UpdynError`.

    Returns
    -------
    callable
    """

    @functools.wraps(action)
    def safe(*arguments: Any) -> None:
        try:
            action(*arguments)
        except (UpdynError, OSError) as error:
            complain(str(error))

    return safe


def complain(text: str) -> None:
    """Show a message that stays until it is closed.

    Parameters
    ----------
    text : str
        The message.
    """
    close = [{"label": "Close", "color": "white"}]
    ui.notify(text, type="negative", timeout=0, actions=close, multi_line=True)


async def asked(function: Callable[..., T], *arguments: Any) -> T | None:
    """Return what a slow function gives, the page alive meanwhile; its error is shown in place.

    Parameters
    ----------
    function : callable
        May raise an `UpdynError`.
    *arguments : object
        Its arguments.

    Returns
    -------
    object or None
        None where it raised, or the page was drawn anew meanwhile.
    """
    with ui.row().classes("items-center") as waiting:
        ui.spinner()
        ui.label("Reading …")
    trouble = ""
    try:
        found = await run.io_bound(function, *arguments)
    except UpdynError as error:
        found, trouble = None, str(error)
    if waiting.is_deleted:
        return None  # the page was drawn anew meanwhile
    waiting.delete()
    if trouble:
        ui.label(trouble).classes("whitespace-pre-wrap text-negative")
    return found


def embedded(place: str, title: str, height: str) -> None:
    """Show another page within this one; it cannot reach this one but by messages.

    Parameters
    ----------
    place : str
        Its address on this server.
    title : str
        What it is, for readers of the screen.
    height : str
        In the units of style sheets.
    """
    frame = ui.element("iframe").classes("w-full").style(f"height: {height}; border: 0")
    frame._props.update(src=place, title=title)
