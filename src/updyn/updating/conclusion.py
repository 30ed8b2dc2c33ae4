"""Conclusion of a run: status, message, next step, values of the unknowns, updated models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from updyn.model import Model
from updyn.remedy import Remedy, join_remedies
from updyn.updating.before_search import ModeComparison
from updyn.updating.fit.methods import options_of
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.alternatives import Alternative, find_differences, select_distinct
from updyn.updating.judge.between_tests import describe_separable_share
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.distant import find_distant_unknowns
from updyn.updating.judge.ending import Ending, assess_ending
from updyn.updating.judge.sentences import split_ending
from updyn.updating.judge.trust import Trust, judge_result
from updyn.updating.judge.verdict import (
    Verdict,
    add_causes,
    compose_verdict,
    explain_ambiguity,
    explain_early_end,
    explain_level_dependence,
    explain_rejection,
    rule_out_faults,
)
from updyn.updating.judged import Judged
from updyn.updating.problem.data import has_quantity
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.setup import Setup

__all__ = ["Conclusion", "conclude"]


@dataclass(frozen=True, slots=True, eq=False)
class Conclusion:
    """Conclusion of a run on all tests together; fields as of `updyn.UpdateResult`."""

    status: str
    message: str
    steps: tuple[Remedy, ...]
    values: Mapping[str, float]
    std: Mapping[str, float]
    alternatives: tuple[Alternative, ...]
    trust: Trust
    findings: tuple[Finding, ...]
    models: tuple[Model, ...]


def conclude(setup: Setup, judged: Judged, history: Sequence[Iteration]) -> Conclusion:
    """Return the conclusion from a judged fit."""
    found, causes, names = judged.judgement, judged.causes, setup.unknowns.names
    adequacy = dict(zip([p.name for p in judged.problem.all_parts], found.adequacy, strict=True))
    end = assess_ending(judged.problem, found.fit, history)
    verdict = compose_verdict(
        found.fit,
        found.analysis,
        names,
        found.advice,
        found.misfit,
        adequacy,
        found.rounding,
        end,
        {name: getattr(setup.method, name) for name in options_of(setup.options.method)},
    )
    x = judged.problem.coordinates.to_values(found.fit.x) + 0.0  # + 0.0 turns -0.0 into 0.0
    values = dict(zip(names, x.tolist(), strict=True))
    std = dict(zip(names, np.sqrt(np.diag(found.covariance)).tolist(), strict=True))
    others = select_distinct(values, std, found.alternatives)
    if others and verdict.status in ("converged", "not-identifiable"):
        also, first = explain_ambiguity(find_differences(values, std, others), others)
        verdict = Verdict(
            "not-identifiable",
            f"{verdict.message} {also}",
            join_remedies([first], verdict.steps),
        )
    trust = _trust(judged, setup.unknowns, verdict.status, end, values, 1 + len(others))
    if causes.findings:
        verdict = add_causes(verdict, causes.findings)
    if causes.is_overruling:
        verdict = explain_early_end(verdict)
    if verdict.status == "converged" and not trust.credible:
        verdict = explain_rejection(verdict, trust)
    if causes.level_dependence:
        verdict = explain_level_dependence(verdict, causes.level_dependence)
    if causes.has_no_cause:
        verdict = rule_out_faults(verdict)
    pull = found.fit.regularisation
    differing = describe_separable_share(found.separable_share)
    notes = [verdict.message, differing, setup.selection.note, "" if pull is None else pull.note]
    plain = Conclusion(
        verdict.status,
        " ".join(filter(None, notes)),
        verdict.steps,
        values,
        std,
        others,
        trust,
        causes.findings,
        _updated_models(setup, values),
    )
    return _with_counterparts(plain, setup.before)


def _with_counterparts(plain: Conclusion, before: ModeComparison) -> Conclusion:
    trust = replace(plain.trust, resembles=before.claim)
    if not before.few or plain.status in ("stopped", "failed"):
        return replace(plain, trust=trust)
    after = before.compare(plain.models)
    if not all(one.few for one in after):
        updated = Claim(True, f"Of the updated model: {after[0].statement}")
        return replace(plain, trust=replace(trust, resembles=updated))
    said = (
        f"{before.found[0].statement} The search ended after its first tries, none of which"
        f" explains the data; in the updated model {after[0].n_paired} of {after[0].n_measured}"
        " have one."
    )
    if any(finding.grave for finding in plain.findings):
        return replace(plain, trust=trust, message=f"{plain.message} {said}")
    status, (ending, _) = plain.status, split_ending(plain.message)
    if status == "converged":
        status, ending = "not-credible", "The fit converged, but its result is not credible."
    message = f"{ending} {said}"
    return replace(plain, trust=trust, status=status, message=message, steps=before.steps)


def _updated_models(setup: Setup, values: Mapping[str, float]) -> tuple[Model, ...]:
    """Return the updated model of each test; a configuration may lack some groups."""
    unknowns, x = setup.unknowns, np.array(list(values.values()))
    # The unbounded plain iteration can end at a negative loss factor, which no model accepts.
    changes = unknowns.changes(np.where(unknowns.is_damping, np.maximum(x, 0.0), x))
    models = []
    for test in setup.tests:
        present: dict[str, dict[str, float]] = {}
        for group, change in changes.items():
            for quantity, value in change.items():
                if has_quantity(test.model, group, quantity):
                    present.setdefault(group, {})[quantity] = value
        models.append(test.model.scaled(present))
    return tuple(models)


def _trust(
    judged: Judged,
    parameters: ParameterSet,
    status: str,
    end: Ending | None,
    values: Mapping[str, float],
    n_solutions: int,
) -> Trust:
    found, fit = judged.judgement, judged.fit
    return judge_result(
        status,
        remaining_gain=None if end is None else end.deviations,
        rank=(found.analysis.report.rank, found.analysis.report.n_parameters),
        n_solutions=n_solutions,
        correlation=found.correlation,
        misfit=found.misfit,
        at_bound=_factors_at_bound(parameters, found.at_bound),
        findings=judged.causes.findings,
        not_searched=judged.causes.not_searched,
        level_dependence=judged.causes.level_dependence,
        structural=any(one is not None and one.outcome == "structure" for one in found.adequacy),
        distant=find_distant_unknowns(parameters, values),
        without_interval=fit.noise[0].get("not_known", ()) if fit.noise else (),
    )


def _factors_at_bound(
    parameters: ParameterSet, at_bound: Mapping[str, str]
) -> tuple[list[str], int]:
    """Return the stiffnesses and masses at a bound, and the number of unknown ones."""
    # Loss factors do not count, because zero is an ordinary value of theirs.
    factors = [p.name for p in parameters if (p.is_factor or p.of_element) and not p.is_channel]
    return [name for name in factors if name in at_bound], len(factors)
