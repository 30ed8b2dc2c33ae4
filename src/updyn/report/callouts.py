"""Sensors and forces in a picture: arrows where they are, labels beside it with lines that lead to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.dofs import DIRECTIONS
from updyn.report import markup as m

__all__ = ["Callout", "callouts", "spread"]

_LINE = 16.0  # between labels
_FLAT = 0.15  # an arrow shorter than this points at the eye: it is drawn as a dot


@dataclass(frozen=True, slots=True, eq=False)
class Callout:
    """What is measured and driven at one node.

    Parameters
    ----------
    node : int
        Its number.
    xyz : ndarray of float, shape (3,)
        Its position, in m.
    axes : ndarray of float, shape (3, 3)
        Its X, Y and Z as rows, in global components.
    sensors, forces : tuple of str
        Directions, with ``-`` where a sensor points the other way.
    """

    node: int
    xyz: NDArray[np.float64]
    axes: NDArray[np.float64]
    sensors: tuple[str, ...]
    forces: tuple[str, ...]

    @property
    def text(self) -> str:
        """The label: node, sensors, forces."""
        said = ", ".join(self.sensors)
        driven = f"force {', '.join(self.forces)}" if self.forces else ""
        return f"{self.node}: " + " · ".join(part for part in (said, driven) if part)


def callouts(
    items: Sequence[Callout],
    at: NDArray[np.float64],
    axes: Sequence[NDArray[np.float64]],
    length: float,
    size: tuple[float, float],
    side: float | None,
) -> str:
    """Return arrows and labels as SVG.

    Parameters
    ----------
    items : sequence of Callout
        What to draw.
    at : ndarray of float, shape (n, 2)
        Where in the picture.
    axes : sequence of ndarray of float, shape (3, 3)
        For each, X, Y and Z as rows in the axes of the picture (right, down, depth).
    length : float
        Of an arrow that lies in the plane of the picture.
    size : (float, float)
        Width and height of the picture.
    side : float or None
        Width of the columns of labels, left and right; None: no labels.

    Returns
    -------
    str
        SVG elements. Where there are more labels than fit, none is drawn: the arrows have titles.
    """
    out = []
    for item, place, directions in zip(items, at, axes, strict=True):
        arrows = [_arrow(place, d, directions, length, "sensor") for d in item.sensors]
        arrows += [_arrow(place, d, directions, 1.25 * length, "force") for d in item.forces]
        dot = f'<circle class="sensor" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="2.4"/>'
        out.append(f"<g><title>{m.esc(item.text)}</title>{dot}{''.join(arrows)}</g>")
    if side is not None and items:
        out.append(_labels(items, at, size, side))
    return "".join(out)


def _arrow(
    place: NDArray[np.float64], direction: str, axes: NDArray[np.float64], length: float, kind: str
) -> str:
    number = DIRECTIONS.index(direction.lstrip("-"))
    vector = axes[number % 3][:2] * (-1.0 if direction.startswith("-") else 1.0)
    seen = float(np.hypot(*vector))
    if seen < _FLAT:
        return f'<circle class="{kind} head" cx="{place[0]:.1f}" cy="{place[1]:.1f}" r="4"/>'
    along = vector / seen
    across = np.array([-along[1], along[0]])
    tip = place + length * vector
    # A force ends where it acts.
    tail, tip = (place, tip) if kind == "sensor" else (place - (tip - place), place)
    wide = 4.0 if kind == "force" else 3.0
    heads = []
    for back in (0.0, 7.0)[: 2 if number >= 3 else 1]:
        point = tip - back * along
        left, right = point - 9.0 * along + wide * across, point - 9.0 * along - wide * across
        line = (
            f"M{left[0]:.1f} {left[1]:.1f}L{point[0]:.1f} {point[1]:.1f}L{right[0]:.1f}"
            f" {right[1]:.1f}"
        )
        heads.append(f'<path class="{kind} head" d="{line}{"Z" if kind == "force" else ""}"/>')
    shaft = f'<path class="{kind}" d="M{tail[0]:.1f} {tail[1]:.1f}L{tip[0]:.1f} {tip[1]:.1f}"/>'
    return shaft + "".join(heads)


def _labels(
    items: Sequence[Callout], at: NDArray[np.float64], size: tuple[float, float], side: float
) -> str:
    """Return labels in two columns, each beside the half of the picture that it belongs to."""
    by_x = np.argsort(at[:, 0], kind="stable")
    half = (len(items) + 1) // 2
    if half * _LINE > size[1] - 2 * _LINE:
        return ""
    out = []
    for column, chosen in (("end", by_x[:half]), ("start", by_x[half:])):
        ordered = chosen[np.argsort(at[chosen, 1], kind="stable")]
        heights = spread(
            at[ordered, 1], _LINE, _LINE, size[1] - (5 * _LINE if column == "end" else _LINE)
        )
        x = side if column == "end" else size[0] - side
        away = -4.0 if column == "end" else 4.0
        for i, y in zip(ordered.tolist(), heights.tolist(), strict=True):
            kind = "label force" if items[i].forces else "label"
            out.append(
                f'<path class="leader" d="M{x:.1f} {y:.1f}L{at[i, 0]:.1f} {at[i, 1]:.1f}"/>'
                f'<text class="{kind}" x="{x + away:.1f}" y="{y + 4.0:.1f}" text-anchor="{column}">'
                f"{m.esc(items[i].text)}</text>"
            )
    return "".join(out)


def spread(wanted: NDArray[np.float64], gap: float, low: float, high: float) -> NDArray[np.float64]:
    """Return heights at least `gap` apart, between `low` and `high`, near those wanted.

    Parameters
    ----------
    wanted : ndarray of float, shape (n,)
        Ascending.
    gap, low, high : float
        Smallest distance, and the limits; ``(n - 1) gap`` fits between them.

    Returns
    -------
    ndarray of float, shape (n,)
        Ascending: pushed down where crowded, then up from the lower limit.
    """
    out = np.clip(np.asarray(wanted, dtype=np.float64), low, high)
    for i in range(1, len(out)):
        out[i] = max(out[i], out[i - 1] + gap)
    for i in range(len(out) - 1, -1, -1):
        out[i] = min(out[i], high if i == len(out) - 1 else out[i + 1] - gap)
    return out
