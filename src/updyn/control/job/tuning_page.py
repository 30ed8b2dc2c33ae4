"""Part of the page Plant: sliders for the gains of the controller, with margins and step."""

from __future__ import annotations

import asyncio
from pathlib import Path

from nicegui import run, ui

from updyn.control.job.settings import TUNING
from updyn.control.job.tuning import (
    Gain,
    GainPath,
    TunedLoop,
    find_plant_file,
    list_gains,
    set_gains,
    tune_loop,
)
from updyn.errors import UpdynError
from updyn.report.formats import capitalize_first
from updyn.web.figure import FigureView
from updyn.web.pages.frame import show_errors, watch
from updyn.web.pages.watch import ValueChange
from updyn.web.workspace import Workspace

__all__ = ["show_tuning"]


def show_tuning(workspace: Workspace) -> None:
    """Show sliders for the controller of the job on its plant; nothing without a controller."""
    _Tuning(workspace).show()


class _Slider(ui.slider):
    """A slider that moves at once, not after the answer of the server: no key press is lost."""

    LOOPBACK = False


class _Tuning:
    """Sliders around the numbers in the job, whose `_values` have been moved, and the loop."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._gains: list[Gain] = []
        self._file: Path | None = None
        self._values: dict[GainPath, float] = {}
        self._turn = 0

    def show(self) -> None:
        """Build the part; it is rebuilt if the numbers in the job or the plant have changed."""
        self._read()
        self._draw()
        watch(self._version, self._rebuild)

    def _version(self) -> object:
        file = self._find_file()
        stamp = file.stat().st_mtime_ns if file is not None and file.is_file() else 0
        document = self._workspace.document
        return None if document is None else list_gains(document.text), file, stamp

    def _find_file(self) -> Path | None:
        workspace = self._workspace
        if workspace.document is None:
            return None
        _, page = workspace.pages("plant")
        inside = workspace.project.inside
        folder = inside(page).parent if page else inside(workspace.proposed_folder("plant"))
        return find_plant_file(workspace.document.text, folder)

    def _read(self) -> None:
        document = self._workspace.document
        self._gains = [] if document is None else list_gains(document.text)
        self._file = self._find_file() if self._gains else None
        self._values = {}

    def _rebuild(self) -> None:
        self._read()
        self._draw.refresh()

    @ui.refreshable_method
    def _draw(self) -> None:
        self._turn += 1
        if not self._gains:
            return
        with ui.expansion("Tune the controller", value=True).classes("w-full"):
            if self._file is None:
                ui.label("Begin once: the sliders need the plant in a .json, .mat or .npz file.")
                return
            with ui.row().classes("w-full items-start max-md:flex-col md:flex-nowrap"):
                with ui.column().classes("w-full md:w-5/12 gap-1"):
                    for gain in self._gains:
                        self._draw_slider(gain)
                    self._draw_buttons()
                with ui.column().classes("w-full md:w-7/12"):
                    self._place = ui.column().classes("w-full gap-1")
        ui.timer(0.0, self._update, once=True)

    def _draw_slider(self, gain: Gain) -> None:
        name = f"{gain.label} ({gain.unit})" if gain.unit else gain.label
        with ui.row().classes("w-full items-center no-wrap gap-3"):
            ui.label(name).classes("w-40")
            most = TUNING.decades
            slider = _Slider(min=-most, max=most, step=TUNING.step, value=0.0)
            slider.props(f'aria-label="{name}"').classes("flex-1 min-w-24")
            shown = ui.label(f"{gain.value:.4g}").classes("w-20 text-right")

        async def move(event: ValueChange) -> None:
            value = gain.value * 10.0 ** float(event.value)
            shown.set_text(f"{value:.4g}")
            self._values[gain.path] = value
            await self._update()

        slider.on_value_change(move)

    def _draw_buttons(self) -> None:
        def write() -> None:
            if self._values:
                self._workspace.edit("controller", set_gains(self._values))

        with ui.row():
            ui.button("Write to the job", on_click=show_errors(write)).props("no-caps")
            ui.button("Reset", on_click=self._rebuild).props("outline no-caps")
        ui.label("On the nominal plant; the page below has the family.").classes("opacity-70")

    async def _update(self) -> None:
        """Compute and show the loop once the sliders have rested."""
        self._turn += 1
        turn, place = self._turn, self._place
        await asyncio.sleep(TUNING.pause)
        if turn != self._turn or place.is_deleted:
            return
        found: TunedLoop | str | None
        try:
            found = await run.io_bound(
                self._workspace.ask, tune_loop, self._file, dict(self._values)
            )
        except UpdynError as error:
            found = str(error)
        if found is not None and turn == self._turn and not place.is_deleted:
            self._show(found)

    def _show(self, found: TunedLoop | str) -> None:
        self._place.clear()
        with self._place:
            if isinstance(found, str):
                ui.label(found).classes("text-negative whitespace-pre-wrap").props("role=alert")
                return
            verdict = ui.label(capitalize_first(found.verdict.text)).mark("verdict")
            verdict.classes("text-lg font-bold").props("role=status")
            verdict.style(f"color: var(--{found.verdict.kind})")
            for reason in found.verdict.reasons:
                ui.label(reason).classes("text-sm opacity-80")
            with ui.grid(columns="auto auto").classes("gap-x-6 gap-y-0 text-sm"):
                for title, value in found.rows:
                    ui.label(title)
                    ui.label(value).classes("text-right")
            for figure in found.figures:
                FigureView(figure).classes("w-full")
