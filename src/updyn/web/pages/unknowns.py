"""The page Unknowns: selection of quantities by group, and their identifiability."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nicegui import events, ui
from tomlkit.exceptions import TOMLKitError

from updyn.errors import UpdynError
from updyn.updating.judge.settings import SEPARATION
from updyn.updating.problem.parameters import Parameter
from updyn.web import edits
from updyn.web.form import REQUIRED
from updyn.web.looking import (
    CHOICES,
    IdentifiabilityView,
    JobView,
    assess_identifiability,
)
from updyn.web.pages.frame import embed_page, run_slow, show_errors, show_fault, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.pages.picks import listen_for_picks
from updyn.web.pages.watch import ValueChange
from updyn.web.project import describe_error
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
    """Fill the page."""
    if has_no_job(workspace):
        return
    choices = _Choices(workspace)

    def take(message: Mapping[str, Any]) -> None:
        groups = message.get("groups")
        choices.pick(set(map(str, groups)) if isinstance(groups, list) else set())

    listen_for_picks(take)

    # side by side; one below the other on a narrow screen
    with ui.row().classes("w-full items-start max-md:flex-col md:flex-nowrap"):
        picture = ui.column().classes("w-full md:w-1/2")
        picture.set_visibility(False)
        with ui.column().classes("w-full md:flex-1 min-w-0"):
            choices.show()

            @ui.refreshable
            async def show_identifiability() -> None:
                view = await run_slow(workspace.view)
                if view is None:
                    return
                show_view_errors(view)
                if view.has_picture and not picture.visible:  # keep it while the job is edited
                    picture.set_visibility(True)
                    with picture:
                        _show_structure()
                choices.take(view)
                if view.errors:
                    return
                found = await run_slow(workspace.ask, assess_identifiability)
                if found is not None:
                    _show_separability(found)
                    _show_table(workspace, view, found)

            watch(lambda: workspace.version, choices.update)
            watch(lambda: workspace.version, show_identifiability.refresh)
            await show_identifiability()


def _show_structure() -> None:
    embed_page("/embedded/structure", "Structure", "560px")
    ui.label("A click on a node shows the groups there.").classes("text-sm opacity-80")


class _Choices:
    """A check box for each quantity of each group, or of the groups at a picked node.

    The boxes are not rebuilt while the job is edited, because a click meanwhile would be lost.
    """

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._groups: list[str] = []
        self._groups_by_quantity: Mapping[str, list[str]] = {}
        self._proposals: Mapping[str, Mapping[str, Any]] = {}
        self._picked: set[str] = set()
        self._boxes: dict[tuple[str, str], ui.checkbox] = {}

    def show(self) -> None:
        """Build this part of the page, empty until `take` is called."""
        self._place = ui.column().classes("w-full")

    def take(self, view: JobView) -> None:
        """Set the groups of the model; rebuild the boxes if the groups have changed."""
        self._proposals = view.proposals
        if (view.groups, view.groups_by_quantity) != (self._groups, self._groups_by_quantity):
            self._groups, self._groups_by_quantity = view.groups, view.groups_by_quantity
            self._draw()

    def pick(self, groups: set[str]) -> None:
        """Show the boxes of some groups; of all groups if none of these is in the model."""
        self._picked = groups
        self._draw()

    def update(self) -> None:
        """Set the boxes to the selection in the job."""
        chosen = self._find_chosen_groups()
        for (group, quantity), box in self._boxes.items():
            box.set_value(group in chosen[quantity])

    def _find_chosen_groups(self) -> dict[str, set[str]]:
        """Return the groups that the current job text selects, by quantity."""
        try:
            return edits.chosen_groups(self._workspace.open_document.text, self._groups_by_quantity)
        except (UpdynError, TOMLKitError, RecursionError):  # shown as a fault of the job
            return {quantity: set() for quantity in self._groups_by_quantity}

    def _draw(self) -> None:
        self._place.clear()
        self._boxes = {}
        groups = [name for name in self._groups if name in self._picked] or self._groups
        if not groups:
            return
        with self._place:
            if len(groups) < len(self._groups):
                every = ui.button("Show all groups", on_click=lambda: self.pick(set()))
                every.props("flat dense no-caps")
            columns = " ".join(["auto"] * (1 + len(CHOICES)))  # column widths fit the names
            frame = ui.column().classes("w-full overflow-auto").style("max-height: 420px")
            with frame, ui.grid(columns=columns).classes("items-center gap-x-4 md:gap-x-8 gap-y-0"):
                ui.label("group").classes("font-bold")
                for quantity in CHOICES:
                    ui.label(quantity.replace("_", " ")).classes("font-bold")
                self._draw_boxes(groups)

    def _draw_boxes(self, groups: Sequence[str]) -> None:
        chosen = self._find_chosen_groups()
        for group in groups:
            ui.label(group)
            for quantity in CHOICES:
                box = ui.checkbox(value=group in chosen[quantity]).props("dense")
                box.set_enabled(group in self._groups_by_quantity[quantity])
                box.on_value_change(self._make_toggle_handler(group, quantity))
                box._props["aria-label"] = f"{group} {quantity}"
                self._boxes[group, quantity] = box

    def _make_toggle_handler(self, group: str, quantity: str) -> Callable[[ValueChange], None]:
        def change(event: ValueChange) -> None:
            names = self._find_chosen_groups()
            if bool(event.value) == (group in names[quantity]):
                return  # the box already agrees with the job
            (names[quantity].add if event.value else names[quantity].discard)(group)
            edit = edits.set_unknowns(names, self._groups_by_quantity, self._proposals)
            show_errors(self._workspace.edit)(f"{group}.{quantity}", edit)
            self.update()  # restores the box if the edit was rejected

        return change


def _show_separability(found: IdentifiabilityView) -> None:
    if found.rank == found.n:
        which = "the one unknown" if found.n == 1 else f"all {found.n} unknowns"
        ui.label(f"The data could determine {which}{_describe_collinearity(found)}.").mark(
            "determined"
        )
    else:
        ui.label(f"The data could determine {found.rank} of {found.n} combinations.").mark(
            "determined"
        )
        ui.label(found.advice).classes("whitespace-pre-wrap")


def _describe_collinearity(found: IdentifiabilityView) -> str:
    """Return a part of a sentence if unknowns are hard to distinguish, else an empty text."""
    limit = SEPARATION.most_collinearity
    if found.collinearity <= limit:
        return ""
    return (
        ", but some are hard to distinguish under noise"
        f" (collinearity index {found.collinearity:.3g}, above {limit:g})"
    )


def _show_table(workspace: Workspace, view: JobView, found: IdentifiabilityView) -> None:
    rows = []
    for unknown in view.unknowns:
        determined = "yes"
        if unknown.name in found.undetermined:
            others = found.undetermined[unknown.name]
            determined = f"no: confounded with {others}" if others else "no: nothing depends on it"
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
    table.props("flat dense wrap-cells").classes("w-full max-w-4xl")
    named = {unknown.name: unknown for unknown in view.unknowns}

    def open_bounds(event: events.GenericEventArguments) -> None:
        row = event.args[1] if isinstance(event.args, list) and len(event.args) > 1 else {}
        unknown = named.get(str(row.get("name")))
        if unknown is not None:
            _show_bounds_dialog(workspace, view, unknown)

    table.on("row-click", open_bounds)
    ui.label("A click on an unknown changes its bounds.").classes("text-sm opacity-80")


def _show_bounds_dialog(workspace: Workspace, view: JobView, unknown: Parameter) -> None:
    with ui.dialog() as dialog, ui.card():
        ui.label(unknown.name).classes("text-lg")
        low = ui.number("lower bound *", value=unknown.lower)
        high = ui.number("upper bound *", value=unknown.upper)
        groups_by_quantity = view.groups_by_quantity.get(unknown.quantity, view.groups)
        reason = ui.label().classes("text-negative").props("role=alert")

        def take() -> None:
            try:
                edit = edits.set_bounds(unknown.name, low.value, high.value, groups_by_quantity)
                workspace.edit(f"bounds of {unknown.name}", edit)
            except UpdynError as error:
                reason.set_text(describe_error(error))
            else:
                dialog.close()

        def update() -> None:
            show_fault(low, REQUIRED if low.value is None else "")
            is_wrong = None not in (low.value, high.value) and high.value <= low.value
            fault = "expected more than the lower bound" if is_wrong else ""
            show_fault(high, REQUIRED if high.value is None else fault)
            button.set_enabled(None not in (low.value, high.value) and not is_wrong)

        with ui.row():
            button = ui.button("Set", on_click=take).props("no-caps")
            ui.button("Cancel", on_click=dialog.close).props("flat no-caps")
        for entry in (low, high):
            entry.on_value_change(update)
    dialog.value = True
