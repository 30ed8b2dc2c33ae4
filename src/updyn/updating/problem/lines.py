"""Selection of frequency lines: all, a list, or the most informative (optimal design)."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import IndexArray, RealArray
from updyn.errors import OptionError, key_path, suggest
from updyn.updating.problem.noise import level_by_unit
from updyn.updating.problem.optimal_design import (
    AOptimal,
    DOptimal,
    exchange_items,
    initial_information,
    scale_information,
    select_greedily,
)
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import Record
from updyn.updating.problem.settings import LINE_DESIGN

__all__ = [
    "choose_lines",
    "find_unknowns",
    "restrict_to_lines",
    "select_a_optimal",
    "select_d_optimal",
]


def choose_lines(lines: str | ArrayLike | None, part: FRFPart) -> IndexArray:
    """Return the positions of the selected lines in the data of a part; None: all lines.

    ``"d-optimal:40"``: 40 lines for the smallest joint uncertainty of all unknowns;
    ``"a-optimal:40"``: for the smallest mean variance, ``"a-optimal:40:shaft.*"`` of some unknowns
    (globs, separated by commas). Else frequencies in Hz, each a line of the data.
    """
    frf = part.frf
    if lines is None:
        return np.arange(len(frf.freq))
    if isinstance(lines, str):
        found = re.fullmatch(r"([ad])-optimal:(\d+)(?::(.+))?", lines)
        if found is None or (found[1] == "d" and found[3]):
            raise OptionError(
                f"lines {lines!r}: expected 'd-optimal:N' or 'a-optimal:N' with a whole number N,"
                " after the latter a colon and names of unknowns where only some count, or"
                " frequencies in Hz",
                key=("lines",),
            )
        count = int(found[2])
        if not 1 <= count <= len(frf.freq):
            raise OptionError(
                f"lines {lines!r}: the data have {len(frf.freq)} lines to choose from; expected 1"
                f" to {len(frf.freq)} of them",
                key=("lines",),
            )
        if found[1] == "d":
            return select_d_optimal(part, count)
        wanted = None
        if found[3]:
            patterns = [pattern.strip() for pattern in found[3].split(",")]
            with key_path(otherwise=("lines",)):
                wanted = find_unknowns(
                    f"lines {lines!r}", patterns, part.coordinates.parameters.names
                )
        return select_a_optimal(part, count, wanted)
    if np.ndim(lines) == 0:  # a number of lines, more likely than one frequency
        raise OptionError(
            f"lines = {lines!r}: expected frequencies in Hz, in a list, or 'd-optimal:N' for the N"
            " lines that determine most",
            key=("lines",),
        )
    return frf.find_lines(lines)


def select_d_optimal(part: FRFPart, count: int) -> IndexArray:
    """Return positions of `count` lines selected by the determinant of the Fisher information."""
    # Relative noise with a floor of 1 % of the rms, as is typical of sensors; loss factors of at
    # least 0.02, so that a peak at a wrong frequency selects lines on its flanks. Greedy (Fedorov,
    # Theory of Optimal Experiments, 1972, chapter 3); few lines are then exchanged one for one,
    # because the first were selected when the information was nearly singular.
    return _select_by_information(
        part, f"d-optimal {count}", lambda information: _maximise_determinant(information, count)
    )


def select_a_optimal(part: FRFPart, count: int, wanted: Sequence[int] | None = None) -> IndexArray:
    """Return positions of `count` lines selected by the variance of the unknowns `wanted`."""
    # Greedy minimisation of the mean of their variances, relative to those with all lines
    # (Fedorov, Theory of Optimal Experiments, 1972, chapter 2), with the information of
    # `select_d_optimal`.
    at = list(range(part.n)) if wanted is None else list(wanted)
    return _select_by_information(
        part,
        f"a-optimal {count} {at}",
        lambda information: _minimise_variance(information, count, at),
    )


def find_unknowns(what: str, patterns: Sequence[str], known: Sequence[str]) -> list[int]:
    """Return the positions of the unknowns that match globs; raise if a glob matches none."""
    at: set[int] = set()
    for pattern in patterns:
        fits = [i for i, name in enumerate(known) if fnmatch.fnmatchcase(name, pattern)]
        if not fits:
            raise OptionError(f"{what}: no unknown {pattern!r}; {suggest(pattern, known)}")
        at.update(fits)
    return sorted(at)


def _select_by_information(
    part: FRFPart, kind: str, choose: Callable[[RealArray], IndexArray]
) -> IndexArray:
    """Select lines by the information of each line, shape (n_f, n, n)."""
    x = _design_point(part)
    floor = LINE_DESIGN.noise_floor * level_by_unit(part.frf)

    def compute() -> Record:
        items = [(x, floor, lines) for lines in part.partition()]
        return (choose(np.concatenate(list(part.map_lines(_information, items)))),)

    return part.recall("lines", x, compute, kind)[0]


def _maximise_determinant(information: RealArray, count: int) -> IndexArray:
    information, _ = scale_information(information)
    n = information.shape[1]
    chosen, total = select_greedily(information, initial_information(n), count, DOptimal())
    if count <= LINE_DESIGN.exchanged_ratio * n:
        chosen = exchange_items(information, total, chosen, DOptimal())
    return np.sort(np.array(chosen, dtype=np.intp))


def _minimise_variance(information: RealArray, count: int, wanted: list[int]) -> IndexArray:
    information, _ = scale_information(information)
    initial = initial_information(information.shape[1])
    criterion = AOptimal.of(initial + information.sum(axis=0), wanted)
    chosen, _ = select_greedily(information, initial, count, criterion)
    return np.sort(np.array(chosen, dtype=np.intp))


def _design_point(part: FRFPart) -> RealArray:
    coordinates = part.coordinates
    x = coordinates.start
    highest = coordinates.to_x(coordinates.parameters.upper)
    least = np.minimum(LINE_DESIGN.least_loss_factor, highest)
    return np.where(~coordinates.parameters.is_damping, x, np.maximum(x, least))


def _information(part: FRFPart, item: tuple[RealArray, RealArray, slice]) -> RealArray:
    """Return the Fisher information of each line of a block, shape (n_f, n, n)."""
    x, floor, lines = item
    block = part.block(x, lines)
    assert block.dH is not None
    weight = 1.0 / np.hypot(np.abs(block.H), floor)
    J = (block.dH * weight).reshape(part.n, len(block.H), -1).view(np.float64).swapaxes(0, 1)
    return np.asarray(J @ J.swapaxes(1, 2))


Lines = str | ArrayLike | None


def restrict_to_lines(part: FRFPart, lines: Lines) -> FRFPart:
    """Return the part restricted to selected lines."""
    at = choose_lines(lines, part)
    if len(at) == len(part.frf.freq):
        return part
    return replace(part, frf=part.frf.select(lines=part.frf.freq[at]))
