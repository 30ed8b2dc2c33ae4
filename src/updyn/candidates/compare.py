"""`compare_models`: several models fitted to the same data, and their comparison."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from updyn.arrays import IndexArray, RealArray
from updyn.candidates.bands import divide_lines, score_bands
from updyn.candidates.evidence import Prior, log_evidence
from updyn.candidates.noise import CommonNoise
from updyn.candidates.result import CandidateRow, ModelComparison, rank_candidates
from updyn.candidates.settings import CANDIDATES
from updyn.comparison.bench import StepCounter, build_line_problem
from updyn.dofs import Dof
from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine, opened_engine
from updyn.errors import DataError, OptionError, StoppedError, key_path
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.uncertainty.counts import check_count
from updyn.uncertainty.restored import AT_MINIMUM, RestoredFit, estimate_of, restore
from updyn.uncertainty.surrogate import run_about
from updyn.updating.fit.monitor import Progress
from updyn.updating.fit.reducing import are_modes_reduced
from updyn.updating.judge.settings import RESIDUAL_TEST
from updyn.updating.problem.data import Test, check_tests, leave_out_undefined_line
from updyn.updating.problem.lines import Lines, choose_lines
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise.modes import ModalNoise, choose_modal_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import Problem
from updyn.updating.problem.selection import Selection
from updyn.updating.problem.session import RecentCache, Session, Stopped
from updyn.updating.result import JointResult, UpdateResult
from updyn.updating.run import run
from updyn.updating.setup import RunOptions

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Candidate", "compare_candidates", "compare_models"]

Callback = Callable[[Progress], bool | None]

#: Statuses of fits that are judged; one that ran out of steps goes on with the common noise.
_JUDGED = (*AT_MINIMUM, "max-iterations")


def compare_models(
    candidates: Mapping[str, tuple[Model, ParameterSet | Selection]],
    frf: FRF | ModeSet,
    lines: str | ArrayLike | None = None,
    noise: Mapping[str, float | str] | str | None = None,
    engine: int | Client | Engine | None = None,
    callback: Callback | None = None,
    *,
    bands: int | None = None,
    base: Iterable[str | Dof] | None = None,
    force: str | Dof | None = None,
    title: str = "",
    tier: str | None = None,
    backend: str | None = None,
    accuracy: float = REDUCTION.accuracy,
    **options: Any,
) -> ModelComparison:
    """Fit several models to the same measurement and compare them.

    Candidates may differ in their groups, in joints that are rigid or elastic, in structural or
    viscous damping, and in what is unknown. Each is fitted by ``"maximum-likelihood"``.

    Parameters
    ----------
    candidates : mapping of str to (Model, ParameterSet or Selection)
        At least two models with their unknowns, by name. Bounds and prior standard deviations of
        the unknowns are part of a candidate: they are the volume over which it is averaged.
    frf : FRF or ModeSet
        The measurement, FRFs or modes. Every response and reference, or every DOF of the modes, has
        to be a DOF of every model.
    lines : None, str or array_like of float
        As for `updyn.update`; chosen once, with the first model.
    noise : None, str or mapping
        As for `updyn.update`. Noise that is estimated is that of the candidate with the largest
        likelihood, for all candidates.
    engine : None, int, dask.distributed Client or Engine
        As for `updyn.update`.
    callback : callable, optional
        As for `updyn.update`; the stage of the progress begins with the candidate. Returning True
        stops with a `StoppedError`.
    bands : int, optional
        Number of contiguous bands that are held out in turn; by default 10, or as many as there are
        lines or modes.
    base, force, title, tier, backend, accuracy
        As for `updyn.update`.
    **options
        Options of the method, as for `updyn.update`: ``starts``, ``seed``, ``max_iterations``.

    Returns
    -------
    ModelComparison
        One row per candidate, the first is the best.

    Raises
    ------
    InputError
        If models, data, unknowns or options do not fit together.
    SolverError
        If a model cannot be solved at its start, at one of the lines.
    StoppedError
        If the callback stops the comparison.

    Notes
    -----
    The evidence is the density of the data with the unknowns integrated over their priors, by
    Laplace's method (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, chapter
    28; Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773, eq. 5; Beck & Yuen, J. Eng. Mech. 130
    (2004) 192); the module `updyn.candidates.evidence` has the equations. The predictive score is
    the log density of each band by a fit to the others, with the posterior of the unknowns and the
    noise (Vehtari, Gelman & Gabry, Stat. Comput. 27 (2017) 1413).

    The evidence decides if the residual of the candidate with the largest is noise. If not, every
    candidate has errors, the noise alone overstates the evidence, and the score decides, with the
    standard error of the paired difference over the bands.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> every = {"stiffness": "all", "mass": "all"}
    >>> found = updyn.compare_models(
    ...     {
    ...         "four parts": (model, updyn.parameters(model, loss_factor="all", **every)),
    ...         "known damping": (model, updyn.parameters(model, **every)),
    ...     },
    ...     frf,
    ...     starts=0,
    ... )
    >>> found.best, found.criterion, found.distinguishable
    ('four parts', 'evidence', True)
    """
    if base is not None or force is not None:
        if not isinstance(frf, FRF):
            raise OptionError("base and force: modes have none; leave them out")
        frf = frf.with_excitation(base, force)
    listed = []
    for name, pair in _check_names(candidates).items():
        model, unknowns = _check_pair(name, pair)
        listed.append(Candidate(name, (Test(model, frf, "", lines, noise),), unknowns))
    run_options = RunOptions(
        method_options=options,
        tier=tier,
        backend=backend,
        accuracy=accuracy,
        engine=engine,
    )
    return compare_candidates(listed, run_options, callback, bands=bands, title=title)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One candidate: its model in the configuration of each test, and its unknowns."""

    name: str
    tests: tuple[Test, ...]
    unknowns: Selection


