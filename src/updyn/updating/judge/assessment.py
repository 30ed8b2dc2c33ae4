"""Assessment of a fit: identifiability, covariance, agreement with the data, adequacy, rounding.

If the user stops the assessment, long evaluations are omitted and the rest is completed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from scipy.special import chdtri

from updyn.arrays import ComplexArray, RealArray
from updyn.correlation import correlate
from updyn.dynamics.fields import FieldSolver
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.updating.fit.method import Fit
from updyn.updating.fit.null_space import complement, covariance_within, null_space
from updyn.updating.judge.adequacy import Adequacy, add_suspects, assess_residual
from updyn.updating.judge.advice import advise
from updyn.updating.judge.alternatives import Alternative, find_alternatives
from updyn.updating.judge.between_tests import find_separable_share
from updyn.updating.judge.discrepancy import Discrepancy, estimate_discrepancy
from updyn.updating.judge.held_out import predictive_figures
from updyn.updating.judge.identifiability import Analysis, analyse_identifiability
from updyn.updating.judge.localise import localise_error
from updyn.updating.judge.modal_figures import correlate_measured_modes
from updyn.updating.judge.noise_split import covariance_over_ratios
from updyn.updating.judge.rounding import Rounding, find_worst_rounding
from updyn.updating.judge.settings import FIT_END, RESIDUAL_TEST, SIGNIFICANCE
from updyn.updating.judge.whitening import whiten_residual, whitening_weights
from updyn.updating.problem.data import ModalSplit, Split
from updyn.updating.problem.local import Local
from updyn.updating.problem.modal import ModalError
from updyn.updating.problem.noise import ASSUMED, Estimated, NoiseModel, Robust, choose_noise
from updyn.updating.problem.normalised import make_normalised_residual
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputError, OutputErrorSet
from updyn.updating.problem.session import Stopped

__all__ = [
    "Judgement",
    "analyse_start",
    "assess_adequacy",
    "gain_by_chance",
    "judge_fit",
    "linearise_at_start",
]

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Assessment of a fit; `correlation` and `adequacy` have an entry for each part of the problem.

    `covariance`, shape (n, n), is from data and priors, inf for undetermined unknowns; `misfit` is
    the median of |H - H_X| / |H_X| over the values clear of the noise, 0 if unknown, nan without
    any; `at_bound` gives "lower" or "upper" by unknown. `discrepancy` is included in `covariance`.
    `separable_share` is that of a misfit which an estimate for each test would explain.
    """

    fit: Fit
    analysis: Analysis
    covariance: RealArray
    advice: str = ""
    misfit: float = 0.0
    at_bound: Mapping[str, str] = field(default_factory=dict)
    correlation: tuple[Mapping[str, Any], ...] = ()
    adequacy: tuple[Adequacy | None, ...] = ()
    rounding: Rounding | None = None
    alternatives: tuple[Alternative, ...] = ()
    discrepancy: Discrepancy | None = None
    separable_share: float = 0.0


