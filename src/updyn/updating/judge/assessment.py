"""Assessment of a fit: identifiability, covariance, agreement with the data, adequacy, rounding.

After a stop, evaluations that take long are left out, and the rest is assessed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from updyn.correlation import correlate
from updyn.dynamics.fields import FieldSolver
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.updating.fit.method import Fit
from updyn.updating.fit.null_space import complement, covariance_within, null_space
from updyn.updating.judge.adequacy import LEVEL, Adequacy, assess, blamed
from updyn.updating.judge.advice import advise
from updyn.updating.judge.alternatives import Alternative, alternatives
from updyn.updating.judge.discrepancy import Discrepancy, estimate_discrepancy
from updyn.updating.judge.held_out import predictive_figures
from updyn.updating.judge.identifiability import Analysis, analyse
from updyn.updating.judge.localise import localise
from updyn.updating.judge.modal_figures import modal_correlation
from updyn.updating.judge.noise_split import covariance_over_ratios
from updyn.updating.judge.rounding import Rounding, worst_rounding
from updyn.updating.problem.data import ModalSplit, Split
from updyn.updating.problem.levelled import levelled
from updyn.updating.problem.local import Local
from updyn.updating.problem.modal import ModalError
from updyn.updating.problem.noise import ASSUMED, Estimated, NoiseModel, Robust, choose_noise
from updyn.updating.problem.problem import Part, Problem
from updyn.updating.problem.residuals import Each, OutputError
from updyn.updating.problem.session import Stopped

__all__ = [
    "Judgement",
    "at_start",
    "examine",
    "judge",
    "local_at_start",
    "whitening",
]

T = TypeVar("T")

#: A level that noise alone hardly has, in its standard deviations.
_CLEAR = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What is known of a fit.

    Attributes
    ----------
    fit : Fit
        The fit, as stopped where the judgement was.
    analysis : Analysis
        What the data determine.
    covariance : ndarray of float, shape (n, n)
        Of the values, from data and priors; inf for unknowns that neither determines.
    advice : str
        Experiment advice on undetermined unknowns.
    misfit : float
        Median of |H - H_X| / |H_X| over values that are clear of the noise as far as it is known
        before a fit: what noise and model error leave. 0 where it is not known, nan where no value
        is clear of the noise.
    at_bound : dict of str to str
        ``"lower"`` or ``"upper"`` for unknowns on a bound.
    correlation : tuple of dict
        For each part of the problem, figures of agreement before and after; empty where they are
        not known.
    adequacy : tuple of Adequacy or None
        For each part, whether the residual is noise; None where it is not known, or rounding is
        seen.
    rounding : Rounding or None
        Where rounding moves the model's answer by what matters.
    alternatives : tuple of Alternative
        Other answers that fit as well.
    discrepancy : Discrepancy or None
        Errors of the model that the residual shows, which the covariance includes; None where it
        shows none.
    """

    fit: Fit
    analysis: Analysis
    covariance: NDArray[np.float64]
    advice: str = ""
    misfit: float = 0.0
    at_bound: Mapping[str, str] = field(default_factory=dict)
    correlation: tuple[Mapping[str, Any], ...] = ()
    adequacy: tuple[Adequacy | None, ...] = ()
    rounding: Rounding | None = None
    alternatives: tuple[Alternative, ...] = ()
    discrepancy: Discrepancy | None = None


