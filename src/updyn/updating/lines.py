"""Choosing lines: all, a list, or the ones that tell most about the unknowns."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.errors import OptionError
from updyn.updating.noise import level_by_unit
from updyn.updating.problem import Problem
from updyn.updating.session import Record

__all__ = ["choose_lines", "d_optimal"]

_RELATIVE_FLOOR = 1e-2


def choose_lines(lines: str | ArrayLike | None, problem: Problem) -> NDArray[np.intp]:
    """Return the positions of the lines to use in the problem's data.

    Parameters
    ----------
    lines : None, str or array_like of float
        None: all. ``"d-optimal:40"``: the 40 that tell most. Else frequencies in Hz, each a line of the data.
    problem : Problem
        Built on all lines.

    Raises
    ------
    OptionError
        If the text is not understood or asks for more lines than there are.
    DataError
        If a frequency is not a line of the data.
    """
    frf = problem.frf
    if lines is None:
        return np.arange(len(frf.freq))
    if isinstance(lines, str):
        found = re.fullmatch(r"d-optimal:(\d+)", lines)
        if found is None:
            raise OptionError(f"lines {lines!r}: expected 'd-optimal:N' with a whole number N, or frequencies in Hz")
        count = int(found[1])
        if not 1 <= count <= len(frf.freq):
            raise OptionError(f"lines {lines!r}: the data have {len(frf.freq)} lines to choose from")
        return d_optimal(problem, count)
    return frf.find_lines(lines)


def d_optimal(problem: Problem, count: int) -> NDArray[np.intp]:
    """Choose lines one by one, each the one that raises the determinant of the Fisher information most.

    The information is taken at the start of the unknowns, for noise that is relative with a floor of 1 % of the rms of
    all data of the same unit, as sensors have. Loss factors are taken as at least 0.02 there, so that a peak that is
    not yet in its place still draws lines to its flanks.

    Parameters
    ----------
    problem : Problem
        Built on all lines.
    count : int
        How many lines to choose.

    Returns
    -------
    ndarray of int, shape (count,)
        Positions, ascending.

    Notes
    -----
    Greedy maximisation of log det (Fedorov, Theory of Optimal Experiments, 1972, chapter 3).
    """
    x = _start(problem)
    floor = _RELATIVE_FLOOR * level_by_unit(problem.frf)

    def compute() -> Record:
        items = [(x, floor, lines) for lines in problem.partition()]
        return (_most_telling(np.concatenate(list(problem.each(_information, items))), count),)

    return problem.recall("d-optimal", x, compute, str(count))[0]


def _most_telling(information: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    n = information.shape[1]
    scale = np.sqrt(np.maximum(np.einsum("fpp->p", information), np.finfo(float).tiny))
    information = information / scale[:, None] / scale
    total = 1e-9 * np.eye(n)
    chosen: list[int] = []
    left = np.ones(len(information), dtype=np.bool_)
    for _ in range(count):
        gain = np.linalg.slogdet(total + information)[1]
        gain[~left] = -np.inf
        best = int(np.argmax(gain))
        chosen.append(best)
        left[best] = False
        total = total + information[best]
    return np.sort(np.array(chosen, dtype=np.intp))


def _start(problem: Problem) -> NDArray[np.float64]:
    coordinates = problem.coordinates
    x = coordinates.to_x(coordinates.parameters.start)
    highest = coordinates.to_x(coordinates.parameters.upper)
    return np.where(coordinates.parameters.is_factor, x, np.maximum(x, np.minimum(0.02, highest)))


def _information(problem: Problem, item: tuple[NDArray[np.float64], NDArray[np.float64], slice]) -> NDArray[np.float64]:
    """Return the Fisher information of each line of a block, shape (n_f, n, n)."""
    x, floor, lines = item
    block = problem.block(x, lines)
    assert block.dH is not None
    weight = 1.0 / np.hypot(np.abs(block.H), floor)
    J = (block.dH * weight).reshape(problem.n, len(block.H), -1)
    return np.asarray(np.einsum("pfm,qfm->fpq", J, J.conj(), optimize=True).real)
