"""HTML of objects in a notebook: small tables and pictures without scripts.

It stays in an exported notebook, needs no network, and escapes every text, as labels come from
files. Pictures have a light background.
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.registry import Registry
from updyn.settings import MESSAGES, NOTEBOOK
from updyn.style import FIGURE_TEXT, PAPER, SPACES, category

__all__ = [
    "VIEWERS",
    "PlotCurve",
    "badge",
    "card",
    "curves",
    "render_view",
    "spans",
    "structure",
    "table",
]

#: Interactive views by class of object, such as ``"Model"``: functions from the object to HTML, or
#: None if it has no interactive view.
VIEWERS: Registry[Callable[[object], str | None]] = Registry(
    "notebook viewer",
    "updyn.notebook_viewers",
    {"Model": "updyn.viewer.notebook:model_frame"},
)


#: Size of a picture in px, and its margins: left, right, top, bottom.
_WIDTH, _HEIGHT = 620, 210
_LEFT, _RIGHT, _ABOVE, _BELOW = 62, 12, 24, 36
#: View direction of the picture of a structure: azimuth and elevation in degrees.
_EYE = 38.0, 24.0


# -- text ------------------------------------------------------------------------------------------
def card(title: str, facts: Mapping[str, object], *parts: str) -> str:
    """Return an object as HTML: title, a line of facts, and HTML parts; empty ones are skipped."""
    shown = []
    for name, value in facts.items():
        if str(value):
            shown.append(f"{html.escape(name)} <b>{html.escape(str(value))}</b>")
    lines = [f"<div><b>{html.escape(title)}</b></div>"]
    if shown:
        lines.append(f"<div>{' · '.join(shown)}</div>")
    gap = f'<div style="margin-top:{SPACES["narrow"]}px">'
    lines += [f"{gap}{part}</div>" for part in parts if part]
    return f'<div class="updyn">{"".join(lines)}</div>'


def badge(text: str, kind: str) -> str:
    """Return HTML of a word on a background whose colour shows its kind: good, warn or bad."""
    look = f"color:{PAPER[kind]};background:{PAPER[f'{kind}-ground']}"
    return (
        f'<span style="{look};border:1px solid;border-radius:999px;padding:1px 10px;'
        f'font-weight:600">{html.escape(text)}</span>'
    )


def table(header: Sequence[str], rows: Sequence[Sequence[str]], left: Iterable[int] = (0,)) -> str:
    """Return a table as HTML; for many rows, the first ones and the number of the others."""
    if not rows:
        return ""
    chosen = set(left)
    lines = [_row("th", header, chosen)]
    lines += [_row("td", row, chosen) for row in rows[: NOTEBOOK.most_rows]]
    hidden = len(rows) - NOTEBOOK.most_rows
    if hidden > 0:
        lines.append(f'<tr><td colspan="{len(header)}">... and {hidden} more</td></tr>')
    look = f"border-collapse:collapse;font-size:{FIGURE_TEXT}px;line-height:1.3"
    return f'<table style="{look}">{"".join(lines)}</table>'


def _row(kind: str, cells: Sequence[str], left: set[int]) -> str:
    shown = []
    for i, cell in enumerate(cells):
        side = "left" if i in left else "right"
        look = f"text-align:{side};padding:2px {SPACES['normal']}px 2px 0"
        shown.append(f'<{kind} style="{look}">{html.escape(cell)}</{kind}>')
    return f"<tr>{''.join(shown)}</tr>"


def render_view(shown: object, otherwise: Callable[[], str]) -> str:
    """Return the view in `VIEWERS` for an object's class, else the picture by `otherwise`."""
    name = type(shown).__name__
    view = VIEWERS[name](shown) if name in VIEWERS else None
    return otherwise() if view is None else view


# -- curves ----------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class PlotCurve:
    """A curve of a picture with its name in the legend; values that are not finite leave gaps."""

    name: str
    y: ArrayLike


def curves(
    x: ArrayLike,
    shown: Sequence[PlotCurve],
    titles: tuple[str, str],
    *,
    log_x: bool = False,
    log_y: bool = True,
    stems: bool = False,
) -> str:
    """Return an SVG of curves (or stems) over a common ascending axis; empty without curves."""
    at = _on_axis(x, log_x)
    heights = [_on_axis(curve.y, log_y) for curve in shown]
    every = np.concatenate([h[np.isfinite(at)] for h in heights]) if heights else np.zeros(0)
    every = every[np.isfinite(every)]
    positions = at[np.isfinite(at)]
    if not every.size or not positions.size:
        return ""
    low = float(every.min())
    if stems:
        low = 0.0
    across = _Axis.of(float(positions.min()), float(positions.max()), _LEFT, _WIDTH - _RIGHT, log_x)
    up = _Axis.of(low, float(every.max()), _HEIGHT - _BELOW, _ABOVE, log_y)
    parts = [_frame(across, up, titles)]
    for number, (curve, height) in enumerate(zip(shown, heights, strict=True)):
        colour, dash = category(number)
        draw = _stems if stems else _path
        line = f'<path d="{draw(across(at), up(height), up(low))}" fill="none" stroke="{colour}"'
        dashes = {"-": "", "--": "6 3", "-.": "7 3 2 3", ":": "2 3"}[dash]
        parts.append(
            f'{line} stroke-width="{2 if stems else 1.4}" stroke-dasharray="{dashes}">'
            f"<title>{html.escape(curve.name)}</title></path>"
        )
    if len(shown) > 1:
        parts.append(_legend([curve.name for curve in shown]))
    return _svg(parts, _HEIGHT)


