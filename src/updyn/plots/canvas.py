"""Figures and axes in the style of updyn, without pyplot and its global state."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from updyn import style
from updyn.arrays import RealArray
from updyn.errors import OptionError, suggest
from updyn.settings import FIGURES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

__all__ = [
    "LEVELS",
    "Canvas",
    "WhichAxes",
    "canvas",
    "colour_map",
    "grid_canvas",
    "heat_map",
    "legend_above",
    "legend_outside",
    "level_axis",
    "level_values",
    "log_axis",
    "name_rows",
    "phase_axis",
]

#: Axes of the caller: one, or one per panel.
WhichAxes = Any
#: Scales of magnitudes.
LEVELS = ("log", "dB", "linear")
#: Pixels per inch of a figure on screen.
_DPI = 100
#: Width in px of a legend letter and of the line sample with its margins.
_LETTER, _HANDLE = 6.6, 42.0


def _to_points(px: float) -> float:
    return px * 72.0 / _DPI


def _settings() -> Any:
    paper, small = style.PAPER, _to_points(style.FIGURE_TEXT - 1)
    return {
        "figure.dpi": _DPI,
        "figure.facecolor": paper["ground"],
        "font.size": _to_points(style.FIGURE_TEXT),
        "font.family": "DejaVu Sans",
        "text.color": paper["text"],
        "axes.labelcolor": paper["text"],
        "axes.labelsize": _to_points(style.FIGURE_TEXT),
        "axes.titlesize": _to_points(style.FIGURE_TEXT),
        "axes.titlelocation": "left",
        "axes.edgecolor": paper["faint"],
        "axes.facecolor": paper["ground"],
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "axes.xmargin": 0.01,
        "grid.color": paper["grid"],
        "grid.linewidth": 0.8,
        "lines.linewidth": 1.4,
        "xtick.color": paper["faint"],
        "ytick.color": paper["faint"],
        "xtick.labelcolor": paper["text"],
        "ytick.labelcolor": paper["text"],
        "xtick.labelsize": small,
        "ytick.labelsize": small,
        "legend.fontsize": small,
        "legend.frameon": False,
        "legend.handlelength": 2.4,
    }


@cache
def _figure_class() -> type[Figure]:
    """Return a matplotlib figure class with a notebook representation, which needs no pyplot."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise OptionError('figures need matplotlib: pip install "updyn[plots]"') from error

    class NotebookFigure(Figure):
        """A figure that displays itself in a notebook."""

        def _repr_png_(self) -> bytes:
            out = io.BytesIO()
            self.savefig(out, format="png")
            return out.getvalue()

    return NotebookFigure


@dataclass(frozen=True, slots=True, eq=False)
class Canvas:
    """A figure, whole even if the caller owns the axes, and its axes by panel, from the top."""

    figure: Figure
    axes: Mapping[str, Axes]

    @property
    def first(self) -> Axes:
        """The axes of the first panel."""
        return next(iter(self.axes.values()))


@contextmanager
def canvas(
    ax: WhichAxes | None,
    panels: Mapping[str, float],
    size: tuple[float, float],
    *,
    share_x: bool = True,
) -> Iterator[Canvas]:
    """Yield panels in one column, in a context with the style of updyn.

    `ax` are axes of the caller in the order of the panels, None for a new figure; only panels with
    axes are yielded. `panels` has relative heights, `size` is in px. An `OptionError` is raised
    without matplotlib, or if `ax` is not axes or has more axes than panels.
    """
    new_figure = _figure_class()
    import matplotlib

    with matplotlib.rc_context(_settings()):
        if ax is None:
            inches = (size[0] / _DPI, size[1] / _DPI)
            figure = new_figure(figsize=inches, layout="constrained")
            made = figure.subplots(
                len(panels), squeeze=False, height_ratios=list(panels.values()), sharex=share_x
            )
            yield Canvas(figure, dict(zip(panels, made[:, 0], strict=True)))
            return
        given = _check_axes(ax, tuple(panels))
        yield Canvas(_find_figure(given[0]), dict(zip(panels, given, strict=False)))