def judge_fit(
    problem: Problem,
    data: Sequence[Split | ModalSplit],
    fit: Fit,
    noises: Sequence[NoiseModel],
    start_solvers: Sequence[FieldSolver] | None = None,
    *,
    is_likelihood: bool,
) -> Judgement:
    """Assess a fit; `data` gives all and held-out data of each part, those of modes last.

    `start_solvers` are needed if the start of the unknowns has other solvers than the problem. The
    covariance includes model errors only if `is_likelihood`: then they shift the estimate as they
    shift that of the weighted output error.
    """
    cut_short = False

    def unless_stopped(compute: Callable[[], T], otherwise: T) -> T:
        nonlocal cut_short
        try:
            return compute()
        except Stopped:
            cut_short = True
            return otherwise

    names, equal_rows = problem.coordinates.parameters.names, None
    if fit.reason == "failed":  # the last point is not informative: analyse the start
        blinded = Fit.without_jacobian(fit.x, fit.reason, fit.note)
        fit = replace(blinded, cause=fit.cause, remedy=fit.remedy)
        blind = analyse_identifiability(fit.R, names)
        analysis, advice = unless_stopped(lambda: analyse_start(problem, noises), (blind, ""))
        misfit = 0.0
    elif fit.reason == "stopped":  # the user is waiting: omit long evaluations
        analysis, advice, misfit = analyse_identifiability(fit.R, names), "", 0.0
    else:
        if not fit.advice:
            equal_rows = unless_stopped(
                lambda: _equal_row_jacobian(problem, noises, fit.x, fit.R), equal_rows
            )
        analysis = analyse_identifiability(fit.R, names, equal_rows=equal_rows)
        misfit = unless_stopped(lambda: _typical_misfit(problem, noises, fit.x), 0.0)
        if fit.advice and not analysis.report.complete:
            advice = fit.advice
        elif not problem.is_linear:
            advice = ""
        else:
            noise = 0.0 if np.isnan(misfit) else misfit
            advice = unless_stopped(lambda: advise(analysis, problem, fit.x, noise), "")
    solvers = start_solvers or [part.solver for part in problem.parts]
    comparisons: list[Callable[[], dict[str, object]]] = []
    splits = [split for split in data if isinstance(split, Split)]
    for part, split, first in zip(problem.parts, splits, solvers, strict=True):
        comparisons.append(partial(_correlate_part, part, fit.x, split, first))
    modal_splits = [split for split in data if isinstance(split, ModalSplit)]
    for modal, of_modes in zip(problem.modal, modal_splits, strict=True):
        comparisons.append(partial(correlate_measured_modes, modal, fit.x, of_modes))
    correlation: tuple[Mapping[str, object], ...] = tuple(
        unless_stopped(compare, _empty_figures(split))
        for compare, split in zip(comparisons, data, strict=True)
    )
    adequacy: tuple[Adequacy | None, ...] = (None,) * len(problem.parts)
    rounding: Rounding | None = None
    if fit.reason in ("converged", "unsettled", "stalled", "unsolvable", "max-iterations"):
        settled = fit.reason != "max-iterations"
        if problem.is_linear:
            rounding = unless_stopped(lambda: find_worst_rounding(problem.parts, fit.x), None)
        if rounding is None:
            adequacy = unless_stopped(
                lambda: assess_adequacy(problem, fit.x, noises, settled=settled), adequacy
            )
    others: tuple[Alternative, ...] = ()
    if fit.rivals and problem.is_linear:
        others = unless_stopped(lambda: find_alternatives(problem, fit), others)
    spread = _covariance_of_coordinates(problem, fit, equal_rows)
    if any("degrees_of_freedom" in record for record in fit.noise):
        widen = partial(_widen_over_ratios, problem, fit, noises, analysis.null_space, spread)
        spread = unless_stopped(widen, spread)
    separable = 0.0
    if len(problem.parts) > 1 and problem.is_linear and _is_structure(adequacy):
        compare_tests = partial(_find_separable_share, problem, noises, fit.x)
        separable = unless_stopped(compare_tests, 0.0)
    error: Discrepancy | None = None
    is_tested = any(found is not None and found.outcome not in _UNINFORMATIVE for found in adequacy)
    if is_likelihood and is_tested and problem.is_linear:
        estimate = partial(
            _estimate_model_error, problem, fit, noises, adequacy, analysis.null_space
        )
        error = unless_stopped(estimate, None)
    if error is not None:
        fit, spread = _add_model_error(problem, fit, spread, error)
    for i, (part, split) in enumerate(zip(problem.parts, splits, strict=True)):
        if split.held is not None and _is_noise_known(adequacy[i], noises[i]):
            predict = partial(
                _predict_held_out, problem, part, split.held, fit.x, spread, noises[i]
            )
            correlation = _add_prediction(correlation, i, unless_stopped(predict, {}))
    adequacy += (None,) * len(problem.modal)
    if cut_short:
        fit = replace(fit, reason="stopped")
    covariance, at_bound = (
        _covariance_of_values(problem, fit.x, spread),
        _find_active_bounds(problem, fit.x),
    )
    return Judgement(
        fit,
        analysis,
        covariance,
        advice,
        misfit,
        at_bound,
        correlation,
        adequacy,
        rounding,
        others,
        error,
        separable,
    )


def analyse_start(problem: Problem, noises: Sequence[NoiseModel]) -> tuple[Analysis, str]:
    """Return the identifiability analysis at the start, and the experiment advice."""
    # Noise of typical size is assumed if a fit would estimate it.
    local, share = linearise_at_start(problem, noises)
    x = problem.coordinates.start
    equal_rows = _equal_row_jacobian(problem, noises, x, local.R)
    analysis = analyse_identifiability(
        local.R, problem.coordinates.parameters.names, equal_rows=equal_rows
    )
    return analysis, advise(analysis, problem, x, share) if problem.is_linear else ""


