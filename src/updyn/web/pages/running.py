"""The page Run: start, watch, stop and resume a run, which continues if the page is closed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from nicegui import background_tasks, run, ui

from updyn.arrays import NumberArray, RealArray
from updyn.errors import UpdynError
from updyn.progress import format_clock
from updyn.report.changes import Change, changes_of_fits
from updyn.web.charts import SCALES, frf_chart, level_chart
from updyn.web.figure import FigureView
from updyn.web.looking import JobView, ModelView, compute_model
from updyn.web.pages.frame import run_slow, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.pages.task import show_controls, show_worker
from updyn.web.project import RunFolder
from updyn.web.runs import read_badge, read_changes
from updyn.web.settings import WEB_PAGE
from updyn.web.worker import Worker
from updyn.web.workspace import Workspace

__all__ = ["show"]


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if has_no_job(workspace):
        return
    show_controls(workspace, "run", begin="Save and run")
    with ui.row().classes("gap-x-4"):
        ui.link("Check the job first", "/check")
        ui.link("Compare model and measurement", "/correlate")
        ui.link("Compare all methods", "/compare")
    _show_state(workspace)
    view = await run_slow(workspace.view)
    if view is None:
        return
    show_view_errors(view)
    if not view.errors:
        pictures = _Pictures(workspace, view)
        pictures.show()
        await pictures.follow()


def _show_state(workspace: Workspace) -> None:
    @ui.refreshable
    def show_state() -> None:
        worker = workspace.run
        if worker is None:
            latest = _find_latest(workspace)
            if latest is not None:  # otherwise the sentence on the step says that there is none
                text = f"Latest run: {workspace.project.title_of(latest.path)}, "
                text += read_badge(latest.record).name
                with ui.row().classes("items-center"):
                    ui.label(text).classes("text-lg").mark("state")
                    ui.link("Results", "/results")
            return
        _show_stages(worker)
        show_worker(worker, workspace, "/results")

    show_state()
    watch(
        lambda: None if workspace.run is None else (id(workspace.run), workspace.run.version),
        show_state.refresh,
    )


def _find_latest(workspace: Workspace) -> RunFolder | None:
    """Return the latest results of the open job."""
    runs = workspace.project.runs_of(workspace.open_document.path)
    return runs[0] if runs else None


def _show_stages(worker: Worker) -> None:
    """Show the stages of a run: ended, active with its remaining time, and to come."""
    if not worker.plan:
        return
    position = worker.now.get("position", 1)
    with ui.row().classes("items-center gap-x-2 gap-y-1").props('role=list aria-label="Stages"'):
        for number, name in enumerate(worker.plan, 1):
            is_done = worker.state == "done" or number < position
            is_active = worker.active and number == position
            icon = "radio_button_unchecked"
            if is_done:
                icon = "check_circle"
            elif is_active:
                icon = "pending"
            item = ui.row().classes("items-center gap-1 no-wrap").props("role=listitem")
            if is_active:
                item.props("aria-current=step").classes("font-bold")
            with item:
                ui.icon(icon, color="primary" if is_done or is_active else None)
                ui.label(name + _format_remaining(worker.now) * is_active)
            if number < len(worker.plan):
                ui.icon("chevron_right").classes("opacity-50")
    share = worker.now.get("share")
    if worker.active and share is not None:
        ui.linear_progress(share, show_value=False).classes("w-full max-w-screen-md")


def _format_remaining(now: Mapping[str, Any]) -> str:
    remaining = now.get("remaining")
    return "" if remaining is None else f", at most {format_clock(remaining)} left"


class _Pictures:
    """Level error, changes of the unknowns, and FRFs of the present model over the measured ones.

    Without a run since the window was opened, the latest results are shown.
    """

    def __init__(self, workspace: Workspace, view: JobView) -> None:
        self._workspace, self._view = workspace, view
        self._shown: dict[str, Any] = {"test": 0, "response": 0, "reference": 0, "scale": "log"}
        self._latest = _find_latest(workspace)
        self._start: dict[int, ModelView] = {}
        self._present: tuple[object, ModelView] | None = None
        self._is_drawing, self._is_outdated = False, False

    def show(self) -> None:
        """Build this part of the page."""
        self._about = ui.label().classes("text-lg").mark("level")
        with ui.element("div").classes("w-full grid gap-4 grid-cols-1 lg:grid-cols-2"):
            self._levels = FigureView(level_chart({})).classes("w-full min-w-0")
            self._bars = FigureView(level_chart({})).classes("w-full min-w-0")
        if self._view.tests:
            self._show_choices()
            self._curves = FigureView(frf_chart("", {})).classes("w-full")
        self._draw_changes()
        self._draw_levels()
        watch(lambda: _find_step(self._workspace), lambda: background_tasks.create(self.follow()))

    def _show_choices(self) -> None:
        tests = self._view.tests
        with ui.row().classes("items-center"):
            if len(tests) > 1:
                names = {place: test.name for place, test in enumerate(tests)}
                self._show_select("test", names)
            self._selects = [self._show_select(what, {}) for what in ("response", "reference")]
            self._show_select("scale", SCALES, "magnitude")
        self._set_channels()

    def _show_select(self, what: str, options: Mapping[Any, str], label: str = "") -> ui.select:
        async def change() -> None:
            if what == "test":
                self._set_channels()
                self._present = None
            await self.follow()

        options = dict(options) or {0: ""}
        select = ui.select(options, label=label or what).bind_value(self._shown, what)
        return select.on_value_change(change).classes("min-w-32")

    def _set_channels(self) -> None:
        test = self._view.tests[self._shown["test"]]
        self._shown["response"] = self._shown["reference"] = 0
        for select, names in zip(self._selects, (test.responses, test.references), strict=True):
            select.set_options(dict(enumerate(names)), value=0)

    async def follow(self) -> None:
        """Draw the present step; steps that come meanwhile are drawn together afterwards."""
        self._is_outdated = True
        if self._is_drawing:
            return
        self._is_drawing = True
        try:
            while self._is_outdated and not self._about.is_deleted:
                self._is_outdated = False
                self._draw_changes()
                if self._view.tests and not self._view.is_large:
                    await self._compute_models()
                self._draw_curves()
                self._draw_levels()
                if self._view.tests and not self._view.is_large:
                    await self._compute_levels()
        finally:
            self._is_drawing = False

    async def _compute_models(self) -> None:
        """Compute the model at the start and at the present step, unless they are known."""
        place = self._shown["test"]
        worker, values = self._find_values()
        if place not in self._start:
            found = await self._ask({})
            if found is None:
                return
            self._start[place] = found
        step = None if worker is None else (id(worker), worker.now.get("iteration", 0))
        if not values:
            self._present = None
        elif self._present is None or self._present[0] != step:
            found = await self._ask(values)
            if found is not None:
                self._present = step, found
                self._store_level(worker, found)

    def _store_level(
        self, worker: Worker | None, found: ModelView, step: Mapping[str, Any] | None = None
    ) -> None:
        """Store the level error of a step, by default the present one, of the first test."""
        if worker is not None and self._shown["test"] == 0:
            worker.levels.setdefault(0, self._start[0].level_error)
            worker.levels[(step or worker.now)["iteration"]] = found.level_error

    async def _compute_levels(self) -> None:
        """Compute level errors of earlier steps of a run that has ended, until a new step comes."""
        worker, _ = self._find_values()
        if worker is None or worker.active or 0 not in self._start:
            return
        steps = [step for step in worker.steps if step["values"]]
        every = -(-len(steps) // WEB_PAGE.level_steps)
        for step in steps[:: max(every, 1)]:
            if self._is_outdated or self._shown["test"] != 0:
                return
            if step["iteration"] not in worker.levels:
                found = await self._ask(step["values"])
                if found is not None:
                    self._store_level(worker, found, step)
        self._draw_levels()

    async def _ask(self, values: Mapping[str, float]) -> ModelView | None:
        test = self._view.tests[self._shown["test"]]
        where = test.number, test.responses, test.references
        try:
            return await run.io_bound(self._workspace.ask, compute_model, values, *where)
        except UpdynError:  # of the job, which the page shows, or of a step that cannot be solved
            return None

    def _find_values(self) -> tuple[Worker | None, dict[str, float]]:
        """Return the run of the open job, and the values of its present step or latest results."""
        worker = self._workspace.run
        if worker is not None:
            is_own = self._workspace.is_of_open_job(worker)
            return (worker, dict(worker.values)) if is_own else (None, {})
        return None, {one.parameter.name: one.value for one in self._read_latest()}

    def _read_latest(self) -> list[Change]:
        return [] if self._latest is None else read_changes(self._latest.record)

    # -- figures -----------------------------------------------------------------------------------
    def _draw_changes(self) -> None:
        worker, values = self._find_values()
        changes = self._read_latest()
        if worker is not None:
            changes = [
                Change(unknown, values[unknown.name], None, "preliminary")
                for unknown in self._view.unknowns
                if unknown.name in values
            ]
            if worker.state == "done":
                found = self._workspace.project.run(worker.out)
                changes = changes if found is None else read_changes(found.record)
        figure = changes_of_fits({"run": changes})
        self._bars.set_visibility(figure is not None)
        if figure is not None:
            self._bars.draw(figure)

    def _draw_levels(self) -> None:
        worker, _ = self._find_values()
        levels = {} if worker is None else dict(worker.levels)
        self._levels.set_visibility(len(levels) > 1)
        if len(levels) > 1:
            self._levels.draw(level_chart(levels))
        start = self._start.get(self._shown["test"])
        if start is None:
            self._about.set_visibility(False)
            return
        text = f"Level error (median): {start.level_error:.2g} dB at the start"
        if self._present is not None:
            when = "now" if worker is not None and worker.active else "in the end"
            text += f", {self._present[1].level_error:.2g} dB {when}"
        best = min(levels.values(), default=math.nan)
        if len(levels) > 2:
            text += f", {best:.2g} dB at best"
        self._about.set_text(f"{text}.")
        self._about.set_visibility(True)

    def _draw_curves(self) -> None:
        if not self._view.tests:
            return
        shown = self._shown
        test = self._view.tests[shown["test"]]
        row, column = shown["response"], shown["reference"]
        curves: dict[str, tuple[RealArray, NumberArray]] = {
            "measured": (test.freq[test.used], test.values[test.used, row, column])
        }
        start, present = self._start.get(shown["test"]), self._present
        if present is not None:
            curves["updated"] = present[1].freq, present[1].values[:, row, column]
        if start is not None:
            curves["start"] = start.freq, start.values[:, row, column]
        self._curves.draw(
            frf_chart(test.quantity, curves, scale=shown["scale"], unit=test.find_unit(row, column))
        )


def _find_step(workspace: Workspace) -> object:
    """Return a value that changes with every step of the run."""
    worker = workspace.run
    return None if worker is None else (id(worker), worker.now.get("accepted"), worker.state)
