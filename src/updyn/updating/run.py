"""Run of an update, from tests and unknowns to one result for each test."""

from __future__ import annotations

import platform
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from updyn import __version__
from updyn.dynamics.fields import ACCURACY
from updyn.engines import Engine, opened_engine
from updyn.errors import OptionError, SolverError, UpdynWarning
from updyn.frf import FRF, ROUNDING
from updyn.group import is_number
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.positions import warn_of_labels
from updyn.updating.before_search import ModeComparison
from updyn.updating.fit.checkpoint import Checkpoint, checkpoint_session, fingerprint
from updyn.updating.fit.method import Fit, Method
from updyn.updating.fit.methods import check_channels, check_modes, make_method, options_of
from updyn.updating.fit.monitor import JUDGE, Monitor, Progress
from updyn.updating.fit.reducing import FINEST, Reducing, is_reduced, record_fallback
from updyn.updating.fit.regularisation import add_regularisation, check_regularise
from updyn.updating.judge.alternatives import find_differences, select_distinct
from updyn.updating.judge.assessment import Judgement, judge_fit
from updyn.updating.judge.causes.of_run import Causes, CauseSearch
from updyn.updating.judge.distant import find_distant_unknowns
from updyn.updating.judge.ending import assess_ending
from updyn.updating.judge.trust import judge_result
from updyn.updating.judge.verdict import (
    add_causes,
    compose_verdict,
    explain_ambiguity,
    explain_early_end,
    explain_rejection,
    join_steps,
    rule_out_faults,
)
from updyn.updating.own_noise import SensorNoiseFit
from updyn.updating.problem.data import (
    ModalSplit,
    Split,
    Test,
    check_measured,
    check_tests,
    has_quantity,
    list_validation,
    split_data,
    split_modes,
)
from updyn.updating.problem.lines import Lines, restrict_to_lines
from updyn.updating.problem.modal import ModalPart, check_any_pair
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.noise.modes import choose_modal_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.selection import Selection
from updyn.updating.problem.session import RecentCache, Session, Stopped
from updyn.updating.result import UpdateResult

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["RunOptions", "run"]