def compare_candidates(
    candidates: Sequence[Candidate],
    options: RunOptions,
    callback: Callback | None = None,
    *,
    bands: int | None = None,
    title: str = "",
) -> ModelComparison:
    """Fit and compare candidates, each with the same tests; as `compare_models`."""
    for one in candidates:
        with key_path(one.name):
            check_tests(one.tests, one.unknowns.parameters)
    if len({type(test.data) for one in candidates for test in one.tests}) > 1:
        raise OptionError("FRFs and modes together cannot be compared; leave out one of the two")
    candidates = _share_lines(candidates, options)
    n_items = [len(_frequencies(test)) for test in candidates[0].tests]
    divided = divide_lines(n_items, _check_bands(bands, min(n_items)))
    counter = StepCounter(callback)
    with opened_engine(options.engine) as engine:
        options = replace(options, engine=engine, callback=counter, seek_causes=False)
        fits = {}
        for number, one in enumerate(candidates, 1):
            counter.stage = f"{one.name} ({number} of {len(candidates)})"
            fits[one.name] = _fit_candidate(one, options)
            if counter.stopped:
                raise StoppedError(f"stopped by the callback at candidate {one.name!r}")
        session = Session(engine, RecentCache())
        counter.stage = "bands"
        rows = _judge_fits(candidates, fits, divided, session, counter, options.accuracy)
    edges = [_band_limits(candidates[0].tests[0], band[0]) for band in divided]
    ranked, criterion = rank_candidates(rows)
    return ModelComparison(ranked, criterion, tuple(edges), title)


# -- input -----------------------------------------------------------------------------------------
def _check_names(candidates: Any) -> Mapping[str, Any]:
    if not isinstance(candidates, Mapping) or len(candidates) < 2:
        raise OptionError(
            "candidates: expected at least two by name, such as"
            " {'rigid': (model, unknowns), 'elastic': (model, unknowns)}"
        )
    return candidates


def _check_pair(name: str, pair: Any) -> tuple[Model, Selection]:
    is_pair = isinstance(pair, tuple | list) and len(pair) == 2
    if not (
        is_pair and isinstance(pair[0], Model) and isinstance(pair[1], ParameterSet | Selection)
    ):
        raise OptionError(f"candidate {name!r}: expected (model, unknowns), found {pair!r}")
    return pair[0], Selection.of(pair[1])


def _check_bands(bands: int | None, n_lines: int) -> int:
    if n_lines < 2:
        raise DataError("one line or mode is too few to compare models; expected at least 2")
    if bands is None:
        return min(CANDIDATES.bands, n_lines)
    return check_count("bands", bands, "bands", 2, n_lines)


