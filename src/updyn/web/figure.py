"""`FigureView`: a figure of the report on a page of the window."""

from __future__ import annotations

from collections.abc import Callable

from nicegui.element import Element

from updyn.report.plots import Figure

__all__ = ["FigureView"]


class FigureView(Element, component="figure.js"):
    """A figure of the report.

    If it is pickable, `on_pick` is called with the lowest and the highest selected frequency in Hz.
    `on_row` is called with the number of a clicked row of a map.
    """

    def __init__(
        self,
        figure: Figure,
        on_pick: Callable[[float, float], object] = lambda *_: None,
        on_row: Callable[[int], object] = lambda _: None,
    ) -> None:
        super().__init__()
        self.draw(figure)
        self.on("pick", lambda event: on_pick(*sorted(map(float, event.args))))
        self.on("row", lambda event: on_row(int(event.args)))

    def draw(self, figure: Figure) -> None:
        """Show another figure in the place of the present one."""
        self._props["figure"] = figure
