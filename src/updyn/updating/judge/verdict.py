"""Verdict on a fit: status, message and remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from types import MappingProxyType

import numpy as np

from updyn.remedy import Remedy, join_remedies
from updyn.text_table import percent_of
from updyn.updating.fit.method import Fit
from updyn.updating.judge.adequacy import Adequacy
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.ending import ActiveBound, Ending
from updyn.updating.judge.identifiability import Analysis
from updyn.updating.judge.rounding import REMEDY, Rounding
from updyn.updating.judge.sentences import split_ending
from updyn.updating.judge.settings import (
    FIT_END,
    LIST_LENGTHS,
    PLAUSIBILITY,
    RESIDUAL_TEST,
    VERDICT,
)
from updyn.updating.judge.trust import Trust
from updyn.updating.problem.noise.known import Assumed

__all__ = [
    "Verdict",
    "add_causes",
    "compose_verdict",
    "explain_ambiguity",
    "explain_early_end",
    "explain_rejection",
    "rule_out_faults",
]

#: Job keys that free the calibration factor of a sensor.
_CALIBRATED = {"calibration": "responses", "force_calibration": "references"}

#: Options of a method whose values are not known.
NO_OPTIONS: Mapping[str, object] = MappingProxyType({})

_CLOSER = "Start closer, or use the default method."
_OWN_NOISE = Remedy.setting(
    "Estimate the noise of each sensor:",
    "method",
    "noise",
    "estimated-by-channel",
    "The values become more accurate, and their standard deviations smaller.",
)
_LONE = Remedy(
    "Leave out the isolated lines (exclude under [test]), or give less weight to outliers:",
    ('noise = { robust = "student-t" }',),
    "under [method] of the job",
    "If it is a resonance, measure it with finer lines.",
)
_INSPECTION = "look at the channels with the lowest FRAC; free other groups."
_LOOK = Remedy(f"Check units, calibration and labels; {_INSPECTION}")
_CONTINUE = Remedy(
    "Run it again; with a checkpoint it continues from here:",
    ("updyn run JOB.toml --resume",),
    "in a terminal, with the job file of this run and its --out",
)
_LOOK_ELSEWHERE = Remedy(f"No known fault of the data explains it (docs/verdict.md); {_INSPECTION}")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Status of a fit (one of `STATUSES`), its explanation, and the steps to take.

    The most effective step comes first.
    """

    status: str
    message: str
    steps: tuple[Remedy, ...] = ()


def compose_verdict(
    fit: Fit,
    analysis: Analysis,
    names: list[str],
    advice: str,
    misfit: float = 0.0,
    adequacy: Mapping[str, Adequacy | None] | None = None,
    rounding: Rounding | None = None,
    end: Ending | None = None,
    options: Mapping[str, object] = NO_OPTIONS,
) -> Verdict:
    """Return the verdict on a fit; `options` are those of its method."""
    ended = _describe_end(fit, analysis, names, advice, misfit, end, options)
    status, message, steps = ended.status, ended.message, ended.steps
    if status in ("converged", "stalled", "not-identifiable", "max-iterations"):
        inadequate = []
        for name, found in (adequacy or {}).items():
            if found is None or found.outcome not in ("structure", "excess"):
                continue
            if name:
                message += f" Test {name!r}:"
            message += f" {found.verdict}"
            inadequate.append(found)
        message += _describe_noise_estimate(fit)
        is_at_minimum = status == "converged" or (
            status == "max-iterations" and not _is_decreasing(end)
        )
        # No start of a search can explain the data if the quantity in error is not an unknown.
        is_held = fit.reason == "unsettled" and any(map(_is_explained, inadequate))
        if is_held or (is_at_minimum and inadequate):
            known = any(map(_is_explained, inadequate))
            if not steps and not known:
                steps = (_advise_inspection(inadequate),)
            steps = join_remedies(_advise_on_error(inadequate), steps)
        if end is not None and end.active_bounds:
            message += _describe_active_bounds(end.active_bounds)
            steps = join_remedies([_advise_wider_bounds(end.active_bounds)], steps)
    if rounding is not None:
        message = f"{message} {rounding.message}"
        kept = () if status in ("converged", "stalled") else steps
        steps = join_remedies(kept, [Remedy(REMEDY)])
    return Verdict(status, message, steps)


def _is_explained(found: Adequacy) -> bool:
    """Return whether a single error explains the residual."""
    suspects, least = found.explained_by, RESIDUAL_TEST.explained_share
    return bool(suspects) and suspects[0].explains >= least


