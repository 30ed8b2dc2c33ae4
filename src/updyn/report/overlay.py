"""The section of measured and computed FRFs over each other, with a channel picker."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.data import ReportData, keep_lines
from updyn.report.plots import Figure, label, numbers
from updyn.report.section import Content, Section
from updyn.report.templates import asset
from updyn.updating.result import UpdateResult

__all__ = ["DRAWING_BUDGET", "FRFS", "overlay"]

#: Bytes of FRFs that the page carries at most, before base64: about two thirds of the size of the
#: largest page.
DRAWING_BUDGET = 16_000_000


class Overlay(Section):
    """Measured and computed FRFs, channel by channel."""

    anchor = "frfs"
    name = "FRFs"
    heading = "Measured and computed FRFs"
    place = 100

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return the channel picker and the place of the overlay."""
        data = content.data
        responses = "".join(
            f'<option value="{i}"'
            f' data-label="{m.esc(r)}">{m.esc(r)}{" (held out)" if held else ""}</option>'
            for i, (r, held) in enumerate(zip(data.responses, data.held_out, strict=True))
        )
        references = "".join(
            f'<option value="{j}" data-label="{m.esc(r)}">{m.esc(r)}</option>'
            for j, r in enumerate(data.references)
        )
        return Template(asset("overlay.html")).substitute(
            responses=responses,
            references=references,
            height=640 if data.coherence is not None else 560,
            bands=_bands(content.result),
            notes=m.note(_thinned(data, DRAWING_BUDGET)[1], *data.notes),
        )

    def embedded(self, content: Content) -> dict[str, Any]:
        """Return the FRFs that are drawn."""
        return {"updyn-frf": overlay(content.result, content.data)[0]}

    def script(self) -> str:
        """Return the channel picker's script."""
        return asset("overlay.js")


FRFS = Overlay()


def _bands(result: UpdateResult) -> str:
    said = ""
    if len(result.lines):
        low, high = w.number(float(result.lines.min())), w.number(float(result.lines.max()))
        said = (
            f"{m.swatch('fit')}band used in the fit, {low} to {high} Hz, {len(result.lines)} lines"
        )
    if result.validation_band is not None:
        low, high = (w.number(v) for v in result.validation_band)
        said += f" {m.swatch('held')}band held out, {low} to {high} Hz"
    return said


def overlay(
    result: UpdateResult, data: ReportData, budget: int = DRAWING_BUDGET
) -> tuple[dict[str, Any], str]:
    """Return what the FRF overlay draws, and a note where lines were thinned to keep the page small.

    Parameters
    ----------
    result : UpdateResult
        The result.
    data : ReportData
        What `gather` made of it.
    budget : int
        Bytes of arrays at most.

    Returns
    -------
    dict
        ``freq`` (Hz) and ``measured``, ``before``, ``after``, ``coherence`` as base64 of
        little-endian float32, channel by channel (response, then reference), real and imaginary
        parts in turn; labels, units and bands.
    str
        The note, or an empty text.
    """
    keep, note = _thinned(data, budget)
    used = data.used[keep]
    payload: dict[str, Any] = {
        "freq": _packed(data.freq[keep], "<f8"),
        "measured": _channels(data.measured, keep),
        "before": _channels(data.before, keep),
        "after": _channels(data.after, keep),
        "coherence": (
            None
            if data.coherence is None
            else _packed(data.coherence[keep].transpose(1, 2, 0), "<f4")
        ),
        "responses": [label(r) for r in data.responses],
        "references": [label(r) for r in data.references],
        "fracBefore": None if data.frac_before is None else numbers(data.frac_before, packed=False),
        "fracAfter": None if data.frac_after is None else numbers(data.frac_after, packed=False),
        "heldOut": list(data.held_out),
        "quantity": data.quantity,
        "units": [[w.unit(data.quantity, r, c) for c in data.references] for r in data.responses],
        "used": np.flatnonzero(used).tolist(),
        "fitBand": (
            [float(result.lines.min()), float(result.lines.max())] if len(result.lines) else None
        ),
        "everyLineUsed": _every_line(data),
        "validationBand": (
            None if result.validation_band is None else list(map(float, result.validation_band))
        ),
    }
    return payload, note


def _thinned(data: ReportData, budget: int) -> tuple[NDArray[np.intp], str]:
    """Return which lines are drawn, and a note where these are not all."""
    n_channels = len(data.responses) * len(data.references)
    n_sets = 1 + (data.before is not None) + (data.after is not None)
    line_bytes = n_channels * (8 * n_sets + 4 * (data.coherence is not None))
    keep = keep_lines(data.measured, data.used, max(budget // line_bytes, 50))
    if keep.size == len(data.freq):
        return keep, ""
    note = (
        f"To keep this page small, {keep.size} of {len(data.freq)} lines are drawn in the"
        " overlay; the highest peaks are among them."
    )
    return keep, note


def _every_line(data: ReportData) -> bool:
    """Whether the lines of the fit are all lines between the first and the last of them."""
    at = np.flatnonzero(data.used)
    return bool(at.size > 1 and at[-1] - at[0] + 1 == at.size)


def _channels(values: NDArray[np.complex128] | None, keep: NDArray[np.intp]) -> str | None:
    return None if values is None else _packed(values[keep].transpose(1, 2, 0), "<c8")


def _packed(array: NDArray[Any], dtype: str) -> str:
    return base64.b64encode(np.ascontiguousarray(array, dtype=dtype).tobytes()).decode("ascii")
