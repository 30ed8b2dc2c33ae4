"""Measured and computed FRFs of a report and their agreement."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.correlation import csac, frac, frf_correlation, relative_residual
from updyn.dynamics.excitation import fix_base
from updyn.dynamics.periodic.settings import LINE_BALANCE
from updyn.dynamics.resonance_lines import even_lines, resonance_lines
from updyn.errors import UpdynError
from updyn.frf import FRF
from updyn.model import Model
from updyn.report.settings import REPORT_COMPUTATION
from updyn.report.start import Start
from updyn.updating.judge.adequacy import Adequacy
from updyn.updating.level_model import respond_as_measured
from updyn.updating.result import UpdateResult, estimated_gains

__all__ = ["ReportData", "compute_frfs", "fine_grid", "gather", "gather_start", "keep_lines"]


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """Measured and computed FRFs and their agreement.

    `freq`, shape (n_f,), are the lines in Hz, without 0 Hz, at which `measured` and the FRFs
    `before` and `after` the update are compared, each (n_f, n_responses, n_references), in the unit
    of `quantity`. The curves are on `grid`, shape (n_g,), with additional lines that resolve
    resonances. `used` are the lines of the fit, `n_lines` of them; `compared` those outside the
    validation band, over which each channel has its FRAC, signed correlation and relative residual,
    shape (n_responses, n_references). CSAC has the shape (n_f,). Values that cannot be computed are
    None (see `notes`), as is CSAC of a single channel, which is always 1. Bands are in Hz; without
    `fitted` there is only a start model.
    """

    freq: RealArray
    measured: ComplexArray
    before: ComplexArray | None
    after: ComplexArray | None
    grid: RealArray
    before_curve: ComplexArray | None
    after_curve: ComplexArray | None
    coherence: RealArray | None
    responses: tuple[str, ...]
    references: tuple[str, ...]
    held_out: tuple[bool, ...]
    quantity: str
    used: BoolArray
    compared: BoolArray
    frac_before: RealArray | None
    frac_after: RealArray | None
    correlation_before: RealArray | None
    correlation_after: RealArray | None
    residual_before: RealArray | None
    residual_after: RealArray | None
    csac_before: RealArray | None
    csac_after: RealArray | None
    notes: tuple[str, ...]
    fit_band: tuple[float, float] | None = None
    validation_band: tuple[float, float] | None = None
    n_lines: int = 0
    fitted: bool = True
    #: Relative residual that the noise alone causes, (n_responses, n_references); nan if unknown.
    noise: RealArray | None = None


def gather(result: UpdateResult) -> ReportData:
    """Compute the start and the updated model and compare them with the data."""
    # The agreement is computed at the measured lines, the curves on a finer grid. With too many
    # lines x DOFs, lines are thinned with their peaks kept, with a note.
    gains = estimated_gains(result)
    made = _compute_data(
        result.frf,
        (result.parameters.at_start(result.start), result.model),
        result.lines,
        result.validation_responses,
        result.validation_band,
        result.options,
        gains,
        stopped=result.status == "stopped",
    )
    made = replace(made, noise=_find_noise(made, result.adequacy))
    if gains is None:
        return made
    note = "The updated model is shown times the calibration factors of the sensors."
    return replace(made, notes=(*made.notes, note))


def _find_noise(data: ReportData, found: Adequacy | None) -> RealArray | None:
    """Return the relative residual that noise alone causes in each channel, from the misfits."""
    if found is None or data.after is None or not np.isfinite(found.misfit).any():
        return None
    noise = np.full(data.measured.shape[1:], np.nan)
    squared = np.abs(data.after - data.measured) ** 2
    for i, response in enumerate(found.responses):
        for j, reference in enumerate(found.references):
            if response not in data.responses or reference not in data.references:
                continue
            at = data.responses.index(response), data.references.index(reference)
            power = level = 0.0
            for (low, high), misfit in zip(found.bands.tolist(), found.misfit[i, j], strict=True):
                lines = (data.freq >= low) & (data.freq <= high)
                if misfit > 0.0:
                    power += float(squared[lines, *at].sum()) / float(misfit) ** 2
                    level += float((np.abs(data.measured[lines, *at]) ** 2).sum())
            noise[at] = np.sqrt(power / level) if level > 0.0 else np.nan
    return noise


def gather_start(start: Start) -> ReportData:
    """Compute the start model of an FRF test, without an update, and compare it with the data."""
    assert isinstance(start.data, FRF)
    made = _compute_data(
        start.data,
        (start.model, None),
        start.lines,
        start.validation_responses,
        start.validation_band,
        start.options,
        None,
        stopped=False,
        known=start.computed,
    )
    return replace(made, fitted=False)


def _compute_data(
    frf: FRF,
    models: tuple[Model, Model | None],
    lines: RealArray,
    validation_responses: Sequence[str],
    validation_band: tuple[float, float] | None,
    options: Mapping[str, object],
    gains: RealArray | None,
    *,
    stopped: bool,
    known: FRF | None = None,
) -> ReportData:
    """Return the data and the FRFs of start (`known`) and, if present, of the updated model."""
    start, updated = models
    notes: list[str] = []
    used = _find_used_lines(frf, lines)
    keep = np.arange(len(frf.freq))
    if frf.freq[0] == 0.0:
        keep = keep[1:]
        notes.append("The line at 0 Hz is not drawn.")
    reduced = options.get("tier") == "reduced"
    per_line = 1 if reduced else _measure_line(start)
    limit = _limit_lines(per_line)
    if stopped:
        limit = min(limit, REPORT_COMPUTATION.stopped_budget // start.n_dofs)
        limit = max(limit, REPORT_COMPUTATION.least_stopped_lines)
    if keep.size > limit:
        chosen = keep_lines(frf.values[keep], used[keep], limit)
        notes.append(
            f"The models were computed at {chosen.size} of the {keep.size} measured lines (the"
            " highest peaks of the mean level are among them); figures of agreement drawn here are"
            " over these."
        )
        keep = keep[chosen]
    freq, measured, used = frf.freq[keep], frf.values[keep], used[keep]
    drawn = [fix_base(model, frf) for model in models if model is not None]
    fine = freq if stopped else fine_grid(drawn, freq, reduced=reduced)
    for grid in (fine, freq):
        failures: list[str] = []
        # Building and certifying a reduced model takes too long after a stop.
        if stopped and (reduced or len(grid) * start.n_dofs > REPORT_COMPUTATION.stopped_budget):
            before_curve = after_curve = None
            failures.append(
                "The models are not drawn: the run was stopped before they were computed."
            )
            break
        before_curve = compute_frfs(start, frf, grid, "start model", failures, options, known)
        after_curve = None
        if updated is not None:
            after_curve = compute_frfs(updated, frf, grid, "updated model", failures, options)
        if not failures:  # else try the measured lines: a model may be singular at others
            break
    notes += failures
    if gains is not None and after_curve is not None:
        after_curve = after_curve * gains
    at = np.searchsorted(grid, freq)
    before = None if before_curve is None else before_curve[at]
    after = None if after_curve is None else after_curve[at]
    compared = _find_compared_lines(freq, validation_band)
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
        frac_before=_measure_channels(frac, measured, before, compared),
        frac_after=_measure_channels(frac, measured, after, compared),
        correlation_before=_measure_channels(frf_correlation, measured, before, compared),
        correlation_after=_measure_channels(frf_correlation, measured, after, compared),
        residual_before=_measure_channels(relative_residual, measured, before, compared),
        residual_after=_measure_channels(relative_residual, measured, after, compared),
        csac_before=_compute_csac(measured, before),
        csac_after=_compute_csac(measured, after),
        notes=tuple(notes),
        fit_band=(float(lines.min()), float(lines.max())) if len(lines) else None,
        validation_band=validation_band,
        n_lines=len(lines),
    )


def _measure_line(model: Model) -> int:
    """Return the work of a line in DOFs; with nonlinear elements, harmonics are solved, too."""
    return model.n_dofs * (1 + LINE_BALANCE.harmonics if model.nonlinear else 1)


def _limit_lines(per_line: int) -> int:
    """Return the largest number of lines for a number of DOFs that are computed at each."""
    affordable = REPORT_COMPUTATION.evaluation_budget // per_line
    return min(max(affordable, REPORT_COMPUTATION.least_lines), REPORT_COMPUTATION.most_lines)


def fine_grid(models: Sequence[Model], freq: RealArray, *, reduced: bool) -> RealArray:
    """Return the given lines (Hz) together with lines that resolve the resonances of the models."""
    # If `reduced`, lines are evenly spaced, because the modes of the full model would be
    # expensive.
    n = REPORT_COMPUTATION.even_lines + REPORT_COMPUTATION.resonance_lines
    if freq.size < 2 or (reduced and freq.size >= n):
        return freq
    low, high = float(freq[0]), float(freq[-1])
    if reduced:
        return np.union1d(freq, even_lines(low, high, n))
    affordable = REPORT_COMPUTATION.grid_budget // _measure_line(models[0])
    affordable = max(affordable, REPORT_COMPUTATION.least_lines)
    each = min(REPORT_COMPUTATION.resonance_lines, affordable) // len(models)
    parts = [freq, even_lines(low, high, min(REPORT_COMPUTATION.even_lines, affordable // 4))]
    for model in models:
        parts.append(resonance_lines(model, low, high, each))
    return np.unique(np.concatenate(parts))


def _find_used_lines(frf: FRF, lines: RealArray) -> BoolArray:
    used = np.zeros(len(frf.freq), dtype=np.bool_)
    if len(lines):
        used[frf.find_lines(lines)] = True
    return used


def _find_compared_lines(freq: RealArray, band: tuple[float, float] | None) -> BoolArray:
    """Return which lines lie outside the validation band; all lines if none does."""
    if band is not None:
        outside = (freq < band[0]) | (freq > band[1])
        if outside.any():
            return np.asarray(outside)
    return np.ones(len(freq), dtype=np.bool_)


def compute_frfs(
    model: Model,
    frf: FRF,
    freq: RealArray,
    what: str,
    notes: list[str],
    options: Mapping[str, object],
    known: FRF | None = None,
) -> ComplexArray | None:
    """Return the FRFs of a model, shape (n, n_responses, n_references), in the unit of the data.

    None if they cannot be computed, with a note on `what`. `freq` is in Hz; `options` are those of
    the update, which determine how a large model is solved. Lines of `known` are not computed.
    """
    if freq.size == 0:
        return None
    if known is not None:
        return _extend(
            known, freq, lambda rest: compute_frfs(model, frf, rest, what, notes, options)
        )
    # Solve as the update did: a direct solution of a large model at every line could take longer
    # than the update.
    how: dict[str, Any] = {}
    if options.get("tier") == "reduced":
        how = {key: options[key] for key in ("tier", "accuracy") if key in options}
    try:
        return respond_as_measured(model, frf, freq, **how).values
    except UpdynError as error:  # a failed fit also gets a report
        notes.append(f"The {what} could not be computed and is not drawn: {error}")
        return None


def _extend(
    known: FRF, freq: RealArray, compute: Callable[[RealArray], ComplexArray | None]
) -> ComplexArray | None:
    """Return known values and computed ones at all other lines; None if these fail."""
    at = np.searchsorted(known.freq, freq).clip(max=len(known.freq) - 1)
    is_known = known.freq[at] == freq
    values = np.asarray(known.values[at], dtype=np.complex128)
    if not is_known.all():
        others = compute(freq[~is_known])
        if others is None:
            return None
        values[~is_known] = others
    return values


def _measure_channels(
    measure: Callable[[ArrayLike, ArrayLike], RealArray],
    measured: ComplexArray,
    computed: ComplexArray | None,
    compared: BoolArray,
) -> RealArray | None:
    """Return a measure of agreement per channel over the lines `compared`."""
    if computed is None:
        return None
    return measure(measured[compared], computed[compared])


def _compute_csac(measured: ComplexArray, computed: ComplexArray | None) -> RealArray | None:
    if computed is None or measured[:1].size < 2:
        return None
    return np.asarray(csac(measured, computed), dtype=np.float64)


def keep_lines(values: ComplexArray, used: BoolArray, limit: int) -> IndexArray:
    """Return ascending positions of lines to keep: peaks, lines of the fit, evenly spaced lines.

    They include the first and the last line. The `limit` is at least 8.
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
    if turns.size > limit // 4:  # noise peaks at every other line: keep the most extreme levels
        turns = turns[np.argsort(-np.abs(level[turns] - np.median(level)))[: limit // 4]]
    wanted = np.flatnonzero(used)
    room = limit - turns.size
    fitted = wanted if wanted.size <= room // 2 else wanted[:0]  # all or none
    even = np.linspace(0, n - 1, room - fitted.size).round().astype(np.intp)
    return np.unique(np.concatenate([turns, fitted, even]))