def _advise_on_error(found: list[Adequacy]) -> list[Remedy]:
    """Return the remedy for an error that would explain the residual; empty if none is known."""
    for adequacy in found:
        if not adequacy.explained_by:
            continue
        if _is_explained(adequacy):
            return [_advise_freeing(adequacy.explained_by[0].name)]
        advice = (
            "Look for a part that the model lacks, such as a further support or connection, or for"
            " several errors at once."
        )
        return [Remedy(advice)]
    return []


def _advise_freeing(name: str) -> Remedy:
    """Return the remedy for an unknown that is held, with the lines of the job that free it."""
    of, _, quantity = name.rpartition(".")
    advice = f"Free {name} if it can be wrong, and run again:"
    if quantity in _CALIBRATED:
        return Remedy.table(advice, "[[calibration]]", {_CALIBRATED[quantity]: [of]})
    return Remedy.table(advice, "[[parameter]]", {"groups": [of], "quantity": quantity})


def _advise_raising(advice: str, option: str, options: Mapping[str, object]) -> Remedy:
    """Return advice to raise an option of the method, with its double if its value is known."""
    number = options.get(option)
    if not isinstance(number, int):
        return Remedy(f"{advice}.")
    return Remedy.setting(f"{advice}:", "method", option, 2 * max(number, 1))


def _advise_inspection(found: list[Adequacy]) -> Remedy:
    """Return the remedy for a residual that no model error explains."""
    if all(adequacy.noisy for adequacy in found):
        return _OWN_NOISE
    if all(adequacy.lone for adequacy in found):
        return _LONE
    return _LOOK


def _describe_noise_estimate(fit: Fit) -> str:
    """Return the sentence on noise that was assumed or estimated from few values, if any."""
    known = fit.noise[0] if fit.noise else {}
    if known.get("kind") == Assumed.kind:
        return (
            " There are no more measured numbers than unknowns, so the noise cannot be estimated:"
            f" {100.0 * known['relative']:g} % was assumed for the standard deviations. State the"
            " noise, or measure more."
        )
    spare = known.get("degrees_of_freedom")
    if spare is None:
        return ""
    if "modes" in known:
        return (
            f" The size of one kind of error of the modes was estimated from {spare} numbers:"
            " intervals are those of Student's distribution."
        )
    return (
        f" Only {spare} degrees of freedom remain for the noise: only its level was estimated,"
        " over all ratios of relative noise and floor, and intervals are those of Student's"
        " distribution."
    )


def _describe_active_bounds(active_bounds: Sequence[ActiveBound]) -> str:
    """Return the sentences on bounds that exclude the values that the data require."""
    return "".join(
        f" {one.name} stopped at its {one.side} bound, {one.limit:.4g}; the data require a value"
        f" beyond it, by {one.deviations:.2g} standard deviations."
        for one in active_bounds
    )


def _advise_wider_bounds(active_bounds: Sequence[ActiveBound]) -> Remedy:
    names = ", ".join(one.name for one in active_bounds)
    its = "its bound" if len(active_bounds) == 1 else "their bounds"
    return Remedy(
        f"If the structure allows it, widen {its} ({names}); if not, another part of the model or"
        " the calibration is wrong, and this unknown compensates for it."
    )


def _is_decreasing(end: Ending | None) -> bool:
    """Return whether the misfit of an unconverged fit was still decreasing substantially."""
    return end is None or (
        end.deviations > FIT_END.arrived_stds
        and (end.share > FIT_END.moving_share or end.recent_gain > FIT_END.recent_share)
    )


def _describe_step_limit(
    fit: Fit,
    analysis: Analysis,
    names: list[str],
    misfit: float,
    end: Ending | None,
    options: Mapping[str, object],
) -> tuple[str, tuple[Remedy, ...]]:
    """Return message and steps of a fit at the step limit whose unknowns are determined."""
    message = "The largest number of steps was reached before convergence."
    if end is None:
        advice = "Raise max_iterations, or start closer"
        remedy = _advise_raising(advice, "max_iterations", options)
        return f"{message} {fit.cause}".strip(), (remedy,)
    if _is_decreasing(end):
        message += (
            f" The misfit was still falling: the values are {end.deviations:.2g} standard"
            " deviations from the next step's."
        )
        return message, (_advise_raising("Raise max_iterations", "max_iterations", options),)
    if end.deviations <= FIT_END.arrived_stds:
        message += (
            f" The remaining gain is {end.deviations:.1g} standard deviations: more steps would"
            " not change the values significantly."
        )
    else:
        message += (
            " The last steps followed a valley along which the misfit hardly changes, mainly in"
            f" {', '.join(end.leading)}; {end.deviations:.2g} standard deviations remain."
        )
    misfit_text = _describe_misfit(fit, misfit)
    if misfit_text:
        return message + misfit_text, (_LOOK, *_advise_method(fit))
    if end.deviations <= FIT_END.arrived_stds:
        return message, (Remedy("Use the values; their standard deviations hold."),)
    leading = [name for name in names if name in end.leading]
    report = analysis.report
    advice = (
        f"Add lines or sensors that tell {', '.join(leading)} apart (collinearity index"
        f" {report.collinearity:.3g}), hold one of them at a known value, or give a prior."
    )
    return message, (Remedy(advice),)


