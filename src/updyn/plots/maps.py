"""Maps of correlation: MAC of modes, FRAC of channels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from updyn.correlation import Correlation, ModeCorrelation, Subspace, auto_mac
from updyn.errors import OptionError, suggest
from updyn.modal import ModeSet
from updyn.plots.canvas import Canvas, WhichAxes, canvas, heat_map
from updyn.style import PAPER

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["frac", "mac"]

#: Size of a cell, and smallest and largest height of a map, in px.
_CELL, _LOWEST, _HIGHEST = 30, 280, 900
#: Criteria of `frac`: name, and whether the criterion is signed.
_CRITERIA = {"frac": ("FRAC", False), "frf_correlation": ("FRF correlation", True)}


def mac(found: ModeCorrelation | ModeSet, *, ax: WhichAxes | None = None) -> Figure:
    """Draw the MAC of computed and measured modes as a map, with paired modes framed.

    Close modes share one frame, labelled with their subspace MAC.

    Parameters
    ----------
    found : ModeCorrelation or ModeSet
        Result of `updyn.correlate`, or modes, for which the AutoMAC is drawn.
    ax : matplotlib.axes.Axes, optional
        Axes; None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or `found` is of another type.
    """
    subspaces: tuple[Subspace, ...] = ()
    if isinstance(found, ModeSet):
        values, names = auto_mac(found.shapes), (_format_frequencies(found.frequency),) * 2
        titles, title = ("mode (Hz)", "mode (Hz)"), "AutoMAC (–)"
        pairs = []
    elif isinstance(found, ModeCorrelation):
        values = found.mac
        names = (
            _format_frequencies(found.computed.frequency),
            _format_frequencies(found.measured.frequency),
        )
        titles, title = ("computed mode (Hz)", "measured mode (Hz)"), "MAC (–)"
        single = ~found.in_subspace
        which = found.pairs.first[single].tolist(), found.pairs.second[single].tolist()
        pairs, subspaces = list(zip(*which, strict=True)), found.subspaces
    else:
        raise OptionError(
            f"plots.mac: expected a ModeCorrelation or a ModeSet, found {type(found).__name__}"
        )
    with canvas(ax, {"map": 1.0}, _figure_size(values.shape)) as made:
        heat_map(made, values, names, title)
        _set_titles(made, titles)
        for row, column in pairs:
            _draw_frame(made, row, row, column, column)
        for one in subspaces:
            for block in one.blocks:
                _draw_frame(made, *block)
                _draw_label(made, block, f"{one.mac:.2f}")
    return made.figure


def frac(found: Correlation, *, criterion: str = "frac", ax: WhichAxes | None = None) -> Figure:
    """Draw the agreement of each channel as a map, responses down, references across.

    Parameters
    ----------
    found : Correlation
        Result of `updyn.correlate`.
    criterion : {"frac", "frf_correlation"}
        FRAC, from 0 to 1; or the FRF correlation, from -1 to 1, which depends also on sign and
        phase.
    ax : matplotlib.axes.Axes, optional
        Axes; None for a new figure.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    OptionError
        If matplotlib is not installed, or `found` or `criterion` cannot be used.
    """
    if not isinstance(found, Correlation):
        raise OptionError(f"plots.frac: expected a Correlation, found {type(found).__name__}")
    if criterion not in _CRITERIA:
        raise OptionError(f"criterion {criterion!r}: {suggest(str(criterion), _CRITERIA)}")
    title, signed = _CRITERIA[criterion]
    values = getattr(found, criterion)
    names = found.responses.labels, found.references.labels
    with canvas(ax, {"map": 1.0}, _figure_size(values.shape)) as made:
        heat_map(made, values, names, f"{title} (–)", signed=signed)
        _set_titles(made, ("response (node:direction)", "force (node:direction)"))
    return made.figure


def _format_frequencies(frequency: np.ndarray) -> list[str]:
    return [f"{f:.4g}" for f in frequency]


def _figure_size(shape: tuple[int, ...]) -> tuple[float, float]:
    """Return width and height in px of a figure for a map."""
    rows, columns = shape
    height = min(max(130 + _CELL * rows, _LOWEST), _HIGHEST)
    width = min(max(260 + 1.6 * _CELL * columns, 420), 1280)
    return width, height


def _set_titles(made: Canvas, titles: tuple[str, str]) -> None:
    made.first.set_ylabel(titles[0])
    made.first.set_xlabel(titles[1])


def _draw_frame(made: Canvas, top: int, bottom: int, left: int, right: int) -> None:
    x = np.array([left + 0.03, right + 0.97])[[0, 1, 1, 0, 0]]
    y = np.array([top + 0.03, bottom + 0.97])[[0, 0, 1, 1, 0]]
    made.first.plot(x, y, color=PAPER["before"], linewidth=1.6)


def _draw_label(made: Canvas, block: tuple[int, int, int, int], text: str) -> None:
    """Print the subspace MAC in the middle of its frame."""
    top, bottom, left, right = block
    made.first.text(
        0.5 * (left + right + 1),
        0.5 * (top + bottom + 1),
        text,
        color=PAPER["before"],
        fontsize=8,
        ha="center",
        va="center",
        bbox={"facecolor": PAPER["ground"], "edgecolor": PAPER["before"], "pad": 1.5},
    )
