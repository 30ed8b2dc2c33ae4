"""Modes that models and tests of a run have in common, and the consequences if there are few.

A model with no more counterparts than a model of another structure is wrong or far from the right
one: the search ends after its first tries, unless one explains the data, and an answer with as few
counterparts is not plausible.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from updyn.errors import UpdynWarning
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.remedy import Remedy
from updyn.updating.fit.monitor import Monitor
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.counterparts import Counterparts, find_counterparts
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["REMEDY", "ModeComparison"]

#: Advice on a model that has few modes or none in common with the test.
REMEDY = (
    "Compare model and test first: orientation and axes of the sections, supports, units, and where"
    " the sensors are on the model (updyn check, updyn correlate)."
)


@dataclass(frozen=True, slots=True, eq=False)
class ModeComparison:
    """Counterparts of each test before a search, and the modes given in addition to its FRFs."""

    tests: tuple[Test, ...]
    modes: tuple[ModeSet | None, ...]
    found: tuple[Counterparts, ...]

    @classmethod
    def of(
        cls, tests: Sequence[Test], unknowns: ParameterSet, options: Mapping[str, Any]
    ) -> ModeComparison:
        """Compare the modes of each test with those of its model at the start of the unknowns."""
        given = options.get("modes")
        by_test = given if isinstance(given, Mapping) else {}
        one = given if isinstance(given, ModeSet) else None
        modes = tuple(by_test.get(test.name, one) for test in tests)
        found = [
            find_counterparts(unknowns.at_start(test.model), test.data, modes_of_test)
            for test, modes_of_test in zip(tests, modes, strict=True)
        ]
        return cls(tuple(tests), modes, tuple(found))

    @property
    def few(self) -> bool:
        """Whether every test is known to have few modes or none in common with its model."""
        return all(one.few for one in self.found)

    @property
    def steps(self) -> tuple[Remedy, ...]:
        """Advice on models with few modes or none in common with their tests."""
        advice = " ".join(dict.fromkeys(one.remedy or REMEDY for one in self.found))
        return (Remedy(advice),)

    def warn(self) -> None:
        """Warn of tests with few modes or none in common with their model."""
        for test, one in zip(self.tests, self.found, strict=True):
            if one.few:
                name = f"{test.name}: " if test.name else ""
                warnings.warn(
                    f"{name}{one.statement} {one.remedy or REMEDY}", UpdynWarning, stacklevel=4
                )

    def wrap_fault_detector(
        self, detect_data_fault: Callable[[Monitor], bool]
    ) -> Callable[[Monitor], bool]:
        """Return the function that decides whether to end a search after its first tries."""
        if not self.few:
            return detect_data_fault

        def without_counterparts(monitor: Monitor) -> bool:
            detect_data_fault(monitor)  # for its findings, which are part of the result
            return True

        return without_counterparts

    @property
    def claim(self) -> Claim:
        """The claim that the models have modes of their tests, before the search."""
        claims = [one.claim for one in self.found]
        asked = all(claim.asked for claim in claims)
        holds = any(claim.holds for claim in claims) if asked else None
        return Claim.join(holds, [claim.why for claim in claims], asked=asked)

    def compare(self, models: Sequence[Model]) -> list[Counterparts]:
        """Return the counterparts of the modes of each test in other models."""
        return [
            find_counterparts(model, test.data, modes_of_test)
            for model, test, modes_of_test in zip(models, self.tests, self.modes, strict=True)
        ]