def _share_lines(candidates: Sequence[Candidate], options: RunOptions) -> list[Candidate]:
    """Return the candidates with the same lines; those of a rule are chosen for the first one."""
    # A free model has no response at 0 Hz; then no candidate is fitted there.
    usable = [tuple(map(leave_out_undefined_line, one.tests)) for one in candidates]
    shared = []
    for tests in zip(*usable, strict=True):
        if all(isinstance(test.data, ModeSet) for test in tests):
            _check_same_modes(tests, candidates)
            shared.append(list(tests))
            continue
        _check_same_data(tests, [one.name for one in candidates])
        fewest = min((test.frf for test in tests), key=lambda frf: len(frf.freq))
        at = _resolve_lines(tests[0], fewest, candidates[0].unknowns.parameters, options)
        freq = fewest.freq[at]
        shared.append([replace(t, data=t.frf.select(lines=freq), lines=None) for t in tests])
    return [
        replace(one, tests=tests)
        for one, tests in zip(candidates, zip(*shared, strict=True), strict=True)
    ]


def _check_same_data(tests: Sequence[Test], names: Sequence[str]) -> None:
    """Raise if the data of a test differ between candidates by more than signs."""
    first, above = tests[0].frf, tests[0].frf.freq > 0.0
    size = np.abs(first.values[above])
    for test, name in zip(tests[1:], names[1:], strict=True):
        frf = test.frf
        same = frf.values.shape[1:] == first.values.shape[1:]
        if not same or not np.allclose(np.abs(frf.values[frf.freq > 0.0]), size, rtol=1e-9):
            raise DataError(
                f"candidate {name!r} is matched to other data than {names[0]!r}: {frf!r} in place"
                f" of {first!r}"
            )


def _resolve_lines(
    test: Test, frf: FRF, parameters: ParameterSet, options: RunOptions
) -> IndexArray:
    lines: Lines = test.lines
    if lines is None:
        return np.arange(len(frf.freq))
    if not isinstance(lines, str):
        return frf.find_lines(lines)
    about = {"tier": options.tier, "backend": options.backend}
    part = build_line_problem(replace(test, data=frf), frf, parameters, about)
    return choose_lines(lines, part)


def _check_same_modes(tests: Sequence[Test], candidates: Sequence[Candidate]) -> None:
    """Raise if the modes of a test differ between candidates, or how many numbers are fitted."""
    measured = []
    for test, one in zip(tests, candidates, strict=True):
        assert isinstance(test.data, ModeSet)
        part = ModalPart.build(test.model, test.data, one.unknowns.parameters, ModalNoise())
        measured.append((part.target.frequency.tolist(), part.n_numbers))
    for (frequency, n), one in zip(measured[1:], candidates[1:], strict=True):
        if frequency != measured[0][0]:
            raise DataError(
                f"candidate {one.name!r} is matched to other modes than {candidates[0].name!r}"
            )
        if n != measured[0][1]:
            raise DataError(
                f"{n} numbers of the modes are data of candidate {one.name!r}, {measured[0][1]} of"
                f" {candidates[0].name!r}: measured damping is data if damping is unknown. Make"
                " damping unknown in all candidates, or leave measured damping out"
            )


def _frequencies(test: Test) -> RealArray:
    """Return the lines, or the natural frequencies, of a test in Hz."""
    return test.data.freq if isinstance(test.data, FRF) else test.data.frequency


def _band_limits(test: Test, band: IndexArray) -> tuple[float, float]:
    freq = _frequencies(test)[band]
    return float(freq[0]), float(freq[-1])


# -- fits ------------------------------------------------------------------------------------------
def _fit_candidate(one: Candidate, options: RunOptions) -> UpdateResult | JointResult:
    with key_path(one.name):
        results = run(one.tests, one.unknowns, replace(options, title=one.name))
    if len(results) == 1:
        return results[0]
    names = [test.name for test in one.tests]
    return JointResult(dict(zip(names, results, strict=True)), one.name)


