"""The bar of steps of the open job, and the sentence on the step of the page."""

from __future__ import annotations

from nicegui import background_tasks, run, ui

from updyn.errors import UpdynError
from updyn.web.pages.watch import watch
from updyn.web.steps import STEPS, Step, list_steps
from updyn.web.workspace import Workspace

__all__ = ["show_step", "show_steps"]

_ICONS = {
    "done": ("check_circle", "positive"),
    "warning": ("warning", "warning"),
    "active": ("sync", "primary"),
    "open": ("radio_button_unchecked", ""),
}


def show_steps(workspace: Workspace, current: str) -> None:
    """Show the steps with links to their pages; the job is read for it if it was not.

    The links are never rebuilt, because a click during this would be lost.
    """
    links: dict[str, tuple[ui.link, ui.icon, ui.tooltip]] = {}
    with ui.element("nav").props('aria-label="Steps"').classes("updyn-steps"), ui.element("ol"):
        for place, name in STEPS.items():
            with ui.element("li"), ui.link(target=place) as link:
                icon = ui.icon("radio_button_unchecked").props("aria-hidden=true")
                ui.label(name)
                links[place] = link, icon, ui.tooltip("")
                if place == current:
                    link.props("aria-current=step")

    def update() -> None:
        if workspace.document is None:
            return
        for step in list_steps(workspace):
            link, icon, tip = links[step.place]
            _set_icon(icon, step)
            tip.set_text(step.text.partition("\n")[0])
            link._props["aria-label"] = f"{step.name}: {step.text}"
        if workspace.find_view() is None:
            background_tasks.create(_read(workspace))

    update()
    watch(lambda: workspace.answers_version, update)


def show_step(workspace: Workspace, current: str) -> None:
    """Show the sentence on the step of a page, and a link to the next step."""
    places = list(STEPS)
    with ui.row().classes("w-full items-start no-wrap"):
        icon = ui.icon("radio_button_unchecked", size="sm").props("aria-hidden=true")
        text = ui.label().classes("flex-1 text-base whitespace-pre-wrap").mark("step")
        following = places[places.index(current) + 1 :]
        if following:
            ui.link(f"Next: {STEPS[following[0]]}", following[0]).classes("whitespace-nowrap")

    def update() -> None:
        if workspace.document is not None:
            step = next(step for step in list_steps(workspace) if step.place == current)
            _set_icon(icon, step)
            text.set_text(step.text)

    update()
    watch(lambda: workspace.answers_version, update)


def _set_icon(icon: ui.icon, step: Step) -> None:
    name, colour = _ICONS[step.state]
    icon.set_name(name)
    icon.props(f"color={colour}" if colour else "", remove="" if colour else "color")


async def _read(workspace: Workspace) -> None:
    """Read the open job; its errors are in the content."""
    try:
        await run.io_bound(workspace.view)
    except UpdynError:
        return  # the page itself shows it
