"""`detect_nonlinearity`: dependence of measured FRFs on the force amplitude."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.errors import DataError, OptionError
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.group import is_number
from updyn.modal import ModeSet, identify_modes
from updyn.modal.level import describe_leaning
from updyn.updating.judge.levels.changes import FollowedModes, ModeChange
from updyn.updating.judge.levels.homogeneity import (
    combine_probabilities,
    line_probabilities,
    residual_variances,
    scatter_variance,
    start_variance,
    stated_variance,
)
from updyn.updating.judge.levels.settings import LEVEL_TEST
from updyn.updating.problem.noise import NoiseChoice

__all__ = ["Nonlinearity", "check_levels", "detect_nonlinearity"]


@dataclass(frozen=True, slots=True, eq=False)
class Nonlinearity:
    """Dependence of FRFs on the force amplitude.

    Parameters
    ----------
    levels : ndarray of float, shape (n_l,)
        Largest force amplitude of each test in N (N m), ascending; nan for one test without.
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    p_lines : ndarray of float, shape (n_f, n_responses, n_references)
        Probability that noise causes the differences between the levels, by line and channel; nan
        for one test.
    modes : tuple of ModeChange
        Modes found at the lowest level.
    leaning : str
        Leaning peaks of one test; empty if there are none.
    significance : float
        Probability of reporting a linear structure.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> frf = chain.measure()
    >>> low, high = frf.with_level(1.0), frf.with_level(5.0)
    >>> updyn.detect_nonlinearity([low, high], noise={"relative": 0.01}).is_nonlinear
    False
    """

    levels: RealArray
    freq: RealArray
    p_lines: RealArray
    modes: tuple[ModeChange, ...]
    leaning: str
    significance: float

    @property
    def p_value(self) -> float:
        """Probability that noise causes changes of lines or modes as large; nan for one test."""
        if len(self.levels) == 1:
            return float("nan")
        of_modes = [p for mode in self.modes for p in mode.p_values]
        smallest = len(of_modes) * min(of_modes, default=1.0)
        return float(min(1.0, 2.0 * min(smallest, combine_probabilities(self.p_lines))))

    @property
    def is_nonlinear(self) -> bool:
        """Whether the FRFs depend on the level."""
        return bool(self.leaning) if len(self.levels) == 1 else self.p_value < self.significance

    @property
    def statement(self) -> str:
        """Result of the tests as text."""
        if len(self.levels) == 1:
            return self.leaning or "One level: no peak leans."
        span = f"from {self.levels[0]:.3g} to {self.levels[-1]:.3g} N"
        if not self.is_nonlinear:
            return f"The FRFs do not depend on the level {span} (p = {self.p_value:.2g})."
        changed = [mode.describe() for mode in self.modes if mode.typical]
        text = f"The FRFs depend on the level {span} (p = {self.p_value:.1g})"
        if changed:
            return f"{text}: {'; '.join(changed)}."
        return f"{text}, but no mode changes: calibration may differ between the levels."


def detect_nonlinearity(
    tests: FRF | Iterable[FRF],
    *,
    noise: NoiseChoice = None,
    significance: float = LEVEL_TEST.significance,
) -> Nonlinearity:
    """Test whether FRFs depend on the force amplitude.

    Parameters
    ----------
    tests : FRF or iterable of FRF
        Measurements of the same channels and lines, each with a different `FRF.level`. Repeated
        measurements at one level are averaged first (`updyn.average`).
    noise : None, str or mapping
        As for `updyn.update`. If the data do not state it, it is estimated from the scatter of
        neighbouring lines.
    significance : float
        Probability of reporting a linear structure.

    Returns
    -------
    Nonlinearity

    Raises
    ------
    DataError
        If tests have no level, equal levels, or other channels or lines.
    OptionError
        If the significance is not between 0 and 1.

    Notes
    -----
    Lines: the differences between the levels are compared with the noise by an F test for each line
    and channel; the smallest probability at two adjacent lines, times their number (Bonferroni).
    Modes: the equivalent linear poles at all levels are compared with those at the lowest. A test
    at one level shows nonlinear stiffness by leaning peaks only (`ModeSet.lean`).

    Examples
    --------
    >>> from updyn.demos import chain
    >>> found = updyn.detect_nonlinearity(chain.measure())
    >>> found.statement
    'One level: no peak leans.'
    """
    if not is_number(significance) or not 0.0 < significance < 1.0:
        raise OptionError(f"significance {significance!r}: expected a number between 0 and 1")
    listed = [tests] if isinstance(tests, FRF) else list(tests)
    ordered = [_without_zero(test) for test in check_levels(listed)]
    first = ordered[0]
    modes = _identify(first)
    if len(ordered) == 1:
        leaning = "" if modes is None else describe_leaning(modes)
        unknown = np.full(first.values.shape, np.nan)
        level = np.array([_level_of(first)])
        return Nonlinearity(level, first.freq, unknown, (), leaning, significance)
    compared = _compare(ordered, modes, noise)
    p_lines = line_probabilities(ordered, compared.variances, compared.freedoms)
    levels = np.array([_level_of(test) for test in ordered])
    changes: list[ModeChange] = []
    if compared.followed is not None:
        poles, stds = _follow(compared.followed, ordered, compared.variances)
        freedoms = compared.followed.average(compared.freedoms)
        limit = significance / (2 * len(freedoms))
        changes = [
            ModeChange(levels, poles[:, r], stds[:, r], float(freedom), limit)
            for r, freedom in enumerate(freedoms)
        ]
    return Nonlinearity(levels, first.freq, p_lines, tuple(changes), "", significance)


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """Variances of tests, their degrees of freedom, and the modes at the lowest level."""

    variances: Sequence[RealArray]
    freedoms: RealArray
    followed: FollowedModes | None


def _compare(tests: Sequence[FRF], modes: ModeSet | None, noise: NoiseChoice) -> _Comparison:
    """Return the noise and the modes of tests with ascending levels."""
    first = tests[0]
    many = np.full(first.values.shape, LEVEL_TEST.noise_freedoms)
    stated = [stated_variance(test, noise) for test in tests]
    known = [one for one in stated if one is not None]
    if len(known) == len(tests):
        followed = None if modes is None else FollowedModes.of(first, known[0], modes)
        return _Comparison(known, many, followed)
    scatter = [scatter_variance(test) for test in tests]
    if modes is not None:
        followed = FollowedModes.of(first, start_variance(first, scatter[0]), modes)
        if followed is not None:
            residual = (followed.values - followed.fit).reshape(first.values.shape)
            variances, freedoms = residual_variances(tests, residual)
            return _Comparison(variances, freedoms, followed.with_variance(variances[0]))
    return _Comparison(scatter, many, None)


def _follow(
    followed: FollowedModes, tests: Sequence[FRF], variances: Sequence[RealArray]
) -> tuple[ComplexArray, ComplexArray]:
    """Return the poles at all levels, and standard deviations of their changes, (n_l, m)."""
    change = np.zeros_like(followed.pole)
    changes, stds = [change], [change]
    for test, variance in zip(tests[1:], variances[1:], strict=True):
        change, std = followed.follow(test.values, variance, change)
        changes.append(change)
        stds.append(std)
    return followed.pole + np.array(changes), np.array(stds)


def check_levels(tests: Sequence[FRF]) -> list[FRF]:
    """Return tests by ascending level; raise DataError if they do not differ by the level only."""
    for number, test in enumerate(tests, 1):
        if not isinstance(test, FRF):
            raise DataError(f"test {number}: expected an FRF, found {type(test).__name__}")
    if not tests:
        raise DataError("tests: expected at least one FRF, found none")
    if len(tests) == 1:
        return list(tests)
    for number, test in enumerate(tests, 1):
        _check_test(tests[0], test, number)
    ordered = sorted(tests, key=_level_of)
    for one, two in pairwise(ordered):
        if _level_of(one) == _level_of(two):
            raise DataError(
                f"level {_level_of(one):g} N occurs twice; average repeated measurements by"
                " updyn.average first"
            )
    return ordered


def _check_test(first: FRF, test: FRF, number: int) -> None:
    if test.level is None:
        raise DataError(
            f"test {number} has no level; expected a force amplitude in N: frf.with_level(5.0)"
        )
    if test.quantity == TRANSMISSIBILITY:
        raise DataError(f"test {number}: a transmissibility has no force amplitude")
    for what in ("quantity", "responses", "references", "decay"):
        one, other = getattr(first, what), getattr(test, what)
        if one != other:
            raise DataError(
                f"test {number}: {what} {other} instead of {one}; expected the same channels in all"
                " tests (FRF.select, FRF.converted)"
            )
    if test.is_random != first.is_random:
        raise DataError(
            f"test {number}: {test.level_text}, test 1: {first.level_text}; expected a sine in all"
            " tests, or a random force"
        )
    if not np.array_equal(first.freq, test.freq):
        raise DataError(f"test {number}: other lines than test 1; expected the same (FRF.select)")


def _level_of(test: FRF) -> float:
    """Return the largest force amplitude in N; nan if none is stated."""
    return float("nan") if test.level is None else float(test.level.max())


def _without_zero(test: FRF) -> FRF:
    """Return a test without a line at 0 Hz, where no mode moves."""
    return test if test.freq[0] > 0.0 else test.select(lines=test.freq[1:])


def _identify(test: FRF) -> ModeSet | None:
    """Return the modes of a test; None if none is found."""
    try:
        return identify_modes(test)
    except DataError:
        return None
