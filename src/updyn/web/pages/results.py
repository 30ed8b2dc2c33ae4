"""The page Result: the runs of the project, one with its report, or several side by side."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from nicegui import events, ui

from updyn.arrays import NumberArray, RealArray
from updyn.report.changes import changes_of_fits
from updyn.web.charts import SCALES, frf_chart
from updyn.web.figure import FigureView
from updyn.web.looking import JobView, ModelView, TestView, compute_run_model
from updyn.web.pages.frame import embed_page, run_slow, watch
from updyn.web.pages.job import show_view_errors
from updyn.web.project import RunFolder
from updyn.web.runs import (
    compare_runs,
    describe_outcome,
    find_level_error,
    read_badge,
    read_changes,
)
from updyn.web.settings import WEB_PAGE
from updyn.web.tasks import RUN
from updyn.web.workspace import Workspace

__all__ = ["show"]

_RUN_COLUMNS: list[dict[str, Any]] = [
    {"name": "name", "label": "run", "field": "name", "align": "left", "sortable": True},
    {"name": "time", "label": "written", "field": "time", "align": "left", "sortable": True},
    {"name": "verdict", "label": "verdict", "field": "verdict", "align": "left"},
    {"name": "level", "label": "level error (dB)", "field": "level", "align": "left"},
    {"name": "method", "label": "method", "field": "method", "align": "left"},
]
#: Marks the cells of a row in which the runs differ.
_MARK = """<q-td :props="props" :style="props.row.differs && props.col.name !== 'section'
  ? 'background: var(--warn-ground); color: var(--warn)' : ''">{{ props.value }}</q-td>"""


def show(workspace: Workspace) -> None:
    """Fill the page."""
    with ui.row().classes("gap-x-4"):
        ui.link("Methods compared", "/compare")
        ui.link("Checks before a run", "/check")
        ui.link("Correlations at the start", "/correlate")

    @ui.refreshable
    def page() -> None:
        runs = {workspace.project.title_of(run.path): run for run in workspace.project.runs()}
        if not runs:
            ui.link("Run the job", "/run")
            return
        chosen = [next(iter(runs))]
        table = ui.table(
            rows=[_describe_run(name, run) for name, run in runs.items()],
            columns=_RUN_COLUMNS,
            row_key="name",
            selection="multiple",
            pagination=WEB_PAGE.listed_runs,
            title="Runs, the latest first: select several to compare them",
        )
        table.props("flat dense wrap-cells").classes("w-full").mark("runs")
        table.selected = [row for row in table.rows if row["name"] in chosen]

        @ui.refreshable
        async def content() -> None:
            picked = {name: runs[name] for name in chosen if name in runs}
            if not picked:
                ui.label("No run is selected.")
                return
            await _show_runs(workspace, picked)

        def select(event: events.TableSelectionEventArguments) -> None:
            del event
            chosen[:] = [row["name"] for row in table.selected]
            content.refresh()

        table.on_select(select)
        ui.timer(0.0, content, once=True)

    page()
    watch(lambda: _run_version(workspace), page.refresh)


def _run_version(workspace: Workspace) -> object:
    """Return a value that changes when a run has ended."""
    run = workspace.run
    return None if run is None else (id(run), run.active)


def _describe_run(name: str, run: RunFolder) -> dict[str, str]:
    before, after = (find_level_error(run.record, when) for when in ("before", "after"))
    return {
        "name": name,
        "time": time.strftime("%Y-%m-%d %H:%M", time.localtime(run.modified)),
        "verdict": read_badge(run.record).phrase,
        "level": "" if after != after else f"{before:.2g} → {after:.2g}",
        "method": str(run.record.get("method") or ""),
    }


async def _show_runs(workspace: Workspace, runs: Mapping[str, RunFolder]) -> None:
    """Show one run with its report, or several side by side."""
    if len(runs) == 1:
        (run,) = runs.values()
        _show_outcome(run)
    else:
        _show_comparison(runs)
    with ui.element("div").classes("w-full grid gap-4 grid-cols-1 lg:grid-cols-2"):
        changes = changes_of_fits({name: read_changes(run.record) for name, run in runs.items()})
        with ui.column().classes("min-w-0 gap-0"):
            if changes is not None:
                ui.label("Changes of the unknowns, with 95 % intervals and bounds")
                FigureView(changes).classes("w-full")
        curves = ui.column().classes("min-w-0 gap-0")
    for name, run in runs.items():
        if (run.path / RUN.page).is_file():
            place = f"/embedded/page/{quote(workspace.project.name_of(run.path / RUN.page))}"
            ui.link(f"Report of {name} in a separate tab", place, new_tab=True)
            if len(runs) == 1:
                embed_page(f"{place}?{run.modified:g}", "Report", "85vh")
    with curves:
        await _show_curves(workspace, runs)


