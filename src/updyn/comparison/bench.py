"""`compare` and `compare_jointly`: every method on the same model, data, lines and unknowns."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import repeat
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from updyn.comparison.fewest import (
    Fewest,
    describe_rule,
    distance_from_estimate,
    errors_against,
    find_fewest_lines,
    list_counts,
)
from updyn.comparison.table import NOT_APPLICABLE, Comparison, Row, figures_of, method_facts
from updyn.dofs import Dof
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine, opened_engine
from updyn.errors import InputError, OptionError, ParameterError, suggest
from updyn.frf import FRF
from updyn.model import Model
from updyn.progress import asks_to_stop
from updyn.updating.fit.methods import METHODS, make_method
from updyn.updating.fit.monitor import CAUSES, FAULTS, JUDGE, Progress
from updyn.updating.fit.reducing import is_reduced
from updyn.updating.fit.regularisation import check_regularise
from updyn.updating.problem.data import Test, check_tests, leave_out_undefined_line, split_data
from updyn.updating.problem.lines import choose_lines, select_d_optimal
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.parameters import Parameter, ParameterSet, check_finite
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.selection import Selection
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.run import run
from updyn.updating.setup import RunOptions
from updyn.updating.update import update, update_jointly

if TYPE_CHECKING:
    from distributed import Client

__all__ = [
    "CHOSEN",
    "Bench",
    "Callback",
    "Options",
    "StepCounter",
    "build_line_problem",
    "compare",
    "compare_jointly",
]

Callback: TypeAlias = "Callable[[Progress], bool | None]"
_Result: TypeAlias = "UpdateResult | JointResult"


@dataclass(slots=True, eq=False)
class StepCounter:
    """Callback of one fit that forwards its steps, counts its lines, and records a stop.

    `stage` is the prefix of the stage of every step: the method, with the number of lines unless
    all are used. `lines_solved` excludes the assessment of the result.
    """

    callback: Callback | None
    stage: str = ""
    lines_solved: int = 0
    stopped: bool = False

    def __call__(self, progress: Progress) -> bool:
        """Forward a step; return whether to stop."""
        if progress.stage not in (FAULTS, JUDGE, CAUSES):
            self.lines_solved = progress.lines_done
        if self.callback is not None:
            shown = replace(progress, stage=f"{self.stage}: {progress.stage}")
            self.stopped = asks_to_stop(self.callback(shown)) or self.stopped
        return self.stopped


#: Ways to choose the fewest lines.
CHOSEN = ("d-optimal", "even")


@dataclass(frozen=True, slots=True)
class Options:
    """The options of a comparison, checked.

    `tolerance` is the error below which an unknown counts as recovered, `fewest` states whether to
    seek the fewest lines, and `chosen` how to choose them.
    """

    methods: tuple[str, ...]
    by_method: Mapping[str, Mapping[str, Any]]
    truth: Mapping[str, float]
    fewest: bool
    tolerance: float
    chosen: str
    title: str

    @classmethod
    def check(
        cls,
        parameters: ParameterSet,
        methods: Iterable[str] | None,
        options: Mapping[str, Mapping[str, object]] | None,
        truth: Mapping[str, float] | None,
        *,
        fewest: bool = False,
        tolerance: float = 0.01,
        chosen: str = "d-optimal",
        title: str = "",
    ) -> Options:
        """Check the arguments of `updyn.compare`; `InputError` if one is unknown or invalid."""
        options = options or {}
        names = _check_methods(methods, options)
        if chosen not in CHOSEN:
            raise OptionError(f"chosen {chosen!r}: {suggest(str(chosen), CHOSEN)}")
        return cls(
            names,
            options,
            _check_truth(truth, parameters),
            fewest,
            _check_tolerance(tolerance),
            chosen,
            title,
        )


def _check_methods(
    given: Iterable[str] | None, options: Mapping[str, Mapping[str, object]]
) -> tuple[str, ...]:
    """Return the methods to run; raise for a wrong name or wrong options."""
    if isinstance(given, str):
        raise OptionError(f"methods {given!r}: expected a list of names, such as [{given!r}]")
    if given is None:
        given = METHODS
    names = tuple(given)
    if not names:
        raise OptionError(f"methods: expected at least one; {suggest('', METHODS)}")
    for name in [*names, *options]:
        make_method(name, options.get(name, {}))
    for name in names:
        if names.count(name) > 1:
            raise OptionError(f"methods: {name!r} occurs twice")
    return names


def _check_truth(given: Mapping[str, float] | None, parameters: ParameterSet) -> dict[str, float]:
    """Return true values, checked against the unknowns."""
    if given is None:
        return {}
    known = dict(zip(parameters.names, parameters, strict=True))
    out = {}
    for name, value in given.items():
        if name not in known:
            raise ParameterError(f"truth: no unknown {name!r}; {suggest(str(name), known)}")
        out[name] = check_finite(value, f"truth of {name!r}")
        if known[name].is_factor and out[name] <= 0.0:
            raise ParameterError(f"truth of {name!r}: {out[name]:g}; expected a factor above 0")
        if out[name] < 0.0:
            raise ParameterError(
                f"truth of {name!r}: {out[name]:g}; expected a value of at least 0"
            )
    if not out:
        raise ParameterError("truth: contains no value; omit it if the truth is unknown")
    return out


def _check_tolerance(given: float) -> float:
    tolerance = check_finite(given, "tolerance")
    if tolerance <= 0.0:
        raise OptionError(f"tolerance {tolerance:g}: expected a number above 0")
    return tolerance


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """The common inputs of all methods: tests with the chosen lines, and `data` on these lines."""

    tests: tuple[Test, ...]
    parameters: ParameterSet
    options: Options
    fit_options: Mapping[str, Any]
    data: tuple[FRF, ...]
    _subsets: dict[int, tuple[Test, ...]] = field(default_factory=dict, init=False)

    @classmethod
    def build(
        cls,
        tests: Sequence[Test],
        parameters: ParameterSet,
        options: Options,
        fit_options: Mapping[str, Any],
    ) -> Bench:
        """Choose the lines once for all methods, and check the inputs for consistency."""
        with_lines, data = [], []
        for test in map(leave_out_undefined_line, tests):
            held: Any = test.validation
            if held is not None:
                held = list(held)
            fitted = split_data(test.frf, held).fitted
            choose_noise(test.noise, fitted)
            if test.lines is None:
                with_lines.append(replace(test, validation=held))
                data.append(fitted)
                continue
            if isinstance(test.lines, str):
                at = choose_lines(
                    test.lines, build_line_problem(test, fitted, parameters, fit_options)
                )
            else:
                at = fitted.find_lines(test.lines)
            lines = fitted.freq[at]
            with_lines.append(replace(test, validation=held, lines=lines))
            data.append(fitted.select(lines=lines))
        return cls(tuple(with_lines), parameters, options, fit_options, tuple(data))

    @property
    def _n_lines(self) -> list[int]:
        return [len(frf.freq) for frf in self.data]

    # -- one method ----------------------------------------------------------------------------
    def run_method(self, name: str, counter: StepCounter) -> Row:
        """Run a method with the unknowns that it can update."""
        facts = method_facts(name)
        updatable: list[Parameter] = []
        fixed: list[str] = []
        for parameter in self.parameters:
            if _acts_on(parameter, facts["cannot"]):
                fixed.append(parameter.name)
            else:
                updatable.append(parameter)
        if not updatable:
            quantities = " and ".join(facts["cannot"]).replace("_", " ")
            return self.make_inapplicable_row(
                name, f"it cannot update {quantities}, and nothing else is unknown"
            )
        counter.lines_solved = 0
        unknowns = ParameterSet(tuple(updatable))
        result = self._fit(name, unknowns, counter, self.tests)
        first = result.first
        message = first.message
        if not self._regularises(name):
            message += " It was run without regularisation."
        values: dict[str, float] = {}
        std: dict[str, float] = {}
        for parameter in self.parameters:
            values[parameter.name] = result.values.get(parameter.name, parameter.start)
            std[parameter.name] = result.std.get(parameter.name, np.nan)
        fitted, held_out = figures_of(result)
        truth = self.options.truth
        return Row(
            **facts,
            status=result.status,
            message=message,
            updated=tuple(unknowns.names),
            fixed=tuple(fixed),
            values=values,
            std=std,
            errors=errors_against(values, truth, self.parameters),
            off={name: values[name] - true for name, true in truth.items()},
            fitted=fitted,
            held_out=held_out,
            rank=first.identifiability.rank,
            iterations=first.iterations,
            lines_solved=counter.lines_solved,
            n_lines=sum(self._n_lines),
            seconds=first.timing_s["total"],
            result=result,
        )

    def make_inapplicable_row(self, name: str, why: str) -> Row:
        """Return the row of a method that does not apply."""
        fixed = tuple(self.parameters.names)
        return Row(**method_facts(name), status=NOT_APPLICABLE, message=why, fixed=fixed)

    def _fit(
        self, name: str, unknowns: ParameterSet, counter: StepCounter, tests: tuple[Test, ...]
    ) -> _Result:
        selection = self._make_selection(name, unknowns)
        keywords = {
            **self._select_fit_options(name),
            **self._find_method_options(name),
            "callback": counter,
        }
        if len(tests) > 1 or tests[0].name:
            return update_jointly(tests, selection, name, **keywords)
        (t,) = tests
        return update(
            t.model, t.frf, selection, name, t.lines, t.noise, validation=t.validation, **keywords
        )

    def _fit_few(
        self, name: str, unknowns: ParameterSet, counter: StepCounter, tests: tuple[Test, ...]
    ) -> UpdateResult:
        """Fit with few lines, without a search for causes, as only the values are used."""
        method_options, fit_options = (
            self._find_method_options(name),
            self._select_fit_options(name),
        )
        options = RunOptions(
            name, method_options, callback=counter, seek_causes=False, **fit_options
        )
        return run(tests, self._make_selection(name, unknowns), options)[0]

    def _make_selection(self, name: str, unknowns: ParameterSet) -> Selection:
        """Return the unknowns of a fit; those that the method cannot update are held fixed."""
        held = []
        left_out = {}
        for parameter in self.parameters:
            if parameter not in unknowns:
                held.append(parameter)
                left_out[parameter.name] = f"{name} cannot update it"
        return Selection(unknowns, left_out=left_out, held=tuple(held))

    def _find_method_options(self, name: str) -> Mapping[str, object]:
        return self.options.by_method.get(name, {})

    def _select_fit_options(self, name: str) -> dict[str, Any]:
        """Return the common fit options that a method accepts."""
        fit_options = dict(self.fit_options)
        if not self._regularises(name):
            del fit_options["regularise"]
        return fit_options

    def _regularises(self, name: str) -> bool:
        """Return whether a method accepts the requested regularisation, if any."""
        try:
            check_regularise(self.fit_options["regularise"], name)
        except OptionError:
            return False
        return True

    # -- with few lines ------------------------------------------------------------------------
    def find_fewest(self, row: Row, counter: StepCounter) -> Fewest:
        """Return the fewest lines with which a method still recovers the unknowns."""
        assert row.result is not None
        unknowns, stage = row.result.parameters, counter.stage
        n_lines = max(self._n_lines)
        if self.options.by_method.get(row.method, {}).get("modes") is not None:
            note = "it was given measured modes, and does not depend on the lines"
            return Fewest(None, note=note)
        distance = self._make_distance(row, unknowns)
        if isinstance(distance, Fewest):
            return distance
        if row.status == "max-iterations" and distance(row.values) > 1.0:
            # A method that is slow with all lines is slow with few.
            return Fewest(None, tried=((n_lines, distance(row.values)),))

        def distance_with(count: int) -> float | None:
            if count == n_lines:
                return distance_of(row)
            counter.stage = f"{stage}, {count} of {n_lines} lines"
            try:
                result = self._fit_few(row.method, unknowns, counter, self._select_lines(count))
            except InputError:  # too few lines for the method
                return np.inf
            finally:
                counter.stage = stage
            if counter.stopped:
                return None
            return distance_of(result)

        def distance_of(fit: Row | _Result) -> float:
            if fit.status == "failed":
                return np.inf
            return distance(fit.values)

        def lines_of(count: int) -> tuple[float, ...]:
            first = self._select_lines(count)[0]
            return tuple(np.asarray(first.lines, dtype=np.float64).tolist())

        free = sum(p.prior_std is None for p in unknowns)
        values_a_line = sum(frf.values[0].size for frf in self.data)
        return find_fewest_lines(list_counts(n_lines, values_a_line, free), distance_with, lines_of)

    def _make_distance(
        self, row: Row, unknowns: ParameterSet
    ) -> Callable[[Mapping[str, float]], float] | Fewest:
        """Return a function that is at most 1 for recovered values, or why it is undefined."""
        truth, tolerance = self.options.truth, self.options.tolerance
        if not truth:
            assert row.result is not None
            if row.status != "converged":
                return Fewest(None, note=f"its estimate with all lines is {row.status}")
            return distance_from_estimate(row.result, tolerance)
        if truth.keys().isdisjoint(unknowns.names):
            return Fewest(None, note="the truth of none of the unknowns that it updates is known")

        def distance(values: Mapping[str, float]) -> float:
            return max(map(abs, errors_against(values, truth, unknowns).values())) / tolerance

        return distance

    def _select_lines(self, count: int) -> tuple[Test, ...]:
        if count not in self._subsets:
            thinned = map(self._thin_test, self.tests, self.data, repeat(count))
            self._subsets[count] = tuple(thinned)
        return self._subsets[count]

    def _thin_test(self, test: Test, frf: FRF, count: int) -> Test:
        n = len(frf.freq)
        if count >= n:
            at = np.arange(n)
        elif self.options.chosen == "d-optimal":
            at = select_d_optimal(
                build_line_problem(test, frf, self.parameters, self.fit_options), count
            )
        elif count == 1:
            at = np.array([round((n - 1) / 2)])
        else:
            at = np.unique(np.linspace(0, n - 1, count).round().astype(np.intp))
        return replace(test, lines=frf.freq[at])


def _acts_on(parameter: Parameter, quantities: Sequence[str]) -> bool:
    return any(drive.quantity in quantities for drive in parameter.acts_on)


def build_line_problem(
    test: Test, frf: FRF, parameters: ParameterSet, fit_options: Mapping[str, Any]
) -> FRFPart:
    """Return the problem for choosing lines; callers do not keep it, as it may be large."""
    tier = fit_options["tier"]
    if is_reduced(tier, test.model.n_dofs, len(frf.freq)):
        tier = "sparse"
    return FRFPart.build(
        test.model, frf, parameters, tier=tier, backend=fit_options["backend"], name=test.name
    )


# -- the public functions ----------------------------------------------------------------------
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
    accuracy: float = REDUCTION.accuracy,
    regularise: str | float | None = None,
) -> Comparison:
    """Run every method on the same model, measurement, lines and unknowns.

    The row of a method that does not apply gives the reason. A method that cannot update some of
    the quantities is run with the other unknowns, and its row lists the unknowns kept at their
    start.

    Parameters
    ----------
    model, frf, parameters
        As for `updyn.update`.
    methods : iterable of str, optional
        Names; by default all methods.
    lines, noise, engine
        As for `updyn.update`. Lines are chosen once for all methods.
    callback : callable, optional
        As for `updyn.update`; the stage of the progress begins with the method. Returning True
        ends the comparison with the rows so far.
    truth : mapping of str to float, optional
        Known true values of unknowns, by name; the rows then contain errors.
    validation
        As for `updyn.update`.
    fewest : bool
        Whether to find the fewest lines with which each method still recovers the unknowns, which
        takes several fits per method.
    tolerance : float
        Error below which an unknown counts as recovered: relative to the truth (absolute for a
        loss factor); or, without a truth, relative to the method's estimate with all lines, with a
        tolerance of at least 3 standard deviations.
    chosen : {"d-optimal", "even"}
        Way to choose the fewest lines among the lines.
    options : mapping of str to mapping, optional
        Options by method.
    title, tier, backend, accuracy, regularise
        As for `updyn.update`. Methods that do not support the regularisation are run without it,
        which their rows mention.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If model, data and unknowns are inconsistent, or an option, a method or a true value is
        unknown.
    SolverError
        If the model cannot be solved at its start values.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> found = updyn.compare(model, frf, unknowns, ["equation-error", "log"])
    >>> found["log"].status
    'converged'
    """
    selected = Selection.of(parameters)
    test = Test(model, frf, "", lines, noise, validation)
    check_tests([test], selected.parameters)
    checked = Options.check(
        selected.parameters,
        methods,
        options,
        truth,
        fewest=fewest,
        tolerance=tolerance,
        chosen=chosen,
        title=title,
    )
    fit_options = {"tier": tier, "backend": backend, "accuracy": accuracy, "regularise": regularise}
    return _compare([test], selected, checked, fit_options, engine, callback)


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
    options: Mapping[str, Mapping[str, object]] | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
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
        As for `compare`. The fewest lines are counted per test.

    Returns
    -------
    Comparison
        Figures of agreement are those of the test with the worst agreement.

    Raises
    ------
    InputError
        If models, data and unknowns are inconsistent, or an option, a method or a true value is
        unknown.
    SolverError
        If a model cannot be solved at its start values.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> halves = [frf.select(references=[r]) for r in frf.references.labels]
    >>> tests = [updyn.Test(model, h, name=n) for h, n in zip(halves, ["a", "b"], strict=True)]
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> updyn.compare_jointly(tests, unknowns, ["log"])["log"].status
    'converged'
    """
    named = []
    for number, test in enumerate(tests, 1):
        if not isinstance(test, Test):
            raise OptionError(
                f"compare_jointly: item {number} is {type(test).__name__}, not a Test"
            )
        named.append(replace(test, name=test.name or f"test {number}"))
    if not named:
        raise OptionError("compare_jointly: expected a sequence of at least one Test")
    selected = Selection.of(parameters)
    check_tests(named, selected.parameters)
    checked = Options.check(
        selected.parameters,
        methods,
        options,
        truth,
        fewest=fewest,
        tolerance=tolerance,
        chosen=chosen,
        title=title,
    )
    fit_options = {"tier": tier, "backend": backend, "accuracy": accuracy, "regularise": regularise}
    return _compare(named, selected, checked, fit_options, engine, callback)


