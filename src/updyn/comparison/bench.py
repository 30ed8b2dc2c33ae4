"""The bench: what every method is given, one method on it, and the fewest lines of one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from updyn.comparison.fewest import Fewest, counts, errors_against, fewest_lines, own_answer
from updyn.comparison.given import Given
from updyn.comparison.rows import NOT_APPLICABLE, Row, figures_of
from updyn.errors import InputError, OptionError
from updyn.frf import FRF
from updyn.updating.fit.methods import method_class
from updyn.updating.fit.monitor import Progress
from updyn.updating.fit.reducing import is_reduced
from updyn.updating.fit.regularisation import check_regularise
from updyn.updating.problem.data import Test, split_data
from updyn.updating.problem.lines import choose_lines, d_optimal
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.parameters import CHANNELS, Parameter, ParameterSet
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.selection import Selection
from updyn.updating.result import JointResult, UpdateResult
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
        if self.callback is not None and self.callback(
            replace(progress, stage=f"{self.stage}: {progress.stage}")
        ):
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
    data : tuple of FRF
        What of each test is fitted, on its lines.
    """

    tests: tuple[Test, ...]
    parameters: ParameterSet
    given: Given
    running: Mapping[str, Any]
    data: tuple[FRF, ...]
    _subsets: dict[int, tuple[Test, ...]] = field(default_factory=dict, init=False)

    @classmethod
    def build(
        cls,
        tests: Sequence[Test],
        parameters: ParameterSet,
        given: Given,
        running: Mapping[str, Any],
    ) -> Bench:
        """Choose the lines once, for all methods, and see that what they are given fits together.

        Raises
        ------
        InputError
            If lines, noise or what is held out do not fit the data.
        """
        made, data = [], []
        for test in tests:
            held: Any = None if test.validation is None else list(test.validation)
            fitted = split_data(test.frf, held).fitted
            choose_noise(test.noise, fitted)
            if test.lines is None:
                lines = None
            elif isinstance(test.lines, str):
                lines = fitted.freq[
                    choose_lines(test.lines, _problem(test, fitted, parameters, running))
                ]
            else:
                lines = fitted.freq[fitted.find_lines(test.lines)]
            made.append(replace(test, validation=held, lines=lines))
            data.append(fitted if lines is None else fitted.select(lines=lines))
        return cls(tuple(made), parameters, given, running, tuple(data))

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
            message=first.message
            + ("" if self._regularises(name) else " It was run without regularisation."),
            updated=tuple(p.name for p in taken),
            left=tuple(p.name for p in self.parameters if p not in taken),
            values=values,
            std={n: result.std.get(n, np.nan) for n in self.parameters.names},
            errors=errors_against(values, self.given.truth, self.parameters),
            off={name: values[name] - true for name, true in self.given.truth.items()},
            fitted=fitted,
            held_out=held_out,
            rank=first.identifiability.rank,
            iterations=first.iterations,
            lines_solved=watch.lines_solved,
            n_lines=sum(len(frf.freq) for frf in self.data),
            seconds=first.timing_s["total"],
            result=result,
        )

    def refused(self, name: str, why: str) -> Row:
        """Return the row of a method that cannot be used."""
        return Row(
            **about(name), status=NOT_APPLICABLE, message=why, left=tuple(self.parameters.names)
        )

    def _fit(
        self, name: str, unknowns: ParameterSet, watch: Watch, tests: tuple[Test, ...]
    ) -> _Result:
        held = tuple(p for p in self.parameters if p not in unknowns)
        chosen = Selection(
            unknowns, left_out={p.name: f"{name} cannot update it" for p in held}, held=held
        )
        how = {**self.running, **self.given.options.get(name, {}), "callback": watch}
        if not self._regularises(name):
            del how["regularise"]
        if len(tests) == 1 and not tests[0].name:
            (t,) = tests
            return update(
                t.model, t.frf, chosen, name, t.lines, t.noise, validation=t.validation, **how
            )
        return update_jointly(tests, chosen, name, **how)

    def _regularises(self, name: str) -> bool:
        """Return whether a method takes what is asked for of regularisation; True where nothing is."""
        try:
            check_regularise(self.running["regularise"], name)
        except OptionError:
            return False
        return True

    # -- with few lines ------------------------------------------------------------------------------------
    def fewest(self, row: Row, watch: Watch) -> Fewest:
        """Seek the fewest lines with which a method that was run still recovers."""
        assert row.result is not None
        unknowns, stage = row.result.parameters, watch.stage
        n_lines = max(len(frf.freq) for frf in self.data)
        if self.given.options.get(row.method, {}).get("modes") is not None:
            return Fewest(
                None, note="it was given measured modes, and does not depend on the lines"
            )
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
        if row.status == "max-iterations" and distance(row.values) > 1.0:
            return Fewest(
                None, tried=((n_lines, distance(row.values)),)
            )  # what is slow with all is so with few
        numbers = counts(n_lines, sum(frf.values[0].size for frf in self.data), free)
        return fewest_lines(numbers, off, lambda count: _lines_of(self._on(count)[0]))

    def _distance(
        self, row: Row, unknowns: ParameterSet
    ) -> Callable[[Mapping[str, float]], float] | Fewest:
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
            made = [
                self._thinned(test, frf, count)
                for test, frf in zip(self.tests, self.data, strict=True)
            ]
            self._subsets[count] = tuple(made)
        return self._subsets[count]

    def _thinned(self, test: Test, frf: FRF, count: int) -> Test:
        """Return a test with so many of its lines."""
        n = len(frf.freq)
        if count >= n:
            at = np.arange(n)
        elif self.given.chosen == "d-optimal":
            at = d_optimal(_problem(test, frf, self.parameters, self.running), count)
        else:
            even = np.linspace(0, n - 1, count) if count > 1 else np.array([(n - 1) / 2])
            at = np.unique(even.round().astype(np.intp))
        return replace(test, lines=frf.freq[at])


def about(name: str) -> dict[str, Any]:
    """Return what is known of a method without running it: ``method``, ``reference``, ``cannot``, ``needs``."""
    made = method_class(name)
    cannot = dict.fromkeys(getattr(made, "cannot", ()))
    if not getattr(made, "calibrates", False):
        cannot |= dict.fromkeys(CHANNELS)
    return {
        "method": name,
        "reference": str(getattr(made, "reference", "")),
        "cannot": tuple(cannot),
        "needs": str(getattr(made, "needs", "")),
    }


def _acts_on(parameter: Parameter, quantities: Sequence[str]) -> bool:
    return any(drive.quantity in quantities for drive in parameter.acts_on)


def _problem(test: Test, frf: FRF, parameters: ParameterSet, running: Mapping[str, Any]) -> Problem:
    """Return what lines are chosen by; it is not kept, as a large model takes room."""
    tier = (
        "sparse"
        if is_reduced(running["tier"], test.model.n_dofs, len(frf.freq))
        else running["tier"]
    )
    return Problem.build(
        test.model, frf, parameters, tier=tier, backend=running["backend"], name=test.name
    )


def _lines_of(test: Test) -> tuple[float, ...]:
    return tuple(np.asarray(test.lines, dtype=np.float64).tolist())