def linearise_at_start(problem: Problem, noises: Sequence[NoiseModel]) -> tuple[Local, float]:
    """Return the whitened output error at the start, and the median relative deviation."""
    x = problem.coordinates.start
    errors, shares = [], []
    for part, given in zip(problem.parts, noises, strict=True):
        noise = choose_noise(ASSUMED, part.frf) if given.kind == Estimated.kind else given
        H = part.responses(x)
        variance = noise.variance(H, part.frf)
        errors.append(OutputError(np.sqrt(2.0 / variance)))
        shares.append((np.sqrt(variance) / np.maximum(np.abs(H), np.finfo(float).tiny)).ravel())
    modal = tuple(
        ModalError(part.noise.without_assumptions(part.rows(x))) for part in problem.modal
    )
    local = OutputErrorSet(tuple(errors), modal).local(problem, x)
    if local is None:
        raise SolverError("the model cannot be solved at its start")
    share = float(np.median(np.concatenate(shares))) if shares else 0.0
    return local, share


def _equal_row_jacobian(
    problem: Problem, noises: Sequence[NoiseModel], x: RealArray, R: RealArray
) -> RealArray | None:
    """Return a reduced Jacobian with rows of equal size; None if R has full or the same rank."""
    deficiency = null_space(R).shape[1]
    if deficiency == 0 or not R.any():
        return None
    local = make_normalised_residual(problem, noises).local(problem, x)
    return local.R if local is not None and null_space(local.R).shape[1] < deficiency else None


def _covariance_of_coordinates(
    problem: Problem, fit: Fit, equal_rows: RealArray | None
) -> RealArray:
    """Return the covariance of the optimiser's coordinates; inf for undetermined ones."""
    weight = problem.coordinates.prior[1]
    if fit.regularisation is not None and fit.regularisation.within is not None:
        known = covariance_within(np.vstack([fit.R, np.diag(weight)]), fit.regularisation.within)
        return np.asarray(known)
    if fit.regularisation is not None:
        weight = weight + fit.regularisation.weight
    rows = np.diag(weight)
    analysis = analyse_identifiability(
        np.vstack([fit.R, rows]),
        problem.coordinates.parameters.names,
        equal_rows=None if equal_rows is None else np.vstack([equal_rows, np.sign(rows)]),
    )
    out = np.array(analysis.covariance)
    out[analysis.involved] = np.inf
    out[:, analysis.involved] = np.inf
    return out


def _widen_over_ratios(
    problem: Problem,
    fit: Fit,
    noises: Sequence[NoiseModel],
    undetermined: RealArray,
    spread: RealArray,
) -> RealArray:
    """Return the covariance over all ratios of relative noise and floor, for few data.

    Return `spread` if this does not apply or if a ratio is known.
    """
    if problem.modal or fit.regularisation is not None or fit.reason in _ABORTED:
        return spread
    floors = []
    for part, noise in zip(problem.parts, noises, strict=True):
        known = noise.refit(part.responses(fit.x), part.frf, problem.share(part))
        if not isinstance(known, Estimated) or known.spare is None:
            return spread
        floors.append(known.floor)
    found = covariance_over_ratios(problem, fit.x, floors, complement(undetermined))
    return spread if found is None else np.where(np.isinf(spread), np.inf, found)


#: Reasons of termination after which a fit is not assessed.
_ABORTED = ("failed", "stopped")
#: Outcomes of the tests of the residual that carry no information on a model error.
_UNINFORMATIVE = ("exact", "untested")


def gain_by_chance() -> float:
    """Return the gain in restricted log-likelihood that chance exceeds at the tests' level."""
    # A model error is estimated although the residual is noise. Its variance of 0 is at the bound
    # of its range, hence twice the gain is 0 in half of the fits and has the chi-square
    # distribution of one degree of freedom in the others (Self & Liang, J. Am. Stat. Assoc. 82
    # (1987) 605).
    return 0.5 * float(chdtri(1.0, 2.0 * RESIDUAL_TEST.alarm_level))


def _estimate_model_error(
    problem: Problem,
    fit: Fit,
    noises: Sequence[NoiseModel],
    adequacy: Sequence[Adequacy | None],
    undetermined: RealArray,
) -> Discrepancy | None:
    """Return the model error found in the residual; None without any."""
    # A residual classed as structure contains a model error; for other residuals, the gain in
    # likelihood must be significant. Few data hardly determine the noise: None.
    if any("degrees_of_freedom" in record for record in fit.noise):
        return None
    return estimate_discrepancy(
        problem,
        fit,
        whiten_residual(problem, noises, fit.x),
        undetermined,
        size_known=all(noise.bulk.size_known for noise in noises[: len(problem.parts)]),
        least_gain=0.0 if _is_structure(adequacy) else gain_by_chance(),
    )


def _find_separable_share(problem: Problem, noises: Sequence[NoiseModel], x: RealArray) -> float:
    return find_separable_share(problem, whiten_residual(problem, noises, x), x)