@contextmanager
def grid_canvas(
    ax: WhichAxes | None, names: Sequence[str], size: tuple[float, float], columns: int
) -> Iterator[Canvas]:
    """Yield panels in a grid, row by row, in a context with the style of updyn.

    `ax` has one axes object per panel, None for a new figure; `size` of a panel is in px. An
    `OptionError` is raised without matplotlib, or if `ax` has another number of axes.
    """
    new_figure = _figure_class()
    import matplotlib

    with matplotlib.rc_context(_settings()):
        if ax is not None:
            given = _check_axes(ax, names)
            if len(given) < len(names):
                raise OptionError(f"ax: {len(given)} axes for {len(names)} panels")
            yield Canvas(_find_figure(given[0]), dict(zip(names, given, strict=True)))
            return
        columns = min(columns, len(names))
        rows = -(-len(names) // columns)
        inches = (columns * size[0] / _DPI, rows * size[1] / _DPI)
        figure = new_figure(figsize=inches, layout="constrained")
        made = figure.subplots(rows, columns, squeeze=False).ravel()
        for unused in made[len(names) :]:
            unused.remove()
        yield Canvas(figure, dict(zip(names, made, strict=False)))


def _check_axes(ax: WhichAxes, panels: Sequence[str]) -> list[Axes]:
    from matplotlib.axes import Axes

    given = [ax] if isinstance(ax, Axes) else list(np.ravel(np.asarray(ax, dtype=object)))
    for one in given:
        if not isinstance(one, Axes):
            raise OptionError(
                f"ax: expected the axes of a matplotlib figure, found {type(one).__name__}"
            )
    if not 0 < len(given) <= len(panels):
        shown = ", ".join(panels)
        raise OptionError(f"ax: {len(given)} axes; the figure has {len(panels)} panels ({shown})")
    return given


def _find_figure(axes: Axes) -> Figure:
    figure = axes.get_figure(root=True)
    assert figure is not None
    return figure


# -- magnitude and phase ---------------------------------------------------------------------------
def level_values(values: ArrayLike, level: str) -> RealArray:
    """Return magnitudes on the scale `level` (dB relative to 1 unit); nan for a logarithm of zero.

    An `OptionError` is raised if `level` is not "log", "dB" or "linear".
    """
    if level not in LEVELS:
        raise OptionError(f"level {level!r}: {suggest(str(level), LEVELS)}")
    size = np.abs(np.asarray(values))
    if level == "linear":
        return np.asarray(size)
    positive = np.where(size > 0, size, np.nan)
    return np.asarray(20.0 * np.log10(positive) if level == "dB" else positive)


def level_axis(axes: Axes, name: str, unit: str, level: str) -> None:
    """Label the y axis of magnitudes with its unit, and set its scale."""
    if level == "log":
        log_axis(axes, "y")
    axes.set_ylabel(f"{name} (dB re 1 {unit})" if level == "dB" else f"{name} ({unit})")


def phase_axis(axes: Axes) -> None:
    """Label the y axis of phases from -180 to 180 degrees, with ticks every 90 degrees."""
    axes.set_ylabel("phase (°)")
    axes.set_ylim(-190.0, 190.0)
    axes.set_yticks([-180, -90, 0, 90, 180])


def log_axis(axes: Axes, which: str = "x") -> None:
    """Make the x or y axis logarithmic, with ticks at 1, 2 and 5 if it spans few decades."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.set(**{f"{which}scale": "log"})
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    if high < (500.0 if which == "x" else 50.0) * low:
        axis = axes.xaxis if which == "x" else axes.yaxis
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda at, _: f"{at:g}"))
        axis.set_minor_formatter(NullFormatter())


# -- names -----------------------------------------------------------------------------------------
def legend_above(axes: Axes, title: str = "") -> None:
    """Put a legend above the axes, in as many columns as fit, or the number of curves if many."""
    labels = list(map(str, axes.get_legend_handles_labels()[1]))
    if not labels:
        return
    if len(labels) > FIGURES.legend_entries:
        axes.set_title(f"{len(labels)} curves: {title}" if title else f"{len(labels)} curves")
        return
    width = axes.get_window_extent().width
    one = _HANDLE + _LETTER * max(map(len, labels))
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=max(1, min(len(labels), int(width // one))),
        borderaxespad=0.3,
        columnspacing=1.4,
        title=title or None,
        alignment="left",
    )


def legend_outside(made: Canvas) -> None:
    """Put the legend of the first panel above all panels; inside it for axes of the caller."""
    handles, labels = made.first.get_legend_handles_labels()
    if made.figure.get_layout_engine() is None or len(made.axes) < len(made.figure.axes):
        made.first.legend()
        return
    made.figure.legend(handles, labels, loc="outside upper left", ncols=len(labels))


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Label the rows of the y axis from top to bottom, in a smaller font for many rows."""
    size = _to_points(style.FIGURE_TEXT - 1 if len(names) <= 40 else 8)
    axes.set_yticks(range(len(names)), list(names), fontsize=size)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.grid(visible=False, axis="y")


# -- maps ------------------------------------------------------------------------------------------
def colour_map(stops: Sequence[str]) -> Colormap:
    """Return a colour map of `updyn.style` as a matplotlib colour map."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("updyn", list(stops)).with_extremes(
        bad=style.PAPER["panel"]
    )


def heat_map(
    found: Canvas,
    values: RealArray,
    names: tuple[Sequence[str], Sequence[str]],
    title: str,
    *,
    signed: bool = False,
    panel: str | None = None,
) -> None:
    """Draw a matrix as a colour map with a colour bar, first row at the top.

    Values are from 0 to 1, or from -1 to 1 if `signed`; nan is unknown. `names` are those of rows
    and columns, `title` that of the colour bar.
    """
    axes = found.first if panel is None else found.axes[panel]
    mesh = axes.pcolormesh(
        np.ma.masked_invalid(values),
        cmap=colour_map(style.DIVERGING if signed else style.SEQUENTIAL),
        vmin=-1.0 if signed else 0.0,
        vmax=1.0,
        edgecolors=style.PAPER["ground"],
        linewidth=0.8 if max(values.shape) <= 60 else 0.0,
    )
    axes.grid(visible=False)
    axes.set_ylim(len(values), 0)
    rows, columns = names
    for axis, texts in ((axes.yaxis, rows), (axes.xaxis, columns)):
        every = -(-len(texts) // 40)
        axis.set_ticks(np.arange(len(texts))[::every] + 0.5, list(texts)[::every])
        axis.set_tick_params(length=0)
    room = axes.get_window_extent().width / _LETTER
    if max(map(len, columns)) + 2 > room / len(columns):
        axes.tick_params(axis="x", rotation=90)
    if values.size <= FIGURES.printed_cells:
        _print_values(axes, values)
    bar = found.figure.colorbar(mesh, ax=axes, shrink=0.9, aspect=25)
    bar.set_label(title)
    bar.outline.set_visible(False)


def _print_values(axes: Axes, values: RealArray) -> None:
    """Print the values in the cells of a map, in a light colour on dark cells."""
    for (i, j), value in np.ndenumerate(values):
        if np.isfinite(value):
            text = f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")
            colour = style.PAPER["ground"] if abs(value) > 0.55 else style.PAPER["text"]
            axes.text(
                j + 0.5,
                i + 0.5,
                text,
                ha="center",
                va="center",
                color=colour,
                fontsize=_to_points(style.FIGURE_TEXT - 2),
            )
