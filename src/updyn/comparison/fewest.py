"""The fewest lines with which a method still recovers the unknowns."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["COUNTS", "Fewest", "counts", "errors_against", "fewest_lines", "own_answer", "rule"]

#: Numbers of lines that are tried before all lines.
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 40, 60, 80, 100, 150, 200, 300, 400, 600, 800, 1000)
#: Standard deviations within which an unknown counts as recovered.
_STDS = 3.0


@dataclass(frozen=True, slots=True)
class Fewest:
    """The fewest lines with which a method still recovers.

    Attributes
    ----------
    count : int or None
        Number of lines of each test; None where none of the numbers tried was enough.
    lines : tuple of float
        These lines of the first test, in Hz.
    tried : tuple of (int, float)
        Every number of lines that was tried, and the error of its fit relative to the tolerance.
    note : str
        Why nothing, or no more, was tried; may be empty.
    """

    count: int | None
    lines: tuple[float, ...] = ()
    tried: tuple[tuple[int, float], ...] = ()
    note: str = ""


def rule(tolerance: float, chosen: str, *, truth: bool) -> str:
    """Return a text that states how the fewest lines are sought.

    Parameters
    ----------
    tolerance : float
        Error below which an unknown counts as recovered.
    chosen : {"d-optimal", "even"}
        How lines are chosen.
    truth : bool
        Whether the truth is known.
    """
    which = "evenly"
    if chosen == "d-optimal":
        which = "D-optimally at the start of the unknowns"
    goal = (
        f"every unknown is within {_STDS:g} standard deviations, or within {tolerance:g}, of the"
        " method's own answer with all lines"
    )
    if truth:
        goal = (
            f"every unknown that the method updates is within {tolerance:g} of the truth (as a"
            " share of it; for a loss factor as it is)"
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
    """Return the errors of the unknowns whose truth is known, by name.

    An error is estimate / truth - 1, of a loss factor estimate - truth. The error of a damping
    coefficient whose truth is 0 is relative to its start.
    """
    errors = {}
    for p in parameters:
        if p.name in truth and p.name in values:
            errors[p.name] = (values[p.name] - truth[p.name]) / _scale(p, truth[p.name])
    return errors


def _scale(parameter: Parameter, value: float) -> float:
    """Return the value that an error of an unknown is relative to."""
    if all(d.quantity == "loss_factor" for d in parameter.acts_on):
        return 1.0
    return abs(value) or abs(parameter.start) or 1.0


def own_answer(
    result: UpdateResult | JointResult, tolerance: float
) -> Callable[[Mapping[str, float]], float]:
    """Return the distance of values from a method's own estimate, relative to the tolerance."""
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

    The order is ascending because fits with few lines cost little, and because more lines need not
    be better.

    Parameters
    ----------
    numbers : list of int
        Numbers to try, ascending.
    distance : callable
        Returns the error of the fit with a number of lines, relative to the tolerance; None where
        the user has stopped.
    lines : callable
        Returns these lines, in Hz.
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
