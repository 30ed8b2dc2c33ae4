"""Dependence on the force level of the tests of a run with a linear model."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress

import numpy as np

from updyn.errors import DataError
from updyn.frf import FRF
from updyn.updating.judge.levels.detect import detect_nonlinearity

__all__ = ["find_level_dependence"]


def find_level_dependence(tests: Iterable[FRF]) -> str:
    """Return how the modes of tests at several levels change, as a sentence; empty if they do not.

    Tests of the same channels and lines are compared. Differences without a change of modes are
    those of a calibration, which the search for causes finds.
    """
    for group in _group_alike(tests):
        with suppress(DataError):
            found = detect_nonlinearity(group)
            if found.is_nonlinear and any(mode.typical for mode in found.modes):
                return found.statement
    return ""


def _group_alike(tests: Iterable[FRF]) -> list[Sequence[FRF]]:
    """Return the tests by channels and lines, one at each level, where several levels are known."""
    groups: dict[object, dict[float, FRF]] = {}
    for test in tests:
        if test.level is None:
            continue
        channels = *test.responses.labels, "", *test.references.labels
        alike = channels, test.quantity, test.is_random, test.freq.tobytes()
        groups.setdefault(alike, {}).setdefault(float(np.max(test.level)), test)
    return [list(group.values()) for group in groups.values() if len(group) > 1]