def _compare(
    tests: Sequence[Test],
    selected: Selection,
    options: Options,
    fit_options: Mapping[str, Any],
    engine: int | Client | Engine | None,
    callback: Callback | None,
) -> Comparison:
    parameters = selected.parameters
    tests = [replace(test, model=selected.start_of(test.model)) for test in tests]
    check_regularise(fit_options["regularise"], "maximum-likelihood")
    rows: list[Row] = []
    refusals: list[InputError] = []
    counter = StepCounter(callback)
    with opened_engine(engine) as opened:
        fit_options = {**fit_options, "engine": opened, "title": options.title}
        bench = Bench.build(tests, parameters, options, fit_options)
        for number, name in enumerate(options.methods, 1):
            counter.stage = name
            if len(options.methods) > 1:
                counter.stage += f" ({number} of {len(options.methods)})"
            try:
                row = bench.run_method(name, counter)
            except InputError as error:
                refusals.append(error)
                row = bench.make_inapplicable_row(name, str(error))
            if options.fewest and row.applies and not counter.stopped:
                row = replace(row, fewest=bench.find_fewest(row, counter))
            rows.append(row)
            if counter.stopped:
                break
    if len(refusals) == len(rows) > 1 and len(set(map(str, refusals))) == 1:
        raise refusals[0]  # the inputs are wrong, not the methods
    searched = ""
    if options.fewest:
        searched = describe_rule(options.tolerance, options.chosen, truth=bool(options.truth))
    return Comparison(
        tuple(rows),
        bench.tests,
        parameters,
        options.truth,
        options.tolerance,
        searched,
        counter.stopped,
        options.methods[len(rows) :],
        options.title,
    )
