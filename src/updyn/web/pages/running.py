"""The page Run: start, watch, stop and resume a run, which continues if the page is closed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nicegui import background_tasks, ui

from updyn.arrays import ComplexArray, RealArray
from updyn.web.charts import SCALES, cost_chart, frf_chart, parameter_chart
from updyn.web.figure import FigureView
from updyn.web.looking import ChannelCurve, TestView, compute_curve
from updyn.web.pages.frame import run_slow, watch
from updyn.web.pages.job import has_no_job, show_view_errors
from updyn.web.pages.task import show_controls, show_worker
from updyn.web.workspace import Workspace

__all__ = ["show"]


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if has_no_job(workspace):
        return
    show_controls(workspace, "run", begin="Save and run")
    _show_state(workspace)
    view = await run_slow(workspace.view)
    if view is None:
        return
    show_view_errors(view)
    if view.tests and not view.errors:
        start = {unknown.name: unknown.start for unknown in view.unknowns}
        await _overlay(workspace, view.tests[0], start)


def _show_state(workspace: Workspace) -> None:
    @ui.refreshable
    def show_state() -> None:
        run = workspace.run
        if run is None:
            ui.label("This job has not run since the window was opened.").mark("state")
            if workspace.project.runs():
                ui.link("Results of earlier runs", "/results")
            return
        show_worker(run, workspace)
        if run.state == "done":
            ui.link("Results", "/results")

    show_state()
    chart = FigureView(cost_chart(())).classes("w-full")

    def draw() -> None:
        steps = [] if workspace.run is None else list(workspace.run.steps)
        chart.set_visibility(len(steps) > 1)
        chart.draw(cost_chart(steps))

    def refresh() -> None:
        show_state.refresh()
        draw()

    draw()
    watch(
        lambda: None if workspace.run is None else (id(workspace.run), workspace.run.version),
        refresh,
    )


async def _overlay(workspace: Workspace, test: TestView, start: Mapping[str, float]) -> None:
    """Show the measured FRF, the start model and the current model."""
    shown: dict[str, Any] = {"response": 0, "reference": 0, "scale": "log"}
    start_curves: dict[tuple[int, int], ChannelCurve] = {}
    n_started = 0

    async def draw() -> None:
        nonlocal n_started
        n_started += 1
        number = n_started
        place.clear()
        row, column = shown["response"], shown["reference"]
        run = workspace.run
        is_own = run is not None and workspace.is_of_open_job(run)
        values = dict(run.values) if run is not None and is_own else {}
        with place:
            if (row, column) not in start_curves:
                first = await run_slow(workspace.ask, compute_curve, {}, test.number, row, column)
                if first is None:
                    return
                start_curves[row, column] = first
            updated = None
            if values:
                updated = await run_slow(
                    workspace.ask, compute_curve, values, test.number, row, column
                )
        if number != n_started:
            return  # a later step is already being drawn
        curves = {"measured": (test.freq[test.used], test.values[test.used, row, column])}
        if updated is not None:
            curves["updated"] = _as_pair(updated)
        curves["start"] = _as_pair(start_curves[row, column])
        overlay.draw(frf_chart(test.quantity, curves, scale=shown["scale"]))
        bars.set_visibility(bool(values))
        bars.draw(parameter_chart(start, values))

    with ui.row():
        for what, names in (("response", test.responses), ("reference", test.references)):
            ui.select(dict(enumerate(names)), label=what).bind_value(shown, what).on_value_change(
                draw
            ).classes("min-w-32")
        ui.select(SCALES, label="magnitude").bind_value(shown, "scale").on_value_change(
            draw
        ).classes("min-w-32")
    overlay = FigureView(frf_chart(test.quantity, {})).classes("w-full")
    bars = FigureView(parameter_chart(start, {})).classes("w-full")
    bars.set_visibility(False)
    place = ui.column()
    watch(lambda: _step_version(workspace), lambda: background_tasks.create(draw()))
    await draw()


def _as_pair(found: ChannelCurve) -> tuple[RealArray, ComplexArray]:
    return found.freq, found.values


def _step_version(workspace: Workspace) -> object:
    """Return a value that changes with every step of the run."""
    run = workspace.run
    return None if run is None else (id(run), run.now.get("accepted"), run.state)