def _is_structure(adequacy: Sequence[Adequacy | None]) -> bool:
    """Return whether the residual of any test contains structure."""
    return any(found is not None and found.outcome == "structure" for found in adequacy)


def _add_model_error(
    problem: Problem, fit: Fit, spread: RealArray, error: Discrepancy
) -> tuple[Fit, RealArray]:
    no_interval = error.lacks_interval(spread)
    record: dict[str, object] = {"model_error": error.share}
    names = [name for name, lost in zip(_names(problem), no_interval, strict=True) if lost]
    if names:
        record["not_known"] = names
    spread = spread + error.covariance
    spread[no_interval] = np.inf
    spread[:, no_interval] = np.inf
    return replace(
        fit, noise=tuple({**noise_record, **record} for noise_record in fit.noise)
    ), spread


def _names(problem: Problem) -> list[str]:
    return problem.coordinates.parameters.names


def _covariance_of_values(problem: Problem, x: RealArray, spread: RealArray) -> RealArray:
    """Return the covariance of the values from that of the optimiser's coordinates."""
    slope = problem.coordinates.slope(x)
    is_open = np.isinf(spread)
    out = np.where(is_open, 0.0, spread) * slope[:, None] * slope
    out[is_open] = np.inf
    return out


def _is_noise_known(adequacy: Adequacy | None, noise: NoiseModel) -> bool:
    """Return whether the size of the noise is stated or estimated from a residual of noise."""
    if noise.bulk.size_known:
        return True
    return adequacy is not None and adequacy.outcome in ("noise", "exact", "untested")


def _predict_held_out(
    problem: Problem,
    part: FRFPart,
    held: FRF,
    x: RealArray,
    spread: RealArray,
    noise: NoiseModel,
) -> dict[str, float]:
    """Return the predictive figures of held-out data; empty if the model is singular."""
    try:
        H = part.responses(x)
        known, scale = noise.refit(H, part.frf, problem.share(part)).bulk, 1.0
        if not known.scale_known:
            power = np.abs(part.frf.values - H) ** 2 / known.variance(H, part.frf)
            scale = float(np.mean(power))
        return predictive_figures(part.with_data(held), x, spread, known, scale)
    except SolverError:
        return {}


def _add_prediction(
    correlation: tuple[Mapping[str, Any], ...], i: int, figures: Mapping[str, float]
) -> tuple[Mapping[str, Any], ...]:
    """Return the figures of agreement extended by the predictive figures of part i."""
    found = list(correlation)
    validation = found[i].get("validation", {})
    if figures and validation.get("after"):
        validation = {**validation, "after": {**validation["after"], **figures}}
        found[i] = {**found[i], "validation": validation}
    return tuple(found)


def _typical_misfit(problem: Problem, noises: Sequence[NoiseModel], x: RealArray) -> float:
    """Return the median of |H - H_X| / |H_X| over values clear of the noise; nan without any."""
    # Without FRFs: the median of the relative errors of natural frequencies.
    misfits = []
    for part, noise in zip(problem.parts, noises, strict=True):
        measured = part.frf.values
        size = np.abs(measured)
        is_clear = size > SIGNIFICANCE.stds * np.sqrt(noise.initial_variance(part.frf))
        misfits.append(np.abs(part.responses(x) - measured)[is_clear] / size[is_clear])
    for modal in problem.modal if not misfits else ():
        rows = modal.rows(x)
        misfits.append(np.abs(rows.r[rows.of("frequency")]))
    misfit = np.concatenate(misfits)
    if misfit.size:
        return float(np.median(misfit))
    return np.nan if problem.parts else 0.0


def _find_active_bounds(problem: Problem, x: RealArray) -> dict[str, str]:
    lower, upper = problem.coordinates.bounds
    near = 1e-9 * (upper - lower)
    sides = np.where(x <= lower + near, "lower", np.where(x >= upper - near, "upper", ""))
    names = problem.coordinates.parameters.names
    return {names[i]: str(sides[i]) for i in np.flatnonzero(sides)}


def _correlate_part(
    part: FRFPart, x: RealArray, split: Split, first: FieldSolver
) -> dict[str, object]:
    part_of_all_data = part.with_data(split.whole)
    start_part = part_of_all_data.with_solver(first)
    start = part.coordinates.start
    # Only the unbounded plain iteration can end at a negative loss factor; the updated model uses
    # zero instead.
    end = np.where(~part.coordinates.parameters.is_damping, x, np.maximum(x, 0.0))
    parts = {"fitted": split.fitted}
    if split.held is not None:
        parts["held"] = split.held
    before, after = (
        _correlate_subsets(start_part, start, parts),
        _correlate_subsets(part_of_all_data, end, parts),
    )
    out: dict[str, object] = {"before": before.get("fitted", {}), "after": after.get("fitted", {})}
    if split.held is not None:
        out["validation"] = {"before": before.get("held", {}), "after": after.get("held", {})}
    return out


