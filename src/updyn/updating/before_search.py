"""Modes that models and tests of a run have in common, and the consequences if there are few.

If a model has no more counterparts of the measured modes than a model of another structure has, it
is the wrong model or far from the right one. Then the search ends after its first tries, unless one
of these explains the data, and an answer with as few counterparts is not plausible.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from updyn.errors import UpdynWarning
from updyn.modal import ModeSet
from updyn.model import Model
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
    """Modes of models and tests before a search.

    Attributes
    ----------
    tests : tuple of Test
        The tests, with the models at the start of the update.
    modes : tuple of (ModeSet or None)
        Modes of each test that are given in addition to its FRFs.
    found : tuple of Counterparts
        Counterparts of each test.
    """

    tests: tuple[Test, ...]
    modes: tuple[ModeSet | None, ...]
    found: tuple[Counterparts, ...]

    @classmethod
    def of(
        cls, tests: Sequence[Test], unknowns: ParameterSet, options: Mapping[str, Any]
    ) -> ModeComparison:
        """Compare the modes of each test with those of its model at the start of the unknowns.

        `options` are those of the method; ``modes`` among them holds the modes of the tests.
        """
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
    def remedy(self) -> str:
        """Advice on models with few modes or none in common with their tests."""
        return " ".join(dict.fromkeys(one.remedy or REMEDY for one in self.found))

    def warn(self) -> None:
        """Warn of tests with few modes or none in common with their model."""
        for test, one in zip(self.tests, self.found, strict=True):
            if one.few:
                name = f"{test.name}: " if test.name else ""
                warnings.warn(
                    f"{name}{one.statement} {one.remedy or REMEDY}", UpdynWarning, stacklevel=4
                )

    def wrap_fault_detector(self, detect_data_fault: Callable[[], bool]) -> Callable[[], bool]:
        """Return the function that decides whether to end a search after its first tries.

        `detect_data_fault` searches for a fault of the data that explains them.
        """
        if not self.few:
            return detect_data_fault

        def without_counterparts() -> bool:
            detect_data_fault()  # for its findings, which are part of the result
            return True

        return without_counterparts

    def adjust_result(self, common: Mapping[str, Any], models: Sequence[Model]) -> dict[str, Any]:
        """Return the entries of a result that the comparison of modes changes.

        `common` holds ``status``, ``message``, ``remedy``, ``trust`` and ``findings`` of the
        result, `models` the updated model of each test.
        """
        status, trust = common["status"], common["trust"]
        claim = _claim_resembles(self.found)
        changed: dict[str, Any] = {"trust": trust and replace(trust, resembles=claim)}
        if not self.few or status in ("stopped", "failed"):
            return changed
        after = [
            find_counterparts(model, test.data, modes_of_test)
            for model, test, modes_of_test in zip(models, self.tests, self.modes, strict=True)
        ]
        if not all(one.few for one in after):
            updated = Claim(True, f"Of the updated model: {after[0].statement}")
            return {"trust": trust and replace(trust, resembles=updated)}
        after_it = f"{after[0].n_paired} of {after[0].n_measured} have one"
        statement = (
            f"{self.found[0].statement} The search ended after its first tries, none of which"
            f" explains the data; in the updated model {after_it}."
        )
        if any(finding.grave for finding in common["findings"]):
            return changed | {"message": f"{common['message']} {statement}"}
        beginning = common["message"].partition(". ")[0].removesuffix(".")
        changed |= {"message": f"{beginning}. {statement}", "remedy": self.remedy}
        if status == "converged":
            beginning = "The fit converged, but its result is not credible"
            changed |= {"status": "not-credible", "message": f"{beginning}. {statement}"}
        return changed


def _claim_resembles(found: Sequence[Counterparts]) -> Claim:
    """Return the claim that the models have modes of their tests, before the search."""
    claims = [one.claim for one in found]
    statement = " ".join(dict.fromkeys(claim.why for claim in claims))
    if not all(claim.asked for claim in claims):
        return Claim(None, statement, asked=False)
    return Claim(any(claim.holds for claim in claims), statement)
