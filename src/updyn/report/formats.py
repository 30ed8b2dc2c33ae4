"""The report in words: verdict, combinations of unknowns, units and numbers, for a test engineer. Plain text only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from updyn.frf import FRF
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult

__all__ = [
    "agreement_name",
    "axis_title",
    "change",
    "chi_hint",
    "combination",
    "counted",
    "decibels",
    "estimate",
    "extent",
    "figure_name",
    "figure_of_agreement",
    "held_out",
    "interval",
    "noise_is_fitted",
    "number",
    "plain",
    "quantity_words",
    "unit",
    "unknown",
    "weighted_sum",
]


_QUANTITY_WORDS = {
    "stiffness": "stiffness",
    "mass": "mass",
    "viscous": "viscous damping",
    "loss_factor": "loss factor",
    "mass_damping": "mass damping",
    "stiffness_damping": "stiffness damping",
    "calibration": "calibration factor",
    "force_calibration": "calibration factor of the force",
}
_POWER = {"receptance": "", "mobility": "/s", "accelerance": "/s²"}
_NORMAL_95 = 1.959964
_WRITTEN_TERMS = 16
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


_FIGURE_WORDS = {
    "frac_median": "FRAC, median over channels",
    "frac_min": "FRAC, worst channel",
    "csac_mean": "CSAC, mean over lines",
    "csf_mean": "CSF, mean over lines",
    "db_error_median": "level difference, median (dB)",
    "db_error_p95": "level difference, 95 % of values below (dB)",
}


def number(value: float | None, digits: int = 4) -> str:
    """Return a number as a reader wants it: `digits` significant, a true minus, a dash where there is none."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        return mantissa.replace("-", "−") + "·10" + str(int(exponent)).translate(_SUPERSCRIPT)
    return text.replace("-", "−")


def estimate(value: float, std: float) -> str:
    """Return an estimate to two digits of its standard deviation; to five digits of its own where there is none."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return number(value, 5)
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:.{decimals}f}".replace("-", "−") if 0 <= decimals <= 8 else number(value, 5)


def quantity_words(quantity: str) -> str:
    """Return ``"loss factor"`` for ``"loss_factor"``, and so on."""
    return _QUANTITY_WORDS.get(quantity, quantity)


def figure_name(quantity: str) -> str:
    """Return ``"loss-factor"`` for ``"loss_factor"``: the name of a figure of a kind of unknown."""
    return quantity.replace("_", "-")


def axis_title(parameter: Parameter) -> str:
    """Return what an axis of values of such unknowns shows: what it is and, in brackets, its unit."""
    if parameter.value_of is None:
        return "value relative to the start"
    unit = parameter.value_unit
    return quantity_words(parameter.value_of) + (f" ({unit})" if unit else "")


def unknown(name: str) -> str:
    """Return ``"stiffness of shaft"`` for ``"shaft.stiffness"``."""
    group, _, quantity = name.rpartition(".")
    return f"{quantity_words(quantity)} of {group}" if group else name


def combination(direction: Mapping[str, float]) -> str:
    """Return weights by unknown as words, the largest first: what goes up, what goes down, by how much."""
    shown, more = _largest(direction)
    terms = [
        f"{unknown(name)} {'up' if w >= 0 else 'down'} ({number(abs(w), 3)})" for name, w in shown
    ]
    return ", ".join(terms) + more


def weighted_sum(direction: Mapping[str, float]) -> str:
    """Return weights by unknown as a sum, the largest first: ``1 × mass of hub + 0.62 × stiffness of hub``."""
    shown, more = _largest(direction)
    terms = [f"{'−' if w < 0 else '+'} {number(abs(w), 3)} × {unknown(name)}" for name, w in shown]
    return " ".join(terms).removeprefix("+ ") + more


def _largest(direction: Mapping[str, float]) -> tuple[list[tuple[str, float]], str]:
    """Return the terms to write out, and what is said of the rest of a long combination."""
    ordered = sorted(direction.items(), key=lambda item: -abs(item[1]))
    rest = ordered[_WRITTEN_TERMS:]
    if not rest:
        return ordered, ""
    return (
        ordered[:_WRITTEN_TERMS],
        f", and {len(rest)} more with weights up to {number(abs(rest[0][1]), 3)}",
    )


def unit(quantity: str, response: str, reference: str) -> str:
    """Return the unit of one channel, from the kind of its two DOFs: ``"(m/s²)/N"``, ``"rad/(N m)"``, ..."""
    motion = ("rad" if _rotation(response) else "m") + _POWER[quantity]
    force = "(N m)" if _rotation(reference) else "N"
    return f"({motion})/{force}" if "/" in motion else f"{motion}/{force}"


def _rotation(label: str) -> bool:
    return "R" in label


def change(parameter: Parameter, value: float) -> str:
    """Return the change from the start: in percent, or as a difference where the start is zero."""
    if parameter.start == 0.0:
        return "0 %" if value == 0.0 else f"from 0 to {number(value, 3)}"
    percent = 100.0 * (value / parameter.start - 1.0)
    return f"{percent:+.3g} %".replace("-", "−") if abs(percent) >= 5e-4 else "0 %"


def interval(parameter: Parameter, value: float, std: float) -> tuple[float, float] | None:
    """Return the 95 % interval, or None where the data leave the unknown open.

    Symmetric in the logarithm for a factor (it is estimated there, and stays positive), symmetric
    and cut at 0 for a loss factor; 1.96 standard deviations of a Gaussian.
    """
    if not math.isfinite(std) or not math.isfinite(value):
        return None
    if parameter.is_factor and value > 0:
        spread = math.exp(min(_NORMAL_95 * std / value, 50.0))
        return value / spread, value * spread
    return max(value - _NORMAL_95 * std, 0.0), value + _NORMAL_95 * std


def figure_of_agreement(value: float) -> str:
    """Return a FRAC or the like with two decimals, and more where two would read as a perfect 1.00."""
    if math.isnan(value):
        return "unknown"
    if 0.9995 <= value < 1.0:
        return ">0.999"
    return f"{value:.3f}" if 0.99 <= value < 1.0 else f"{value:.2f}"


def counted(n: int, noun: str) -> str:
    """Return ``"1 line"``, ``"2 lines"``."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def extent(frf: FRF) -> str:
    """Return how many channels and lines there are, and from where to where."""
    channels = (
        f"{counted(len(frf.responses), 'response')} × {counted(len(frf.references), 'reference')}"
    )
    first, last = number(float(frf.freq[0])), number(float(frf.freq[-1]))
    return f"{channels}, {counted(len(frf.freq), 'line')} from {first} to {last} Hz"


