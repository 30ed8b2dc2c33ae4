"""What all figures of the report share: how arrays and labels are handed to plotly, and rows with names."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

__all__ = [
    "PRINTED_CELLS",
    "Figure",
    "categories",
    "colour_bar",
    "error_bars",
    "existing",
    "label",
    "labels",
    "log_step",
    "numbers",
    "rows_height",
]

#: ``{"data": ..., "layout": ..., "height": ...}`` of plain lists, ready for JSON.
Figure = dict[str, Any]

#: Heat maps with up to this many cells have their values printed.
PRINTED_CELLS = 150


def existing(made: Mapping[str, Figure | None]) -> dict[str, Figure]:
    """Return the figures that have something to show, by name."""
    return {name: figure for name, figure in made.items() if figure is not None}


def label(text: str) -> str:
    """Return `text` for plotly, which reads a small HTML in labels: shown as it is, never interpreted."""
    return html.escape(text, quote=False)


def labels(texts: Iterable[str]) -> list[str]:
    """Return each of `texts` as `label` does."""
    return [label(t) for t in texts]


def numbers(values: ArrayLike, *, packed: bool = True) -> Any:
    """Return an array for plotly: a list where short (None for what is not finite), else float32 as base64."""
    array = np.asarray(values, dtype=np.float64)
    if array.size <= 400 or not packed:
        listed = array.astype(object)
        listed[~np.isfinite(array)] = None
        return listed.tolist()
    text = base64.b64encode(np.ascontiguousarray(array, dtype="<f4").tobytes()).decode("ascii")
    out = {"dtype": "f4", "bdata": text}
    if array.ndim > 1:
        out["shape"] = ", ".join(map(str, array.shape))
    return out


def error_bars(minus: ArrayLike, plus: ArrayLike, colour: str) -> dict[str, Any]:
    """Return error bars along x, of different lengths either way."""
    return {
        "type": "data",
        "symmetric": False,
        "array": numbers(plus),
        "arrayminus": numbers(minus),
        "color": colour,
        "thickness": 1.6,
        "width": 4,
    }


def colour_bar(title: str, ticks: Sequence[float], height: int) -> dict[str, Any]:
    """Return a colour bar beside the top of a heat map, of a readable length however tall the map is."""
    return {
        "title": {"text": title, "side": "right"},
        "thickness": 12,
        "tickvals": list(ticks),
        "lenmode": "pixels",
        "len": min(max(height - 80, 110), 280),
        "y": 1.0,
        "yanchor": "top",
    }


def log_step(values: ArrayLike) -> int | str:
    """Return how to mark a log axis: at most ten whole decades where `values` span more than two, else 1, 2 and 5."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array) & (array > 0)]
    if not array.size or array.max() <= 100.0 * array.min():
        return "D2"
    return int(np.ceil(np.log10(array.max() / array.min()) / 10.0))


def rows_height(n: int, extra: int) -> int:
    """Return the height in pixels of a figure with `n` rows; rows get closer when there are many."""
    return int(extra + n * (34 if n <= 12 else 22 if n <= 40 else 14))


def categories(names: Sequence[str], title: str) -> dict[str, Any]:
    """Return an axis with one named place for each of `names`, counted from 0."""
    return {
        "title": {"text": title},
        "tickvals": list(range(len(names))),
        "ticktext": labels(names),
        "showgrid": False,
        "zeroline": False,
        "tickfont": {"size": 12 if len(names) <= 40 else 9},
    }
