"""Colours of groups by a size: standard deviation, share of strain energy."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.viewer.scene import Colouring

__all__ = ["by_size"]

#: Steps of the sequential map.
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
    """Return a colouring by sizes of one sign, in eight steps.

    Parameters
    ----------
    name, unit : str
        What they are.
    values : array_like of float, shape (g,)
        By group, at least 0; nan: not known; inf: not determined.
    groups : sequence of str
        Names of the groups.
    by_row : array_like of float, shape (r, g), optional
        The same for each row of the modes of the scene.
    logarithmic : bool
        Whether steps are of equal ratio, from the least value to the largest; else of equal
        difference, from 0.

    Returns
    -------
    Colouring
    """
    sizes = np.asarray(values, dtype=np.float64)
    rows = np.empty((0, len(groups))) if by_row is None else np.asarray(by_row, dtype=np.float64)
    every = np.concatenate([sizes, rows.ravel()])
    edges = _edges(every, logarithmic=logarithmic)
    steps = [(f"seq-{i}", f"up to {_written(edge)}") for i, edge in enumerate(edges[1:])]
    if np.isinf(every).any():
        steps.append(("same", "not determined"))

    def shown(sizes: NDArray[np.float64]) -> tuple[list[int], list[str]]:
        looks = [_look(name, unit, size, edges) for size in sizes.tolist()]
        said = [f"{group}{text}" for group, (_, text) in zip(groups, looks, strict=True)]
        return [step for step, _ in looks], said

    of_group, texts = shown(sizes)
    return Colouring(name, unit, steps, of_group, texts, [shown(row) for row in rows])


def _edges(values: NDArray[np.float64], *, logarithmic: bool) -> NDArray[np.float64]:
    """Return the limits of the steps, shape (_STEPS + 1,); of zeros alone (2,), of nothing (0,)."""
    known = values[np.isfinite(values)]
    if not known.any():
        return np.zeros(2 if known.size else 0)
    low, high = float(known[known > 0.0].min()), float(known.max())
    if logarithmic and low < high:
        return np.geomspace(low, high, _STEPS + 1)
    return np.linspace(0.0, high, _STEPS + 1)


def _look(name: str, unit: str, size: float, edges: NDArray[np.float64]) -> tuple[int, str]:
    """Return the step of a size and what is said of it."""
    if np.isnan(size):
        return -1, ""
    if np.isinf(size):
        return len(edges[1:]), f": {name.lower()} not determined"
    step = int(np.searchsorted(edges[1:-1], size))
    return step, f": {name.lower()} {_written(size)} {unit}".rstrip()


def _written(value: float) -> str:
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else text
