"""The page Results: the runs of the project, side by side, and their reports."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from nicegui import ui

from updyn.web.pages.frame import embed_page, watch
from updyn.web.project import RunFolder
from updyn.web.tasks import RUN
from updyn.web.workspace import Workspace

__all__ = ["compare_runs", "show"]

#: Figures of agreement to compare, by their key in the record.
_FIGURES = {
    "frac_median": "FRAC after, median",
    "correlation_median": "FRF correlation after, median",
    "residual_median": "relative residual after, median",
    "db_error_median": "level error after, median (dB)",
}
_ANSWERS = {True: "yes", False: "no", None: "not known"}


def show(workspace: Workspace) -> None:
    """Fill the page."""

    @ui.refreshable
    def page() -> None:
        runs = workspace.project.runs()
        if not runs:
            ui.label("No results in this folder yet.")
            return
        names = {workspace.project.name_of(run.path): run for run in runs}
        chosen = ui.select(
            list(names), value=[next(iter(names))], multiple=True, label="Runs to compare"
        )
        chosen.classes("min-w-96").props("use-chips")

        @ui.refreshable
        def content() -> None:
            picked = {name: names[name] for name in chosen.value}
            if not picked:
                ui.label("No run is chosen.")
                return
            columns, rows = compare_runs(picked)
            table = ui.table(rows=rows, columns=columns, row_key="what", pagination=50)
            table.props("flat dense wrap-cells").classes("max-w-full").mark("compared")
            for name, run in picked.items():
                if (run.path / RUN.page).is_file():
                    place = f"/embedded/page/{quote(name)}/{RUN.page}"
                    ui.link(f"Report of {name} in a separate tab", place, new_tab=True)
                    if len(picked) == 1:
                        embed_page(f"{place}?{run.modified:g}", "Report", "85vh")

        chosen.on_value_change(content.refresh)
        content()

    page()
    watch(lambda: _run_version(workspace), page.refresh)


def _run_version(workspace: Workspace) -> object:
    """Return a value that changes when a run has ended."""
    run = workspace.run
    return None if run is None else (id(run), run.active)


def compare_runs(
    runs: Mapping[str, RunFolder],
) -> tuple[list[dict[str, Any]], list[dict[str, str]]]:
    """Return columns and rows of a table of runs: status, trust, agreement, unknowns."""
    keys = {name: f"run{number}" for number, name in enumerate(runs)}  # no dots in keys
    columns: list[dict[str, Any]] = [
        {"name": "what", "label": "", "field": "what", "align": "left"},
        *(
            {"name": key, "label": name, "field": key, "align": "left"}
            for name, key in keys.items()
        ),
    ]
    rows: dict[str, dict[str, str]] = {}

    def add_cell(what: str, name: str, text: object) -> None:
        rows.setdefault(what, {"what": what})[keys[name]] = str(text)

    for name, run in runs.items():
        record = run.record
        add_cell("status", name, record.get("status", ""))
        add_cell("message", name, record.get("message", ""))
        add_cell("steps", name, record.get("iterations", ""))
        for part, verdict in _as_mapping(record.get("trust")).items():
            add_cell(part, name, _ANSWERS.get(_as_mapping(verdict).get("holds"), ""))
        after = _as_mapping(_as_mapping(record.get("correlation")).get("after"))
        for figure, label in _FIGURES.items():
            if isinstance(after.get(figure), int | float):
                add_cell(label, name, f"{after[figure]:.4g}")
        for unknown in _as_records(record.get("parameters")):
            add_cell(str(unknown.get("name", "")), name, _format_value(unknown))
    return columns, list(rows.values())


def _format_value(unknown: Mapping[str, Any]) -> str:
    """Return the value of an unknown with its standard deviation, if known."""
    value, std = unknown.get("value"), unknown.get("std")
    if not isinstance(value, int | float):
        return "not known"
    return f"{value:.5g} ± {std:.2g}" if isinstance(std, int | float) else f"{value:.5g}"


def _as_records(given: Any) -> list[Mapping[str, Any]]:
    return [_as_mapping(item) for item in given] if isinstance(given, list) else []


def _as_mapping(given: Any) -> Mapping[str, Any]:
    return given if isinstance(given, Mapping) else {}
