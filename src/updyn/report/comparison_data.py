"""What the page of a comparison draws: one channel, measured, before, and after by each method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.comparison import Comparison, Row
from updyn.frf import FRF
from updyn.report.data import EVALUATION_BUDGET, computed, keep_lines
from updyn.updating.problem.data import Test
from updyn.updating.result import UpdateResult

__all__ = ["Curves", "gather_curves", "is_geometric"]

#: Points of a curve where the model is small enough for them.
_POINTS = 600
_FEWEST_POINTS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """One channel.

    Attributes
    ----------
    test, response, reference, quantity : str
        Which; the test has a name where there are several.
    lines : ndarray of float, shape (n_f,)
        Lines of the data, in Hz.
    measured : ndarray of complex, shape (n_f,)
        The data there.
    fitted : ndarray of bool, shape (n_f,)
        Which of these lines were used in the fits.
    freq : ndarray of float, shape (n,)
        Where the models were computed, in Hz.
    before : ndarray of complex, shape (n,)
        The start.
    after : mapping of str to ndarray of complex, shape (n,)
        By method; those that gave no answer are not there.
    misfit : float
        Median level difference of the start in this channel, in dB: the largest of all channels.
    notes : tuple of str
        What was left out or thinned.
    """

    test: str
    response: str
    reference: str
    quantity: str
    lines: NDArray[np.float64]
    measured: NDArray[np.complex128]
    fitted: NDArray[np.bool_]
    freq: NDArray[np.float64]
    before: NDArray[np.complex128]
    after: Mapping[str, NDArray[np.complex128]]
    misfit: float
    notes: tuple[str, ...]


def gather_curves(comparison: Comparison) -> Curves | None:
    """Compute the channel in which the start is furthest off; None where no model could be computed."""
    notes: list[str] = []
    worst: tuple[float, Test, int, int] | None = None
    for test in comparison.tests:
        seen = _thinned(test)
        answer = computed(test.model, seen, seen.freq, "start model", notes, _how(comparison, test))
        if answer is None:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            level = np.abs(20.0 * np.log10(np.abs(answer) / np.abs(seen.values)))
        off = np.median(np.where(np.isfinite(level), level, 0.0), axis=0)
        i, j = (int(k) for k in np.unravel_index(int(np.argmax(off)), off.shape))
        if worst is None or off[i, j] > worst[0]:
            worst = float(off[i, j]), test, i, j
    if worst is None:
        return None
    misfit, test, i, j = worst
    channel = test.frf.select(
        responses=test.frf.responses[np.array([i])], references=test.frf.references[np.array([j])]
    )
    channel = channel.select(lines=channel.freq[channel.freq > 0])
    freq = _grid(channel.freq, test.model.n_dofs)
    before = computed(test.model, channel, freq, "start model", notes, _how(comparison, test))
    if before is None:
        return None
    after = {}
    for row in comparison:
        result = _of_test(row, test)
        if result is None or row.status == "failed":
            continue
        values = computed(
            result.model, channel, freq, f"model of {row.method}", notes, result.options
        )
        if values is not None:
            after[row.method] = values[:, 0, 0]
    first = _first(comparison, test)
    used = (
        np.ones(len(channel.freq), dtype=np.bool_)
        if first is None
        else np.isin(channel.freq, first.lines)
    )
    return Curves(
        test.name,
        channel.responses.labels[0],
        channel.references.labels[0],
        channel.quantity,
        channel.freq,
        channel.values[:, 0, 0],
        used,
        freq,
        before[:, 0, 0],
        after,
        misfit,
        tuple(dict.fromkeys(notes)),
    )


def _thinned(test: Test) -> FRF:
    """Return the data at no more lines than are worth computing, 0 Hz left out."""
    frf = test.frf.select(lines=test.frf.freq[test.frf.freq > 0])
    limit = int(np.clip(EVALUATION_BUDGET // test.model.n_dofs, _FEWEST_POINTS, 1000))
    keep = keep_lines(frf.values, np.ones(len(frf.freq), dtype=np.bool_), limit)
    return frf.select(lines=frf.freq[keep])


def _grid(lines: NDArray[np.float64], n_dofs: int) -> NDArray[np.float64]:
    """Return where curves are computed: between the lines, too, where these are few and the model is small."""
    limit = int(np.clip(EVALUATION_BUDGET // n_dofs, _FEWEST_POINTS, 2 * _POINTS))
    if len(lines) > limit:
        at = np.linspace(0, len(lines) - 1, limit).round().astype(np.intp)
        return lines[np.unique(at)]
    if len(lines) < 2 or len(lines) + _POINTS > limit:
        return lines
    between = (np.geomspace if is_geometric(lines) else np.linspace)(lines[0], lines[-1], _POINTS)
    return np.union1d(lines, np.clip(between, lines[0], lines[-1]))


def is_geometric(lines: NDArray[np.float64]) -> bool:
    """Whether lines are spaced more evenly in the logarithm of frequency, over more than a decade."""
    if len(lines) < 3 or lines[-1] < 10.0 * lines[0]:
        return False
    spread = [
        float(np.std(step) / np.mean(step)) for step in (np.diff(lines), np.diff(np.log(lines)))
    ]
    return spread[1] < spread[0]


def _first(comparison: Comparison, test: Test) -> UpdateResult | None:
    return next((r for row in comparison if (r := _of_test(row, test)) is not None), None)


def _how(comparison: Comparison, test: Test) -> Mapping[str, Any]:
    """Return how the model was solved in the fits."""
    first = _first(comparison, test)
    return {} if first is None else first.options


def _of_test(row: Row, test: Test) -> UpdateResult | None:
    if row.result is None or isinstance(row.result, UpdateResult):
        return row.result
    return row.result.results.get(test.name)