def decibels(value: float) -> str:
    """Return a level difference with its unit."""
    return "unknown" if math.isnan(value) else f"{number(value, 2 if abs(value) < 10 else 3)} dB"


def noise_is_fitted(noise: Mapping[str, Any]) -> bool:
    """Whether the noise was taken from the residual, so that chi-square says nothing about the fit."""
    return str(noise.get("kind", "")).startswith(("estimated", "spread"))


def chi_hint(noise: Mapping[str, Any]) -> str:
    """Return what a reduced chi-square of 1 means."""
    return (
        "by construction: noise estimated from the residual"
        if noise_is_fitted(noise)
        else "1: the residual is noise"
    )


def held_out(result: UpdateResult) -> str:
    """Return what was held out of the fit, in words; empty where nothing was."""
    parts = []
    if result.validation_responses:
        names = result.validation_responses
        shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
        parts.append(f"response{'s' if len(names) > 1 else ''} {shown}")
    if result.validation_band is not None:
        low, high = result.validation_band
        parts.append(f"band {number(low)} to {number(high)} Hz")
    return " and ".join(parts)


def plain(value: Any) -> str:
    """Return an option as text: mappings and sequences opened, nothing of Python's quoting."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return number(value, 6)
    if isinstance(value, Mapping):
        return "; ".join(f"{k}: {plain(v)}" for k, v in value.items()) or "none"
    if hasattr(value, "tolist"):
        value = value.tolist()
        if not isinstance(value, list):
            return plain(value)
    if isinstance(value, list | tuple):
        shown = ", ".join(plain(v) for v in value[:20])
        return (shown + (f", ... ({len(value)} in all)" if len(value) > 20 else "")) or "none"
    return str(value)


def agreement_name(key: str) -> str:
    """Return what a figure of agreement is called in a table."""
    return _FIGURE_WORDS.get(key, key.replace("_", " "))
