"""Verdict on a fit: status, message and remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress

import numpy as np

from updyn.updating.fit.method import Fit
from updyn.updating.judge.adequacy import Adequacy
from updyn.updating.judge.alternatives import Alternative
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.ending import ActiveBound, Ending
from updyn.updating.judge.identifiability import Analysis
from updyn.updating.judge.rounding import REMEDY, Rounding
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
    "STEP",
    "add_causes",
    "compose_verdict",
    "explain_ambiguity",
    "explain_early_end",
    "explain_rejection",
    "join_steps",
    "rule_out_faults",
]

#: Job keys that free the calibration factor of a sensor.
_CALIBRATED = {"calibration": "responses", "force_calibration": "references"}
#: Separator between the steps of a remedy; the most effective step comes first.
STEP = "\n"

_CLOSER = "Start closer, or use the default method."
_CHECK = "Check units, calibration and labels"
_OWN_NOISE = (
    'Estimate the noise of each sensor, noise = "estimated-by-channel": the values become more'
    " accurate, and their standard deviations smaller."
)
_LONE = (
    "Leave out the isolated lines (exclude under [test]), or give less weight to outliers"
    ' (noise = { robust = "student-t" }); if it is a resonance, measure it with finer lines.'
)
_LOOK = f"{_CHECK}; look at the channels with the lowest FRAC; free other groups."


def compose_verdict(
    fit: Fit,
    analysis: Analysis,
    names: list[str],
    advice: str,
    misfit: float = 0.0,
    adequacy: Mapping[str, Adequacy | None] | None = None,
    rounding: Rounding | None = None,
    end: Ending | None = None,
) -> tuple[str, str, str]:
    """Return status (one of `STATUSES`), message and remedy (may be empty) of a fit."""
    status, message, remedy = _describe_end(fit, analysis, names, advice, misfit, end)
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
            remedy = join_steps(
                _advise_on_error(inadequate),
                remedy or ("" if known else _advise_inspection(inadequate)),
            )
        if end is not None and end.active_bounds:
            message += _describe_active_bounds(end.active_bounds)
            remedy = join_steps(_advise_wider_bounds(end.active_bounds), remedy)
    if rounding is not None:
        message = f"{message} {rounding.message}"
        remedy = REMEDY if status in ("converged", "stalled") else join_steps(remedy, REMEDY)
    return status, message, remedy


def join_steps(*steps: str) -> str:
    """Return the non-empty steps of a remedy as one text, without duplicates."""
    return STEP.join(dict.fromkeys(step for step in steps if step))


def _is_explained(found: Adequacy) -> bool:
    """Return whether a single error explains the residual."""
    suspects, least = found.explained_by, RESIDUAL_TEST.explained_share
    return bool(suspects) and suspects[0].explains >= least


def _advise_on_error(found: list[Adequacy]) -> str:
    """Return the remedy for an error that would explain the residual; empty if none is known."""
    for adequacy in found:
        if not adequacy.explained_by:
            continue
        if _is_explained(adequacy):
            return _advise_freeing(adequacy.explained_by[0].name)
        return (
            "Look for a part that the model lacks, such as a further support or connection, or for"
            " several errors at once."
        )
    return ""


def _advise_freeing(name: str) -> str:
    """Return the remedy for an unknown that is held, with the lines of the job that free it."""
    of, _, quantity = name.rpartition(".")
    lines = f'[[parameter]] with groups = ["{of}"] and quantity = "{quantity}"'
    if quantity in _CALIBRATED:
        lines = f'[[calibration]] with {_CALIBRATED[quantity]} = ["{of}"]'
    return f"Free {name} if it can be wrong, and run again: {lines}."


def _advise_inspection(found: list[Adequacy]) -> str:
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


def _advise_wider_bounds(active_bounds: Sequence[ActiveBound]) -> str:
    names = ", ".join(one.name for one in active_bounds)
    its = "its bound" if len(active_bounds) == 1 else "their bounds"
    return (
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
    fit: Fit, analysis: Analysis, names: list[str], misfit: float, end: Ending | None
) -> tuple[str, str]:
    """Return message and remedy of a fit at the step limit whose unknowns are determined."""
    message = "The largest number of steps was reached before convergence."
    if end is None:
        return f"{message} {fit.cause}".strip(), "Raise max_iterations, or start closer."
    if _is_decreasing(end):
        message += (
            f" The misfit was still falling: the values are {end.deviations:.2g} standard"
            " deviations from the next step's."
        )
        return message, "Raise max_iterations."
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
    misfit_text, remedy = _describe_misfit(fit, misfit)
    if misfit_text:
        return message + misfit_text, remedy
    if end.deviations <= FIT_END.arrived_stds:
        return message, "Use the values; their standard deviations hold."
    leading = [name for name in names if name in end.leading]
    report = analysis.report
    return message, (
        f"Add lines or sensors that tell {', '.join(leading)} apart (collinearity index"
        f" {report.collinearity:.3g}), hold one of them at a known value, or give a prior."
    )


def _describe_end(
    fit: Fit,
    analysis: Analysis,
    names: list[str],
    advice: str,
    misfit: float,
    end: Ending | None,
) -> tuple[str, str, str]:
    if fit.reason == "failed":
        message = f"{fit.note or 'The fit broke down.'} {fit.cause}".strip()
        return "failed", message, fit.remedy or _CLOSER
    if fit.reason == "stopped":
        message = (
            "Stopped before convergence and assessment; the values are those of the best step so"
            " far."
        )
        if not fit.R.any():
            message += " What the data determine is not known."
        return "stopped", message, "Run it again; with a checkpoint it continues from here."
    if fit.reason == "max-iterations":
        if analysis.report.complete:
            return "max-iterations", *_describe_step_limit(fit, analysis, names, misfit, end)
        message = "The largest number of steps was reached before convergence."
        message = f"{message} {fit.cause}".strip()
        return (
            "max-iterations",
            f"{message} Besides, {_describe_undetermined(analysis, names)}",
            advice,
        )
    if not analysis.report.complete:
        return (
            "not-identifiable",
            f"The fit ended, but {_describe_undetermined(analysis, names)}",
            advice,
        )
    if fit.reason == "unsettled":
        if fit.cause:
            remedy = "State the noise, free what is held and may be wrong, or widen bounds."
            return "stalled", fit.cause, remedy
        message = (
            "The search did not settle: the residual of its best solution is not noise, and"
            " its tries did not agree. A better solution may exist."
        )
        return "stalled", message, "Raise starts, start closer, or fix what is known."
    if fit.reason == "unsolvable":
        message = (
            "The search ended where the model cannot be solved at the points next to it: no"
            f" minimum was reached. {fit.cause}"
        )
        return "stalled", message.strip(), f"Start elsewhere. {REMEDY}"
    # If the misfit is rounding, so is its change by a step.
    if fit.reason == "stalled" and not misfit < PLAUSIBILITY.rounding_misfit:
        message = f"No step lowers the misfit although its gradient is not zero. {fit.cause}"
        return "stalled", message.strip(), "Start elsewhere or loosen bounds."
    return "converged", *_describe_convergence(fit, analysis, names, misfit)


def add_causes(findings: Sequence[Finding], message: str, remedy: str) -> tuple[str, str]:
    """Return message and remedy with the causes of the misfit."""
    # If a cause makes the result unacceptable, advice on the fit is omitted.
    statements = " ".join(finding.statement for finding in findings)
    grave = [finding for finding in findings if finding.grave]
    if grave:
        return f"{statements} {message.partition('. ')[0].rstrip('.')}.", grave[0].remedy
    return f"{message} {statements}", join_steps(findings[0].remedy, remedy)


def explain_early_end(message: str) -> str:
    """Return the message of a fit whose search was ended by a data fault."""
    return f"{message} No further start was tried: without that fault, the model explains the data."


def rule_out_faults(remedy: str) -> str:
    """Return the remedy of a fit in whose data no known fault was found."""
    return remedy.replace(_CHECK, "No known fault of the data explains it (docs/verdict.md)")


def explain_rejection(trust: Trust, message: str, remedy: str) -> tuple[str, str]:
    """Return message and remedy of a converged fit whose result is not credible."""
    against = [
        claim.why
        for claim in (trust.resembles, trust.plausible, trust.validated)
        if claim.holds is False
    ]
    reasons = " ".join(why for why in against if why not in message)
    message = message.replace("The fit converged and the data", "The data")
    return (
        f"The fit converged, but its result is not credible. {reasons} {message}".replace(
            "  ", " "
        ),
        remedy or _LOOK,
    )


def explain_ambiguity(
    different: Sequence[tuple[str, Sequence[float]]], others: Sequence[Alternative]
) -> tuple[str, str]:
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
        return message, (
            f"{known}, or measure more: a wider band, further modes, their shapes, less noise."
        )
    least_difference = min(other.difference for other in others if other.sensor)
    where = " or ".join(sensors)
    return message, (
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


def _describe_convergence(
    fit: Fit, analysis: Analysis, names: list[str], misfit: float
) -> tuple[str, str]:
    message = "The fit converged and the data determine all unknowns."
    remedy = fit.note
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
    misfit_text, inspection = _describe_misfit(fit, misfit)
    if misfit_text:
        message, remedy = message + misfit_text, inspection
    return message, remedy


def _describe_misfit(fit: Fit, misfit: float) -> tuple[str, str]:
    """Return the sentences on a misfit that noise does not explain, if any, and the remedy."""
    known = ("stated", "variance", "coherence")
    text = ""
    if misfit > VERDICT.most_misfit and any(n.get("kind") not in known for n in fit.noise or ({},)):
        text += (
            " But the model does not fit the data: half of the values are off by more than"
            f" {100 * misfit:.0f} %."
        )
    # Of several tests: the same for all but the kind of their noise.
    noise = fit.noise[0] if fit.noise else {}
    chi_square = float(noise.get("chi_square", 1.0))
    if chi_square > VERDICT.most_chi_square:
        text += (
            f" The misfit is {np.sqrt(chi_square):.3g} times what the noise explains: the model"
            " cannot fit the data, and the standard deviations were widened by the same factor."
        )
    return text, f"{_LOOK} {fit.note}".strip() if text else ""
