"""Colours of groups by magnitude, such as standard deviation or share of strain energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import RealArray
from updyn.viewer.scene import Colouring

__all__ = ["by_size"]

#: Number of steps of the sequential colour map.
_STEPS = 8


def by_size(
    name: str,
    unit: str,
    values: ArrayLike,
    groups: Sequence[str],
    *,
    by_row: ArrayLike | None = None,
    logarithmic: bool = False,
) -> Colouring:
    """Return a colouring by nonnegative values, in eight steps.

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
        Whether the steps have equal ratios, from the smallest to the largest value; else equal
        differences, from 0.

    Returns
    -------
    Colouring
    """
    sizes = np.asarray(values, dtype=np.float64)
    rows = np.empty((0, len(groups))) if by_row is None else np.asarray(by_row, dtype=np.float64)
    every = np.concatenate([sizes, rows.ravel()])
    edges = _find_edges(every, logarithmic=logarithmic)
    steps = [(f"seq-{i}", f"up to {_format_value(edge)}") for i, edge in enumerate(edges[1:])]
    if np.isinf(every).any():
        steps.append(("same", "not determined"))

    def describe_sizes(sizes: RealArray) -> tuple[list[int], list[str]]:
        looks = [_describe_size(name, unit, size, edges) for size in sizes.tolist()]
        texts = [f"{group}{text}" for group, (_, text) in zip(groups, looks, strict=True)]
        return [step for step, _ in looks], texts

    of_group, texts = describe_sizes(sizes)
    return Colouring(name, unit, steps, of_group, texts, [describe_sizes(row) for row in rows])


def _find_edges(values: RealArray, *, logarithmic: bool) -> RealArray:
    """Return the step limits, shape (_STEPS + 1,); (2,) for zeros only, (0,) without values."""
    known = values[np.isfinite(values)]
    if not known.any():
        return np.zeros(2 if known.size else 0)
    low, high = float(known[known > 0.0].min()), float(known.max())
    if logarithmic and low < high:
        return np.geomspace(low, high, _STEPS + 1)
    return np.linspace(0.0, high, _STEPS + 1)


def _describe_size(name: str, unit: str, size: float, edges: RealArray) -> tuple[int, str]:
    if np.isnan(size):
        return -1, ""
    if np.isinf(size):
        return len(edges[1:]), f": {name.lower()} not determined"
    step = int(np.searchsorted(edges[1:-1], size))
    return step, f": {name.lower()} {_format_value(size)} {unit}".rstrip()


def _format_value(value: float) -> str:
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else text
