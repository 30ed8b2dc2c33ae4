"""The fewest lines with which a method still recovers what it should."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["COUNTS", "Fewest", "counts", "errors_against", "fewest_lines", "own_answer", "rule"]

#: Numbers of lines that are tried, and then all.
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 60, 80, 100, 150, 200, 300, 400, 600, 800, 1000)
_STDS = 3.0


@dataclass(frozen=True, slots=True)
class Fewest:
    """The fewest lines with which a method still recovers.

    Attributes
    ----------
    count : int or None
        Lines (of each test); None where none of the numbers tried was enough.
    lines : tuple of float
        Which, in Hz, of the first test.
    tried : tuple of (int, float)
        Every number of lines that was tried and how far its fit was off, as a multiple of what
        counts as recovered.
    note : str
        Why nothing, or no more, was tried; may be empty.
    """

    count: int | None
    lines: tuple[float, ...] = ()
    tried: tuple[tuple[int, float], ...] = ()
    note: str = ""


def rule(tolerance: float, chosen: str, *, truth: bool) -> str:
    """Return how the fewest lines are sought, in words.

    Parameters
    ----------
    tolerance : float
        What counts as recovered.
    chosen : str
        How lines are chosen.
    truth : bool
        Whether the truth is known.
    """
    which = "D-optimally at the start of the unknowns" if chosen == "d-optimal" else "evenly"
    goal = (
        f"every unknown that the method updates is within {tolerance:g} of the truth (as a share of"
        " it; for a loss factor as it is)"
        if truth
        else (
            f"every unknown is within {_STDS:g} standard deviations, or within {tolerance:g}, of"
            " the method's own answer with all lines"
        )
    )
    return (
        f"Fewest lines: {', '.join(map(str, COUNTS[:8]))}, ... lines are tried in turn, chosen"
        f" {which}, from the same start, until {goal}. Numbers of lines with fewer measured values"
        " than unknowns are passed over; a method that has not arrived with all lines after its"
        " largest number of steps is not tried with fewer."
    )


def counts(n_lines: int, values_a_line: int, n_unknowns: int) -> list[int]:
    """Return the numbers of lines to try, ascending; the last is all.

    Parameters
    ----------
    n_lines : int
        Lines of the data.
    values_a_line : int
        Complex values at a line, of all tests.
    n_unknowns : int
        Unknowns without a prior: fewer real values than these cannot determine them.
    """
    least = math.ceil(n_unknowns / (2 * values_a_line))
    return [k for k in COUNTS if least <= k < n_lines] + [n_lines]


def errors_against(
    values: Mapping[str, float], truth: Mapping[str, float], parameters: ParameterSet
) -> dict[str, float]:
    """Return the errors of the unknowns whose truth is known: estimate / truth - 1, of a loss factor estimate - truth.

    A damping coefficient with a unit whose truth is 0 is counted in its start.
    """
    return {
        p.name: (values[p.name] - truth[p.name]) / _scale(p, truth[p.name])
        for p in parameters
        if p.name in truth and p.name in values
    }


def _scale(parameter: Parameter, value: float) -> float:
    """Return what an error of an unknown is counted in."""
    if all(d.quantity == "loss_factor" for d in parameter.acts_on):
        return 1.0
    return next((abs(x) for x in (value, parameter.start) if x != 0.0), 1.0)


def own_answer(
    result: UpdateResult | JointResult, tolerance: float
) -> Callable[[Mapping[str, float]], float]:
    """Return what tells how far values are from a method's own answer, as a multiple of what counts as recovered."""
    parameters = result.parameters

    def distance(values: Mapping[str, float]) -> float:
        worst = 0.0
        for p in parameters:
            there, std = result.values[p.name], result.std[p.name]
            allowed = max(_STDS * std, tolerance * _scale(p, there))
            worst = max(worst, abs(values[p.name] - there) / allowed)
        return worst

    return distance


def fewest_lines(
    numbers: list[int],
    distance: Callable[[int], float | None],
    lines: Callable[[int], tuple[float, ...]],
) -> Fewest:
    """Try numbers of lines in ascending order until one is enough.

    Upwards, as fits with few lines cost little, and as it need not be taken for granted that more
    lines never hurt.

    Parameters
    ----------
    numbers : list of int
        What to try, ascending.
    distance : callable
        How far the fit with so many lines is off, as a multiple of what counts as recovered; None
        where the user has stopped.
    lines : callable
        Which lines these are, in Hz.
    """
    tried: list[tuple[int, float]] = []
    for number in numbers:
        off = distance(number)
        if off is None:
            return Fewest(None, (), tuple(tried), "stopped")
        tried.append((number, off))
        if off <= 1.0:
            return Fewest(number, lines(number), tuple(tried))
    return Fewest(None, (), tuple(tried))
