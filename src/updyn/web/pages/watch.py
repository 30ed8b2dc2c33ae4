"""`watch`: follow changes of the shared state, also those by other tabs and by tasks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from updyn.web.settings import WEB_PAGE

__all__ = ["ValueChange", "watch"]

#: The event of a field whose value has changed.
ValueChange = events.ValueChangeEventArguments[Any]


def watch(version: Callable[[], object], refresh: Callable[[], object]) -> None:
    """Call `refresh` whenever the returned value has changed, also by another tab or a run.

    Call this before the value is shown, to detect later changes.
    """
    last = version()

    def check() -> None:
        nonlocal last
        now = version()
        if now != last:
            last = now
            refresh()

    ui.timer(WEB_PAGE.refresh_interval, check)
