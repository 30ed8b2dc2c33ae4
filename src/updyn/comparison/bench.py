"""The bench: what every method is given, one method on it, and the fewest lines of one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from updyn.comparison.fewest import Fewest, counts, errors_against, fewest_lines, own_answer, rule
from updyn.comparison.table import NOT_APPLICABLE, Comparison, Row, about, figures_of
from updyn.dofs import Dof
from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine, choose_engine
from updyn.errors import InputError, OptionError, ParameterError, suggest
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit.methods import METHODS, make_method
from updyn.updating.fit.monitor import Progress
from updyn.updating.fit.reducing import is_reduced
from updyn.updating.fit.regularisation import check_regularise
from updyn.updating.problem.data import Test, check, split_data
from updyn.updating.problem.lines import choose_lines, d_optimal
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.parameters import Parameter, ParameterSet, finite
from updyn.updating.problem.problem import Part
from updyn.updating.problem.selection import Selection
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.update import update, update_jointly

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "CHOSEN",
    "Bench",
    "Callback",
    "Given",
    "Watch",
    "compare",
    "compare_jointly",
]

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
        first = result.first
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


def _acts_on(parameter: Parameter, quantities: Sequence[str]) -> bool:
    return any(drive.quantity in quantities for drive in parameter.acts_on)


def _problem(test: Test, frf: FRF, parameters: ParameterSet, running: Mapping[str, Any]) -> Part:
    """Return what lines are chosen by; it is not kept, as a large model takes room."""
    tier = (
        "sparse"
        if is_reduced(running["tier"], test.model.n_dofs, len(frf.freq))
        else running["tier"]
    )
    return Part.build(
        test.model, frf, parameters, tier=tier, backend=running["backend"], name=test.name
    )


def _lines_of(test: Test) -> tuple[float, ...]:
    return tuple(np.asarray(test.lines, dtype=np.float64).tolist())


#: How the fewest lines are chosen.
CHOSEN = ("d-optimal", "even")


@dataclass(frozen=True, slots=True)
class Given:
    """What the caller asks for, valid in itself.

    Attributes
    ----------
    methods : tuple of str
        Names, each once.
    options : mapping of str to mapping
        Options by method.
    truth : mapping of str to float
        By unknown; empty where it is not known.
    fewest : bool
        Whether the fewest lines are sought.
    tolerance : float
        What counts as recovered.
    chosen : str
        How the fewest lines are chosen.
    title : str
        For the record.
    """

    methods: tuple[str, ...]
    options: Mapping[str, Mapping[str, Any]]
    truth: Mapping[str, float]
    fewest: bool
    tolerance: float
    chosen: str
    title: str

    @classmethod
    def checked(
        cls,
        parameters: ParameterSet,
        methods: Iterable[str] | None,
        options: Mapping[str, Mapping[str, Any]] | None,
        truth: Mapping[str, float] | None,
        *,
        fewest: bool = False,
        tolerance: float = 0.01,
        chosen: str = "d-optimal",
        title: str = "",
    ) -> Given:
        """Check the arguments of `updyn.compare`.

        Raises
        ------
        InputError
            If one is not known or not valid.
        """
        options = options or {}
        names = _methods(methods, options)
        if chosen not in CHOSEN:
            raise OptionError(f"chosen {chosen!r}: {suggest(str(chosen), CHOSEN)}")
        return cls(
            names, options, _truth(truth, parameters), fewest, _tolerance(tolerance), chosen, title
        )


def _methods(
    given: Iterable[str] | None, options: Mapping[str, Mapping[str, Any]]
) -> tuple[str, ...]:
    if isinstance(given, str):
        raise OptionError(f"methods {given!r}: expected a list of names, such as [{given!r}]")
    names = tuple(METHODS if given is None else given)
    if not names:
        raise OptionError(f"methods: expected at least one; {suggest('', METHODS)}")
    for name in [*names, *options]:
        make_method(
            name, options.get(name, {})
        )  # what is wrong with its name or options is wrong with the input
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice:
        raise OptionError(f"methods: {twice[0]!r} stands twice")
    return names


def _truth(given: Mapping[str, float] | None, parameters: ParameterSet) -> dict[str, float]:
    if given is None:
        return {}
    known = {p.name: p for p in parameters}
    out = {}
    for name, value in given.items():
        if name not in known:
            raise ParameterError(f"truth: no unknown {name!r}; {suggest(str(name), known)}")
        out[name] = finite(value, f"truth of {name!r}")
        if out[name] <= 0.0 if known[name].is_factor else out[name] < 0.0:
            expected = "a factor above 0" if known[name].is_factor else "a value of at least 0"
            raise ParameterError(f"truth of {name!r}: {out[name]:g}; expected {expected}")
    if not out:
        raise ParameterError("truth: holds no value; leave it out where the truth is not known")
    return out


def _tolerance(given: float) -> float:
    tolerance = finite(given, "tolerance")
    if tolerance <= 0.0:
        raise OptionError(f"tolerance {tolerance:g}: expected a number above 0")
    return tolerance


def compare(
    model: Model,
    frf: FRF,
    parameters: ParameterSet | Selection,
    methods: Iterable[str] | None = None,
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float] | str | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callback | None = None,
    *,
    truth: Mapping[str, float] | None = None,
    validation: Iterable[str | Dof] | tuple[float, float] | None = None,
    fewest: bool = False,
    tolerance: float = 0.01,
    chosen: str = "d-optimal",
    options: Mapping[str, Mapping[str, Any]] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = ACCURACY,
    regularise: str | float | None = None,
) -> Comparison:
    """Run every method on the same model, measurement, lines and unknowns.

    A method that cannot be used on them is a row that says why. One that cannot update some of the
    quantities is run with the other unknowns, and its row says which were left at their start.

    Parameters
    ----------
    model, frf, parameters
        As for `updyn.update`.
    methods : iterable of str, optional
        Names; by default every method that there is.
    lines, noise, engine
        As for `updyn.update`. Lines that are to be chosen are chosen once, for all methods.
    callback : callable, optional
        As for `updyn.update`; the stage of what it is shown begins with the method. Returning True
        ends the comparison, with the rows so far.
    truth : mapping of str to float, optional
        True values of unknowns, by name, as far as they are known: then the rows hold the errors,
        too.
    validation
        As for `updyn.update`.
    fewest : bool
        Also seek the fewest lines with which each method still recovers; that takes several fits a
        method.
    tolerance : float
        What counts as recovered: so far from the truth, as a share of it (of a loss factor as it
        is); or, where no truth is given, so far or 3 standard deviations from the method's own
        answer with all lines.
    chosen : {"d-optimal", "even"}
        How the fewest lines are chosen among the lines.
    options : mapping of str to mapping, optional
        Options by method.
    title, tier, backend, accuracy, regularise
        As for `updyn.update`. Methods that know no regularisation are run without it, and their
        rows say so.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If model, data and unknowns do not fit together, or an option, a method or a true value is
        not known.
    SolverError
        If the model cannot be solved at a line where it starts.
    """
    selected = Selection.of(parameters)
    test = Test(model, frf, "", lines, noise, validation)
    check([test], selected.parameters)
    given = Given.checked(
        selected.parameters,
        methods,
        options,
        truth,
        fewest=fewest,
        tolerance=tolerance,
        chosen=chosen,
        title=title,
    )
    how = {"tier": tier, "backend": backend, "accuracy": accuracy, "regularise": regularise}
    return _compare([test], selected, given, how, engine, callback)


def compare_jointly(
    tests: Sequence[Test],
    parameters: ParameterSet | Selection,
    methods: Iterable[str] | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callback | None = None,
    *,
    truth: Mapping[str, float] | None = None,
    fewest: bool = False,
    tolerance: float = 0.01,
    chosen: str = "d-optimal",
    options: Mapping[str, Mapping[str, Any]] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = ACCURACY,
    regularise: str | float | None = None,
) -> Comparison:
    """Run every method on several tests of one structure at once.

    Parameters
    ----------
    tests : sequence of Test
        As for `updyn.update_jointly`.
    parameters, methods, engine, callback
        As for `compare`.
    truth, fewest, tolerance, chosen, options, title, tier, backend, accuracy, regularise
        As for `compare`. The fewest lines are so many of each test.

    Returns
    -------
    Comparison
        Figures of agreement are those of the test that agrees worst.

    Raises
    ------
    InputError
        If models, data and unknowns do not fit together, or an option, a method or a true value is
        not known.
    SolverError
        If a model cannot be solved at a line where it starts.
    """
    listed = list(tests)
    if not listed or not all(isinstance(test, Test) for test in listed):
        raise OptionError("compare_jointly: expected a sequence of at least one Test")
    selected = Selection.of(parameters)
    check(listed, selected.parameters)
    given = Given.checked(
        selected.parameters,
        methods,
        options,
        truth,
        fewest=fewest,
        tolerance=tolerance,
        chosen=chosen,
        title=title,
    )
    named = [
        replace(test, name=test.name or f"test {number}") for number, test in enumerate(listed, 1)
    ]
    how = {"tier": tier, "backend": backend, "accuracy": accuracy, "regularise": regularise}
    return _compare(named, selected, given, how, engine, callback)


def _compare(
    tests: Sequence[Test],
    selected: Selection,
    given: Given,
    how: Mapping[str, Any],
    engine: int | Client | Engine | None,
    callback: Callback | None,
) -> Comparison:
    names, rows, parameters = given.methods, list[Row](), selected.parameters
    tests = [replace(test, model=selected.start_of(test.model)) for test in tests]
    refusals: list[InputError] = []
    watch = Watch(callback)
    check_regularise(how["regularise"], "maximum-likelihood")
    with ExitStack() as ending:
        made = choose_engine(engine)
        if made is not engine:
            ending.callback(made.close)
        bench = Bench.build(tests, parameters, given, {**how, "engine": made, "title": given.title})
        for number, name in enumerate(names, 1):
            watch.stage = f"{name} ({number} of {len(names)})" if len(names) > 1 else name
            try:
                row = bench.row(name, watch)
            except InputError as error:
                refusals.append(error)
                row = bench.refused(name, str(error))
            if given.fewest and row.applies and not watch.stopped:
                row = replace(row, fewest=bench.fewest(row, watch))
            rows.append(row)
            if watch.stopped:
                break
    if len(refusals) == len(rows) > 1 and len({str(error) for error in refusals}) == 1:
        raise refusals[0]  # it is not the methods that do not fit
    return Comparison(
        tuple(rows),
        bench.tests,
        parameters,
        given.truth,
        given.tolerance,
        rule(given.tolerance, given.chosen, truth=bool(given.truth)) if given.fewest else "",
        watch.stopped,
        names[len(rows) :],
        given.title,
    )