def _describe_end(
    fit: Fit,
    analysis: Analysis,
    names: list[str],
    advice: str,
    misfit: float,
    end: Ending | None,
    options: Mapping[str, object],
) -> Verdict:
    measure = (Remedy(advice),) if advice else ()
    if fit.reason == "failed":
        message = f"{fit.note or 'The fit broke down.'} {fit.cause}".strip()
        return Verdict("failed", message, (Remedy(fit.remedy or _CLOSER),))
    if fit.reason == "stopped":
        message = (
            "Stopped before convergence and assessment; the values are those of the best step so"
            " far."
        )
        if not fit.R.any():
            message += " What the data determine is not known."
        return Verdict("stopped", message, (_CONTINUE,))
    if fit.reason == "max-iterations":
        if analysis.report.complete:
            return Verdict(
                "max-iterations",
                *_describe_step_limit(fit, analysis, names, misfit, end, options),
            )
        message = "The largest number of steps was reached before convergence."
        message = f"{message} {fit.cause}".strip()
        message = f"{message} Besides, {_describe_undetermined(analysis, names)}"
        return Verdict("max-iterations", message, measure)
    if not analysis.report.complete:
        message = f"The fit ended, but {_describe_undetermined(analysis, names)}"
        return Verdict("not-identifiable", message, measure)
    if fit.reason == "unsettled":
        if fit.cause:
            advice = "State the noise, free what is held and may be wrong, or widen bounds."
            return Verdict("stalled", fit.cause, (Remedy(advice),))
        message = (
            "The search did not settle: the residual of its best solution is not noise, and"
            " its tries did not agree. A better solution may exist."
        )
        advice = "Raise starts, start closer, or fix what is known"
        return Verdict("stalled", message, (_advise_raising(advice, "starts", options),))
    if fit.reason == "unsolvable":
        message = (
            "The search ended where the model cannot be solved at the points next to it: no"
            f" minimum was reached. {fit.cause}"
        )
        return Verdict("stalled", message.strip(), (Remedy(f"Start elsewhere. {REMEDY}"),))
    # If the misfit is rounding, so is its change by a step.
    if fit.reason == "stalled" and not misfit < PLAUSIBILITY.rounding_misfit:
        message = f"No step lowers the misfit although its gradient is not zero. {fit.cause}"
        return Verdict("stalled", message.strip(), (Remedy("Start elsewhere or loosen bounds."),))
    return _describe_convergence(fit, analysis, names, misfit)


def add_causes(verdict: Verdict, findings: Sequence[Finding]) -> Verdict:
    """Return the verdict with the causes of the misfit."""
    # If a cause makes the result unacceptable, advice on the fit is omitted.
    statements = " ".join(finding.statement for finding in findings)
    grave = [finding for finding in findings if finding.grave]
    if grave:
        ending, _ = split_ending(verdict.message)
        return replace(verdict, message=f"{statements} {ending}", steps=(grave[0].step,))
    steps = join_remedies([findings[0].step], verdict.steps)
    return replace(verdict, message=f"{verdict.message} {statements}", steps=steps)


def explain_level_dependence(verdict: Verdict, statement: str) -> Verdict:
    """Return the verdict on a linear model fitted to data of several force levels that differ."""
    advice = (
        "Find the place and the kind of the nonlinear element (updyn.locate_nonlinearity, or"
        " [locate] in the job and updyn compare) and add it to the model ([[element]] in the job),"
        " or update to one level and use the result at this level."
    )
    message = verdict.message
    if statement not in message:
        message = f"{message} {statement}"
    return replace(verdict, message=message, steps=(Remedy(advice),))


def explain_early_end(verdict: Verdict) -> Verdict:
    """Return the verdict on a fit whose search was ended by a data fault."""
    why = "No further start was tried: without that fault, the model explains the data."
    return replace(verdict, message=f"{verdict.message} {why}")


def rule_out_faults(verdict: Verdict) -> Verdict:
    """Return the verdict on a fit in whose data no known fault was found."""
    steps = tuple(
        replace(one, advice=_LOOK_ELSEWHERE.advice) if one.advice == _LOOK.advice else one
        for one in verdict.steps
    )
    return replace(verdict, steps=steps)


