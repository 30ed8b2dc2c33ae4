"""Tiles that cover the band, each searched for modes.

Lines between candidates of the stabilisation diagram have tiles too, because a mode may have no
stable pole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.modal.measured import Measured, group_overlapping
from updyn.modal.search import search_window
from updyn.modal.settings import MODE_SEARCH, MODE_WINDOW

__all__ = ["search_band"]


@dataclass(frozen=True, slots=True)
class _Tile:
    """Lines searched together; `low` and `high`, in Hz, limit the frequencies of its modes."""

    candidates: slice
    lines: slice
    low: float
    high: float


def search_band(measured: Measured, candidates: ComplexArray) -> ComplexArray:
    """Return the poles that may be modes, from the stable poles of a diagram."""
    axis = measured.axis
    candidates = candidates[measured.is_inside(candidates)]
    candidates = candidates[np.argsort(axis.frequency(candidates), kind="stable")]
    found = np.zeros(0, dtype=np.complex128)
    for tile in _split_into_tiles(measured, candidates):
        tile_candidates, after = candidates[tile.candidates], candidates[tile.candidates.stop :]
        window = measured.window(tile.lines, np.concatenate([found, after]))
        most = max(1, (tile.lines.stop - tile.lines.start) // MODE_WINDOW.lines_per_mode)
        poles = search_window(
            window, tile_candidates, _make_trial_poles(measured, tile_candidates, tile), most
        ).poles
        at = axis.frequency(poles)
        # Extend the tile by half a line: an estimate at the edge may fall on the other side in the
        # next tile, which contains the poles found so far.
        edge = 0.5 * measured.spacing
        kept = measured.is_inside(poles) & (at >= tile.low - edge) & (at < tile.high + edge)
        found = np.concatenate([found, poles[kept]])
    return found[np.argsort(axis.frequency(found), kind="stable")]


def _split_into_tiles(measured: Measured, candidates: ComplexArray) -> Iterator[_Tile]:
    """Yield the tiles from the lowest line to the highest."""
    freq = measured.freq
    at = measured.axis.frequency(candidates)
    covered = 0
    for group in group_overlapping(at, measured.bandwidth(candidates)):
        lines = measured.lines_of(candidates[group])
        if lines.start > covered:
            yield from _tile_gap(freq, group.start, covered, lines.start)
            covered = lines.start
        end = lines.stop
        if group.stop < len(at):
            middle = 0.5 * (at[group.stop - 1] + at[group.stop])
            end = min(end, int(np.searchsorted(freq, middle)))
        end = max(end, covered)
        yield _Tile(group, lines, *_tile_limits(freq, covered, end))
        covered = end
    if covered < len(freq):
        yield from _tile_gap(freq, len(at), covered, len(freq))


def _tile_gap(freq: RealArray, next_candidate: int, first: int, last: int) -> Iterator[_Tile]:
    """Yield tiles of lines without candidates."""
    count = max(1, round((last - first) / MODE_SEARCH.tile_lines))
    edges = np.linspace(first, last, count + 1).astype(int)
    none, margin = slice(next_candidate, next_candidate), MODE_SEARCH.margin_lines
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        lines = slice(max(0, a - margin), min(len(freq), b + margin))
        yield _Tile(none, lines, *_tile_limits(freq, a, b))


def _tile_limits(freq: RealArray, first: int, last: int) -> tuple[float, float]:
    """Return the limits of some lines for the frequencies of their modes."""
    low = float(freq[first]) if first else 0.0
    return low, float(freq[last]) if last < len(freq) else np.inf


def _make_trial_poles(
    measured: Measured, tile_candidates: ComplexArray, tile: _Tile
) -> ComplexArray:
    axis, f = measured.axis, measured.freq[tile.lines]
    f = f[(f >= tile.low) & (f < tile.high)]
    if not len(f):
        return tile_candidates[:0]
    if len(tile_candidates):
        losses = [float(np.median(axis.loss(tile_candidates)))]
    else:
        losses = [width * measured.spacing / f[len(f) // 2] for width in MODE_SEARCH.trial_widths]
    trials = []
    for loss in losses:
        steps = (f[-1] - f[0]) / max(MODE_SEARCH.grid_step * loss * f[0], f[-1] * 1e-9)
        at = np.linspace(f[0], f[-1], int(np.clip(steps, 2, MODE_SEARCH.most_trials)))
        trials.append(axis.pole(at, float(np.clip(loss, 1e-6, MODE_SEARCH.largest_trial_loss))))
    return np.concatenate(trials)
