"""Run of an update, from tests and unknowns to one result for each test.

A run is a chain of immutable values: `Setup`, `Assembly`, `Fitted`, `Judged`, `Conclusion`, and the
results.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import scipy

from updyn import __version__
from updyn.engines import opened_engine
from updyn.updating.assembly import Assembly
from updyn.updating.conclusion import Conclusion, conclude
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fitted import fit_tests
from updyn.updating.judge.causes.of_run import CauseSearch
from updyn.updating.judged import Judged, judge_tests
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection
from updyn.updating.problem.session import RecentCache, Session
from updyn.updating.result import UpdateResult
from updyn.updating.setup import RunOptions, Setup, prepare_setup

__all__ = ["run"]


def run(
    tests: Sequence[Test], parameters: ParameterSet | Selection, options: RunOptions
) -> list[UpdateResult]:
    """Fit the unknowns to all tests and return one result for each."""
    start = time.perf_counter()
    setup = prepare_setup(tests, parameters, options)
    setup.before.warn()
    with ExitStack() as stack:
        session = Session(stack.enter_context(opened_engine(options.engine)), RecentCache())
        assembly = Assembly.build(setup, session)
        stack.enter_context(assembly.keep_evaluations())
        search = CauseSearch(assembly.problem, setup.splits, setup.noises)
        detect = setup.before.wrap_fault_detector(search.detect_data_fault)
        monitor = Monitor(assembly.problem, options.callback, detect)
        fitted = fit_tests(assembly, monitor)
        judged = judge_tests(assembly, fitted, search, monitor)
    conclusion = conclude(setup, judged, monitor.history)
    monitor.timing_s["total"] = time.perf_counter() - start
    return [_result(assembly, judged, conclusion, monitor, n) for n in range(len(setup.tests))]


def _result(
    assembly: Assembly,
    judged: Judged,
    conclusion: Conclusion,
    monitor: Monitor,
    n: int,
) -> UpdateResult:
    setup, found = assembly.setup, judged.judgement
    test, i = setup.tests[n], setup.positions[n]
    reduced = assembly.reduced if i < len(judged.problem.parts) else None
    used = assembly.used_data(i, judged.problem)
    return UpdateResult(
        status=conclusion.status,
        message=conclusion.message,
        steps=conclusion.steps,
        method=setup.options.method,
        options={**assembly.record(i, judged.problem), **_further_record(setup, judged)},
        start=test.model,
        model=conclusion.models[n],
        data=test.data,
        lines=used.lines,
        fitted_responses=used.fitted,
        validation_responses=used.held_out,
        validation_band=used.band,
        parameters=setup.unknowns,
        values=conclusion.values,
        std=conclusion.std,
        covariance=found.covariance,
        at_bound=found.at_bound,
        identifiability=replace(found.analysis.report, advice=found.advice),
        history=tuple(monitor.history),
        noise=dict(judged.fit.noise[i]) if judged.fit.noise else {},
        correlation=found.correlation[i],
        timing_s=dict(monitor.timing_s),
        versions=_versions(),
        title=": ".join(filter(None, [setup.options.title, test.name])),
        adequacy=found.adequacy[i],
        alternatives=conclusion.alternatives,
        trust=conclusion.trust,
        findings=conclusion.findings,
        counterparts=setup.before.found[n],
        kept_basis=None if reduced is None else reduced.kept_basis(i, test.model),
    )


def _further_record(setup: Setup, judged: Judged) -> dict[str, object]:
    """Return the selection before the fit and the regularisation, for the record."""
    more = dict(setup.selection.option)
    if judged.fit.regularisation is not None:
        more["regularisation"] = dict(judged.fit.regularisation.record)
    if setup.options.regularise is not None:
        more["regularise"] = setup.options.regularise
    return more


def _versions() -> dict[str, str]:
    """Return the versions of the program, its libraries and the platform."""
    return {
        "updyn": __version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "python": platform.python_version(),
        "platform": platform.platform(terse=True),
    }