def explain_rejection(verdict: Verdict, trust: Trust) -> Verdict:
    """Return the verdict on a converged fit whose result is not credible."""
    message = verdict.message
    against = [
        claim.why
        for claim in (trust.resembles, trust.plausible, trust.validated)
        if claim.holds is False
    ]
    reasons = " ".join(why for why in against if why not in message)
    message = message.replace("The fit converged and the data", "The data")
    message = " ".join(
        filter(None, ["The fit converged, but its result is not credible.", reasons, message])
    )
    return Verdict("not-credible", message, verdict.steps or (_LOOK,))


def explain_ambiguity(
    different: Sequence[tuple[str, Sequence[float]]], others: Sequence[Alternative]
) -> tuple[str, Remedy]:
    """Return message and remedy if several solutions fit equally well."""
    differing = []
    for name, values in different[: LIST_LENGTHS.named_items]:
        *first, last = [f"{value:.4g}" for value in values]
        differing.append(f"{name} ({', '.join(first)} or {last})")
    n_more = len(different) - LIST_LENGTHS.named_items
    more = f" and {n_more} more" if n_more > 0 else ""
    odds = max(other.odds for other in others)
    message = (
        f"But at least {1 + len(others)} answers fit the data equally well (odds within"
        f" {max(odds, 1.0):.2g} to 1); they differ in {', '.join(differing)}{more}."
    )
    sensors = list(dict.fromkeys(other.sensor for other in others if other.sensor))
    known = "Fix one of these unknowns where it is known"
    if not sensors:
        return message, Remedy(
            f"{known}, or measure more: a wider band, further modes, their shapes, less noise."
        )
    least_difference = min(other.difference for other in others if other.sensor)
    where = " or ".join(sensors)
    return message, Remedy(
        f"A sensor at {where} would distinguish them: there they differ by"
        f" {100.0 * least_difference:.0f} % typically. {known}."
    )


def _describe_undetermined(analysis: Analysis, names: list[str]) -> str:
    report = analysis.report
    involved = list(compress(names, analysis.involved))
    blind = np.isinf(report.condition)
    how = "without changing anything" if blind else "with no change, above the noise, of anything"
    return (
        f"the data determine only {report.rank} of {report.n_parameters} unknowns:"
        f" {', '.join(involved)} can change together {how} that was measured."
    )


def _describe_convergence(fit: Fit, analysis: Analysis, names: list[str], misfit: float) -> Verdict:
    message = "The fit converged and the data determine all unknowns."
    std = np.sqrt(np.diag(analysis.covariance))
    named = zip(names, std, strict=True)
    weak = [f"{n} ({100 * s:.0f} %)" for n, s in named if s > VERDICT.weak_std]
    if weak:
        message += f" Weakly determined: the standard deviation is large for {', '.join(weak)}."
    # Of several tests: the same for all but the kind of their noise.
    noise = fit.noise[0] if fit.noise else {}
    length = float(noise.get("correlation_length", 1.0))
    if length > VERDICT.most_correlation_lines:
        message += (
            f" The residual is serially correlated over about {length:.0f} lines: model error"
            f" rather than noise; the standard deviations were widened {np.sqrt(length):.2g} times"
            " for it."
        )
    misfit_text = _describe_misfit(fit, misfit)
    if misfit_text:
        return Verdict("converged", message + misfit_text, (_LOOK, *_advise_method(fit)))
    return Verdict("converged", message, _advise_method(fit))


def _advise_method(fit: Fit) -> tuple[Remedy, ...]:
    """Return the note of the method, with the setting of the method that it advises."""
    if not fit.note:
        return ()
    if not fit.better:
        return (Remedy(fit.note),)
    advice = f"{fit.note.removesuffix('.')}:"
    return (Remedy.setting(advice, "method", "name", fit.better),)


def _describe_misfit(fit: Fit, misfit: float) -> str:
    """Return the sentences on a misfit that noise does not explain; may be empty."""
    known = ("stated", "variance", "coherence")
    text = ""
    if misfit > VERDICT.most_misfit and any(n.get("kind") not in known for n in fit.noise or ({},)):
        text += (
            " But the model does not fit the data: half of the values are off by more than"
            f" {percent_of(misfit, 'their level')}."
        )
    # Of several tests: the same for all but the kind of their noise.
    noise = fit.noise[0] if fit.noise else {}
    chi_square = float(noise.get("chi_square", 1.0))
    if chi_square > VERDICT.most_chi_square:
        text += (
            f" The misfit is {np.sqrt(chi_square):.3g} times what the noise explains: the model"
            " cannot fit the data, and the standard deviations were widened by the same factor."
        )
    return text
