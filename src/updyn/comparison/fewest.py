"""Fewest lines with which a method still recovers the unknowns."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from updyn.comparison.settings import FEWEST_LINES
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "Fewest",
    "describe_rule",
    "distance_from_estimate",
    "errors_against",
    "find_fewest_lines",
    "list_counts",
]


@dataclass(frozen=True, slots=True)
class Fewest:
    """The fewest lines with which a method still recovers the unknowns.

    Attributes
    ----------
    count : int or None
        Number of lines per test; None if no tried number was sufficient.
    lines : tuple of float
        These lines of the first test, in Hz.
    tried : tuple of (int, float)
        Each tried number of lines and the error of its fit relative to the tolerance.
    note : str
        Why no numbers, or no further ones, were tried; may be empty.
    """

    count: int | None
    lines: tuple[float, ...] = ()
    tried: tuple[tuple[int, float], ...] = ()
    note: str = ""


def describe_rule(tolerance: float, chosen: str, *, truth: bool) -> str:
    """Return a text that describes the search for the fewest lines."""
    which = "evenly"
    if chosen == "d-optimal":
        which = "D-optimally at the start of the unknowns"
    goal = (
        f"every unknown is within {FEWEST_LINES.most_stds:g} standard deviations, or within"
        f" {tolerance:g}, of the method's own estimate with all lines"
    )
    if truth:
        goal = (
            f"every unknown that the method updates is within {tolerance:g} of the truth (as a"
            " share of it; for a loss factor as it is)"
        )
    first = ", ".join(map(str, FEWEST_LINES.counts[:8]))
    return (
        f"Fewest lines: {first}, ... lines are tried in turn, chosen {which}, from the same start,"
        f" until {goal}. Numbers of lines with fewer measured values than unknowns are skipped; a"
        " method that has not converged with all lines within its largest number of steps is not"
        " tried with fewer."
    )


def list_counts(n_lines: int, values_a_line: int, n_unknowns: int) -> list[int]:
    """Return the numbers of lines to try, ascending; the last is `n_lines`.

    `values_a_line` is the number of complex values per line of all tests; `n_unknowns` counts
    unknowns without a prior, which fewer real values cannot determine.
    """
    least = math.ceil(n_unknowns / (2 * values_a_line))
    return [k for k in FEWEST_LINES.counts if least <= k < n_lines] + [n_lines]


def errors_against(
    values: Mapping[str, float], truth: Mapping[str, float], parameters: ParameterSet
) -> dict[str, float]:
    """Return the errors of the unknowns whose truth is known, by name.

    An error is estimate / truth - 1, and for a loss factor estimate - truth. The error of a damping
    coefficient with truth 0 is relative to its start.
    """
    errors = {}
    for p in parameters:
        if p.name in truth and p.name in values:
            errors[p.name] = (values[p.name] - truth[p.name]) / _scale(p, truth[p.name])
    return errors


def _scale(parameter: Parameter, value: float) -> float:
    """Return the reference value of the error of an unknown."""
    if all(d.quantity == "loss_factor" for d in parameter.acts_on):
        return 1.0
    return abs(value) or abs(parameter.start) or 1.0


def distance_from_estimate(
    result: UpdateResult | JointResult, tolerance: float
) -> Callable[[Mapping[str, float]], float]:
    """Return a function for the distance from a method's own estimate, in tolerances."""
    parameters = result.parameters

    def distance(values: Mapping[str, float]) -> float:
        worst = 0.0
        for p in parameters:
            estimate, std = result.values[p.name], result.std[p.name]
            allowed = max(FEWEST_LINES.most_stds * std, tolerance * _scale(p, estimate))
            worst = max(worst, abs(values[p.name] - estimate) / allowed)
        return worst

    return distance


def find_fewest_lines(
    numbers: list[int],
    distance: Callable[[int], float | None],
    lines: Callable[[int], tuple[float, ...]],
) -> Fewest:
    """Try numbers of lines in ascending order until one is sufficient.

    The order is ascending because fits with few lines are cheap, and because more lines are not
    always better. `distance` returns the error of the fit with a number of lines, relative to the
    tolerance, or None if the user stopped; `lines` returns these lines in Hz.
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