def _show_outcome(run: RunFolder) -> None:
    """Show the outcome of a run and its next step; further remarks are folded."""
    found = describe_outcome(run.record)
    with ui.column().classes("gap-0 w-full"):
        ui.label(found.statement).classes("text-lg").mark("outcome")
        if found.next_step:
            ui.label(f"Next: {found.next_step}").classes("whitespace-pre-wrap opacity-80")
        if found.remarks:
            with ui.expansion("Further remarks").classes("w-full").props("dense"):
                for remark in found.remarks:
                    ui.label(remark).classes("whitespace-pre-wrap")


def _show_comparison(runs: Mapping[str, RunFolder]) -> None:
    """Show the rows of the comparison, with differences marked."""
    columns: list[dict[str, Any]] = [
        {"name": "section", "label": "", "field": "section", "align": "left"},
        {"name": "what", "label": "", "field": "what", "align": "left"},
        *(
            {"name": f"run{place}", "label": name, "field": f"run{place}", "align": "left"}
            for place, name in enumerate(runs)
        ),
    ]
    rows = []
    for number, row in enumerate(compare_runs(list(runs.values()))):
        cells = {f"run{place}": cell for place, cell in enumerate(row.cells)}
        rows.append(
            {
                "id": number,
                "section": row.section,
                "what": f"≠ {row.name}" if row.differs else row.name,
                "differs": row.differs,
                **cells,
            }
        )
    differing = [row for row in rows if row["differs"]]
    only = ui.switch("only differences", value=True)
    table = ui.table(rows=differing, columns=columns, row_key="id", pagination=0)
    table.props("flat dense wrap-cells hide-pagination").classes("max-w-full").mark("compared")
    table.add_slot("body-cell", _MARK)

    def filter_rows() -> None:
        table.rows = differing if only.value else rows

    only.on_value_change(filter_rows)


async def _show_curves(workspace: Workspace, runs: Mapping[str, RunFolder]) -> None:
    """Show the updated models of runs over the measured FRFs of the first."""
    files = {name: workspace.project.name_of(run.path / "job.toml") for name, run in runs.items()}
    first = next(iter(files.values()))
    view = await run_slow(workspace.view_run, first, note="Reading the measurement …")
    if view is None:
        return
    show_view_errors(view)  # such as an input that has been moved since the run
    if not view.tests or view.errors:
        return
    if view.is_large:
        place = ui.column()

        async def draw() -> None:
            button.delete()
            with place:
                await _draw_curves(workspace, files, view)

        button = ui.button("Draw the FRFs of the models", on_click=draw)
        button.props("outline no-caps")
        return
    await _draw_curves(workspace, files, view)


async def _draw_curves(workspace: Workspace, files: Mapping[str, str], view: JobView) -> None:
    test = view.tests[0]
    where = test.number, test.responses, test.references
    models: dict[str, ModelView] = {}
    for name, file in files.items():
        note = f"Computing the model of {name} …"
        found = await run_slow(workspace.ask_file, compute_run_model, file, *where, note=note)
        if found is not None:
            models[name] = found
    if models:
        _show_overlay(test, models)


def _show_overlay(test: TestView, models: Mapping[str, ModelView]) -> None:
    """Show one channel of the measurement with the models."""
    shown: dict[str, Any] = {"response": 0, "reference": 0, "scale": "log"}

    def make() -> dict[str, Any]:
        row, column = shown["response"], shown["reference"]
        curves: dict[str, tuple[RealArray, NumberArray]] = {
            "measured": (test.freq[test.used], test.values[test.used, row, column])
        }
        for name, model in models.items():
            curves[name] = model.freq, model.values[:, row, column]
        return frf_chart(
            test.quantity, curves, scale=shown["scale"], unit=test.find_unit(row, column)
        )

    choices = ui.row().classes("items-center")
    figure = FigureView(make()).classes("w-full")
    with choices:
        for what, options in (
            ("response", dict(enumerate(test.responses))),
            ("reference", dict(enumerate(test.references))),
            ("scale", SCALES),
        ):
            label = "magnitude" if what == "scale" else what
            select = ui.select(options, label=label).bind_value(shown, what)
            select.on_value_change(lambda: figure.draw(make())).classes("min-w-28")
