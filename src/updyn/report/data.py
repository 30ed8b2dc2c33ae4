"""Measured and computed FRFs of a report, and their agreement, gathered once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.correlation import csac, frac, frf_correlation, relative_residual
from updyn.dynamics.resonance_lines import even_lines, resonance_lines
from updyn.errors import UpdynError
from updyn.frf import FRF
from updyn.model import Model
from updyn.report.start import Start
from updyn.updating.result import UpdateResult, gains_of

__all__ = [
    "EVALUATION_BUDGET",
    "ReportData",
    "computed",
    "fine_grid",
    "gather",
    "gather_start",
    "keep_lines",
]

#: Lines x DOFs up to which the two models are computed at every line of the data: seconds to a few
#: minutes.
EVALUATION_BUDGET = 2_000_000
#: The same where the user has stopped the run, and waits: about a second.
_STOPPED_BUDGET = 50_000
_MOST_LINES = 5_000
_FEWEST_LINES = 100
_LEAST_LINES = 8
#: Further lines at which the curves of the models are computed: even ones, and at most so many
#: about resonances; of models that are costly to solve fewer, so many lines x DOFs. Where a reduced
#: model answers at any line at little cost, all are even ones.
_EVEN_LINES = 400
_RESONANCE_LINES = 1_200
_GRID_BUDGET = 500_000


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """Measured and computed FRFs, and their agreement.

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines at which measured and computed FRFs are compared, in Hz; 0 Hz left out.
    measured : ndarray of complex, shape (n_f, n_responses, n_references)
        The data, in the unit of `quantity`.
    before, after : ndarray of complex, same shape, or None
        The start and the updated model; None where it could not be computed (`notes` says why).
    grid : ndarray of float, shape (n_g,)
        Lines of the curves of the models, in Hz: those of `freq`, and further ones that resolve the
        resonances.
    before_curve, after_curve : ndarray of complex, shape (n_g, n_responses, n_references), or None
        The start and the updated model on `grid`.
    coherence : ndarray of float, same shape, or None
        Ordinary coherence of the data.
    responses, references : tuple of str
        DOF labels.
    held_out : tuple of bool
        By response, whether it was held out of the fit.
    quantity : str
        Receptance, mobility or accelerance.
    used : ndarray of bool, shape (n_f,)
        Which of the lines were used in the fit.
    compared : ndarray of bool, shape (n_f,)
        Lines over which FRAC and level differences are formed: all but those of a band held out.
    frac_before, frac_after : ndarray of float, shape (n_responses, n_references), or None
        Frequency response assurance criterion of each channel over the lines `compared`.
    correlation_before, correlation_after : ndarray of float, same shape, or None
        FRF correlation of each channel, with sign, over the same lines.
    residual_before, residual_after : ndarray of float, same shape, or None
        Relative residual of each channel over the same lines.
    csac_before, csac_after : ndarray of float, shape (n_f,), or None
        Cross signature assurance criterion at each line; None too where there is one channel only
        (it is 1 then).
    notes : tuple of str
        What was left out or thinned, in sentences for the reader.
    fit_band, validation_band : (float, float) or None
        First and last line of the fit, and the band that was held out of it, in Hz.
    n_lines : int
        How many lines the fit uses.
    fitted : bool
        Whether there was a fit; else there is a start only.
    """

    freq: NDArray[np.float64]
    measured: NDArray[np.complex128]
    before: NDArray[np.complex128] | None
    after: NDArray[np.complex128] | None
    grid: NDArray[np.float64]
    before_curve: NDArray[np.complex128] | None
    after_curve: NDArray[np.complex128] | None
    coherence: NDArray[np.float64] | None
    responses: tuple[str, ...]
    references: tuple[str, ...]
    held_out: tuple[bool, ...]
    quantity: str
    used: NDArray[np.bool_]
    compared: NDArray[np.bool_]
    frac_before: NDArray[np.float64] | None
    frac_after: NDArray[np.float64] | None
    correlation_before: NDArray[np.float64] | None
    correlation_after: NDArray[np.float64] | None
    residual_before: NDArray[np.float64] | None
    residual_after: NDArray[np.float64] | None
    csac_before: NDArray[np.float64] | None
    csac_after: NDArray[np.float64] | None
    notes: tuple[str, ...]
    fit_band: tuple[float, float] | None = None
    validation_band: tuple[float, float] | None = None
    n_lines: int = 0
    fitted: bool = True


def gather(result: UpdateResult) -> ReportData:
    """Compute both models and compare them with what was measured.

    They are computed at the lines of the data, which figures of agreement are over, and on a finer
    grid for their curves. Above `EVALUATION_BUDGET` (lines x DOFs) the lines are thinned, peaks
    kept, and a note says so.
    """
    gains = gains_of(result)
    made = _gathered(
        result.frf,
        (result.parameters.at_start(result.start), result.model),
        result.lines,
        result.validation_responses,
        result.validation_band,
        result.options,
        gains,
        stopped=result.status == "stopped",
    )
    if gains is None:
        return made
    note = "The updated model is shown as the sensors read it: times their calibration factors."
    return replace(made, notes=(*made.notes, note))


def gather_start(start: Start) -> ReportData:
    """Compute a model where its update would start, and compare it with what was measured.

    Parameters
    ----------
    start : Start
        Of a test that measured FRFs.

    Returns
    -------
    ReportData
        Without an updated model.
    """
    assert isinstance(start.data, FRF)
    made = _gathered(
        start.data,
        (start.model, None),
        start.lines,
        start.validation_responses,
        start.validation_band,
        start.options,
        None,
        stopped=False,
    )
    return replace(made, fitted=False)


def _gathered(
    frf: FRF,
    models: tuple[Model, Model | None],
    lines: NDArray[np.float64],
    validation_responses: Sequence[str],
    validation_band: tuple[float, float] | None,
    options: Mapping[str, Any],
    gains: NDArray[np.float64] | None,
    *,
    stopped: bool,
) -> ReportData:
    """Return the data and the FRFs of the start and, where there is one, of the updated model."""
    start, updated = models
    notes: list[str] = []
    used = _is_used(frf, lines)
    keep = np.arange(len(frf.freq))
    if frf.freq[0] == 0.0:
        keep = keep[1:]
        notes.append("The line at 0 Hz is not drawn.")
    reduced = options.get("tier") == "reduced"
    per_line = 1 if reduced else start.n_dofs
    limit = int(np.clip(EVALUATION_BUDGET // per_line, _FEWEST_LINES, _MOST_LINES))
    if stopped:
        limit = max(min(limit, _STOPPED_BUDGET // start.n_dofs), _LEAST_LINES)
    if keep.size > limit:
        chosen = keep_lines(frf.values[keep], used[keep], limit)
        notes.append(
            f"The models were computed at {chosen.size} of the {keep.size} measured lines (the"
            " highest peaks of the mean level are among them); figures of agreement drawn here are"
            " over these."
        )
        keep = keep[chosen]
    freq, measured, used = frf.freq[keep], frf.values[keep], used[keep]
    drawn = [model for model in models if model is not None]
    fine = freq if stopped else fine_grid(drawn, freq, reduced=reduced)
    for grid in (fine, freq):
        refused: list[str] = []
        # A reduced model would be built, and its error certified, for a look alone.
        if stopped and (reduced or len(grid) * start.n_dofs > _STOPPED_BUDGET):
            before_curve = after_curve = None
            refused.append(
                "The models are not drawn: the run was stopped before they were computed."
            )
            break
        before_curve = computed(start, frf, grid, "start model", refused, options)
        after_curve = None
        if updated is not None:
            after_curve = computed(updated, frf, grid, "updated model", refused, options)
        if not refused:  # else one of them is singular: it may be so between lines only
            break
    notes += refused
    if gains is not None and after_curve is not None:
        after_curve = after_curve * gains
    at = np.searchsorted(grid, freq)
    before = None if before_curve is None else before_curve[at]
    after = None if after_curve is None else after_curve[at]
    compared = _outside(freq, validation_band)
    validation = set(validation_responses)
    return ReportData(
        freq=freq,
        measured=measured,
        before=before,
        after=after,
        grid=grid,
        before_curve=before_curve,
        after_curve=after_curve,
        coherence=None if frf.coherence is None else frf.coherence[keep],
        responses=tuple(frf.responses.labels),
        references=tuple(frf.references.labels),
        held_out=tuple(label in validation for label in frf.responses.labels),
        quantity=frf.quantity,
        used=used,
        compared=compared,
        frac_before=_scores(frac, measured, before, compared),
        frac_after=_scores(frac, measured, after, compared),
        correlation_before=_scores(frf_correlation, measured, before, compared),
        correlation_after=_scores(frf_correlation, measured, after, compared),
        residual_before=_scores(relative_residual, measured, before, compared),
        residual_after=_scores(relative_residual, measured, after, compared),
        csac_before=_csac(measured, before),
        csac_after=_csac(measured, after),
        notes=tuple(notes),
        fit_band=(float(lines.min()), float(lines.max())) if len(lines) else None,
        validation_band=validation_band,
        n_lines=len(lines),
    )


def fine_grid(
    models: Sequence[Model], freq: NDArray[np.float64], *, reduced: bool
) -> NDArray[np.float64]:
    """Return some lines and those that resolve the resonances of models, in Hz.

    Parameters
    ----------
    models : sequence of Model
        Those whose curves are drawn, of one size.
    freq : ndarray of float, shape (n,)
        Lines that are among them, ascending, in Hz, above 0.
    reduced : bool
        Whether they are computed in a reduced model, which answers at any line at little cost; the
        modes of the whole model would take long.
    """
    if freq.size < 2:
        return freq
    low, high = float(freq[0]), float(freq[-1])
    if reduced:
        return np.union1d(freq, even_lines(low, high, _EVEN_LINES + _RESONANCE_LINES))
    affordable = max(_GRID_BUDGET // models[0].n_dofs, _FEWEST_LINES)
    each = min(_RESONANCE_LINES, affordable) // len(models)
    parts = [freq, even_lines(low, high, min(_EVEN_LINES, affordable // 4))]
    for model in models:
        parts.append(resonance_lines(model, low, high, each))
    return np.unique(np.concatenate(parts))


def _is_used(frf: FRF, lines: NDArray[np.float64]) -> NDArray[np.bool_]:
    used = np.zeros(len(frf.freq), dtype=np.bool_)
    if len(lines):
        used[frf.find_lines(lines)] = True
    return used


def _outside(freq: NDArray[np.float64], band: tuple[float, float] | None) -> NDArray[np.bool_]:
    """Return which lines lie outside the band held out; all where that leaves none."""
    if band is not None:
        outside = (freq < band[0]) | (freq > band[1])
        if outside.any():
            return np.asarray(outside)
    return np.ones(len(freq), dtype=np.bool_)


def computed(
    model: Model,
    frf: FRF,
    freq: NDArray[np.float64],
    what: str,
    notes: list[str],
    options: Mapping[str, Any],
) -> NDArray[np.complex128] | None:
    """Return the FRFs of a model at some lines; None, with a note, where they cannot be computed.

    Parameters
    ----------
    model : Model
        The model.
    frf : FRF
        The data: channels and quantity.
    freq : ndarray of float, shape (n,)
        Lines in Hz.
    what : str
        The name of the model in the note.
    notes : list of str
        The note is appended to it.
    options : mapping
        Options of the update, which say how a large model was solved.

    Returns
    -------
    ndarray of complex, shape (n, n_responses, n_references), or None
        In the unit of the data.
    """
    from updyn.dynamics.response import response

    if freq.size == 0:
        return None
    # As the update solved it: a large model line by line would take longer than the update.
    how: dict[str, Any] = {}
    if options.get("tier") == "reduced":
        how = {key: options[key] for key in ("tier", "accuracy") if key in options}
    try:
        where = (freq, frf.responses, frf.references, frf.quantity)
        return response(model, *where, decay=frf.decay, **how).values
    except UpdynError as error:  # a failed fit has a report too
        notes.append(f"The {what} could not be computed and is not drawn: {error}")
        return None


def _scores(
    measure: Callable[[ArrayLike, ArrayLike], NDArray[np.float64]],
    measured: NDArray[np.complex128],
    computed: NDArray[np.complex128] | None,
    compared: NDArray[np.bool_],
) -> NDArray[np.float64] | None:
    """Return a measure of agreement of each channel over some lines."""
    if computed is None:
        return None
    return measure(measured[compared], computed[compared])


def _csac(
    measured: NDArray[np.complex128], computed: NDArray[np.complex128] | None
) -> NDArray[np.float64] | None:
    if computed is None or measured[:1].size < 2:
        return None
    return np.asarray(csac(measured, computed), dtype=np.float64)


def keep_lines(
    values: NDArray[np.complex128], used: NDArray[np.bool_], limit: int
) -> NDArray[np.intp]:
    """Choose lines of too many: peaks first, then lines of the fit, then evenly spaced ones.

    Parameters
    ----------
    values : ndarray of complex, shape (n_f, n_responses, n_references)
        The data.
    used : ndarray of bool, shape (n_f,)
        Lines used in the fit.
    limit : int
        How many lines may stay, at least 8.

    Returns
    -------
    ndarray of int
        Positions, ascending, at most `limit`; first and last line included.
    """
    n = len(values)
    if n <= limit:
        return np.arange(n)
    with np.errstate(divide="ignore"):
        level = np.log(np.abs(values)).reshape(n, -1)
    level = np.where(np.isfinite(level), level, 0.0).mean(axis=1)
    inner = np.arange(1, n - 1)
    height = level[1:-1] - np.maximum(level[:-2], level[2:])
    depth = np.minimum(level[:-2], level[2:]) - level[1:-1]
    turns = inner[(height > 0) | (depth > 0)]
    if turns.size > limit // 4:  # noise turns at every other line: keep the largest levels
        turns = turns[np.argsort(-np.abs(level[turns] - np.median(level)))[: limit // 4]]
    wanted = np.flatnonzero(used)
    room = limit - turns.size
    fitted = wanted if wanted.size <= room // 2 else wanted[:0]  # all of them or none
    even = np.linspace(0, n - 1, room - fitted.size).round().astype(np.intp)
    return np.unique(np.concatenate([turns, fitted, even]))
