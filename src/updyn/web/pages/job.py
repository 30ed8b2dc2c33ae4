"""The page Job file: its text and its errors."""

from __future__ import annotations

from nicegui import ui

from updyn.errors import UpdynError
from updyn.web.entry import TextEntry
from updyn.web.looking import JobView
from updyn.web.pages.frame import run_slow, show_fault, watch
from updyn.web.pages.watch import ValueChange
from updyn.web.project import describe_error
from updyn.web.workspace import Workspace

__all__ = ["has_no_job", "show", "show_view_errors"]


#: Set the theme of an editor, now and whenever the page becomes light or dark. By the browser: an
#: update by the server would also replace the text, while it is typed.
_FOLLOW_LOOK = """
(() => {
  const follow = () => {
    const editor = window.did_handshake && getElement(%d);
    if (!editor || !editor.editor) return setTimeout(follow, 50);
    const isDark = document.body.classList.contains("body--dark");
    editor.setTheme(isDark ? "githubDark" : "githubLight");
  };
  follow();
  new MutationObserver(follow).observe(document.body, { attributeFilter: ["class"] });
})();
"""


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

    def store_text(event: ValueChange) -> None:
        document.type(str(event.value))

    with ui.row().classes("items-center"):
        copy = TextEntry("Another name", placeholder="job-2.toml").classes("w-60")

        def save_as() -> None:
            try:
                workspace.save_as(copy.value)
            except (UpdynError, OSError) as error:
                show_fault(copy, describe_error(error))
                return
            ui.notify(f"Saved as {workspace.project.name_of(document.path)}", type="positive")

        def update() -> None:
            show_fault(copy, "")
            button.set_enabled(bool(copy.value.strip()))

        button = ui.button("Save as", on_click=save_as).props("outline no-caps")
        copy.on_value_change(update)
        update()
    editor = ui.codemirror(document.text, language="TOML", on_change=store_text)
    ui.add_body_html(f"<script>{_FOLLOW_LOOK % editor.id}</script>")
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
