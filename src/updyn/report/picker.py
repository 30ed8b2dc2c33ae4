"""Figure for picking modes: stabilisation diagram over CMIF, and FRFs measured and synthesised."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from updyn.arrays import BoolArray, IndexArray, RealArray
from updyn.correlation import frac
from updyn.errors import DataError
from updyn.frf import FRF, reference_noun, unit
from updyn.modal import ModeSet, cmif, synthesise
from updyn.modal.indicator import Indicator
from updyn.modal.settings import SYNTHESIS
from updyn.modal.stabilisation import Diagram
from updyn.modal.synthesis import band_of_modes, line_weights
from updyn.report.formats import format_count
from updyn.report.plots import Figure, encode_array, encode_numbers, escape_label
from updyn.report.settings import REPORT_LIST, REPORT_SIZE

__all__ = ["IdentifiedModes", "picker_data", "picker_figure"]

#: Heights of the panels from top to bottom and the gap between them, as fractions.
_DIAGRAM, _MAGNITUDE, _PHASE, _GAP = 0.46, 0.33, 0.13, 0.04
#: Height of the figure in pixels.
_HEIGHT = 660


@dataclass(frozen=True, eq=False)
class IdentifiedModes:
    """Identified modes and the measurement they come from.

    `poles` has the frequency (Hz) of the pole picked for each mode, None for modes found without a
    pole; `left_out` are modes found but not picked.
    """

    modes: ModeSet
    frf: FRF
    poles: list[float | None]
    left_out: ModeSet | None = None

    @cached_property
    def indicator(self) -> Indicator:
        """The mode indicator function."""
        return cmif(self.frf)

    @cached_property
    def band(self) -> BoolArray:
        """The lines that the modes can explain, shape (n_f,)."""
        return band_of_modes(self.modes, self.frf)

    @cached_property
    def frac(self) -> RealArray | None:
        """FRAC of each channel in `band`; None if the FRFs cannot be synthesised."""
        try:
            values = synthesise(self.modes, self.frf).values
        except DataError:
            return None
        return frac(self.frf.values[self.band], values[self.band])

    @cached_property
    def channels(self) -> IndexArray:
        """Ascending flat positions of the channels that are drawn."""
        # All lines of a channel are kept, because the synthesis needs them. If channels are too
        # many, those with the lowest FRAC are drawn. Channels of zeros only are omitted.
        nonzero = np.flatnonzero(self.frf.values.any(axis=0))
        most = max(1, REPORT_SIZE.frf_bytes // (8 * len(self.frf.freq)))
        return np.sort(self._sort_by_agreement(nonzero)[:most])

    @property
    def worst(self) -> int:
        """Flat position of the drawn channel with the lowest FRAC."""
        return int(self._sort_by_agreement(self.channels)[0])

    def _sort_by_agreement(self, channels: IndexArray) -> IndexArray:
        """Return channels by ascending FRAC."""
        if self.frac is None:
            return channels
        return channels[np.argsort(self.frac.ravel()[channels], kind="stable")]

    @property
    def note(self) -> str:
        """A note on the channels that are not drawn; empty if all are."""
        channels = self.frf.values.any(axis=0)
        parts = []
        if len(self.channels) < np.count_nonzero(channels):
            parts.append(
                f"To keep this page small, the {len(self.channels)} of {channels.size} channels"
                " with the lowest FRAC are drawn."
            )
        if not channels.all():
            zero = format_count(int(np.count_nonzero(~channels)), "channel")
            parts.append(f"Not drawn, as it is zero at all lines: {zero}.")
        return " ".join(parts)


def picker_figure(found: IdentifiedModes) -> Figure:
    """Return the figure; ``picks.js`` adds curves and modes."""
    diagram = found.modes.diagram
    highest = 2.0 if diagram is None else float(diagram.order.max(initial=0)) + 3.0
    traces = [_curve_trace("cmif-0", "y", "@measured", 1.3, "CMIF")]
    for k in range(1, REPORT_LIST.indicator_curves):
        traces.append(_curve_trace(f"cmif-{k}", "y", "@measured", 0.7))
    traces += [] if diagram is None else _pole_traces(diagram)
    traces += [
        _marker_trace("mode", "mode", {"color": "@after", "size": 11, "symbol": "triangle-down"}),
        _marker_trace(
            "added", "picked, not yet refined", {"color": "@before", "size": 12, "symbol": "star"}
        ),
        _marker_trace(
            "left-out",
            "mode left out",
            {"color": "@muted", "size": 10, "symbol": "triangle-down-open"},
        ),
        _marker_trace("peak", "peak without a mode", {"color": "@bad", "size": 9, "symbol": "x"}),
        _curve_trace("measured", "y3", "@measured", 2.0, "measured"),
        _curve_trace("synthesised", "y3", "@after", 1.4, "synthesised from the modes"),
        _curve_trace("measured-phase", "y4", "@measured", 1.0),
        _curve_trace("synthesised-phase", "y4", "@after", 1.4),
    ]
    layout = _make_layout(found.indicator.unit, highest)
    return {"data": traces, "height": _HEIGHT, "layout": layout, "row": highest}


def _pole_traces(diagram: Diagram) -> list[dict[str, object]]:
    new = {"color": "@muted", "size": 4}
    stable = {"color": "@third", "size": 6}
    hover = "pole at %{x:.6g} Hz, order %{y}, damping %{customdata:.3g} %<extra></extra>"
    return [
        {
            "type": "scatter",
            "mode": "markers",
            "name": name,
            "x": encode_numbers(diagram.frequency[chosen]),
            "y": encode_numbers(diagram.order[chosen]),
            "yaxis": "y2",
            "customdata": encode_numbers(100.0 * diagram.damping[chosen]),
            "marker": marker,
            "hovertemplate": hover,
        }
        for chosen, name, marker in (
            (~diagram.stable, "pole new in this order", new),
            (diagram.stable, "pole stable", stable),
        )
    ]


def _make_layout(unit_: str, highest: float) -> dict[str, object]:
    """Return the axes of the figure: unit of the indicator, and order at which modes are marked."""
    level = [_PHASE + _GAP, _PHASE + _GAP + _MAGNITUDE]
    log = {"type": "log", "exponentformat": "power", "fixedrange": True, "zeroline": False}
    return {
        "xaxis": {"title": {"text": "frequency (Hz)"}, "anchor": "y4", "zeroline": False},
        # The indicator is on the lower of two overlaid axes, so that poles are drawn on top.
        "yaxis": {
            "title": {"text": f"CMIF ({unit_})"},
            "domain": [1.0 - _DIAGRAM, 1.0],
            "side": "right",
            "showgrid": False,
            **log,
        },
        "yaxis2": {
            "title": {"text": "order"},
            "overlaying": "y",
            "side": "left",
            "anchor": "x",
            "range": [0.0, highest + 2.0],
            "tickmode": "linear",
            "dtick": 10,
            "showgrid": False,
            "fixedrange": True,
            "zeroline": False,
        },
        "yaxis3": {"domain": level, **log},
        "yaxis4": {
            "title": {"text": "phase (°)"},
            "domain": [0.0, _PHASE],
            "range": [-190, 190],
            "tickvals": [-180, 0, 180],
            "fixedrange": True,
            "zeroline": False,
        },
        "hovermode": "closest",
        "showlegend": True,
    }


def _curve_trace(
    meta: str, axis: str, colour: str, width: float, name: str = ""
) -> dict[str, object]:
    """Return a curve without points; ``picks.js`` finds the trace by `meta`."""
    return {
        "type": "scatter",
        "mode": "lines",
        "meta": meta,
        "name": name or meta,
        "showlegend": bool(name),
        "x": [],
        "y": [],
        "yaxis": axis,
        "line": {"color": colour, "width": width},
        "hovertemplate": f"%{{x:.6g}} Hz: {name or meta} %{{y:.4g}}<extra></extra>",
    }


def _marker_trace(meta: str, name: str, marker: dict[str, object]) -> dict[str, object]:
    """Return markers without points; ``picks.js`` finds the trace by `meta`."""
    return {
        "type": "scatter",
        "mode": "markers",
        "meta": meta,
        "name": name,
        "x": [],
        "y": [],
        "yaxis": "y2",
        "marker": marker,
        "hovertemplate": f"{name} at %{{x:.6g}} Hz<extra></extra>",
    }


def picker_data(found: IdentifiedModes) -> dict[str, object]:
    """Return the data for ``picks.js``, ready for JSON.

    The arrays ``freq`` (Hz), ``weights``, ``cmif`` (by singular value, 0 at 0 Hz) and ``values``
    (by drawn channel, real and imaginary parts interleaved) are base64 of little-endian floats.
    """
    frf, modes = found.frf, found.modes
    values = found.indicator.values[:, : REPORT_LIST.indicator_curves]
    indicator = np.zeros((len(frf.freq), values.shape[1]))
    indicator[np.isin(frf.freq, found.indicator.freq)] = values
    shown, n_references = found.channels, len(frf.references)
    channels = []
    for k in shown:
        i, j = divmod(int(k), n_references)
        response, reference = frf.responses.labels[i], frf.references.labels[j]
        channels.append(
            {
                "name": f"response {response}, {reference_noun(frf.quantity)} {reference}",
                "unit": escape_label(unit(frf.quantity, response, reference)),
            }
        )
    flat = frf.values.reshape(len(frf.freq), -1)[:, shown]
    diagram = modes.diagram
    units = {channel["unit"] for channel in channels}
    return {
        "freq": encode_array(frf.freq, "<f8"),
        "weights": encode_array(line_weights(frf), "<f8"),
        "cmif": encode_array(indicator.T, "<f4"),
        "values": encode_array(flat.T, "<c8"),
        "decay": frf.decay,
        "power": frf.modal_power,
        "quantity": frf.quantity,
        "channels": channels,
        "worst": int(np.flatnonzero(shown == found.worst)[0]),
        "reach": SYNTHESIS.band_bandwidths,
        "together": units.pop() if len(units) == 1 and len(channels) > 1 else "",
        "note": found.note,
        "modes": _list_modes(modes, found.poles, chosen=True)
        + ([] if found.left_out is None else _list_modes(found.left_out, None, chosen=False)),
        "peaks": modes.unexplained.tolist(),
        "canAdd": diagram is not None,
        "poles": [] if diagram is None else [diagram.frequency.tolist(), diagram.order.tolist()],
    }


def _list_modes(
    modes: ModeSet, poles: list[float | None] | None, *, chosen: bool
) -> list[dict[str, object]]:
    given = [None] * len(modes) if poles is None else poles
    return [
        {"f": float(f), "loss": None if np.isnan(loss) else float(loss), "pole": pole, "on": chosen}
        for f, loss, pole in zip(modes.frequency, modes.loss_factor, given, strict=True)
    ]
