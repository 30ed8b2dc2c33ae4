"""Colours of groups by magnitude or by change, on continuous scales with round ticks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.settings import FIGURES
from updyn.text_table import format_change
from updyn.viewer.scene import Colouring, Scale

__all__ = ["by_size", "scale_of_changes"]

#: Colours of magnitudes from small to large, and of changes from decrease to increase.
_SEQUENTIAL = tuple(f"seq-{step}" for step in range(8))
_DIVERGING = (
    *(f"less-{step}" for step in (4, 3, 2, 1)),
    *(f"more-{step}" for step in (1, 2, 3, 4)),
)


def by_size(
    name: str,
    unit: str,
    values: ArrayLike,
    groups: Sequence[str],
    *,
    by_row: ArrayLike | None = None,
    logarithmic: bool = False,
) -> Colouring:
    """Return a colouring by nonnegative values, on a continuous scale.

    Parameters
    ----------
    name, unit : str
        Name and unit of the values.
    values : array_like of float, shape (g,)
        Nonnegative values by group; nan for unknown, inf for undetermined.
    groups : sequence of str
        Names of the groups.
    by_row : array_like of float, shape (r, g), optional
        The values for each row of the modes of the scene.
    logarithmic : bool
        Whether the scale is logarithmic, from a round number below the smallest value on; else
        linear from 0. It ends at a round number.

    Returns
    -------
    Colouring
    """
    sizes = np.asarray(values, dtype=np.float64)
    rows = np.empty((0, len(groups))) if by_row is None else np.asarray(by_row, dtype=np.float64)
    every = np.concatenate([sizes, rows.ravel()])
    steps = [("same", "not determined")] if np.isinf(every).any() else []

    def describe_sizes(sizes: RealArray) -> tuple[list[int], list[str]]:
        texts = [_describe_size(name, unit, size) for size in sizes.tolist()]
        of_group = [0 if size == np.inf else -1 for size in sizes.tolist()]
        return of_group, [f"{group}{text}" for group, text in zip(groups, texts, strict=True)]

    scale = _find_scale(sizes, rows, every[np.isfinite(every)], logarithmic=logarithmic)
    of_group, texts = describe_sizes(sizes)
    return Colouring(
        name, unit, steps, of_group, texts, [describe_sizes(row) for row in rows], scale
    )


def scale_of_changes(factors: ArrayLike, reach: float) -> Scale:
    """Return the scale of factors on properties, even in their logarithm, with 1 in its middle.

    Parameters
    ----------
    factors : array_like of float, shape (g,)
        Positive factor of each group; nan for groups without a place on the scale.
    reach : float
        Logarithm of the factor at the end of the scale, positive.

    Returns
    -------
    Scale
    """

    def place(factor: float) -> float:
        return float(np.clip(0.5 + 0.5 * np.log(factor) / reach, 0.0, 1.0))

    low, high = float(np.expm1(-reach)), float(np.expm1(reach))
    sizes = _round_numbers(min(0.1 * high, 1.0 + low), high)
    losses = [size - 1.0 for size in sizes if size < 1.0]
    changes = [part for size in reversed(sizes) for part in (size, -size)] + losses[::-1]
    ticks = [(place(1.0 + c), format_change(1.0 + c)) for c in changes if low <= c <= high]
    of_group = [place(factor) for factor in np.asarray(factors).tolist()]
    return Scale(_DIVERGING, _spread_ticks([(0.5, "0 %"), *ticks]), of_group)


def _find_scale(
    sizes: RealArray, rows: RealArray, known: RealArray, *, logarithmic: bool
) -> Scale | None:
    """Return the scale of magnitudes; None if none is known."""
    if not known.size:
        return None
    positive = known[known > 0.0]
    if logarithmic and positive.size and positive.min() < positive.max():
        ends = _round_numbers(float(positive.min()), float(positive.max()), outward=True)
        numbers, span = ends, np.log(ends[-1] / ends[0])
    else:
        logarithmic = False
        numbers = _even_numbers(float(known.max()))
        span = numbers[-1] or 1.0

    def place(size: float) -> float:
        if not np.isfinite(size):
            return np.nan
        at = np.log(max(size, numbers[0]) / numbers[0]) if logarithmic else size
        return float(np.clip(at / span, 0.0, 1.0))

    first = [numbers[0], numbers[-1], *(n for n in numbers if np.log10(n or 1.0) % 1.0 == 0.0)]
    ticks = [(place(number), _format_value(number)) for number in dict.fromkeys(first + numbers)]
    of_rows = [[place(size) for size in row] for row in rows.tolist()]
    of_group = [place(size) for size in sizes.tolist()]
    return Scale(_SEQUENTIAL, _spread_ticks(ticks), of_group, of_rows)


def _even_numbers(high: float) -> list[float]:
    """Return up to six multiples of 1, 2 or 5 times a power of ten, from 0 to `high` or more."""
    if high == 0.0:
        return [0.0]
    step = _round_numbers(0.2 * high, high)[0]
    return [step * number for number in range(int(np.ceil(high / step * (1.0 - 1e-12))) + 1)]


def _round_numbers(low: float, high: float, *, outward: bool = False) -> list[float]:
    """Return 1, 2 and 5 times powers of ten from `low` to `high`; `outward`: that enclose both."""
    powers = range(int(np.floor(np.log10(low))) - 1, int(np.ceil(np.log10(high))) + 2)
    every = np.array([float(f"{digit}e{power}") for power in powers for digit in (1, 2, 5)])
    slack = 1e-12  # of the rounding of the limits
    first = np.searchsorted(every, low * (1.0 - slack))
    last = np.searchsorted(every, high * (1.0 + slack))
    if outward:
        first = np.searchsorted(every, low * (1.0 + slack)) - 1
        last = np.searchsorted(every, high * (1.0 - slack)) + 1
    return [float(number) for number in every[first:last]]


def _spread_ticks(ticks: Sequence[tuple[float, str]]) -> list[tuple[float, str]]:
    """Return the ticks in order, without those that are too close to one given before them."""
    kept: list[tuple[float, str]] = []
    for place, text in ticks:
        if all(abs(place - other) >= FIGURES.tick_distance for other, _ in kept):
            kept.append((place, text))
    return sorted(kept)


def _describe_size(name: str, unit: str, size: float) -> str:
    if np.isnan(size):
        return ""
    if np.isinf(size):
        return f": {name.lower()} not determined"
    return f": {name.lower()} {_format_value(size)} {unit}".rstrip()


def _format_value(value: float) -> str:
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else text
