"""Numbers that limit what a report on a plant and a servo contains."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ControlReportSettings:
    """Largest numbers of curves, points and rows."""

    #: [channels] Largest number of plotted channels, those with the largest errors. Drawing: length
    #: of the page.
    plotted_channels: int = 6
    #: [members] Largest number of members of a family with separate curves. Drawing: size of the
    #: page.
    plotted_members: int = 40
    #: [points] Largest number of points of a loop function. Drawing: size of the page; more than
    #: the pixels of a figure.
    loop_points: int = 3000
    #: [points] Largest number of points of a time series. Drawing: size of the page; more than the
    #: pixels of a figure.
    series_points: int = 4000
    #: [rows] Largest number of poles and of antiresonances in a table. Drawing: length of the page.
    listed_poles: int = 60
    #: [rows] Largest number of channels in the table of errors. Drawing: length of the page.
    listed_channels: int = 40
    #: [1] Distance of a line from an antiresonance, relative to its frequency, within which its
    #: error is said to be at the antiresonance. Drawing: about the width of those of structures.
    antiresonance_distance: float = 0.03
    #: [items] Largest number of crossings of a loop, and of unstable members, in a list. Drawing:
    #: length of the page.
    listed_items: int = 12


CONTROL_REPORT = ControlReportSettings()
