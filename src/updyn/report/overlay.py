"""Sections on measured and computed FRFs: all channels in one picture, and one selected channel."""

from __future__ import annotations

import numpy as np

from updyn.arrays import IndexArray, NumberArray, RealArray
from updyn.frf import reference_noun
from updyn.report.data import ReportData, keep_lines
from updyn.report.formats import unit
from updyn.report.plots import encode_array, encode_numbers, escape_labels
from updyn.report.section import PageContent, ReportSection
from updyn.report.settings import REPORT_SIZE
from updyn.report.templates import asset

__all__ = ["ALL_CHANNELS", "FRFS", "overlay"]


class AllChannelsSection(ReportSection):
    """The levels of all channels in one picture, drawn from the data of `OverlaySection`."""

    anchor = "all-channels"
    name = "FRFs"
    heading = "FRFs: all channels in one picture"
    place = 60
    template = "updyn.report/all_channels.html"
    needs_frfs = True
    of_start = True

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows several channels of one test, each with more than one line."""
        if not super().applies(content):
            return False
        return _count_channels(content.data) > 1 and len(content.data.freq) > 1

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the number of channels, the sets of curves, and the units."""
        data = content.data
        sets = [("measured", "measured", True)]
        last = "before" if data.after_curve is None else "after"
        for key, name, curves in (
            ("before", "start", data.before_curve),
            ("after", "updated", data.after_curve),
        ):
            if curves is not None:
                sets.append((key, name, key == last))
        units = dict.fromkeys(unit for row in _list_units(data) for unit in row)
        return {"n_channels": _count_channels(data), "sets": sets, "units": list(units)}


ALL_CHANNELS = AllChannelsSection()


class OverlaySection(ReportSection):
    """Measured and computed FRFs of a selected channel."""

    anchor = "frfs"
    name = "FRFs"
    heading = "FRFs: one channel at a time"
    place = 100
    template = "updyn.report/frfs.html"
    needs_frfs = True
    of_start = True

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the selectable channels, the bands and the notes."""
        data = content.data
        thinned = _choose_lines(data, REPORT_SIZE.frf_bytes)[1]
        return {
            "responses": list(zip(data.responses, data.held_out, strict=True)),
            "references": data.references,
            "noun": reference_noun(data.quantity),
            "height": 560 if data.coherence is None else 640,
            "fit_band": data.fit_band,
            "held_band": data.validation_band,
            "n_lines": data.n_lines,
            "notes": [thinned, *data.notes],
        }

    def embedded_data(self, content: PageContent) -> dict[str, object]:
        """Return the FRFs that are drawn."""
        return {"updyn-frf": overlay(content.data)[0]}

    def script(self) -> str:
        """Return the scripts of the channel selection and of the picture of all channels."""
        return "\n".join(map(asset, ("channels.min.js", "curves.js", "overlay.js")))


FRFS = OverlaySection()


def overlay(data: ReportData, budget: int | None = None) -> tuple[dict[str, object], str]:
    """Return the arrays of the FRF overlay, at most `budget` bytes, and a note if thinned.

    The default budget is `REPORT_SIZE.frf_bytes`.

    Values are base64 of little-endian float32 by channel (response, then reference), real and
    imaginary parts interleaved. Lines are in Hz: ``freq`` of the data, ``grid`` of the models.
    """
    budget = REPORT_SIZE.frf_bytes if budget is None else budget
    keep, note = _choose_lines(data, budget)
    curves = _choose_grid_lines(data, budget)
    payload: dict[str, object] = {
        "freq": encode_array(data.freq[keep], "<f8"),
        "measured": _encode_channels(data.measured, keep, "<c8"),
        "grid": encode_array(data.grid[curves], "<f8"),
        "before": _encode_channels(data.before_curve, curves, "<c8"),
        "after": _encode_channels(data.after_curve, curves, "<c8"),
        "coherence": _encode_channels(data.coherence, keep, "<f4"),
        "responses": escape_labels(data.responses),
        "references": escape_labels(data.references),
        "fracBefore": _round_figures(data.frac_before),
        "fracAfter": _round_figures(data.frac_after),
        "correlationBefore": _round_figures(data.correlation_before),
        "correlationAfter": _round_figures(data.correlation_after),
        "residualBefore": _round_figures(data.residual_before),
        "residualAfter": _round_figures(data.residual_after),
        "heldOut": list(data.held_out),
        "quantity": data.quantity,
        "noun": reference_noun(data.quantity),
        "units": _list_units(data),
        "used": np.flatnonzero(data.used[keep]).tolist(),
        "fitBand": _to_list(data.fit_band),
        "everyLineUsed": _uses_every_line(data),
        "validationBand": _to_list(data.validation_band),
    }
    return payload, note


def _choose_lines(data: ReportData, budget: int) -> tuple[IndexArray, str]:
    """Return the lines that are drawn, and a note if lines are omitted."""
    line_bytes = _count_channels(data) * (8 + 4 * (data.coherence is not None))
    most = int(REPORT_SIZE.measured_share * budget) // line_bytes
    keep = keep_lines(data.measured, data.used, max(most, REPORT_SIZE.least_channel_lines))
    if keep.size == len(data.freq):
        return keep, ""
    note = (
        f"To keep this page small, {keep.size} of {len(data.freq)} lines are drawn in the"
        " overlay; the highest peaks are among them."
    )
    return keep, note


def _choose_grid_lines(data: ReportData, budget: int) -> IndexArray:
    """Return the lines at which the model curves are drawn, within their part of the budget."""
    curves = [values for values in (data.after_curve, data.before_curve) if values is not None]
    if not curves:
        return np.arange(0)
    share = int((1.0 - REPORT_SIZE.measured_share) * budget)
    most = max(share // (8 * len(curves) * _count_channels(data)), REPORT_SIZE.least_channel_lines)
    return keep_lines(curves[0], np.zeros(len(data.grid), dtype=np.bool_), most)


def _count_channels(data: ReportData) -> int:
    return len(data.responses) * len(data.references)


def _list_units(data: ReportData) -> list[list[str]]:
    """Return the unit of each channel, by response and reference."""
    out = []
    for response in data.responses:
        out.append([unit(data.quantity, response, reference) for reference in data.references])
    return out


def _to_list(band: tuple[float, float] | None) -> list[float] | None:
    if band is None:
        return None
    return [float(band[0]), float(band[1])]


def _round_figures(values: RealArray | None) -> object:
    if values is None:
        return None
    return encode_numbers(np.round(values, 6), packed=False)  # more digits than are displayed


def _uses_every_line(data: ReportData) -> bool:
    """Whether the fit uses all lines between its first and last line."""
    at = np.flatnonzero(data.used)
    return bool(at.size > 1 and at[-1] - at[0] + 1 == at.size)


def _encode_channels(values: NumberArray | None, keep: IndexArray, dtype: str) -> str | None:
    """Return the kept lines, channel by channel, as base64."""
    if values is None:
        return None
    return encode_array(values[keep].transpose(1, 2, 0), dtype)
