"""The page Measurement: FRFs, selection of the band by dragging, excluded lines, faults."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from nicegui import events, ui

from updyn.web import edits
from updyn.web.charts import SCALES, edges, frf_chart, unused_bands
from updyn.web.figure import FigureView
from updyn.web.looking import FindingRow, ModalView, TestView, count_counterparts, find_faults
from updyn.web.pages.frame import navigate_after, run_slow, show_errors, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.settings import WEB_PAGE
from updyn.web.workspace import Workspace

__all__ = ["show"]

_ALL = -1
_MODES = [
    {"name": "mode", "label": "mode", "field": "mode"},
    {"name": "frequency", "label": "frequency (Hz)", "field": "frequency"},
    {"name": "damping", "label": "loss factor (1)", "field": "damping"},
]


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if has_no_job(workspace):
        return
    choices: dict[int, _Choice] = {}

    @ui.refreshable
    async def content() -> None:
        view = await run_slow(workspace.view)
        if view is None:
            return
        show_view_errors(view)
        _show_tables(workspace, has_errors=bool(view.errors))
        for test in view.tests:
            choice = choices.setdefault(test.number, _Choice())
            _Measurement(workspace, test, choice).show()
        for modal in view.modal:
            _show_modes(modal)
        if view.tests and not view.errors:
            _look_for_faults(workspace)

    watch(lambda: workspace.version, content.refresh)
    await content()


def _show_tables(workspace: Workspace, *, has_errors: bool) -> None:
    """Show a button for each file whose columns or variables can be selected."""
    with ui.row():
        for number, file in workspace.tables().items():
            open_table = functools.partial(navigate_after, "/table", workspace.open_table, number)
            button = ui.button(f"Select the FRFs in {file}", on_click=open_table)
            button.props("no-caps icon=table_chart")
            if not has_errors:
                button.props("flat dense")


def _show_modes(test: ModalView) -> None:
    ui.label(f"Modes {test.name}").classes("text-lg")
    table = ui.table(rows=test.modes, columns=_MODES, row_key="mode", pagination=20)
    table.props("flat dense wrap-cells").classes("max-w-full")


class _Choice:
    """The selected view of a test, kept when the page is rebuilt."""

    def __init__(self) -> None:
        self.response, self.reference = 0, 0
        self.scale, self.mode = "log", "band"


class _Measurement:
    """The view of one test, with the selected channel, scale and mode."""

    def __init__(self, workspace: Workspace, test: TestView, choice: _Choice) -> None:
        self._workspace, self._test, self._choice = workspace, test, choice

    def show(self) -> None:
        test, choice = self._test, self._choice
        if test.name:
            ui.label(test.name).classes("text-lg")
        with ui.row().classes("items-center"):
            for what, names in (("response", test.responses), ("reference", test.references)):
                channels = {_ALL: "all", **dict(enumerate(names))}
                ui.select(channels, label=what).classes("min-w-32").bind_value(
                    choice, what
                ).on_value_change(self._redraw)
            ui.select(SCALES, label="magnitude").classes("min-w-32").bind_value(
                choice, "scale"
            ).on_value_change(self._redraw)
            ui.toggle(
                {"band": "Drag chooses the band", "exclude": "Drag or click leaves lines out"}
            ).bind_value(choice, "mode").props("no-caps")
            whole = show_errors(
                lambda: self._edit("all lines", edits.include_all(self._test.number))
            )
            ui.button("Use all lines", on_click=whole).props("flat no-caps")
        used = test.freq[test.used]
        text = f"{len(used)} of {len(test.freq)} lines are used"
        ui.label(f"{text}, {used[0]:g} to {used[-1]:g} Hz." if len(used) else f"{text}.")
        self._chart = FigureView(self._make_chart(), show_errors(self._apply)).classes("w-full")
        self._show_validation()

    def _show_validation(self) -> None:
        """Show a selection of responses to hold out of the fit."""
        test = self._test

        def set_validation(event: events.ValueChangeEventArguments[Any]) -> None:
            names = [name for name in test.holdable if name in (event.value or ())]
            show_errors(self._edit)("responses held out", edits.hold_out(names, self._test.number))

        label = "responses held out of the fit for validation"
        if test.held_band is not None:
            low, high = test.held_band
            ui.label(
                f"The band from {low:g} to {high:g} Hz is held out of the fit; responses"
                " chosen here replace it."
            )
        options = dict(test.holdable)
        shown = [name for name in options if name in test.held]
        chosen = ui.select(options, value=shown, multiple=True, label=label)
        chosen.classes("min-w-64 max-w-full").props("use-chips").on_value_change(set_validation)

    def _make_chart(self) -> dict[str, Any]:
        test, choice = self._test, self._choice
        rows = _find_positions(choice.response, len(test.responses))
        columns = _find_positions(choice.reference, len(test.references))
        curves = {
            f"{test.responses[row]} / {test.references[column]}": (
                test.freq,
                test.values[:, row, column],
            )
            for row in rows
            for column in columns
        }
        names = list(curves)[: WEB_PAGE.most_channels]
        used = test.freq[test.used]
        coherence = None
        if test.coherence is not None and _ALL not in (choice.response, choice.reference):
            coherence = test.coherence[:, choice.response, choice.reference]
        return frf_chart(
            test.quantity,
            {name: curves[name] for name in names},
            scale=choice.scale,
            band=(float(used[0]), float(used[-1])) if len(used) else None,
            excluded=unused_bands(test.freq, test.used),
            coherence=coherence,
            pickable=True,
            points=None if len(names) == 1 else WEB_PAGE.shared_points,
        )

    def _redraw(self) -> None:
        self._chart.draw(self._make_chart())

    def _apply(self, low: float, high: float) -> None:
        """Apply a dragged band that contains lines, or a click (`low` equals `high`)."""
        freq = self._test.freq
        inside = np.flatnonzero((freq >= low) & (freq <= high))
        if low == high:
            inside = np.array([np.argmin(np.abs(freq - low))])
        if not inside.size or (low == high and self._choice.mode == "band"):
            return
        low, high = edges(freq, inside[0], inside[-1])
        if self._choice.mode == "band":
            self._edit("band", edits.set_band(low, high, self._test.number))
        elif np.any(self._test.used[inside]):
            self._edit("lines left out", edits.exclude(low, high, self._test.number))

    def _edit(self, what: str, edit: edits.Edit) -> None:
        document = self._workspace.open_document
        before = edits.listed_lines(document.text)
        self._workspace.edit(what, edit)
        after = edits.listed_lines(document.text)
        if after < before:
            rest = f"{after} are left" if after else "all lines of the test are used now"
            ui.notify(
                f"{before - after} of the {before} lines listed in [method] are excluded: {rest}"
            )


def _find_positions(chosen: int, n: int) -> range:
    return range(n) if chosen == _ALL else range(chosen, chosen + 1)


def _look_for_faults(workspace: Workspace) -> None:
    """Show a button that searches for faults of the data, and a button for each repair."""

    async def show_faults() -> None:
        button.delete()
        with place:
            for statement in await run_slow(workspace.ask, count_counterparts) or ():
                ui.label(statement)
            found = await run_slow(workspace.ask, find_faults)
            if found is None:
                return
            if not found:
                ui.label("No fault was found in these data.")
            for row in found:
                _show_finding(workspace, row)

    place = ui.column().classes("w-full")
    with place:
        button = ui.button("Look for faults of the data", on_click=show_faults).props(
            "outline no-caps"
        )


def _show_finding(workspace: Workspace, row: FindingRow) -> None:
    with ui.card().classes("w-full"):
        ui.label(row.statement)
        ui.label(row.remedy).classes("opacity-80")
        if row.repair:
            repair = edits.add_repair(row.repair, row.test)
            ui.button(
                f"Repair: {row.repair}",
                on_click=show_errors(lambda: workspace.edit(f"repair {row.repair}", repair)),
            ).props("no-caps")