def judge(
    problem: Problem,
    data: Sequence[Split | ModalSplit],
    fit: Fit,
    noises: Sequence[NoiseModel],
    firsts: Sequence[FieldSolver] | None = None,
    *,
    is_likelihood: bool,
) -> Judgement:
    """Judge a fit.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    data : sequence of Split or ModalSplit
        For each part, all its data, and what of them was held out; those of modes last.
    fit : Fit
        How it ended.
    noises : sequence of NoiseModel
        How uncertain the data of each part are.
    firsts : sequence of FieldSolver, optional
        What solves each part at the start of the unknowns, where it is not the problem's own.
    is_likelihood : bool
        Whether the fit maximises a likelihood. Only then do errors of the model move the estimate
        as they move the weighted output error, and are part of the covariance.

    Returns
    -------
    Judgement
    """
    cut_short = False

    def unless_stopped(compute: Callable[[], T], otherwise: T) -> T:
        nonlocal cut_short
        try:
            return compute()
        except Stopped:
            cut_short = True
            return otherwise

    names, even = problem.coordinates.parameters.names, None
    if fit.reason == "failed":  # where it broke down says nothing about the data; the start does
        blinded = Fit.blind(fit.x, fit.reason, fit.note)
        fit = replace(blinded, cause=fit.cause, remedy=fit.remedy)
        blind = analyse(fit.R, names)
        analysis, advice = unless_stopped(lambda: at_start(problem, noises), (blind, ""))
        misfit = 0.0
    elif fit.reason == "stopped":  # the user waits
        analysis, advice, misfit = analyse(fit.R, names), "", 0.0
    else:
        if not fit.advice:
            even = unless_stopped(lambda: _even(problem, noises, fit.x, fit.R), even)
        analysis = analyse(fit.R, names, even=even)
        misfit = unless_stopped(lambda: _typical_misfit(problem, noises, fit.x), 0.0)
        if fit.advice and not analysis.report.complete:
            advice = fit.advice
        else:
            noise = 0.0 if np.isnan(misfit) else misfit
            advice = unless_stopped(lambda: advise(analysis, problem, fit.x, noise), "")
    solvers = firsts or [part.solver for part in problem.parts]
    scored: list[Callable[[], dict[str, Any]]] = []
    splits = [split for split in data if isinstance(split, Split)]
    for part, split, first in zip(problem.parts, splits, solvers, strict=True):
        scored.append(partial(_correlation, part, fit.x, split, first))
    modal_splits = [split for split in data if isinstance(split, ModalSplit)]
    for modal, of_modes in zip(problem.modal, modal_splits, strict=True):
        scored.append(partial(modal_correlation, modal, fit.x, of_modes))
    correlation: tuple[Mapping[str, Any], ...] = tuple(
        unless_stopped(score, _no_figures(split)) for score, split in zip(scored, data, strict=True)
    )
    adequacy: tuple[Adequacy | None, ...] = (None,) * len(problem.parts)
    rounding: Rounding | None = None
    if fit.reason in ("converged", "unsettled", "stalled", "unsolvable", "max-iterations"):
        settled = fit.reason != "max-iterations"
        rounding = unless_stopped(lambda: worst_rounding(problem.parts, fit.x), None)
        if rounding is None:
            adequacy = unless_stopped(
                lambda: examine(problem, fit.x, noises, settled=settled), adequacy
            )
    others: tuple[Alternative, ...] = ()
    if fit.rivals:
        others = unless_stopped(lambda: alternatives(problem, fit), others)
    spread = _spread(problem, fit, even)
    if any("degrees_of_freedom" in record for record in fit.noise):
        over_ratios = partial(_over_ratios, problem, fit, noises, analysis.null_space, spread)
        spread = unless_stopped(over_ratios, spread)
    error: Discrepancy | None = None
    tested = any(found is not None and found.outcome not in _UNTOLD for found in adequacy)
    if is_likelihood and tested:
        estimated = partial(_model_error, problem, fit, noises, adequacy, analysis.null_space)
        error = unless_stopped(estimated, None)
    if error is not None:
        fit, spread = _with_model_error(problem, fit, spread, error)
    for i, (part, split) in enumerate(zip(problem.parts, splits, strict=True)):
        if split.held is not None and _noise_is_known(adequacy[i], noises[i]):
            predicted = partial(_predicted, problem, part, split.held, fit.x, spread, noises[i])
            correlation = _with_prediction(correlation, i, unless_stopped(predicted, {}))
    adequacy += (None,) * len(problem.modal)
    if cut_short:
        fit = replace(fit, reason="stopped")
    covariance, at_bound = _in_values(problem, fit.x, spread), _at_bound(problem, fit.x)
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
    )


