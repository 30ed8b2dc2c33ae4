"""The page Unknowns: which quantities of which groups are sought, and what the data determine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nicegui import events, ui

from updyn.web import edits
from updyn.web.looking import CHOICES, Separability, UnknownRow, View, identifiability
from updyn.web.pages.frame import asked, complain, embedded, said, watch
from updyn.web.pages.job import no_job, troubles
from updyn.web.pages.picks import hear_picks
from updyn.web.workspace import Workspace

__all__ = ["show"]

_COLUMNS: list[dict[str, Any]] = [
    {"name": "name", "label": "unknown", "field": "name", "align": "left", "sortable": True},
    {"name": "start", "label": "start", "field": "start"},
    {"name": "lower", "label": "lower bound", "field": "lower"},
    {"name": "upper", "label": "upper bound", "field": "upper"},
    {"name": "determined", "label": "determined", "field": "determined", "align": "left"},
]


async def show(workspace: Workspace) -> None:
    """Fill the page.

    Parameters
    ----------
    workspace : Workspace
        What it shows.
    """
    if no_job(workspace):
        return
    picked: set[str] = set()

    def take(message: Mapping[str, Any]) -> None:
        groups = message.get("groups")
        picked.clear()
        if isinstance(groups, list):
            picked.update(map(str, groups))
        choices.refresh()

    hear_picks(take)
    kept: dict[str, View] = {}

    @ui.refreshable
    def choices() -> None:
        if "view" in kept:
            _choices(workspace, kept["view"], picked)

    # side by side, on a narrow screen one below the other
    with ui.row().classes("w-full items-start max-md:flex-col md:flex-nowrap"):
        picture = ui.column().classes("w-full md:w-1/2")
        picture.set_visibility(False)
        with ui.column().classes("w-full md:flex-1 min-w-0"):
            choices()

            @ui.refreshable
            async def determined() -> None:
                view = await asked(workspace.view)
                if view is None:
                    return
                troubles(view)
                kept["view"] = view
                if view.has_picture and not picture.visible:  # it stays while the job is edited
                    picture.set_visibility(True)
                    with picture:
                        _structure()
                choices.refresh()
                if view.wrong:
                    return
                found = await asked(workspace.ask, identifiability)
                if found is not None:
                    _separability(found)
                    _table(workspace, view, found)

            watch(lambda: workspace.version, determined.refresh)
            await determined()


def _structure() -> None:
    """Show the picture of the model."""
    embedded("/embedded/structure", "Structure", "560px")
    ui.label("A click on a node shows the groups there.").classes("text-sm opacity-80")


def _choices(workspace: Workspace, view: View, picked: set[str]) -> None:
    """Show a box for each quantity of each group, or of the groups at a picked node."""
    chosen = {quantity: set[str]() for quantity in CHOICES}
    for unknown in view.unknowns:
        if unknown.quantity in chosen:
            chosen[unknown.quantity].add(unknown.group)

    def toggled(group: str, quantity: str) -> Any:
        def change(event: events.ValueChangeEventArguments[Any]) -> None:
            names = {each: set(groups) for each, groups in chosen.items()}
            (names[quantity].add if event.value else names[quantity].discard)(group)
            if not any(names.values()) and len(view.unknowns) == 1:
                complain("a job needs one unknown at least; choose another one first")
                boxes[group, quantity].set_value(True)
                return
            edit = edits.set_unknowns(names, view.able)
            said(workspace.opened.edit)(f"{group}.{quantity}", edit)

        return change

    boxes: dict[tuple[str, str], ui.checkbox] = {}
    groups = [name for name in view.groups if name in picked] or view.groups
    if len(groups) < len(view.groups):

        def everything() -> None:
            picked.clear()
            frame.clear()
            with frame:
                _choices(workspace, view, picked)

        ui.button("Show all groups", on_click=everything).props("flat dense no-caps")
    frame = ui.column().classes("w-full overflow-auto").style("max-height: 420px")
    columns = " ".join(["auto"] * (1 + len(CHOICES)))  # as wide as their names
    with frame, ui.grid(columns=columns).classes("items-center gap-x-4 md:gap-x-8 gap-y-0"):
        ui.label("group").classes("font-bold")
        for quantity in CHOICES:
            ui.label(quantity.replace("_", " ")).classes("font-bold")
        for group in groups:
            ui.label(group)
            for quantity in CHOICES:
                box = ui.checkbox(value=group in chosen[quantity]).props("dense")
                box.set_enabled(group in view.able[quantity])
                box.on_value_change(toggled(group, quantity))
                boxes[group, quantity] = box
                box._props["aria-label"] = f"{group} {quantity}"


def _separability(found: Separability) -> None:
    if found.rank == found.n:
        which = "the one unknown" if found.n == 1 else f"all {found.n} unknowns"
        ui.label(f"The data could determine {which}; collinearity {found.collinearity:.3g}.").mark(
            "determined"
        )
    else:
        ui.label(f"The data could determine {found.rank} of {found.n} combinations.").mark(
            "determined"
        )
        ui.label(found.advice).classes("whitespace-pre-wrap")


def _table(workspace: Workspace, view: View, found: Separability) -> None:
    rows = []
    for unknown in view.unknowns:
        determined = "yes"
        if unknown.name in found.open:
            others = found.open[unknown.name]
            determined = f"no: trades against {others}" if others else "no: nothing depends on it"
        rows.append(
            {
                "name": unknown.name,
                "start": f"{unknown.start:.5g}",
                "lower": f"{unknown.lower:.5g}",
                "upper": f"{unknown.upper:.5g}",
                "determined": determined,
            }
        )
    table = ui.table(rows=rows, columns=_COLUMNS, row_key="name", pagination=25)
    table.props("flat dense wrap-cells").classes("w-full")
    named = {unknown.name: unknown for unknown in view.unknowns}

    def clicked(event: events.GenericEventArguments) -> None:
        row = event.args[1] if isinstance(event.args, list) and len(event.args) > 1 else {}
        unknown = named.get(str(row.get("name")))
        if unknown is not None:
            _bounds(workspace, view, unknown)

    table.on("row-click", clicked)
    ui.label("A click on an unknown changes its bounds.").classes("text-sm opacity-80")


def _bounds(workspace: Workspace, view: View, unknown: UnknownRow) -> None:
    """Ask for the bounds of an unknown."""
    with ui.dialog() as dialog, ui.card():
        ui.label(unknown.name).classes("text-lg")
        low = ui.number("lower bound", value=unknown.lower)
        high = ui.number("upper bound", value=unknown.upper)
        able = view.able.get(unknown.quantity, view.groups)

        def take() -> None:
            if low.value is not None and high.value is not None:
                edit = edits.set_bounds(unknown.name, low.value, high.value, able)
                workspace.opened.edit(f"bounds of {unknown.name}", edit)
            dialog.close()

        with ui.row():
            ui.button("Set", on_click=said(take)).props("no-caps")
            ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
    dialog.value = True