def _on_axis(values: ArrayLike, logarithmic: bool) -> RealArray:
    array = np.asarray(values, dtype=np.float64)
    if logarithmic:
        array = np.log10(np.where(array > 0, array, np.nan))
    return array


@dataclass(frozen=True, slots=True)
class _Axis:
    """Map from values (on a logarithmic axis: their logarithms) to px, with tick marks."""

    low: float
    high: float
    first: float
    last: float
    logarithmic: bool

    @classmethod
    def of(cls, low: float, high: float, first: float, last: float, log: bool) -> _Axis:
        """Return an axis with a margin above and below the values."""
        room = 0.03 * (high - low) or 0.05 * abs(high) or 1.0
        return cls(low - room * (low != 0.0 or log), high + room, first, last, log)

    def __call__(self, values: ArrayLike) -> RealArray:
        share = (np.asarray(values, dtype=np.float64) - self.low) / (self.high - self.low)
        return np.asarray(self.first + share * (self.last - self.first))

    def marks(self) -> list[tuple[float, str]]:
        """Return positions in px and labels of the tick marks."""
        if self.logarithmic and self.high - self.low > 1.5:
            every = max(1, math.ceil((self.high - self.low) / 5.0))
            values = np.arange(math.ceil(self.low), math.floor(self.high) + 1, every)
            texts = [f"{10.0**v:g}" if abs(v) < 4 else f"1e{v:.0f}" for v in values.tolist()]
            return list(zip(self(values).tolist(), texts, strict=True))
        low, high = self.low, self.high
        if self.logarithmic:
            low, high = 10.0**low, 10.0**high
        if self.logarithmic and high > 5.0 * low:
            powers = 10.0 ** np.arange(math.floor(self.low), math.ceil(self.high) + 1)
            some = np.outer(powers, (1.0, 2.0, 5.0)).ravel()
            some = some[(some >= low) & (some <= high)]
            places = self(np.log10(some))
            return list(zip(places.tolist(), [f"{v:g}" for v in some.tolist()], strict=True))
        rough = (high - low) / 5.0
        unit = 10.0 ** math.floor(math.log10(rough))
        step = unit * next(s for s in (1, 2, 5, 10) if s * unit >= rough)
        round_ = step * np.arange(math.ceil(low / step), math.floor(high / step) + 1)
        places = self(np.log10(round_)) if self.logarithmic else self(round_)
        return list(zip(places.tolist(), [f"{v:.4g}" for v in round_.tolist()], strict=True))


def _frame(across: _Axis, up: _Axis, titles: tuple[str, str]) -> str:
    """Return grid, tick marks and titles of the axes."""
    bottom, right = _HEIGHT - _BELOW, _WIDTH - _RIGHT
    parts = []
    for place, text in across.marks():
        parts.append(_line(place, _ABOVE, place, bottom))
        parts.append(_text(place, bottom + 14, text, "middle"))
    for place, text in up.marks():
        parts.append(_line(_LEFT, place, right, place))
        parts.append(_text(_LEFT - 6, place + 4, text, "end"))
    parts.append(_text(right, _HEIGHT - 5, titles[0], "end"))
    parts.append(_text(4, 14, titles[1], "start"))
    return "".join(parts)


def _line(x1: float, y1: float, x2: float, y2: float, role: str = "grid") -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{PAPER[role]}"/>'


def _text(x: float, y: float, text: str, anchor: str, role: str = "text") -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{PAPER[role]}">'
        f"{html.escape(text)}</text>"
    )


def _legend(names: Sequence[str]) -> str:
    """Return the names of the curves in their colours, for the upper right corner."""
    spans = []
    most = MESSAGES.listed_items
    for number, name in enumerate(names[:most]):
        colour, _ = category(number)
        spans.append(f'<tspan dx="10" fill="{colour}">{html.escape(name)}</tspan>')
    if len(names) > most:
        spans.append(f'<tspan dx="10">... {len(names) - most} more</tspan>')
    return f'<text x="{_WIDTH - _RIGHT}" y="14" text-anchor="end">{"".join(spans)}</text>'


