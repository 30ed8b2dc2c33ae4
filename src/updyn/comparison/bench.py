"""The bench: what every method is given, one method on it, and the fewest lines of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from updyn.comparison.fewest import Fewest, counts, errors_against, fewest_lines, own_answer
from updyn.comparison.given import Given
from updyn.comparison.rows import NOT_APPLICABLE, Row, figures_of
from updyn.errors import InputError
from updyn.updating.lines import d_optimal
from updyn.updating.methods import method_class
from updyn.updating.monitor import Progress
from updyn.updating.noise import choose_noise
from updyn.updating.parameters import Parameter, ParameterSet
from updyn.updating.problem import Problem
from updyn.updating.reducing import is_reduced
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.run import Test, on_lines
from updyn.updating.selected import Selection
from updyn.updating.split import split_data
from updyn.updating.update import update, update_jointly

__all__ = ["Bench", "Callback", "Watch", "about"]

Callback: TypeAlias = "Callable[[Progress], bool | None]"
_Result: TypeAlias = "UpdateResult | JointResult"


@dataclass(slots=True, eq=False)
class Watch:
    """Shows the steps of one fit as those of its method, counts its lines, and remembers a wish to stop.

    Attributes
    ----------
    callback : callable or None
        Of the caller.
    stage : str
        What is run.
    lines_solved : int
        In the latest fit, up to its latest step.
    stopped : bool
        Whether the caller has asked to stop.
    """

    callback: Callback | None
    stage: str = ""
    lines_solved: int = 0
    stopped: bool = False

    def __call__(self, progress: Progress) -> bool:
        """Show a step; return whether to stop."""
        self.lines_solved = progress.lines_done
        if self.callback is not None and self.callback(replace(progress, stage=f"{self.stage}: {progress.stage}")):
            self.stopped = True
        return self.stopped


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """What every method is given.

    Attributes
    ----------
    tests : tuple of Test
        With the lines that were chosen.
    parameters : ParameterSet
        The unknowns.
    given : Given
        What is asked for.
    running : mapping of str to object
        How fits are run.
    problems : tuple of Problem
        The tests on their lines.
    """

    tests: tuple[Test, ...]
    parameters: ParameterSet
    given: Given
    running: Mapping[str, Any]
    problems: tuple[Problem, ...]
    _subsets: dict[int, tuple[Test, ...]] = field(default_factory=dict, init=False)

    @classmethod
    def build(cls, tests: Sequence[Test], parameters: ParameterSet, given: Given, running: Mapping[str, Any]) -> Bench:
        """Choose the lines once, for all methods, and see that what they are given fits together.

        Raises
        ------
        InputError
            If lines, noise or what is held out do not fit the data.
        """
        made, problems = [], []
        lines = sum(len(test.frf.freq) for test in tests)
        tier = running["tier"]
        tier = "sparse" if is_reduced(tier, max(test.model.n_dofs for test in tests), lines) else tier
        for test in tests:
            held: Any = None if test.validation is None else list(test.validation)
            split = split_data(test.frf, held)
            choose_noise(test.noise, split.fitted)
            whole = Problem.build(
                test.model, split.fitted, parameters, tier=tier, backend=running["backend"], name=test.name
            )
            problem = on_lines(whole, test.lines)
            made.append(replace(test, validation=held, lines=None if problem is whole else problem.frf.freq))
            problems.append(problem)
        return cls(tuple(made), parameters, given, running, tuple(problems))

    # -- one method ----------------------------------------------------------------------------------------
    def row(self, name: str, watch: Watch) -> Row:
        """Run a method with the unknowns that it can update.

        Raises
        ------
        InputError
            If it cannot be used.
        SolverError
            If the model cannot be solved at a line where it starts.
        """
        known = about(name)
        taken = [p for p in self.parameters if not _acts_on(p, known["cannot"])]
        if not taken:
            quantities = " and ".join(q.replace("_", " ") for q in known["cannot"])
            return self.refused(name, f"it cannot update {quantities}, and nothing else is unknown")
        watch.lines_solved = 0
        result = self._fit(name, ParameterSet(tuple(taken)), watch, self.tests)
        values = {p.name: result.values.get(p.name, p.start) for p in self.parameters}
        first = result if isinstance(result, UpdateResult) else result.first
        fitted, held_out = figures_of(result)
        return Row(
            **known,
            status=result.status,
            message=first.message,
            updated=tuple(p.name for p in taken),
            left=tuple(p.name for p in self.parameters if p not in taken),
            values=values,
            std={n: result.std.get(n, np.nan) for n in self.parameters.names},
            errors=errors_against(values, self.given.truth, self.parameters),
            fitted=fitted,
            held_out=held_out,
            iterations=first.iterations,
            lines_solved=watch.lines_solved,
            n_lines=sum(problem.n_lines for problem in self.problems),
            seconds=first.timing_s["total"],
            result=result,
        )

    def refused(self, name: str, why: str) -> Row:
        """Return the row of a method that cannot be used."""
        return Row(**about(name), status=NOT_APPLICABLE, message=why, left=tuple(self.parameters.names))

    def _fit(self, name: str, unknowns: ParameterSet, watch: Watch, tests: tuple[Test, ...]) -> _Result:
        held = tuple(p for p in self.parameters if p not in unknowns)
        chosen = Selection(unknowns, left_out={p.name: f"{name} cannot update it" for p in held}, held=held)
        how = {**self.running, **self.given.options.get(name, {}), "callback": watch}
        if len(tests) == 1 and not tests[0].name:
            (t,) = tests
            return update(t.model, t.frf, chosen, name, t.lines, t.noise, validation=t.validation, **how)
        return update_jointly(tests, chosen, name, **how)

    # -- with few lines ------------------------------------------------------------------------------------
    def fewest(self, row: Row, watch: Watch) -> Fewest:
        """Seek the fewest lines with which a method that was run still recovers."""
        assert row.result is not None
        unknowns, stage = row.result.parameters, watch.stage
        n_lines = max(problem.n_lines for problem in self.problems)
        distance = self._distance(row, unknowns)
        if isinstance(distance, Fewest):
            return distance

        def off(count: int) -> float | None:
            if count == n_lines:
                return np.inf if row.status == "failed" else distance(row.values)
            watch.stage = f"{stage}, {count} of {n_lines} lines"
            try:
                result = self._fit(row.method, unknowns, watch, self._on(count))
            except InputError:  # so few lines are too few for it
                return np.inf
            finally:
                watch.stage = stage
            if watch.stopped:
                return None
            return np.inf if result.status == "failed" else distance(result.values)

        free = sum(1 for p in unknowns if p.prior_std is None)
        numbers = counts(n_lines, sum(p.n_values // p.n_lines for p in self.problems), free)
        return fewest_lines(numbers, off, lambda count: _lines_of(self._on(count)[0]))

    def _distance(self, row: Row, unknowns: ParameterSet) -> Callable[[Mapping[str, float]], float] | Fewest:
        """Return what tells how far values are off, as a multiple of what counts as recovered, or why nothing can."""
        truth, tolerance = self.given.truth, self.given.tolerance
        if not truth:
            assert row.result is not None
            if row.status != "converged":
                return Fewest(None, note=f"its own answer with all lines is {row.status}")
            return own_answer(row.result, tolerance)
        if not any(name in truth for name in unknowns.names):
            return Fewest(None, note="the truth of none of the unknowns that it updates is known")

        def distance(values: Mapping[str, float]) -> float:
            return max(abs(e) for e in errors_against(values, truth, unknowns).values()) / tolerance

        return distance

    def _on(self, count: int) -> tuple[Test, ...]:
        """Return the tests with so many of their lines; the same for every method."""
        if count not in self._subsets:
            chosen = [p.frf.freq[_positions(p, count, self.given.chosen)] for p in self.problems]
            self._subsets[count] = tuple(replace(t, lines=own) for t, own in zip(self.tests, chosen, strict=True))
        return self._subsets[count]


def about(name: str) -> dict[str, Any]:
    """Return what is known of a method without running it: ``method``, ``reference``, ``cannot``, ``needs``."""
    made = method_class(name)
    return {
        "method": name,
        "reference": str(getattr(made, "reference", "")),
        "cannot": tuple(getattr(made, "cannot", ())),
        "needs": str(getattr(made, "needs", "")),
    }


def _acts_on(parameter: Parameter, quantities: Sequence[str]) -> bool:
    return any(drive.quantity in quantities for drive in parameter.acts_on)


def _positions(problem: Problem, count: int, chosen: str) -> NDArray[np.intp]:
    n = problem.n_lines
    if count >= n:
        return np.arange(n)
    if chosen == "d-optimal":
        return d_optimal(problem, count)
    even = np.linspace(0, n - 1, count) if count > 1 else np.array([(n - 1) / 2])
    return np.unique(even.round().astype(np.intp))


def _lines_of(test: Test) -> tuple[float, ...]:
    return tuple(np.asarray(test.lines, dtype=np.float64).tolist())