#: Relative change of each unknown at the start if the model is singular there.
_ASIDE = 1e-3


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of the run of an update; most are the arguments of `updyn.update` of the same name.

    Attributes
    ----------
    method : str
        Name of the method.
    method_options : mapping of str to object
        Options of the method.
    engine : None, int, dask.distributed Client or Engine
        Engine that evaluates lines and tries of the search.
    callback : callable or None
        Called with a `Progress` after every step and between blocks of lines.
    title : str
        Title of the update.
    tier : {"dense", "sparse", "reduced"} or None
        How the model is solved.
    backend : str or None
        Sparse factorisation.
    accuracy : float
        Accuracy of the reduced tier.
    checkpoint : path or None
        File that receives every evaluation.
    resume : bool
        Whether to continue the run in `checkpoint`.
    regularise : None, str or float
        Regularisation of the unknowns.
    seek_causes : bool
        Whether to search for causes of the residual after the fit.
    """

    method: str = "maximum-likelihood"
    method_options: Mapping[str, Any] = field(default_factory=dict)
    engine: int | Client | Engine | None = None
    callback: Callable[[Progress], bool | None] | None = None
    title: str = ""
    tier: str | None = None
    backend: str | None = None
    accuracy: float = ACCURACY
    checkpoint: str | Path | None = None
    resume: bool = False
    regularise: str | float | None = None
    seek_causes: bool = True


def run(
    tests: Sequence[Test], parameters: ParameterSet | Selection, options: RunOptions
) -> list[UpdateResult]:
    """Fit the unknowns to all tests and return one result for each.

    Raises
    ------
    InputError
        If models, data, unknowns or options do not fit together, or the checkpoint to resume
        belongs to another run.
    SolverError
        If a model cannot be solved at its start, at one of the lines.
    """
    start_time = time.perf_counter()
    _check_kinds(options)
    if isinstance(options.regularise, np.generic):  # plain type, for the record and the fingerprint
        options = replace(options, regularise=options.regularise.item())
    strategy = make_method(options.method, options.method_options)
    driver = add_regularisation(strategy, options.method, options.regularise)
    selection = Selection.of(parameters)
    unknowns = selection.parameters
    tests = [replace(test, model=selection.start_of(test.model)) for test in tests]
    check_tests(tests, unknowns)
    for test in tests:
        if isinstance(test.data, FRF):
            warn_of_labels(test.model, test.data)
    check_channels(unknowns, strategy)
    for i, test in enumerate(tests):
        if test.validation is not None:  # read once, for the fit and for the fingerprint
            tests[i] = replace(test, validation=list_validation(test.validation))
    of_frfs = [test for test in tests if isinstance(test.data, FRF)]
    splits = [split_data(test.frf, test.validation) for test in of_frfs]
    for test, split in zip(of_frfs, splits, strict=True):
        check_measured(split.fitted, test.name)
    noises = [
        choose_noise(test.noise, split.fitted) for test, split in zip(of_frfs, splits, strict=True)
    ]
    check_modes(tests, strategy)
    if not of_frfs:
        _check_without_lines(options)
    before = ModeComparison.of(tests, unknowns, options.method_options)
    before.warn()
    modal_splits = [
        split_modes(test.data, test.validation) for test in tests if isinstance(test.data, ModeSet)
    ]
    with ExitStack() as stack:
        session = Session(stack.enter_context(opened_engine(options.engine)), RecentCache())
        largest = max((test.model.n_dofs for test in of_frfs), default=0)
        n_lines = sum(len(test.frf.freq) for test in of_frfs)
        reducing = bool(of_frfs) and is_reduced(
            options.tier, largest, n_lines, options.method, options.regularise
        )
        check_regularise(options.regularise, options.method, reducing=reducing)
        parts = [
            FRFPart.build(
                test.model,
                split.fitted,
                unknowns,
                tier="sparse" if reducing else options.tier,
                backend=options.backend,
                session=session,
                name=test.name,
            )
            for test, split in zip(of_frfs, splits, strict=True)
        ]
        modal = _modal_parts(tests, modal_splits, unknowns, session)
        whole = Problem.of(parts, modal)
        used_options = _collect_options(strategy, tests, parts, options, reducing=reducing)
        measured = [test.frf for test in of_frfs]
        reduced = None
        if reducing:
            all_data = list(map(FRFPart.with_data, parts, measured))
            reduced = Reducing(Problem.of(all_data), options.accuracy)

        def head() -> dict[str, Any]:
            return fingerprint(
                whole, [t.data for t in tests], _decisive_options(tests, used_options[0], options)
            )

        keeping = checkpoint_session(session, options.checkpoint, head, resume=options.resume)
        stack.enter_context(keeping)
        monitor = Monitor(whole, options.callback)
        lines = [test.lines for test in of_frfs]
        causes_of_run = CauseSearch(whole, splits, noises, monitor)
        monitor.detect_data_fault = before.wrap_fault_detector(causes_of_run.detect_data_fault)
        problem, fit = _fit_lines(whole, lines, driver, noises, monitor, reduced)
        with monitor.stage(JUDGE):
            fit = _add_failure_cause(strategy, problem, fit)
            start_solvers = reduced.start_solvers if reduced is not None else None

            def judge(fit: Fit, noises: Sequence[NoiseModel]) -> Judgement:
                return judge_fit(
                    problem,
                    (*splits, *modal_splits),
                    fit,
                    noises,
                    start_solvers,
                    is_likelihood=strategy.is_likelihood,
                )

            found = judge(fit, noises)
        chosen = [test.noise for test in of_frfs]
        found = SensorNoiseFit(problem, driver, noises, chosen, monitor, reduced).continue_fit(
            found, judge
        )
        if reduced is not None:
            reduced.release()
        causes = causes_of_run.search_after_fit(found) if options.seek_causes else Causes()
        if monitor.stopped:
            found = replace(found, fit=replace(found.fit, reason="stopped"))
        if found.fit.reason == "stopped" and isinstance(session.cache, Checkpoint):
            session.cache.keep()
    common = _common_entries(problem, found, causes, selection, options, monitor)
    common["timing_s"] = {**monitor.timing_s, "total": time.perf_counter() - start_time}
    values = np.array(list(common["values"].values()))
    # The unbounded plain iteration can end at a negative loss factor, which no model accepts.
    changes = unknowns.changes(np.where(unknowns.is_factor, values, np.maximum(values, 0.0)))
    fit = found.fit
    extra_options = _collect_extra_options(selection, fit, options)
    models = [test.model.scaled(_select_changes(changes, test.model)) for test in tests]
    common |= before.adjust_result(common, models)
    results = []
    for test, model, counterparts, i in zip(
        tests, models, before.found, _part_positions(tests), strict=True
    ):
        own_options: dict[str, Any] = {}
        if i < len(parts):
            own_options |= {
                **_record_solution(parts[i], reduced),
                **_record_rounding(problem.parts[i]),
            }
        kept_basis = None
        if reduced is not None and i < len(parts):
            kept_basis = reduced.kept_basis(i, test.model)
        result = UpdateResult(
            **common,
            **_data_entries(problem, (*splits, *modal_splits), i),
            title=_make_title(options.title, test.name),
            options={
                **used_options[i],
                "engine": session.engine.name,
                **own_options,
                **extra_options,
            },
            start=test.model,
            model=model,
            data=test.data,
            noise=dict(fit.noise[i]) if fit.noise else {},
            correlation=found.correlation[i],
            adequacy=found.adequacy[i],
            counterparts=counterparts,
            kept_basis=kept_basis,
        )
        results.append(result)
    return results


def _check_kinds(options: RunOptions) -> None:
    """Check the types of options that are first used during the run."""
    if options.callback is not None and not callable(options.callback):
        raise OptionError(f"callback = {options.callback!r}: expected a function, or None")
    if not isinstance(options.title, str):
        raise OptionError(f"title = {options.title!r}: expected a text", key=("title",))
    if options.checkpoint is not None and not isinstance(options.checkpoint, str | Path):
        raise OptionError(
            f"checkpoint = {options.checkpoint!r}: expected the path of a file", key=("checkpoint",)
        )
    if not is_number(options.accuracy):
        raise OptionError(
            f"accuracy = {options.accuracy!r}: expected a number, such as {ACCURACY:g}",
            key=("accuracy",),
        )


def _check_without_lines(options: RunOptions) -> None:
    """Refuse options of the line-by-line solution for an update to modes."""
    for key in ("tier", "backend"):
        if getattr(options, key) is not None:
            raise OptionError(f"{key}: modes are computed by one way; leave it out", key=(key,))


def _modal_parts(
    tests: Sequence[Test],
    splits: Sequence[ModalSplit],
    unknowns: ParameterSet,
    session: Session,
) -> list[ModalPart]:
    """Return the parts of the tests with modal data."""
    modal_tests = [test for test in tests if isinstance(test.data, ModeSet)]
    return [
        ModalPart.build(
            test.model,
            split.fitted,
            unknowns,
            choose_modal_noise(test.noise),
            session=session,
            name=test.name,
        )
        for test, split in zip(modal_tests, splits, strict=True)
    ]


def _part_positions(tests: Sequence[Test]) -> list[int]:
    """Return the position of each test among the parts; modal tests follow all others."""
    order = sorted(range(len(tests)), key=lambda i: isinstance(tests[i].data, ModeSet))
    return [order.index(i) for i in range(len(tests))]


def _data_entries(problem: Problem, splits: Sequence[Split | ModalSplit], i: int) -> dict[str, Any]:
    """Return the fitted and the held-out data of a test, for the record."""
    split = splits[i]
    if isinstance(split, Split):
        return {
            "lines": problem.parts[i].frf.freq,
            "fitted_responses": tuple(split.fitted.responses.labels),
            "validation_responses": split.responses,
            "validation_band": split.band,
        }
    return {
        "lines": np.zeros(0),
        "fitted_responses": tuple(split.fitted.dofs.labels),
        "validation_responses": (),
        "validation_band": split.band,
    }


def _collect_options(
    strategy: Method,
    tests: Sequence[Test],
    parts: Sequence[FRFPart],
    options: RunOptions,
    *,
    reducing: bool,
) -> list[dict[str, Any]]:
    """Return the options used for each test, in the order of the parts."""
    common = {key: getattr(strategy, key) for key in options_of(options.method)}
    found = []
    of_frfs = [test for test in tests if isinstance(test.data, FRF)]
    for test, part in zip(of_frfs, parts, strict=True):
        plain = isinstance(test.lines, str) or test.lines is None
        tier = part.solver.tier
        options_of_test = {
            "lines": test.lines if plain else "list",
            "tier": "reduced" if reducing else tier,
            "backend": part.solver.backend if tier == "sparse" else "lapack",
        }
        found.append(common | options_of_test)
    return found + [dict(common) for _ in range(len(tests) - len(parts))]


def _decisive_options(
    tests: Sequence[Test], used: Mapping[str, Any], options: RunOptions
) -> dict[str, object]:
    """Return the options that change the answer, which a resumed run has to share."""
    decisive: dict[str, object] = dict(used)
    decisive.pop("max_iterations", None)
    decisive |= {"method": options.method, "accuracy": options.accuracy}
    if options.regularise is not None:
        decisive["regularise"] = options.regularise
    decisive["lines"] = [_plain_lines(test.lines) for test in tests]
    decisive["noise"] = [test.noise for test in tests]
    decisive["validation"] = [test.validation for test in tests]
    return decisive


def _common_entries(
    problem: Problem,
    found: Judgement,
    causes: Causes,
    selection: Selection,
    options: RunOptions,
    monitor: Monitor,
) -> dict[str, Any]:
    """Return the entries that the results of all tests share, except for the durations."""
    fit, names = found.fit, selection.parameters.names
    tests = [part.name for part in problem.all_parts]
    adequacy = dict(zip(tests, found.adequacy, strict=True))
    end = assess_ending(problem, fit, monitor.history)
    status, message, remedy = compose_verdict(
        fit,
        found.analysis,
        names,
        found.advice,
        found.misfit,
        adequacy,
        found.rounding,
        end,
    )
    x = problem.coordinates.to_values(fit.x) + 0.0  # + 0.0 turns -0.0 into 0.0
    values = dict(zip(names, x.tolist(), strict=True))
    std = dict(zip(names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    others = select_distinct(values, std, found.alternatives)
    if others and status in ("converged", "not-identifiable"):
        status = "not-identifiable"
        also, first = explain_ambiguity(find_differences(values, std, others), others)
        message, remedy = f"{message} {also}", join_steps(first, remedy)
    judgement = judge_result(
        status,
        remaining_gain=None if end is None else end.deviations,
        rank=(found.analysis.report.rank, found.analysis.report.n_parameters),
        n_solutions=1 + len(others),
        correlation=found.correlation,
        misfit=found.misfit,
        at_bound=_factors_at_bound(selection.parameters, found.at_bound),
        findings=causes.findings,
        not_searched=causes.not_searched,
        structural=any(one is not None and one.outcome == "structure" for one in found.adequacy),
        distant=find_distant_unknowns(selection.parameters, values),
        without_interval=fit.noise[0].get("not_known", ()) if fit.noise else (),
    )
    if causes.findings:
        message, remedy = add_causes(causes.findings, message, remedy)
    if causes.is_overruling:
        message = explain_early_end(message)
    if status == "converged" and not judgement.credible:
        status = "not-credible"
        message, remedy = explain_rejection(judgement, message, remedy)
    if causes.has_no_cause:
        remedy = rule_out_faults(remedy)
    notes = [message, selection.note]
    if fit.regularisation is not None:
        notes.append(fit.regularisation.note)
    return {
        "status": status,
        "message": " ".join(filter(None, notes)),
        "remedy": remedy,
        "method": options.method,
        "parameters": selection.parameters,
        "values": values,
        "std": std,
        "covariance": found.covariance,
        "at_bound": found.at_bound,
        "identifiability": replace(found.analysis.report, advice=found.advice),
        "alternatives": others,
        "trust": judgement,
        "findings": causes.findings,
        "history": tuple(monitor.history),
        "versions": {
            "updyn": __version__,
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "python": platform.python_version(),
            "platform": platform.platform(terse=True),
        },
    }


def _factors_at_bound(
    parameters: ParameterSet, at_bound: Mapping[str, str]
) -> tuple[list[str], int]:
    """Return the stiffnesses and masses at a bound, and the number of unknown ones.

    Loss factors do not count, because zero is an ordinary value of theirs.
    """
    factors = [p.name for p in parameters if p.is_factor and not p.is_channel]
    return [name for name in factors if name in at_bound], len(factors)


def _collect_extra_options(selection: Selection, fit: Fit, options: RunOptions) -> dict[str, Any]:
    """Return the selection before the fit and the regularisation, for the record."""
    more = dict(selection.option)
    if fit.regularisation is not None:
        more["regularisation"] = dict(fit.regularisation.record)
    if options.regularise is not None:
        more["regularise"] = options.regularise
    return more


def _make_title(title: str, test: str) -> str:
    """Return the title of the result of a test."""
    if not test:
        return title
    return f"{title}: {test}".removeprefix(": ")


def _select_changes(
    changes: Mapping[str, Mapping[str, float]], model: Model
) -> dict[str, dict[str, float]]:
    """Return the changes of the groups in a model; a configuration may lack some groups."""
    selected: dict[str, dict[str, float]] = {}
    for group, change in changes.items():
        for quantity, value in change.items():
            if has_quantity(model, group, quantity):
                selected.setdefault(group, {})[quantity] = value
    return selected


def _plain_lines(lines: Lines) -> object:
    if isinstance(lines, str) or lines is None:
        return lines
    return np.asarray(lines).tolist()


def _record_solution(part: FRFPart, reduced: Reducing | None) -> dict[str, Any]:
    """Return the certificate of a reduced model or the use of another backend, for the record."""
    if reduced is not None:
        return reduced.record
    return record_fallback(part.solver.solve_counts, part.solver.backend)


def _record_rounding(part: FRFPart) -> dict[str, list[str]]:
    """Return the channels whose values are rounding, for the record."""
    at = np.argwhere(part.sign == 0.0)
    names = [f"{part.frf.responses[i]} / {part.frf.references[j]}" for i, j in at]
    return {"rounding": names} if names else {}


def _fit_lines(
    whole: Problem,
    lines: Sequence[Lines],
    strategy: Method,
    noises: Sequence[NoiseModel],
    monitor: Monitor,
    reduced: Reducing | None,
) -> tuple[Problem, Fit]:
    """Choose the lines and fit; return the problem on these lines and the fit.

    If the model is singular at the start, because a line is a natural frequency of an undamped
    model, the fit starts from slightly changed unknowns.
    """
    try:
        return _fit_from_start(whole, lines, strategy, noises, monitor, reduced)
    except SolverError as error:
        perturbed = _perturb_start(whole)
        if reduced is not None:
            reduced.restart(_perturb_start(reduced.exact))
        try:
            found = _fit_from_start(perturbed, lines, strategy, noises, monitor, reduced)
        except SolverError:
            raise error from None  # no unknown affects the singularity
        text = (
            f"{error}. The fit starts 0.1 % from the start of the unknowns, where it can be solved"
        )
        warnings.warn(text, UpdynWarning, stacklevel=3)
        return found


def _add_failure_cause(strategy: Method, problem: Problem, fit: Fit) -> Fit:
    """Return a fit with the cause of its failure, as far as the method knows it."""
    if fit.reason not in ("failed", "stalled", "unsolvable", "max-iterations"):
        return fit
    try:
        cause = strategy.describe_obstacle(problem)
    except (SolverError, Stopped):
        cause = ""
    return replace(fit, cause=cause, remedy=strategy.failure_remedy)


def _perturb_start(whole: Problem) -> Problem:
    """Return the problem with a slightly changed start, each unknown by a different amount.

    Stiffnesses increase and masses decrease, which changes natural frequencies; damping increases.
    """
    coordinates = whole.coordinates
    x, (lower, upper) = coordinates.start, coordinates.bounds
    share = 0.5 + 0.5 * np.random.default_rng(0).random(len(x))
    is_mass = np.array([p.quantity == "mass" for p in coordinates.parameters])
    step = _ASIDE * share * np.where(is_mass, -1.0, 1.0)
    step = np.where((x + step < lower) | (x + step > upper), -step, step)
    shifted = coordinates.with_start(x + step)
    return whole.with_coordinates(shifted)


def _fit_from_start(
    whole: Problem,
    lines: Sequence[Lines],
    strategy: Method,
    noises: Sequence[NoiseModel],
    monitor: Monitor,
    reduced: Reducing | None,
) -> tuple[Problem, Fit]:
    """Choose the lines and fit from the start.

    Raises
    ------
    SolverError
        If the model cannot be solved at its start, at one of the lines.
    """
    x, problem = whole.coordinates.start, whole
    try:
        with monitor.stage("start"):
            if reduced is not None:
                reduced.begin()
                problem = whole = reduced.with_reduced_models(whole)
            problem = whole.with_parts(list(map(restrict_to_lines, whole.parts, lines)))
            finest = ROUNDING if reduced is None else FINEST
            problem = problem.with_parts(
                [part.without_rounding(x, finest) for part in problem.parts]
            )
            monitor.problem = problem
            for part in problem.parts:
                part.responses(x)
            if problem.modal and not problem.parts:
                check_any_pair(problem.modal, x)
        try:
            if reduced is not None:
                return reduced.fit(problem, strategy, noises, monitor)
            starts = strategy.search(problem, noises, monitor)
            return problem, strategy.fit_best(problem, noises, monitor, starts)
        except SolverError as error:
            return problem, Fit.without_jacobian(x, "failed", str(error))
    except Stopped:
        return problem, Fit.without_jacobian(x, "stopped")