def _path(x: RealArray, y: RealArray, _floor: RealArray) -> str:
    """Return a curve; of many points only the minimum and maximum of each bin, to keep peaks."""
    if len(x) > 2 * NOTEBOOK.curve_bins:
        edges = np.linspace(0, len(x), NOTEBOOK.curve_bins + 1).round().astype(np.intp)
        chosen: list[int] = []
        for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            part = y[a:b]
            if np.isfinite(part).any():
                chosen += sorted({a + int(np.nanargmin(part)), a + int(np.nanargmax(part))})
        x, y = x[chosen], y[chosen]
    parts, pen = [], "M"
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if math.isfinite(px) and math.isfinite(py):
            parts.append(f"{pen}{px:.1f} {py:.1f}")
            pen = "L"
        else:
            pen = "M"
    return "".join(parts)


def _stems(x: RealArray, y: RealArray, floor: RealArray) -> str:
    known = np.isfinite(x) & np.isfinite(y)
    stems = zip(x[known].tolist(), y[known].tolist(), strict=True)
    return "".join(f"M{px:.1f} {float(floor):.1f}V{py:.1f}" for px, py in stems)


def _svg(parts: Sequence[str], height: float) -> str:
    look = "max-width:100%;height:auto;font-family:system-ui,sans-serif"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height:.0f}"'
        f' width="{_WIDTH}" style="{look};font-size:{FIGURE_TEXT - 2}px">'
        f'<rect width="100%" height="100%" fill="{PAPER["ground"]}"/>{"".join(parts)}</svg>'
    )


# -- intervals -------------------------------------------------------------------------------------
def spans(rows: Sequence[tuple[str, float, float, float]], title: str) -> str:
    """Return an SVG of values (name, low, value, high) with intervals; of many, the first ones."""
    drawn = [row for row in rows if math.isfinite(row[2])][: NOTEBOOK.most_rows]
    if not drawn:
        return ""
    numbers = np.array([row[1:] for row in drawn], dtype=np.float64)
    known = np.append(numbers[np.isfinite(numbers)], 0.0)
    wide = max(6.2 * max(len(row[0]) for row in drawn) + 16, _LEFT)
    left = min(wide, 0.45 * _WIDTH)
    across = _Axis.of(float(known.min()), float(known.max()), left, _WIDTH - _RIGHT, log=False)
    bottom = 10 + 18 * len(drawn)
    parts = []
    for place, text in across.marks():
        parts.append(_line(place, 6, place, bottom))
        parts.append(_text(place, bottom + 14, text, "middle"))
    zero = float(across(0.0))
    parts.append(_line(zero, 6, zero, bottom, "text"))
    for number, (name, low, value, high) in enumerate(drawn):
        y = 18 + 18 * number
        parts.append(_text(left - 8, y + 4, name, "end"))
        role = "muted"
        if math.isfinite(low) and math.isfinite(high):
            role = "after"
            ends = across([low, high]).tolist()
            parts.append(_line(ends[0], y, ends[1], y, role))
        place = float(across(value))
        parts.append(f'<circle cx="{place:.1f}" cy="{y}" r="3.5" fill="{PAPER[role]}"/>')
    parts.append(_text(_WIDTH - _RIGHT, bottom + 30, title, "end"))
    return _svg(parts, bottom + 36)


# -- structure -------------------------------------------------------------------------------------
def structure(xyz: ArrayLike, ends: ArrayLike) -> str:
    """Return an SVG of nodes (n, 3) in m and lines between them (m, 2), from a fixed direction.

    If there are more than 3000 lines or nodes, an evenly spaced subset is drawn, with a note.
    """
    points, pairs = np.asarray(xyz, dtype=np.float64), np.asarray(ends, dtype=np.intp)
    if not len(points):
        return ""
    azimuth, elevation = np.radians(_EYE)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    eye = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    flat = points @ np.array([right, np.cross(eye, right)]).T
    low, high = flat.min(axis=0), flat.max(axis=0)
    margin = 18.0
    size = np.maximum(high - low, 1e-9 * max(float(np.ptp(flat)), 1e-300))
    height = float(np.clip(size[1] / size[0] * _WIDTH, 70.0, 280.0))
    free = np.array([_WIDTH, height]) - 2 * margin
    scale = float(np.min(free / size))
    at = (flat - (low + high) / 2) * scale * [1.0, -1.0] + [_WIDTH / 2, height / 2]
    items = len(pairs) if len(pairs) else len(points)
    every = -(-items // NOTEBOOK.structure_lines)
    what = "line" if len(pairs) else "node"
    if len(pairs):
        lines = at[pairs[::every]].reshape(-1, 4).tolist()
        d = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {e:.1f}" for a, b, c, e in lines)
    else:
        d = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in at[::every].tolist())
    wide = 1.1 if len(pairs) else 4.0
    parts = [
        f'<path d="{d}" fill="none" stroke="{PAPER["after"]}" stroke-width="{wide}"'
        ' stroke-linecap="round"/>'
    ]
    if every > 1:
        parts.append(_text(_WIDTH - 6, height - 6, f"one of {every} {what}s", "end", "muted"))
    return _svg(parts, height)
