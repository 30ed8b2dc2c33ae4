"""The page Data: FRFs with the model at its start, selection of the band, faults."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from nicegui import binding, ui

from updyn.arrays import NumberArray, RealArray
from updyn.frf import reference_noun
from updyn.report.formats import format_count, percentage
from updyn.web import edits
from updyn.web.charts import SCALES, channel_map, edges, frf_chart, unused_bands
from updyn.web.figure import FigureView
from updyn.web.looking import (
    FindingRow,
    ModalView,
    ModelView,
    TestView,
    compute_model,
    count_counterparts,
    find_faults,
)
from updyn.web.pages.frame import navigate_after, run_slow, show_errors, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.pages.watch import ValueChange
from updyn.web.settings import WEB_PAGE
from updyn.web.workspace import Workspace

__all__ = ["show"]

#: Ways to show the channels.
_VIEWS = {"all": "All channels", "map": "Map", "one": "One channel"}
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
    findings = _Findings(workspace)

    @ui.refreshable
    async def content() -> None:
        view = await run_slow(workspace.view)
        if view is None:
            return
        show_view_errors(view)
        _show_tables(workspace, has_errors=bool(view.errors))
        for test in view.tests:
            choice = choices.setdefault(test.number, _Choice.of(test))
            shown = _Measurement(workspace, test, choice)
            shown.show()
            if not view.errors:
                shown.show_model(at_once=not view.is_large)
        for modal in view.modal:
            _show_modes(modal)
        if view.tests and not view.errors:
            await findings.show({test.number: test for test in view.tests})

    watch(lambda: workspace.version, content.refresh)
    await content()


def _show_tables(workspace: Workspace, *, has_errors: bool) -> None:
    """Show a button for each file whose columns or variables can be selected."""
    tables = workspace.tables()
    if not tables:
        return
    with ui.row():
        for number, file in tables.items():
            open_table = functools.partial(navigate_after, "/table", workspace.open_table, number)
            button = ui.button(f"Select the FRFs in {file}", on_click=open_table)
            button.props("no-caps icon=table_chart")
            if not has_errors:
                button.props("flat dense")


def _show_modes(test: ModalView) -> None:
    ui.label(f"Modes {test.name}").classes("text-lg")
    table = ui.table(rows=test.modes, columns=_MODES, row_key="mode", pagination=20)
    table.props("flat dense wrap-cells").classes("max-w-full")


@binding.bindable_dataclass
class _Choice:
    """The selected view of a test, and its model at the start, kept when the page is rebuilt."""

    view: str
    response: int = 0
    reference: int = 0
    page: int = 1
    scale: str = "log"
    mode: str = "band"
    phase: bool = False
    has_model: bool = True
    model: ModelView | None = None

    @classmethod
    def of(cls, test: TestView) -> _Choice:
        return cls("all" if len(test.responses) * len(test.references) > 1 else "one")


class _Measurement:
    """The view of one test, with the selected channels, scale and mode."""

    def __init__(self, workspace: Workspace, test: TestView, choice: _Choice) -> None:
        self._workspace, self._test, self._choice = workspace, test, choice
        self._channels = [
            (row, column)
            for row in range(len(test.responses))
            for column in range(len(test.references))
        ]
        self._figures: list[FigureView] = []
        self._titles: list[ui.button] = []
        self._is_complete = True  # whether the choice may be drawn

    def show(self) -> None:
        """Build this part of the page."""
        self._show_head()
        self._show_choices()
        self._charts = ui.element("div").classes("w-full")
        self._redraw()
        self._show_validation()

    def show_model(self, *, at_once: bool) -> None:
        """Add the model at its start to the figures: at once, or on request."""

        async def load() -> None:
            button.delete()
            test = self._test
            with self._place:
                found = await run_slow(
                    self._workspace.ask,
                    compute_model,
                    {},
                    test.number,
                    test.responses,
                    test.references,
                    note="Computing the model at its start …",
                )
            if found is None or self._place.is_deleted:
                return
            self._choice.model = found
            with self._place:
                ui.label(
                    f"The model at its start differs from these data by {found.level_error:.2g} dB"
                    " (median)."
                )
            self._redraw()

        with self._place:
            button = ui.button("Draw the model at its start", on_click=load)
            button.props("outline dense no-caps").set_visibility(not at_once)
            if at_once:
                # After the first figures, which need the processor, too.
                ui.timer(WEB_PAGE.refresh_interval, load, once=True)

    def _show_head(self) -> None:
        """Show the number of channels and lines, and a place for the sentence on the model."""
        test = self._test
        if test.name:
            ui.label(test.name).classes("text-lg")
        units = dict.fromkeys(self._test.find_unit(*channel) for channel in self._channels)
        responses = format_count(len(test.responses), "response")
        noun = reference_noun(test.quantity)
        used = test.freq[test.used]
        text = f"{len(used)} of {len(test.freq)} lines are used"
        with ui.row().classes("items-baseline gap-x-6 gap-y-0"):
            ui.label(
                f"{test.quantity.capitalize()} in {', '.join(units)} over frequency in Hz:"
                f" {responses}, {format_count(len(test.references), noun)}."
            ).classes("text-lg")
            ui.label(f"{text}, {used[0]:g} to {used[-1]:g} Hz." if len(used) else f"{text}.")
            self._place = ui.row().classes("items-center")

    def _show_choices(self) -> None:
        choice, test = self._choice, self._test
        with ui.row().classes("items-center gap-y-1"):
            if len(self._channels) > 1:
                self._bind(ui.toggle(_VIEWS), "view").props("no-caps")
            self._bind(ui.select(SCALES, label="magnitude"), "scale").classes("min-w-32")
            ui.label("measured").style("border-bottom: 4px solid var(--measured)")
            model = self._bind(ui.checkbox("model at the start"), "has_model")
            model.style("border-bottom: 2px solid var(--before)")
            with (
                ui.row()
                .classes("items-center")
                .bind_visibility_from(choice, "view", lambda view: view == "one")
            ):
                step = functools.partial(ui.button, color=None)
                step(icon="chevron_left", on_click=lambda: self._step(-1)).props(
                    'flat dense aria-label="Previous channel"'
                )
                for what, names in (("response", test.responses), ("reference", test.references)):
                    select = ui.select(dict(enumerate(names)), label=what)
                    self._bind(select, what).classes("min-w-28")
                step(icon="chevron_right", on_click=lambda: self._step(1)).props(
                    'flat dense aria-label="Next channel"'
                )
                self._bind(ui.checkbox("phase"), "phase")
            n_pages = -(-len(self._channels) // WEB_PAGE.page_channels)
            if n_pages > 1:
                pages = ui.pagination(1, n_pages, direction_links=True)
                self._bind(pages.props("max-pages=7"), "page").bind_visibility_from(
                    choice, "view", lambda view: view == "all"
                )
        with ui.row().classes("items-center gap-y-1"):
            ui.toggle(
                {"band": "Drag chooses the band", "exclude": "Drag or click leaves lines out"}
            ).bind_value(choice, "mode").props("no-caps")
            whole = show_errors(lambda: self._edit("all lines", edits.include_all(test.number)))
            ui.button("Use all lines", on_click=whole).props("flat no-caps")

    def _bind(self, element: Any, name: str) -> Any:
        """Bind an element to a part of the choice, and redraw on a change."""
        return element.bind_value(self._choice, name).on_value_change(self._redraw)

    def _step(self, by: int) -> None:
        """Show another channel."""
        at = self._channels.index((self._choice.response, self._choice.reference)) + by
        self._open(self._channels[at % len(self._channels)])

    def _open(self, channel: tuple[int, int]) -> None:
        """Show one channel."""
        self._is_complete = False
        self._choice.response, self._choice.reference = channel
        self._choice.view = "one"
        self._is_complete = True
        self._redraw()

    def _show_validation(self) -> None:
        """Show a selection of responses to hold out of the fit."""
        test = self._test

        def set_validation(event: ValueChange) -> None:
            names = [name for name in test.holdable if name in (event.value or ())]
            show_errors(self._edit)("responses held out", edits.hold_out(names, self._test.number))

        label = "responses held out of the fit"
        if test.held_band is not None:
            low, high = test.held_band
            ui.label(
                f"The band from {low:g} to {high:g} Hz is held out of the fit; responses"
                " chosen here replace it."
            )
        options = dict(test.holdable)
        shown = [name for name in options if name in test.held]
        chosen = ui.select(options, value=shown, multiple=True, label=label)
        chosen.classes("min-w-80 max-w-full").props("use-chips").on_value_change(set_validation)

    # -- figures -----------------------------------------------------------------------------------
    def _redraw(self) -> None:
        """Draw the figures of the selected view; the elements are kept if their number is."""
        choice = self._choice
        if not self._is_complete:
            return
        if choice.view == "map":
            self._draw_map()
            return
        channels = [(choice.response, choice.reference)]
        if choice.view == "all":
            first = (choice.page - 1) * WEB_PAGE.page_channels
            channels = self._channels[first : first + WEB_PAGE.page_channels]
        is_small = choice.view == "all"
        figures = [self._make_chart(*channel, small=is_small) for channel in channels]
        if len(self._titles) != (len(channels) if is_small else 0) or not self._figures:
            self._build(figures, small=is_small)
        for shown, figure in zip(self._figures, figures, strict=True):
            shown.draw(figure)
        for title, channel in zip(self._titles, channels, strict=False):
            title.set_text(self._name(*channel))
        self._shown = channels

    def _build(self, figures: list[dict[str, Any]], *, small: bool) -> None:
        self._charts.clear()
        self._figures, self._titles = [], []
        pick = show_errors(self._apply)
        with self._charts.classes(replace="w-full"):
            if not small:
                self._figures.append(FigureView(figures[0], pick).classes("w-full"))
                return
            self._charts.classes(
                "grid gap-x-4 gap-y-1 grid-cols-1 sm:grid-cols-2 lg:grid-cols-3 2xl:grid-cols-4"
            )
            for place, figure in enumerate(figures):
                with ui.column().classes("gap-0 min-w-0"):
                    title = ui.button(on_click=lambda at=place: self._open(self._shown[at]))
                    title.props("flat dense no-caps size=12px")
                    self._titles.append(title)
                    self._figures.append(FigureView(figure, pick).classes("w-full"))

    def _draw_map(self) -> None:
        test, model = self._test, self._choice.model
        values = test.values.reshape(len(test.freq), -1)
        computed = None
        if self._choice.has_model and model is not None:
            computed = model.freq, model.values.reshape(len(model.freq), -1)
        names = [self._name(*channel) for channel in self._channels]
        figure = channel_map(test.freq, values, names, computed)
        self._charts.clear()
        self._figures, self._titles = [], []
        with self._charts.classes(replace="w-full"):
            open_row = lambda row: self._open(self._channels[row])  # noqa: E731
            FigureView(figure, on_row=open_row).classes("w-full")
            ui.label("Click a row to see the channel.").classes("text-sm opacity-80")

    def _make_chart(self, row: int, column: int, *, small: bool) -> dict[str, Any]:
        test, choice = self._test, self._choice
        curves: dict[str, tuple[RealArray, NumberArray]] = {
            "measured": (test.freq, test.values[:, row, column])
        }
        model = choice.model
        if model is not None:
            if model.repaired is not None:
                curves["repaired"] = model.repaired_freq, model.repaired[:, row, column]
            if choice.has_model:
                curves["start"] = model.freq, model.values[:, row, column]
        used = test.freq[test.used]
        return frf_chart(
            test.quantity,
            curves,
            scale=choice.scale,
            band=(float(used[0]), float(used[-1])) if len(used) else None,
            excluded=unused_bands(test.freq, test.used),
            coherence=None if test.coherence is None else test.coherence[:, row, column],
            phase=choice.phase and not small,
            pickable=True,
            small=small,
            unit=self._test.find_unit(row, column),
        )

    def _name(self, row: int, column: int) -> str:
        return f"{self._test.responses[row]} / {self._test.references[column]}"

    # -- edits -------------------------------------------------------------------------------------
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


# -- faults ----------------------------------------------------------------------------------------
class _Findings:
    """The suspected faults of the data; once requested, they are searched after each edit."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._is_requested = False

    async def show(self, tests: dict[int, TestView]) -> None:
        """Show a button that starts the search, or the findings."""
        place = ui.column().classes("w-full")

        async def search() -> None:
            self._is_requested = True
            place.clear()
            with place:
                await self._search(tests)

        with place:
            if self._is_requested:
                ui.timer(0.0, search, once=True)
            else:
                ui.button("Look for faults of the data", on_click=search).props("outline no-caps")

    async def _search(self, tests: dict[int, TestView]) -> None:
        ask = self._workspace.ask
        for statement in await run_slow(ask, count_counterparts) or ():
            ui.label(statement)
        found = await run_slow(ask, find_faults, note="Looking for faults …")
        if found is None:
            return
        if not found:
            with ui.row().classes("items-center gap-2"):
                ui.icon("check_circle", color="positive")
                ui.label("No fault was found in these data.")
        for row in found:
            self._show_card(row, tests)

    def _show_card(self, row: FindingRow, tests: dict[int, TestView]) -> None:
        with (
            ui.card().classes("w-full"),
            ui.element("div").classes("w-full grid gap-4 grid-cols-1 lg:grid-cols-2"),
        ):
            with ui.column().classes("min-w-0"):
                ui.label(row.statement).classes("text-base font-bold")
                ui.label(row.remedy).classes("opacity-80")
                if row.view is not None:
                    before, after = map(
                        percentage, (row.view.residual_before, row.view.residual_after)
                    )
                    ui.label(
                        f"Relative residual of {row.view.channel} at the start: {before} now,"
                        f" {after} after the repair."
                    )
                self._show_actions(row, tests.get(row.test))
            if row.view is not None:
                self._show_effect(row, tests[row.test])

    def _show_actions(self, row: FindingRow, test: TestView | None) -> None:
        workspace = self._workspace
        with ui.row():
            if row.repair:
                repair = edits.add_repair(row.repair, row.test)
                act = show_errors(lambda: workspace.edit(f"repair {row.repair}", repair))
                ui.button(f"Repair: {row.repair}", on_click=act).props("no-caps")
            if row.omissible and test is not None:
                names = ", ".join(name for found in row.omissible.values() for name in found)
                known = {"responses": test.responses, "references": test.references}
                omit = edits.leave_out(row.omissible, known, row.test)
                act = show_errors(lambda: workspace.edit(f"leave out {names}", omit))
                ui.button(f"Leave out {names}", on_click=act).props("outline no-caps")

    def _show_effect(self, row: FindingRow, test: TestView) -> None:
        """Show the channel before and after the repair, and the model."""
        view = row.view
        assert view is not None
        curves: dict[str, tuple[RealArray, NumberArray]] = {
            "measured": (view.freq, view.before),
            "repaired": (view.freq, view.after),
            "start": (view.freq, view.model),
        }
        figure = frf_chart(test.quantity, curves, phase=True, unit=view.unit)
        figure["height"] = 300
        with ui.column().classes("min-w-0 w-full gap-0"):
            ui.label(f"{view.channel}: before, after the repair, and the model at its start")
            FigureView(figure).classes("w-full")
