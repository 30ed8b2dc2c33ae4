"""The common parts of all pages: navigation, the open job with undo and save, and messages."""

from __future__ import annotations

import functools
import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeVar

from nicegui import run, ui

from updyn.errors import UpdynError
from updyn.progress import format_clock
from updyn.style import LOOKS, PAPER
from updyn.web.document import JobDocument
from updyn.web.form import REQUIRED
from updyn.web.look import HEAD, THEMES
from updyn.web.pages.steps import show_step, show_steps
from updyn.web.pages.watch import watch
from updyn.web.project import describe_error
from updyn.web.steps import STEPS
from updyn.web.workspace import Workspace

__all__ = [
    "add_frame",
    "complain",
    "embed_page",
    "navigate_after",
    "run_slow",
    "show_errors",
    "show_fault",
    "watch",
]

T = TypeVar("T")

_DARK = {"auto": None, "light": False, "dark": True}


def add_frame(
    workspace: Workspace,
    places: Mapping[str, str],
    current: str,
    name: str,
    fill: Callable[[Workspace], object],
) -> Callable[[], Awaitable[None]]:
    """Return a function that builds the page `name` at `current` with its frame, then calls `fill`.

    `places` has the names of the pages by address that are no steps of a job.
    """

    async def page() -> None:
        ui.add_head_html(HEAD)
        if workspace.theme in LOOKS:
            ui.add_head_html(
                f"<script>document.documentElement.dataset.look = '{workspace.theme}'</script>"
            )
        ui.colors(
            primary=PAPER["after"],
            negative=PAPER["bad"],
            positive=PAPER["good"],
            warning=PAPER["warn"],
        )
        ui.dark_mode(_DARK[workspace.theme])
        ui.query(".nicegui-content").classes("w-full updyn-content")
        with ui.header(elevated=False).classes("items-center gap-x-1 gap-y-0 py-1 updyn-nav"):
            ui.link("updyn", "/").classes("text-lg font-bold px-2 no-underline")
            with ui.element("nav").classes("flex gap-x-1").props('aria-label="Pages"'):
                for place, text in places.items():
                    link = ui.link(text, place).classes("px-2 py-1 rounded no-underline")
                    if place == current:
                        link.props("aria-current=page")
            ui.space()
            _show_active_task(workspace)
            _show_job_bar(workspace)
            _show_theme_menu(workspace)
            if workspace.document is not None:
                show_steps(workspace, current)
        _follow_title(workspace, name)
        if workspace.document is not None and current in STEPS:
            show_step(workspace, current)
        result = fill(workspace)
        if isinstance(result, Awaitable):
            await result

    return page


def _follow_title(workspace: Workspace, name: str) -> None:
    """Set the title of the page by the title of the open job, once it is read."""

    def update() -> None:
        view = workspace.find_view()
        title = "" if view is None else view.title
        ui.page_title(" – ".join(filter(None, [name, title, "updyn"])))

    update()
    watch(lambda: workspace.answers_version, update)


def _show_active_task(workspace: Workspace) -> None:
    """Show the task under way, of any job, as a link to its page."""
    with ui.link(target="/run").classes("items-center gap-1 px-2 no-underline flex") as link:
        ui.spinner(size="1.2em")
        text = ui.label().classes("max-w-72 truncate").mark("task")

    def update() -> None:
        active = next((each for each in workspace.workers.values() if each.active), None)
        link.set_visibility(active is not None)
        if active is not None:
            text.set_text(f"{workspace.project.name_of(active.job)}: {active.progress}")
            link._props["href"] = f"/{active.task}"

    update()
    watch(lambda: [(each.task, each.version) for each in workspace.workers.values()], update)


def _show_theme_menu(workspace: Workspace) -> None:
    """Show a menu for light or dark pages."""

    def make_handler(theme: str) -> Callable[[], None]:
        def choose() -> None:
            workspace.theme = theme
            ui.navigate.reload()

        return choose

    with ui.button(icon="contrast").props('flat dense aria-label="Light or dark"'), ui.menu():
        for theme, name in THEMES.items():
            ui.menu_item(name, on_click=make_handler(theme))