def _judge_fits(
    candidates: Sequence[Candidate],
    results: Mapping[str, UpdateResult | JointResult],
    bands: Sequence[Sequence[IndexArray]],
    session: Session,
    counter: StepCounter,
    accuracy: float,
) -> list[CandidateRow]:
    """Return the row of each candidate, with the noise of the one with the largest likelihood."""
    fits = {
        one.name: _restore_fit(results[one.name], one.tests, session)
        for one in candidates
        if results[one.name].status in _JUDGED
    }
    rows = []
    noise = CommonNoise.of(list(fits.values())) if fits else None
    for name, result in results.items():
        if name not in fits or noise is None:
            rows.append(_row_without_fit(name, result, len(bands)))
            continue
        rows.append(_judge_fit(name, result, fits[name], noise, bands, counter, accuracy))
    return rows


def _restore_fit(
    result: UpdateResult | JointResult, tests: Sequence[Test], session: Session
) -> RestoredFit:
    """Return a finished fit of FRFs, or of modes, for further analysis."""
    if all(isinstance(test.data, FRF) for test in tests):
        return restore(result, session, statuses=_JUDGED)
    parts = []
    for one, test in zip(result.results.values(), tests, strict=True):
        assert isinstance(test.data, ModeSet)
        part = ModalPart.build(
            one.start,
            test.data,
            one.parameters,
            choose_modal_noise(test.noise),
            session=session,
            name=test.name,
            reduced=are_modes_reduced(one.options.get("tier"), one.start.n_dofs),
        )
        parts.append(part)
    problem = Problem.of([], parts)
    x = problem.coordinates.to_x(estimate_of(result.first))
    return RestoredFit(tuple(result.results.values()), problem, problem, x, 1.0)


def _judge_fit(
    name: str,
    result: UpdateResult | JointResult,
    fit: RestoredFit,
    noise: CommonNoise,
    bands: Sequence[Sequence[IndexArray]],
    counter: StepCounter,
    accuracy: float,
) -> CandidateRow:
    """Return evidence, scores and residual of one candidate with the common noise."""
    found: dict[str, Any] = {}

    def report(number: int) -> None:
        lines = fit.problem.session.lines_solved
        progress = Progress(name, number, math.nan, lines, fit.problem.n_lines)
        if counter(progress):
            raise Stopped

    def judge(problem: Problem) -> RealArray:
        data = noise.weigh(problem)
        point = data.likelihood.descend(fit.x)
        x = fit.x if point is None else point.x
        local = data.data(x)
        prior = Prior.of(problem.coordinates)
        found["log_evidence"] = data.log_constant(x) + log_evidence(local, x, prior)
        spare = max(problem.n_numbers - len(x), 1)
        found["probability"] = float(chdtrc(spare, 2.0 * local.cost))
        found["residual"] = float(np.sqrt(2.0 * local.cost / problem.n_numbers))
        scores, estimates = score_bands(data, x, bands, report)
        found["band_scores"] = tuple(scores.tolist())
        return np.vstack([x, estimates])

    try:
        run_about(fit, accuracy, 0, judge)
    except Stopped:
        raise StoppedError(f"stopped by the callback at candidate {name!r}") from None
    return _row_of_fit(name, result, **found)


def _row_of_fit(
    name: str,
    result: UpdateResult | JointResult,
    log_evidence: float,
    band_scores: tuple[float, ...],
    residual: float,
    probability: float,
) -> CandidateRow:
    """Return the row of a fit that is judged."""
    first = result.first
    report, tests = first.identifiability, result.results.values()
    return CandidateRow(
        name,
        first.status,
        first.message,
        report.n_parameters,
        report.n_parameters - report.rank,
        log_evidence,
        band_scores,
        residual,
        all(_is_adequate(one, probability) for one in tests),
        result,
    )


def _is_adequate(result: UpdateResult, probability: float) -> bool:
    """Return whether a residual is consistent with noise; of modes, by its `probability`."""
    if isinstance(result.data, ModeSet):
        return probability > RESIDUAL_TEST.alarm_level
    return result.adequacy is not None and result.adequacy.adequate


def _row_without_fit(name: str, result: UpdateResult | JointResult, n_bands: int) -> CandidateRow:
    """Return the row of a fit that failed."""
    first, scores = result.first, (math.nan,) * n_bands
    about = (name, first.status, first.message, len(first.parameters), 0)
    return CandidateRow(*about, -math.inf, scores, math.nan, False, result)