def at_start(problem: Problem, noises: Sequence[NoiseModel]) -> tuple[Analysis, str]:
    """Analyse the data at the start of the unknowns, and advise.

    Parameters
    ----------
    problem : Problem
        Model, data and unknowns.
    noises : sequence of NoiseModel
        How uncertain the data of each part are; noise of ordinary size is taken where it would be
        estimated from a fit.

    Raises
    ------
    SolverError
        If the model cannot be solved there.
    """
    local, share = local_at_start(problem, noises)
    x = problem.coordinates.home
    even = _even(problem, noises, x, local.R)
    analysis = analyse(local.R, problem.coordinates.parameters.names, even=even)
    return analysis, advise(analysis, problem, x, share)


def local_at_start(problem: Problem, noises: Sequence[NoiseModel]) -> tuple[Local, float]:
    """Return the whitened output error at the start, and the median of standard deviation over |H|.

    Parameters
    ----------
    problem, noises
        As for `at_start`.

    Raises
    ------
    SolverError
        If the model cannot be solved there.
    """
    x = problem.coordinates.home
    errors, shares = [], []
    for part, given in zip(problem.parts, noises, strict=True):
        noise = choose_noise(ASSUMED, part.frf) if given.kind == Estimated.kind else given
        H = part.responses(x)
        variance = noise.variance(H, part.frf)
        errors.append(OutputError(np.sqrt(2.0 / variance)))
        shares.append((np.sqrt(variance) / np.maximum(np.abs(H), np.finfo(float).tiny)).ravel())
    modal = tuple(ModalError(part.noise) for part in problem.modal)
    local = Each(tuple(errors), modal).local(problem, x)
    if local is None:
        raise SolverError("the model cannot be solved at its start")
    share = float(np.median(np.concatenate(shares))) if shares else 0.0
    return local, share