def _empty_figures(split: Split | ModalSplit) -> dict[str, object]:
    none: dict[str, object] = {"before": {}, "after": {}}
    if split.held is not None:
        none["validation"] = {"before": {}, "after": {}}
    return none


def _correlate_subsets(
    whole: FRFPart, x: RealArray, parts: Mapping[str, FRF]
) -> dict[str, dict[str, float]]:
    """Return the figures of agreement with parts of the data; empty if the model is singular."""
    frf = whole.frf
    try:
        response = FRF(
            frf.freq,
            whole.responses(x),
            frf.responses,
            frf.references,
            frf.quantity,
            decay=frf.decay,
        )
    except SolverError:
        return {}
    scores = {}
    for name, part in parts.items():
        computed = response.select(lines=part.freq, responses=part.responses)
        scores[name] = dict(correlate(computed, part).figures())
    return scores


def assess_adequacy(
    problem: Problem, x: RealArray, noises: Sequence[NoiseModel], *, settled: bool = True
) -> tuple[Adequacy | None, ...]:
    """Test the residual of each part of FRFs against noise; None if the model cannot be solved."""
    # The residual is measured minus computed FRF, whichever residual the method minimised.
    # Outliers of a robust fit have full weight in the tests, but reduced weight in the search for
    # a model error, because any quantity that affects a single value explains an outlier. A fit
    # that is not `settled` is tested only if a step could not reduce the residual by more than 5
    # %.
    if not problem.parts:
        return ()
    problem = problem.without_modes
    try:
        responses = [part.responses(x) for part in problem.parts]
    except SolverError:
        return (None,) * len(problem.parts)
    found, errors, robust_residuals = [], [], []
    for part, noise, H in zip(problem.parts, noises, responses, strict=True):
        share = problem.share(part)
        known = noise.refit(H, part.frf, share)
        weight = robust = whitening_weights(known, H, part)
        if isinstance(known, Robust):  # outliers have full weight in the tests
            weight = whitening_weights(replace(known, weight=None), H, part)
        errors.append(OutputError(robust, "residual"))
        with np.errstate(invalid="ignore"):
            misfit = part.frf.values - H
            is_used = (weight > 0.0) & ((H != 0.0) | (part.frf.values != 0.0))
            robust_residuals.append(np.where(is_used, robust * misfit, np.nan))
            whitened = np.where(is_used, weight * misfit, np.nan)
        base = noise.bulk
        found.append(
            assess_residual(
                whitened,
                H,
                part.frf.freq,
                part.frf.responses.labels,
                part.frf.references.labels,
                n_unknowns=share,
                absolute=base.size_known,
                averages=part.frf.averages if base.source != "stated" else None,
                level=RESIDUAL_TEST.alarm_level / len(problem.parts),
                relative=_relative_misfit(misfit, part),
                whitened_H=np.where(is_used, weight * H, np.nan),
            )
        )
    residual = OutputErrorSet(tuple(errors))
    if not settled and _is_unsettled(problem, residual, x):
        return (None,) * len(problem.parts)
    outcomes = {a.outcome for a in found}
    if outcomes.isdisjoint(("structure", "excess")):
        return tuple(found)
    excess = None
    if all(a.absolute for a in found):
        excess = 0.0
        for e in robust_residuals:
            excess += float(np.nansum(np.abs(e) ** 2)) - 2.0 * np.isfinite(e).sum()
        excess += problem.n
    if not problem.is_linear:  # places are those of linear groups
        return tuple(found)
    suspects = localise_error(problem, x, residual, robust_residuals, excess)
    return tuple(add_suspects(a, suspects) for a in found)


def _is_unsettled(problem: Problem, residual: OutputErrorSet, x: RealArray) -> bool:
    """Return whether a step could still reduce the residual by more than `_MOVING`."""
    local = residual.local(problem, x)
    return local is None or float(local.q @ local.q) > FIT_END.moving_share * 2.0 * local.cost


def _relative_misfit(misfit: ComplexArray, part: FRFPart) -> float:
    """Return the largest rms misfit of a channel over the rms of its data."""
    rms_misfit = np.sqrt(np.mean(np.abs(misfit) ** 2, axis=0))
    size = np.sqrt(np.mean(np.abs(part.frf.values) ** 2, axis=0))
    return float(np.max(rms_misfit / np.where(size > 0.0, size, 1.0)))