def _show_job_bar(workspace: Workspace) -> None:
    """Show the open job, with undo, redo and save.

    The buttons are never rebuilt while the job changes, because a click during this would be lost.
    """

    def make_document_handler(action: Callable[[JobDocument], None]) -> Callable[[], None]:
        return show_errors(lambda: action(workspace.open_document))

    def save_job() -> None:
        show_errors(workspace.save)()
        update()

    with ui.row().classes("items-center gap-1"):
        name = ui.label().mark("job")
        buttons = ui.row().classes("items-center gap-1")
        with buttons:
            undo_button = ui.button(icon="undo", on_click=make_document_handler(JobDocument.undo))
            redo_button = ui.button(icon="redo", on_click=make_document_handler(JobDocument.redo))
            for button, word in ((undo_button, "Undo"), (redo_button, "Redo")):
                button.props(f"flat dense aria-label={word}")
            with undo_button:
                undo_tip = ui.tooltip("")
            with redo_button:
                redo_tip = ui.tooltip("")
            save_button = ui.button("Save", on_click=save_job)
            save_button.props("flat dense no-caps")

    def update() -> None:
        document = workspace.document
        buttons.set_visibility(document is not None)
        if document is None:
            name.set_text("no job open")
            return
        edited = " (edited)" if workspace.has_unsaved else ""
        name.set_text(workspace.project.name_of(document.path) + edited)
        last, following = document.last_edit, document.next_edit
        undo_tip.set_text(f"Undo: {last}" if last else "Nothing to undo")
        redo_tip.set_text(f"Redo: {following}" if following else "Nothing to redo")
        undo_button.set_enabled(bool(last))
        redo_button.set_enabled(bool(following))
        save_button.set_enabled(workspace.has_unsaved)

    update()
    watch(lambda: (workspace.version, workspace.has_unsaved), update)


def show_errors(action: Callable[..., Any]) -> Callable[..., None]:
    """Return an action that shows its `UpdynError` or `OSError` as a message."""

    @functools.wraps(action)
    def run_safely(*arguments: Any) -> None:
        try:
            action(*arguments)
        except (UpdynError, OSError) as error:
            complain(describe_error(error))

    return run_safely


def show_fault(entry: ui.input | ui.select | ui.number, fault: str, hint: str = "") -> None:
    """Show the fault of an entry below it: a missing entry as a hint, others as an error."""
    is_missing = fault == REQUIRED
    entry.without_auto_validation()  # which would clear the fault after the handlers of a change
    entry.error = fault if fault and not is_missing else None
    text = fault if is_missing else hint
    if entry.props.get("hint", "") != text:  # each update resets what is being typed
        entry.props["hint"] = text


def complain(text: str) -> None:
    """Show a message that stays until it is closed."""
    close = [{"label": "Close", "color": "white"}]
    ui.notify(text, type="negative", timeout=0, actions=close, multi_line=True)


async def navigate_after(place: str, function: Callable[..., Any], *arguments: Any) -> None:
    """Run a slow function without blocking the page, then open another page; show its error."""
    try:
        await run.io_bound(function, *arguments)
    except UpdynError as error:
        complain(describe_error(error))
        return
    ui.navigate.to(place)


async def run_slow(
    function: Callable[..., T], *arguments: Any, note: str = "Reading …"
) -> T | None:
    """Return the result of a slow function without blocking the page; show its error instead.

    None if it raised an `UpdynError`, or the page was rebuilt in the meantime. `note` is shown
    while it works, with the time that it has taken.
    """
    begun = time.monotonic()

    def count_time() -> None:
        label.set_text(f"{note} {format_clock(time.monotonic() - begun)}")

    with ui.row().classes("items-center") as waiting:
        ui.spinner()
        label = ui.label(note)
        ui.timer(1.0, count_time, immediate=False)
    message = ""
    try:
        found = await run.io_bound(function, *arguments)
    except UpdynError as error:
        found, message = None, describe_error(error)
    if waiting.is_deleted:
        return None  # the page was rebuilt in the meantime
    waiting.delete()
    if message:
        ui.label(message).classes("whitespace-pre-wrap text-negative")
    return found


def embed_page(place: str, title: str, height: str) -> None:
    """Show the page at an address of this server in a frame, which can only send messages."""
    frame = ui.element("iframe").classes("w-full").style(f"height: {height}; border: 0")
    frame._props.update(src=place, title=title)