def _even(
    problem: Problem, noises: Sequence[NoiseModel], x: NDArray[np.float64], R: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return a reduced Jacobian in which no value outweighs the others, where rank is lost by that.

    None where R has full rank, or as much of it.
    """
    short = null_space(R).shape[1]
    if short == 0 or not R.any():
        return None
    local = levelled(problem, noises).local(problem, x)
    return local.R if local is not None and null_space(local.R).shape[1] < short else None


def _spread(problem: Problem, fit: Fit, even: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """Return the covariance of the optimiser's coordinates; inf for what is left open."""
    weight = problem.coordinates.prior[1]
    if fit.pull is not None and fit.pull.within is not None:
        known = covariance_within(np.vstack([fit.R, np.diag(weight)]), fit.pull.within)
        return np.asarray(known)
    if fit.pull is not None:
        weight = weight + fit.pull.weight
    rows = np.diag(weight)
    analysis = analyse(
        np.vstack([fit.R, rows]),
        problem.coordinates.parameters.names,
        even=None if even is None else np.vstack([even, np.sign(rows)]),
    )
    out = np.array(analysis.covariance)
    out[analysis.involved] = np.inf
    out[:, analysis.involved] = np.inf
    return out


def _over_ratios(
    problem: Problem,
    fit: Fit,
    noises: Sequence[NoiseModel],
    undetermined: NDArray[np.float64],
    spread: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the covariance over all ratios of relative noise and floor; `spread` if one is known.

    It is that of fits whose noise was estimated from few data.
    """
    if problem.modal or fit.pull is not None or fit.reason in _ABORTED:
        return spread
    floors = []
    for part, noise in zip(problem.parts, noises, strict=True):
        known = noise.refit(part.responses(fit.x), part.frf, problem.share(part))
        if not isinstance(known, Estimated) or known.spare is None:
            return spread
        floors.append(known.floor)
    found = covariance_over_ratios(problem, fit.x, floors, complement(undetermined))
    return spread if found is None else np.where(np.isinf(spread), np.inf, found)


#: How a fit ended whose answer is not assessed.
_ABORTED = ("failed", "stopped")
#: Outcomes of a test of the residual that say nothing of an error of the model.
_UNTOLD = ("exact", "untested")
#: Restricted log-likelihood that an error of the model gains by chance in a share `LEVEL` of fits
#: whose residual is noise: a variance of 0 is at the bound of its range, so that twice the gain is
#: 0 in half of them, and has the chi-square distribution of one degree of freedom in the others
#: (Self & Liang, J. Am. Stat. Assoc. 82 (1987) 605).
_BY_CHANCE = 0.5 * float(chdtri(1.0, 2.0 * LEVEL))


def _model_error(
    problem: Problem,
    fit: Fit,
    noises: Sequence[NoiseModel],
    adequacy: Sequence[Adequacy | None],
    undetermined: NDArray[np.float64],
) -> Discrepancy | None:
    """Return the errors of the model that the residual shows; None where it shows none.

    A residual that tests have called structure has one; any other has to show it by likelihood.
    From few data the noise itself is hardly known, and nothing is found.
    """
    if any("degrees_of_freedom" in record for record in fit.noise):
        return None
    errors, size_known = [], True
    for part, noise in zip(problem.parts, noises, strict=True):
        H = part.responses(fit.x)
        known = noise.refit(H, part.frf, problem.share(part))
        errors.append(OutputError(whitening(known, H, part)))
        size_known = size_known and noise.bulk.size_known
    is_structure = any(found is not None and found.outcome == "structure" for found in adequacy)
    return estimate_discrepancy(
        problem,
        fit,
        Each(tuple(errors)),
        undetermined,
        size_known=size_known,
        least_gain=0.0 if is_structure else _BY_CHANCE,
    )


def _with_model_error(
    problem: Problem, fit: Fit, spread: NDArray[np.float64], error: Discrepancy
) -> tuple[Fit, NDArray[np.float64]]:
    """Return a fit whose record states an error of the model, and the covariance with it."""
    unknown = error.unknown(spread)
    record: dict[str, Any] = {"model_error": error.share}
    names = [name for name, lost in zip(_names(problem), unknown, strict=True) if lost]
    if names:
        record["not_known"] = names
    spread = spread + error.covariance
    spread[unknown] = np.inf
    spread[:, unknown] = np.inf
    return replace(fit, noise=tuple({**own, **record} for own in fit.noise)), spread


def _names(problem: Problem) -> list[str]:
    return problem.coordinates.parameters.names


def _in_values(
    problem: Problem, x: NDArray[np.float64], spread: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance of the values by that of the optimiser's coordinates."""
    slope = problem.coordinates.slope(x)
    is_open = np.isinf(spread)
    out = np.where(is_open, 0.0, spread) * slope[:, None] * slope
    out[is_open] = np.inf
    return out


def _noise_is_known(adequacy: Adequacy | None, noise: NoiseModel) -> bool:
    """Return whether the size of the noise is known: stated, or that of a residual of noise."""
    if noise.bulk.size_known:
        return True
    return adequacy is not None and adequacy.outcome in ("noise", "exact", "untested")


def _predicted(
    problem: Problem,
    part: Part,
    held: FRF,
    x: NDArray[np.float64],
    spread: NDArray[np.float64],
    noise: NoiseModel,
) -> dict[str, float]:
    """Return what is predicted of held-out data; empty where the model is singular."""
    try:
        H = part.responses(x)
        known, scale = noise.refit(H, part.frf, problem.share(part)).bulk, 1.0
        if not known.scale_known:
            power = np.abs(part.frf.values - H) ** 2 / known.variance(H, part.frf)
            scale = float(np.mean(power))
        return predictive_figures(part.with_data(held), x, spread, known, scale)
    except SolverError:
        return {}


def _with_prediction(
    correlation: tuple[Mapping[str, Any], ...], i: int, figures: Mapping[str, float]
) -> tuple[Mapping[str, Any], ...]:
    """Return the figures of agreement, those of the held-out data of a part extended."""
    found = list(correlation)
    validation = found[i].get("validation", {})
    if figures and validation.get("after"):
        validation = {**validation, "after": {**validation["after"], **figures}}
        found[i] = {**found[i], "validation": validation}
    return tuple(found)


def _typical_misfit(
    problem: Problem, noises: Sequence[NoiseModel], x: NDArray[np.float64]
) -> float:
    """Return the median of |H - H_X| / |H_X|, over values that are clear of the noise.

    Nan where none is. Of modes alone, of the relative errors of frequencies.
    """
    misfits = []
    for part, noise in zip(problem.parts, noises, strict=True):
        measured = part.frf.values
        size = np.abs(measured)
        seen = size > _CLEAR * np.sqrt(noise.beforehand(part.frf))
        misfits.append(np.abs(part.responses(x) - measured)[seen] / size[seen])
    for modal in problem.modal if not misfits else ():
        rows = modal.rows(x)
        misfits.append(np.abs(rows.r[rows.of("frequency")]))
    misfit = np.concatenate(misfits)
    if misfit.size:
        return float(np.median(misfit))
    return np.nan if problem.parts else 0.0


def _at_bound(problem: Problem, x: NDArray[np.float64]) -> dict[str, str]:
    lower, upper = problem.coordinates.bounds
    near = 1e-9 * (upper - lower)
    sides = np.where(x <= lower + near, "lower", np.where(x >= upper - near, "upper", ""))
    names = problem.coordinates.parameters.names
    return {names[i]: str(sides[i]) for i in np.flatnonzero(sides)}


def _correlation(
    part: Part, x: NDArray[np.float64], split: Split, first: FieldSolver
) -> dict[str, Any]:
    whole = part.with_data(split.whole)
    untouched = replace(whole, solver=first)
    start = part.coordinates.home
    # Only the unbounded plain iteration can leave a loss factor below zero; the updated model has
    # none.
    end = np.where(part.coordinates.parameters.is_factor, x, np.maximum(x, 0.0))
    parts = {"fitted": split.fitted}
    if split.held is not None:
        parts["held"] = split.held
    before, after = _scores(untouched, start, parts), _scores(whole, end, parts)
    out: dict[str, Any] = {"before": before.get("fitted", {}), "after": after.get("fitted", {})}
    if split.held is not None:
        out["validation"] = {"before": before.get("held", {}), "after": after.get("held", {})}
    return out


def _no_figures(split: Split | ModalSplit) -> dict[str, Any]:
    none: dict[str, Any] = {"before": {}, "after": {}}
    if split.held is not None:
        none["validation"] = {"before": {}, "after": {}}
    return none


def _scores(
    whole: Part, x: NDArray[np.float64], parts: Mapping[str, FRF]
) -> dict[str, dict[str, float]]:
    """Score the model on parts of the data, solved once; empty where it is singular."""
    frf = whole.frf
    try:
        answer = FRF(
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
        computed = answer.select(lines=part.freq, responses=part.responses)
        scores[name] = dict(correlate(computed, part).figures())
    return scores


#: A fit is not settled if its unknowns could still reduce the residual by more than this share.
_MOVING = 0.05


def examine(
    problem: Problem, x: NDArray[np.float64], noises: Sequence[NoiseModel], *, settled: bool = True
) -> tuple[Adequacy | None, ...]:
    """Test the residual of a fit against noise, whitened by the noise models of its tests.

    Whatever residual a method has minimised, measured minus computed FRF is looked at. Values that
    a robust fit gave less weight count in full, but not where something is sought that would
    explain a misfit: whatever moves a single value explains an outlier. That takes one evaluation
    with derivatives.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    x : ndarray of float, shape (n,)
        The estimate.
    noises : sequence of NoiseModel
        How uncertain the data of each part are.
    settled : bool
        Whether the fit ended at a minimum. Where it did not, it is tested all the same if the
        unknowns could not reduce the residual by more than a twentieth.

    Returns
    -------
    tuple of Adequacy or None
        For each part of FRFs; None where the model cannot be solved, or the fit is not settled.
    """
    if not problem.parts:
        return ()
    problem = problem.of_frfs
    try:
        answers = [part.responses(x) for part in problem.parts]
    except SolverError:
        return (None,) * len(problem.parts)
    found, errors, limited = [], [], []
    for part, noise, H in zip(problem.parts, noises, answers, strict=True):
        share = problem.share(part)
        known = noise.refit(H, part.frf, share)
        weight = robust = whitening(known, H, part)
        if isinstance(known, Robust):  # outliers count as all other values
            weight = whitening(replace(known, weight=None), H, part)
        errors.append(OutputError(robust, "residual"))
        with np.errstate(invalid="ignore"):
            misfit = part.frf.values - H
            counted = (weight > 0.0) & ((H != 0.0) | (part.frf.values != 0.0))
            limited.append(np.where(counted, robust * misfit, np.nan))
            whitened = np.where(counted, weight * misfit, np.nan)
        base = noise.bulk
        found.append(
            assess(
                whitened,
                H,
                part.frf.freq,
                part.frf.responses.labels,
                part.frf.references.labels,
                n_unknowns=share,
                absolute=base.size_known,
                averages=part.frf.averages if base.source != "stated" else None,
                level=LEVEL / len(problem.parts),
                relative=_relative(misfit, part),
                course=np.where(counted, weight * H, np.nan),
            )
        )
    residual = Each(tuple(errors))
    if not settled and _moves(problem, residual, x):
        return (None,) * len(problem.parts)
    outcomes = {a.outcome for a in found}
    if outcomes.isdisjoint(("structure", "excess")):
        return tuple(found)
    beyond = None
    if all(a.absolute for a in found):
        beyond = 0.0
        for e in limited:
            beyond += float(np.nansum(np.abs(e) ** 2)) - 2.0 * np.isfinite(e).sum()
        beyond += problem.n
    suspects = localise(problem, x, residual, limited, beyond)
    return tuple(blamed(a, suspects) for a in found)


def _moves(problem: Problem, residual: Each, x: NDArray[np.float64]) -> bool:
    """Return whether the unknowns could still reduce the residual by a good part."""
    local = residual.local(problem, x)
    return local is None or float(local.q @ local.q) > _MOVING * 2.0 * local.cost


def whitening(known: NoiseModel, H: NDArray[np.complex128], part: Part) -> NDArray[np.float64]:
    """Return 1 / sigma of the real and of the imaginary part; 0 for what has no finite variance.

    Parameters
    ----------
    known : NoiseModel
        Refitted to the residual.
    H : ndarray of complex, shape (n_f, n_i, n_j)
        Of the model.
    part : Part
        With the data.
    """
    variance = np.broadcast_to(known.variance(H, part.frf), H.shape)
    usable = np.isfinite(variance) & (variance > 0.0)
    return np.where(usable, np.sqrt(2.0 / np.where(usable, variance, 1.0)), 0.0)


def _relative(misfit: NDArray[np.complex128], part: Part) -> float:
    """Return the largest rms misfit of a channel over the rms of its data."""
    left = np.sqrt(np.mean(np.abs(misfit) ** 2, axis=0))
    size = np.sqrt(np.mean(np.abs(part.frf.values) ** 2, axis=0))
    return float(np.max(left / np.where(size > 0.0, size, 1.0)))
