"""`compare` and `compare_jointly`: every method on the same model, data, lines and unknowns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from updyn.comparison.bench import Bench, Callback, Watch
from updyn.comparison.fewest import rule
from updyn.comparison.given import Given
from updyn.comparison.rows import Comparison, Row
from updyn.dofs import Dof
from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine, choose_engine
from updyn.errors import InputError, OptionError
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit.regularisation import check_regularise
from updyn.updating.problem.data import Test, check
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["compare", "compare_jointly"]


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
