"""The page Sensors: the model with its sensors, and the matching of sensors to nodes.

A sensor is moved by two clicks: on the sensor, in the table or in the picture, and on its node.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nicegui import events, ui

from updyn.dofs import Dof
from updyn.errors import UpdynError
from updyn.web import edits
from updyn.web.looking import ModalView, TestView
from updyn.web.pages.frame import embed_page, run_slow, show_errors, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.pages.picks import listen_for_picks
from updyn.web.settings import WEB_PAGE
from updyn.web.workspace import Workspace

__all__ = ["show"]

_DIRECTIONS = ("X", "Y", "Z", "RX", "RY", "RZ")
_COLUMNS = [
    {"name": "sensor", "label": "sensor or force", "field": "sensor", "align": "left"},
    {"name": "is", "label": "is", "field": "is", "align": "left"},
    {"name": "dof", "label": "DOF of the model", "field": "dof", "align": "left"},
    {"name": "distance", "label": "distance (m)", "field": "distance"},
]


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if has_no_job(workspace):
        return
    mover = _Mover(workspace)
    listen_for_picks(mover.handle_pick)

    modes = 0

    async def animate() -> None:
        nonlocal modes
        modes = WEB_PAGE.shown_modes
        await content.refresh()

    @ui.refreshable
    async def content() -> None:
        view = await run_slow(workspace.view)
        if view is None:
            return
        show_view_errors(view)
        tests: list[TestView | ModalView] = [*view.tests, *view.modal]
        mover.show(tests)
        if view.groups and not view.has_picture:
            ui.label("The model has no node positions, so it cannot be drawn.")
        # side by side; one below the other on a narrow screen
        with ui.row().classes("w-full items-start max-lg:flex-col lg:flex-nowrap"):
            if view.groups and view.has_picture:
                with ui.column().classes("w-full lg:flex-1 min-w-0"):
                    address = f"/embedded/structure?modes={modes}&{workspace.open_document.version}"
                    embed_page(address, "Structure", "640px")
                    if not modes:
                        label = f"Show the {WEB_PAGE.shown_modes} lowest modes of the start"
                        ui.button(label, on_click=animate).props("outline no-caps")
            with ui.column().classes("min-w-0 max-w-full"):
                for test in tests:
                    _show_matches(test, mover)

    watch(lambda: workspace.version, content.refresh)
    await content()


def _show_matches(test: TestView | ModalView, mover: _Mover) -> None:
    """Show the sensors and forces of a test with their DOFs of the model."""
    rows = test.matches
    if not rows and isinstance(test, TestView):
        rows = _unmatched_rows(test)
    title = ", ".join(filter(None, ["Sensors and forces", test.name]))
    ui.label(title).classes("text-lg")
    table = ui.table(
        rows=rows, columns=_COLUMNS, row_key="sensor", selection="single", pagination=20
    )
    table.on_select(mover.select).props("flat dense wrap-cells").classes("max-w-full")


def _unmatched_rows(test: TestView) -> list[dict[str, str]]:
    """Return the rows of sensors and forces without a match."""
    roles = (("response", test.responses), ("reference", test.references))
    return [
        {"sensor": label, "is": role, "dof": "", "distance": ""}
        for role, labels in roles
        for label in labels
    ]


class _Mover:
    """Moves one sensor at a time."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._sensor = ""
        self._sensor_of: dict[str, str] = {}

    def show(self, tests: Sequence[TestView | ModalView]) -> None:
        """Show the selected sensor and the next step."""
        rows = [row for test in tests for row in test.matches]
        self._sensor_of = {_strip_sign(row["dof"]): row["sensor"] for row in rows}
        with ui.row().classes("items-center"):
            self._hint = ui.label().mark("mover")
            self._direction = ui.select(list(_DIRECTIONS), value="Z", label="direction")
            self._direction.classes("w-28")
            self._flip = ui.checkbox("against the axis")
            ui.button("Deselect", on_click=lambda: self._choose("")).props("flat no-caps")
        self._choose(self._sensor)

    def select(self, event: events.TableSelectionEventArguments) -> None:
        self._choose(str(event.selection[0]["sensor"]) if event.selection else "")

    def handle_pick(self, message: Mapping[str, Any]) -> None:
        """Select the sensor at a picked node, or move the selected sensor to it."""
        node = message.get("label")
        if not isinstance(node, int):
            return
        if self._sensor:
            show_errors(self._move)(node)
            return
        at = [*_texts(message.get("sensors")), *_texts(message.get("forces"))]
        names = [self._sensor_of.get(_strip_sign(label), "") for label in at]
        self._choose(next((name for name in names if name), ""))

    def _choose(self, sensor: str) -> None:
        self._sensor = sensor
        try:
            dof = Dof.parse(sensor)
        except UpdynError:
            pass  # a label of another form: the user sets the direction
        else:
            self._direction.value, self._flip.value = dof.direction, dof.sign < 0
        self._hint.text = (
            f"{sensor}: click its node"
            if sensor
            else "To move a sensor, click it in the table or in the picture, then its node."
        )

    def _move(self, node: int) -> None:
        sign = "-" if self._flip.value else ""
        dof = f"{node}:{sign}{self._direction.value}"
        sensor, self._sensor = self._sensor, ""
        edit = edits.match_sensor(_strip_sign(sensor), dof)
        self._workspace.edit(f"{sensor} at {dof}", edit)


def _strip_sign(label: str) -> str:
    return label.replace("-", "").replace("+", "")


def _texts(given: object) -> list[str]:
    return [str(item) for item in given] if isinstance(given, list) else []
