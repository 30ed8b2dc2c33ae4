"""The page of a table of FRFs: selection of its columns or variables, with a preview."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from nicegui import run, ui

from updyn.errors import UpdynError
from updyn.io.inventory import Item
from updyn.web.charts import frf_chart
from updyn.web.entry import TextEntry
from updyn.web.figure import FigureView
from updyn.web.form import REQUIRED
from updyn.web.pages.frame import complain, navigate_after, show_fault
from updyn.web.pages.watch import ValueChange
from updyn.web.project import describe_error
from updyn.web.settings import WEB_PAGE
from updyn.web.table_form import FORM_NAMES, Entry, Key, TableForm
from updyn.web.table_preview import FRFPreview
from updyn.web.workspace import OpenTable, Workspace

__all__ = ["show"]

_ITEMS = [
    {"name": "name", "label": "name", "field": "name", "align": "left"},
    {"name": "size", "label": "size", "field": "size", "align": "left"},
    {"name": "unit", "label": "unit", "field": "unit", "align": "left"},
    {"name": "first", "label": "first values", "field": "first", "align": "left"},
    {"name": "use", "label": "used as", "field": "use", "align": "left"},
]
_ROWS = ("frequency (Hz)", "real", "imaginary", "magnitude", "phase (°)", "coherence")


async def show(workspace: Workspace) -> None:
    """Fill the page."""
    if workspace.table is None:
        with ui.row():
            ui.label("No table is open.")
            ui.link("Choose a measurement", "/")
        return
    await _TablePage(workspace, workspace.table).show()


class _TablePage:
    """The form of an open table; the preview follows each change."""

    def __init__(self, workspace: Workspace, table: OpenTable) -> None:
        self._workspace, self._table = workspace, table
        self._shown: dict[Key, Any] = {}
        self._turn = 0
        self._page = 1

    @property
    def _form(self) -> TableForm:
        return self._table.form

    async def show(self) -> None:
        what = self._form.root
        ui.label(f"Select the FRFs in {self._table.view.first_file}").classes("text-xl")
        self._layout = ui.label().classes("opacity-70")
        with ui.row().classes("w-full items-center sm:flex-nowrap"):
            self._icon = ui.icon("hourglass_empty", size="sm")
            self._status = ui.label().classes("flex-1 min-w-48 whitespace-pre-wrap").mark("status")
            self._status.props("role=status")
            ui.button("Cancel", on_click=lambda: ui.navigate.to(self._place)).props("flat no-caps")
            self._use = ui.button(f"Use these {what}", on_click=self._apply).props("no-caps")
        with ui.row().classes("w-full items-stretch max-lg:flex-col lg:flex-nowrap"):
            with ui.card().classes("w-full lg:w-7/12"):
                ui.label("Entries").classes("text-lg")
                self._draw_form()
            with ui.card().classes("w-full lg:w-5/12"):
                ui.label("As they are read").classes("text-lg")
                self._preview = _Preview()
        with ui.card().classes("w-full"):
            ui.label(f"{what.capitalize()} in the file").classes("text-lg")
            columns = _ITEMS if what == "variables" else [c for c in _ITEMS if c["name"] != "size"]
            self._items = ui.table(rows=[], columns=columns, row_key="key", pagination=20)
            self._items.props("flat dense wrap-cells").classes("w-full")
            if len(self._form.inventory.items) <= 20:
                self._items.props("hide-bottom")
            if self._form.inventory.head:
                with ui.expansion("First lines of the file").classes("w-full"):
                    rows = enumerate(self._form.inventory.head, 1)
                    text = "\n".join(f"{number:>3}  {row}" for number, row in rows)
                    ui.label(text).classes("whitespace-pre font-mono text-sm overflow-auto")
        await self._update()

    # -- form --------------------------------------------------------------------------------------
    @ui.refreshable_method
    def _draw_form(self) -> None:
        form = self._form
        self._shown.clear()
        self._show_pattern()
        with ui.row().classes("w-full items-end"):
            parts = ui.select(dict(FORM_NAMES), value=form.parts, label="values are")
            parts.classes("min-w-60").on_value_change(self._choose_parts)
            if form.root == "variables":
                ways = {True: "arrays of all channels", False: "a variable for each channel"}
                ways_select = ui.select(ways, value=form.is_array, label="the file has")
                ways_select.classes("min-w-60").on_value_change(self._choose_array)
        with ui.row().classes("w-full items-start"):
            for entry in form.entries():
                self._show_entry(entry, "w-52 max-sm:w-full")
        n, step = len(form.channels), WEB_PAGE.shown_channels
        self._page = min(self._page, max(1, -(-n // step)))
        for number in range(n)[step * (self._page - 1) : step * self._page]:
            self._show_channel(number)
        if n > step:
            pages = ui.pagination(1, -(-n // step), value=self._page)
            pages.on_value_change(self._turn_page)
        if n:
            with ui.row():
                ui.button("Add a channel", icon="add", on_click=self._add).props("flat no-caps")
                if n > 1:
                    ui.button(
                        "Use the first reference for all", on_click=self._repeat_reference
                    ).props("flat no-caps")

    def _show_pattern(self) -> None:
        """Show whether all files of measurement points are read."""
        table, form = self._table, self._form
        if not table.view.pattern:
            return
        text = f"Read all {table.view.n_files} files {table.view.pattern} as one test"
        box = ui.checkbox(text, value=form.file == table.pattern)
        box.on_value_change(self._choose_pattern)

    def _show_channel(self, number: int) -> None:
        form = self._form
        many = len(form.channels) > 1
        with (
            ui.row().classes("w-full items-start border-t pt-2").style("border-color: var(--rule)")
        ):
            if many:
                ui.label(f"{number + 1}").classes("pt-4 w-4 opacity-70")
            for entry in form.channel_entries(number):
                narrow = entry.kind == "text"
                self._show_entry(entry, "w-24" if narrow else "flex-1 min-w-28 max-sm:min-w-full")
            if many:
                remove = ui.button(icon="close", on_click=lambda: self._remove(number))
                remove.props(f'flat round dense aria-label="Remove channel {number + 1}"')
                remove.classes("mt-3")

    def _show_entry(self, entry: Entry, width: str) -> None:
        label = f"{entry.label} *" if entry.required else entry.label
        value = self._form.get(entry.key)
        if entry.kind in ("text", "texts"):
            shown: Any = TextEntry(label, value=value, placeholder=entry.example)
            shown.props("debounce=300")
        elif entry.kind == "item":
            shown = ui.select(self._item_names(value), value=value or None, label=label)
            shown.props("" if entry.required else "clearable")
        elif entry.kind == "whole":
            shown = ui.number(label, value=value or None, min=1, precision=0)
            shown.props("clearable debounce=800")
        else:
            choices = {**entry.choices, **({} if value in entry.choices else {value: value})}
            choices.pop("", None)
            is_unit = entry.kind == "unit"
            shown = ui.select(
                list(choices) if is_unit else choices,
                value=value or None,
                label=label,
                with_input=is_unit,
                new_value_mode="add-unique" if is_unit else None,
            ).props("clearable")
        shown.classes(width).props("hide-bottom-space")
        self._shown[entry.key] = shown

        async def store(event: ValueChange) -> None:
            value = event.value
            is_whole = isinstance(value, float) and value.is_integer()
            self._form.set(entry.key, int(value) if is_whole else value)
            if entry.relists:
                await self._relist()
            else:
                await self._update()

        shown.on_value_change(store)

    def _item_names(self, value: Any) -> dict[Any, str]:
        """Return the columns or variables by their value in the mapping."""
        names = {item.select: _name_item(item) for item in self._form.inventory.items}
        return names if value in ("", *names) else {**names, value: f"{value} (not in the file)"}

    async def _relist(self) -> None:
        try:
            await run.io_bound(self._workspace.relist_table)
        except UpdynError as error:
            complain(describe_error(error))
        await self._redraw()

    # -- changes of the form -----------------------------------------------------------------------
    async def _redraw(self) -> None:
        self._draw_form.refresh()
        await self._update()

    async def _choose_parts(self, event: ValueChange) -> None:
        self._form.choose_parts(event.value)
        await self._redraw()

    async def _choose_array(self, event: ValueChange) -> None:
        self._form.choose_array(bool(event.value))
        await self._redraw()

    async def _choose_pattern(self, event: ValueChange) -> None:
        table = self._table
        self._form.choose_file(table.pattern if event.value else table.first_file)
        await self._redraw()

    async def _turn_page(self, event: ValueChange) -> None:
        self._page = int(event.value)
        await self._redraw()

    async def _add(self) -> None:
        self._form.add_channel()
        self._page = -(-len(self._form.channels) // WEB_PAGE.shown_channels)
        await self._redraw()

    async def _repeat_reference(self) -> None:
        self._form.repeat_reference()
        await self._redraw()

    async def _remove(self, number: int) -> None:
        self._form.remove_channel(number)
        await self._redraw()

    @property
    def _place(self) -> str:
        """The page that opened the form."""
        return "/" if self._table.test is None else "/measurement"

    async def _apply(self) -> None:
        await navigate_after(self._place, self._workspace.use_table)

    # -- preview -----------------------------------------------------------------------------------
    async def _update(self) -> None:
        """Show faults, uses and the preview of the present entries."""
        self._turn += 1
        turn, form = self._turn, self._form
        self._list_items()
        faults = form.faults()
        self._use.disable()
        try:
            found = await run.io_bound(self._workspace.preview_table)
        except UpdynError as error:
            found = FRFPreview({(): str(error)})
        if turn != self._turn or self._status.is_deleted:
            return  # another change has come meanwhile
        errors = dict(found.errors) if found is not None else {}
        placed = {self._find_entry(key): message for key, message in errors.items()}
        self._show_faults({**placed, **faults})
        self._preview.show(found, labelled=not faults)
        if not faults and found is not None and not errors:
            self._status.set_text(f"{found.summary}, {found.quantity}.")
            self._use.enable()

    def _list_items(self) -> None:
        uses = self._form.uses()
        self._layout.set_text(f"{self._form.inventory.layout}.")
        self._items.rows = [
            {
                "key": str(item.select),
                "name": item.name or f"{item.select}",
                "size": item.size,
                "unit": item.unit,
                "first": item.first,
                "use": ", ".join(uses.get(item.select, [])),
            }
            for item in self._form.inventory.items
        ]

    def _show_faults(self, faults: Mapping[Key, str]) -> None:
        """Show each fault at its entry, others in the status."""
        hints = self._form.hints()
        for key, shown in self._shown.items():
            show_fault(shown, faults.get(key, ""), hints.get(key, ""))
        missing = [key for key, message in faults.items() if message == REQUIRED]
        others = [text for key, text in faults.items() if text != REQUIRED]
        icon, colour, text = "check_circle", "positive", ""
        if others:
            icon, colour, text = "error", "negative", "\n".join(others)
        elif missing:
            names = list(dict.fromkeys(self._name_of(key) for key in missing))
            icon, colour = "edit", "warning"
            text = f"To fill in: {', '.join(names)}."
        self._icon.props(f"name={icon} color={colour}")
        self._status.set_text(text)

    def _find_entry(self, key: Key) -> Key:
        """Return the key of the entry at which an error is shown.

        An error of a table of options is shown at the first item in it.
        """
        if key in self._shown or not key:
            return key
        inside = [shown for shown in self._shown if shown[: len(key)] == key]
        items = [shown for shown in inside if shown[-1] not in ("response", "reference")]
        return next(iter(items), key)

    def _name_of(self, key: Key) -> str:
        shown = self._shown.get(key)
        return str(key[-1]) if shown is None else str(shown.props["label"]).removesuffix(" *")


class _Preview:
    """A figure and the first rows of a channel, both kept while their content changes."""

    def __init__(self) -> None:
        self._found = FRFPreview()
        self._names: dict[int, str] = {}
        self._quantity = ""
        self._figure: FigureView | None = None
        self._empty = ui.label("Shown once the frequency and the values can be read.")
        self._body = ui.column().classes("w-full")
        with self._body:
            self._notes = ui.label().classes("opacity-80 whitespace-pre-wrap")
            self._channel = ui.select({}, label="channel").classes("min-w-48")
            self._channel.on_value_change(self._draw)
            self._place = ui.column().classes("w-full")
            self._rows = ui.table(rows=[]).props("flat dense").classes("max-w-full")
        self.show(None, labelled=False)

    def show(self, found: FRFPreview | None, *, labelled: bool) -> None:
        """Show FRFs, with numbers in place of their labels unless `labelled`; None for none."""
        can_show = found is not None and not found.errors
        self._empty.set_visibility(not can_show)
        self._body.set_visibility(can_show)
        if found is None or not can_show:
            return
        self._found, self._quantity = found, found.quantity if labelled else "H"
        self._names = {
            number: f"{i} / {j}" if labelled else f"channel {number + 1}"
            for number, (i, j) in enumerate(found.channels)
        }
        self._notes.set_text("\n".join(found.notes))
        self._channel.set_visibility(len(self._names) > 1)
        known = self._channel.value in self._names
        self._channel.set_options(self._names, value=self._channel.value if known else 0)
        if known:  # otherwise it is drawn, as the channel has changed
            self._draw()

    def _draw(self) -> None:
        found, channel = self._found, self._channel.value
        values = found.values[:, channel]
        figure = frf_chart(self._quantity, {self._names[channel]: (found.freq, values)})
        figure["height"] = WEB_PAGE.preview_height
        if self._figure is None:
            with self._place:
                self._figure = FigureView(figure).classes("w-full")
        else:
            self._figure.draw(figure)
        numbers = [found.freq, values.real, values.imag, np.abs(values), np.angle(values, deg=True)]
        numbers += [] if found.coherence is None else [found.coherence[:, channel]]
        columns = _ROWS[: len(numbers)]
        self._rows.columns = [{"name": name, "label": name, "field": name} for name in columns]
        self._rows.rows = [
            {name: f"{column[line]:.5g}" for name, column in zip(columns, numbers, strict=True)}
            for line in range(min(WEB_PAGE.preview_rows, len(found.freq)))
        ]


def _name_item(item: Item) -> str:
    """Return a column or variable with its first values."""
    name = item.name if item.name == item.select else f"{item.select} {item.name}".strip()
    unit = f" [{item.unit}]" if item.unit and item.unit not in item.name else ""
    return f"{name}{unit}  ({item.first})"
