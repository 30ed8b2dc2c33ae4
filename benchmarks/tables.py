"""Tables of `accuracy.py` in Markdown, one for each structure, and what they add up to.

recovered
    Every unknown within 1e-6 of the truth without noise; within four standard deviations of the
    Cramer-Rao bound of the true noise with it; of a symmetric structure the mirror image counts
    too. Unknowns with a bound above 100 % are not asked for: four of these reach from bound to
    bound. An unknown that a method cannot change stays where it starts.
from truth
    The same of fits by the default method that begin at the truth.
of these
    Of the draws that are recovered from the truth, how many the search recovers.
told
    The same, where another answer that the fit says to fit as well counts too.
RMS/bound
    RMS error over the bound, median and largest of the unknowns; over what the fits call determined
    (converged, or not in the null space) and the data know well (bound below 5 %).
covered
    Share of the 95 % intervals that hold the truth, mean and least of the unknowns; over the same.
known well
    Unknowns with a bound below 5 %.
ended
    How many fits converged / are not identifiable / stopped at their largest number of steps /
    ended otherwise.
falsely sure
    Fits that converged with an unknown more than six of their standard deviations off.
two answers
    Fits of full rank that are called not identifiable, as another answer fits as well: rightly
    (their own is more than six standard deviations off, the structure is symmetric, or the bound of
    an unknown is above 100 %) / wrongly.
fit as well
    Fits that are not recovered, yet whose chi-square is at most 4 above that of the fit from the
    truth: the data do not tell them from the truth.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from structures import Bench, Noise, bench

#: Largest error of a recovered unknown: without noise, and in standard deviations with noise.
EXACT = 1e-6
SURE = 4.0
#: Largest bound of the unknowns that RMS and coverage are taken of.
WELL_KNOWN = 0.05
#: Bound from which the data say nothing of an unknown.
UNKNOWN = 1.0
#: An estimate that is farther off than this, in its own standard deviations, was falsely sure.
FALSE = 6.0
#: Chi-squares that differ by less are of answers that fit alike: two standard deviations.
ALIKE = 4.0
#: The method that the others are compared with.
DEFAULT = "maximum-likelihood"

_COLUMNS = (
    "noise", "floor", "method", "recovered", "from truth", "of these", "told", "RMS/bound",
    "covered", "known well", "ended", "falsely sure", "two answers", "fit as well", "steps", "s",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Cell:
    """Fits of one structure by one method to data of one noise, draw by draw.

    Parameters
    ----------
    case, method : str
        What is fitted, and how.
    noise : Noise
        Of the data.
    found : list of dict
        The fits; one that was refused has the key ``"refused"`` only.
    true : list of dict
        The fits of the same draws from the truth.
    """

    case: str
    method: str
    noise: Noise
    found: list[dict[str, Any]]
    true: list[dict[str, Any]]

    @property
    def bench(self) -> Bench:
        return bench(self.case)

    @property
    def made(self) -> list[dict[str, Any]]:
        return [fit for fit in self.found if "refused" not in fit]

    @cached_property
    def bound(self) -> np.ndarray | None:
        return self.bench.bound(self.noise) if self.noise else None

    @cached_property
    def largest(self) -> np.ndarray | float:
        """Largest error of a recovered unknown."""
        if self.bound is None:
            return EXACT
        return np.where(self.bound > UNKNOWN, np.inf, SURE * self.bound)

    def is_recovered(self, fit: dict[str, Any]) -> bool:
        return "refused" not in fit and self._is_true(fit["error"])

    def is_told(self, fit: dict[str, Any]) -> bool:
        """Whether the answer of a fit, or one that it says to fit as well, is right."""
        return self.is_recovered(fit) or any(map(self._is_true, fit.get("others", ())))

    def _is_true(self, errors: Sequence[float]) -> bool:
        error = np.array(errors)
        return any(
            bool((np.abs(e) <= self.largest).all()) for e in (error, self.bench.in_mirror(error))
        )

    @cached_property
    def recovered(self) -> np.ndarray:
        return np.array([self.is_recovered(fit) for fit in self.found])

    @cached_property
    def told(self) -> np.ndarray:
        return np.array([self.is_told(fit) for fit in self.found])

    @cached_property
    def from_truth(self) -> np.ndarray:
        return np.array([self.is_recovered(fit) for fit in self.true])

    def count(self, what: Any) -> int:
        return sum(map(what, self.made))

    @property
    def as_well(self) -> int:
        pairs = zip(self.found, self.true, self.recovered, strict=True)
        return sum(not near and _fits_alike(fit, true) for fit, true, near in pairs)

    @cached_property
    def has_others(self) -> bool:
        """Whether other answers than the truth fit as well."""
        weak = self.bound is not None and (self.bound > UNKNOWN).any()
        return bool(self.bench.mirrored) or bool(weak)

    def is_right(self, fit: dict[str, Any]) -> bool:
        """Whether a fit that speaks of two answers is right."""
        return _of_two(fit) and (self.has_others or farthest(fit) > FALSE)

    def is_wrong(self, fit: dict[str, Any]) -> bool:
        """Whether a fit that speaks of two answers is wrong."""
        return _of_two(fit) and not self.is_right(fit)

    @cached_property
    def figures(self) -> tuple[np.ndarray, np.ndarray]:
        """RMS error over bound, and share of covering intervals, by unknown."""
        if self.bound is None:
            return np.empty(0), np.empty(0)
        error = np.array([fit["error"] for fit in self.made])
        std = np.array([fit["std"] for fit in self.made], dtype=float)
        called = np.array([_called(fit) for fit in self.made])
        inside = np.abs(error) <= 1.96 * std
        ratio, covered = [], []
        for i in np.flatnonzero(self.bound < WELL_KNOWN):
            own = called[:, i]
            if own.any():
                ratio.append(np.sqrt(np.mean(error[own, i] ** 2)) / self.bound[i])
                covered.append(np.mean(inside[own, i]))
        return np.array(ratio), np.array(covered)


def farthest(fit: dict[str, Any]) -> float:
    """Largest error in the standard deviations that the fit states; errors of rounding left out."""
    largest = 0.0
    for error, std in zip(fit["error"], fit["std"], strict=True):
        if std is not None and abs(error) > EXACT:
            largest = max(largest, abs(error) / std if std else np.inf)
    return largest


def _called(fit: dict[str, Any]) -> np.ndarray:
    """Which unknowns a fit calls determined."""
    ended = fit["status"] == "converged" or (
        fit["status"] == "not-identifiable" and not fit["complete"]
    )
    finite = np.array([std is not None for std in fit["std"]])
    return finite & np.array(fit["seen"]) & ended


def _falsely_sure(fit: dict[str, Any]) -> bool:
    return fit["status"] == "converged" and farthest(fit) > FALSE


def _of_two(fit: dict[str, Any]) -> bool:
    return fit["status"] == "not-identifiable" and fit["complete"]


def _fits_alike(fit: dict[str, Any], true: dict[str, Any]) -> bool:
    if "misfit" not in fit or "misfit" not in true:
        return False
    return bool(fit["misfit"] <= true["misfit"] + ALIKE)


def print_case(cells: Sequence[Cell]) -> None:
    """Print the table of one structure."""
    made = cells[0].bench
    unknowns, (_, responses, references) = (
        len(made.sought(made.case.true)),
        made.case.clean.values.shape,
    )
    print(
        f"\n{cells[0].case}: {unknowns} unknowns, {responses} sensors, {references} forces,"
        f" {len(cells[0].found)} draws\n"
    )
    print(f"| {' | '.join(_COLUMNS)} |\n|{'---|' * len(_COLUMNS)}")
    for cell in cells:
        print(f"| {' | '.join(row(cell))} |", flush=True)
    for _, same in groupby(cells, lambda cell: cell.noise):
        print_better(list(same))


def row(cell: Cell) -> list[str]:
    """The words of a row."""
    noise = [f"{100 * cell.noise.relative:g} %", f"{cell.noise.floor:g}", cell.method]
    if not cell.made:
        return [*noise, "refused", *["-"] * (len(_COLUMNS) - 4)]
    ended = Counter(fit["status"] for fit in cell.found if "refused" not in fit)
    three = [ended[name] for name in ("converged", "not-identifiable", "max-iterations")]
    both = int((cell.recovered & cell.from_truth).sum())
    ratio, covered = cell.figures
    return [
        *noise,
        f"{100 * cell.recovered.mean():.1f} %",
        f"{100 * cell.from_truth.mean():.1f} %",
        f"{both} of {cell.from_truth.sum()}",
        f"{(cell.told & cell.from_truth).sum()} of {cell.from_truth.sum()}",
        f"{np.median(ratio):.2f} - {ratio.max():.2f}" if ratio.size else "-",
        f"{100 * covered.mean():.1f} - {100 * covered.min():.1f} %" if covered.size else "-",
        "-" if cell.bound is None else f"{(cell.bound < WELL_KNOWN).sum()} of {len(cell.bound)}",
        " / ".join(map(str, [*three, len(cell.found) - sum(three)])),
        f"{cell.count(_falsely_sure)}",
        f"{cell.count(cell.is_right)} / {cell.count(cell.is_wrong)}",
        f"{cell.as_well}",
        f"{np.mean([fit['steps'] for fit in cell.made]):.0f}",
        f"{np.mean([fit['seconds'] for fit in cell.made]):.2f}",
    ]


def print_better(cells: Sequence[Cell]) -> None:
    """Print the methods that recover more than the default, beyond the standard error of that."""
    for default in cells:
        if default.method == DEFAULT:
            own = default.recovered.mean()
            break
    else:
        return
    for cell in cells:
        share = cell.recovered.mean()
        error = np.sqrt((own * (1 - own) + share * (1 - share)) / len(cell.found))
        if share - own > error:
            print(
                f"\nBetter than the default at {100 * cell.noise.relative:g} %, floor"
                f" {cell.noise.floor:g}: {cell.method}, by {100 * (share - own):.1f} +-"
                f" {100 * error:.1f} %"
            )


def _lowest(cells: Sequence[Cell], which: Callable[[Cell], np.ndarray]) -> str:
    """Lowest share of the draws that the truth recovers, over the cells."""
    shares = [
        (which(cell) & cell.from_truth).sum() / cell.from_truth.sum()
        for cell in cells
        if cell.from_truth.any()
    ]
    return f"{100 * min(shares):.0f} %" if shares else "-"


def print_total(cells: Sequence[Cell]) -> None:
    """Print what the cells of each method add up to."""
    columns = ("method", "cells", "fits", "recovered", "of these", "lowest cell", "told",
               "lowest cell", "converged", "falsely sure", "two answers", "fit as well",
               "s")  # fmt: skip
    print(f"\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for method in dict.fromkeys(cell.method for cell in cells):
        own = [cell for cell in cells if cell.method == method]
        found = sum(int((cell.recovered & cell.from_truth).sum()) for cell in own)
        could = sum(int(cell.from_truth.sum()) for cell in own)
        told = sum(int((cell.told & cell.from_truth).sum()) for cell in own)
        words = [
            method,
            len(own),
            sum(len(cell.found) for cell in own),
            sum(int(cell.recovered.sum()) for cell in own),
            f"{found} of {could}",
            _lowest(own, lambda cell: cell.recovered),
            f"{told} of {could}",
            _lowest(own, lambda cell: cell.told),
            sum(cell.count(lambda fit: fit["status"] == "converged") for cell in own),
            sum(cell.count(_falsely_sure) for cell in own),
            f"{sum(cell.count(cell.is_right) for cell in own)} /"
            f" {sum(cell.count(cell.is_wrong) for cell in own)}",
            sum(cell.as_well for cell in own),
            f"{sum(fit['seconds'] for cell in own for fit in cell.made):.0f}",
        ]
        print(f"| {' | '.join(map(str, words))} |")
