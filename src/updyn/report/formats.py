"""Numbers, units and names of quantities as plain text."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from updyn.arrays import RealArray
from updyn.correlation.figures import FIGURE_NAMES
from updyn.frf import FRF, unit
from updyn.modal import ModeSet
from updyn.report.settings import REPORT_LIST
from updyn.text_table import FACTORS, format_change, format_count, format_multiple
from updyn.updating.problem.parameters import Parameter
from updyn.updating.result import UpdateResult
from updyn.updating.result import interval as confidence_interval

__all__ = [
    "agreement_name",
    "axis_title",
    "capitalize_first",
    "change",
    "chi_hint",
    "combination_words",
    "decibels",
    "estimate",
    "extent",
    "figure_name",
    "figure_of_agreement",
    "format_count",
    "format_padded",
    "interval",
    "noise_is_fitted",
    "number",
    "option_words",
    "paragraphs",
    "percentage",
    "quantity_words",
    "split_more",
    "unit",
    "unknown_words",
    "validation_words",
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
#: Number of places that a sentence on the residual does not name.
_MORE = re.compile(r"and \d+ more channels or bands")
_SENTENCE_END = re.compile(r"(?<=[.!?]) (?=[A-Z0-9])")
_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 4) -> str:
    """Return a number with `digits` significant digits and a true minus sign; a dash if missing."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        power = str(int(exponent)).translate(_SUPERSCRIPT)
        return f"{mantissa.replace('-', '−')}·10{power}"
    return text.replace("-", "−")


def format_padded(value: float | None, digits: int) -> str:
    """Return a number as `number` does, but with trailing zeros, for table columns."""
    text = number(value, digits)
    if value is None or not math.isfinite(value) or "·" in text:
        return text
    return f"{value:#.{digits}g}".rstrip(".").replace("-", "−")


def estimate(value: float, std: float) -> str:
    """Return an estimate rounded to two digits of its standard deviation, else to five digits."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return number(value, 5)
    decimals = 1 - math.floor(math.log10(std))
    if not 0 <= decimals <= 8:
        return number(value, 5)
    return f"{value:.{decimals}f}".replace("-", "−")


def quantity_words(quantity: str) -> str:
    """Return a quantity in words: ``"loss factor"`` for ``"loss_factor"``."""
    return _QUANTITY_WORDS.get(quantity, quantity.replace("_", " "))


def figure_name(quantity: str) -> str:
    """Return the figure name of a kind of unknown: ``"loss-factor"`` for ``"loss_factor"``."""
    return quantity.replace("_", "-")


def axis_title(parameter: Parameter) -> str:
    """Return the axis title for values of an unknown: quantity, and unit in brackets."""
    if parameter.value_of is None or parameter.is_log:
        return "value relative to the start"
    quantity = quantity_words(parameter.value_of)
    if parameter.value_unit:
        return f"{quantity} ({parameter.value_unit})"
    return quantity


def unknown_words(name: str) -> str:
    """Return an unknown in words: ``"stiffness of shaft"`` for ``"shaft.stiffness"``."""
    group, _, quantity = name.rpartition(".")
    if not group:
        return name
    return f"{quantity_words(quantity)} of {group}"


def combination_words(direction: Mapping[str, float]) -> str:
    """Return the weights of unknowns in words, largest first, with direction and size."""
    shown, more = _take_largest(direction)
    terms = []
    for name, weight in shown:
        way = "up" if weight >= 0 else "down"
        terms.append(f"{unknown_words(name)} {way} ({number(abs(weight), 3)})")
    return ", ".join(terms) + more


def weighted_sum(direction: Mapping[str, float]) -> str:
    """Return weights as a sum, such as ``1 × mass of hub + 0.62 × stiffness of hub``."""
    shown, more = _take_largest(direction)
    text = ""
    for name, weight in shown:
        sign = "−" if weight < 0 else "+"
        text += f" {sign} {number(abs(weight), 3)} × {unknown_words(name)}"
    return text.strip().removeprefix("+ ") + more


def _take_largest(direction: Mapping[str, float]) -> tuple[list[tuple[str, float]], str]:
    """Return the largest terms in descending order, and a text about the remaining terms."""
    ordered = sorted(direction.items(), key=lambda item: -abs(item[1]))
    most = REPORT_LIST.written_terms
    rest = ordered[most:]
    if not rest:
        return ordered, ""
    largest = number(abs(rest[0][1]), 3)
    return ordered[:most], f", and {len(rest)} more with weights up to {largest}"


def change(parameter: Parameter, value: float) -> str:
    """Return the change from the start in percent; large ones as factors, from 0 as the value."""
    if math.isnan(value):
        return number(value)
    if parameter.start == 0.0:
        return "0 %" if value == 0.0 else f"from 0 to {number(value, 3)}"
    return format_change(value / parameter.start)


def interval(
    parameter: Parameter, value: float, std: float, freedom: int | None = None
) -> tuple[float, float] | None:
    """Return the 95 % interval; None if the data do not determine the unknown."""
    # With `freedom`, by Student's t distribution, because the noise was estimated from few values.
    if not math.isfinite(std) or not math.isfinite(value):
        return None
    return confidence_interval(parameter, value, std, freedom=freedom)


def figure_of_agreement(value: float) -> str:
    """Return a criterion such as FRAC with two decimals, or three if two would round up to 1.00."""
    if math.isnan(value):
        return "unknown"
    if 0.9995 <= value < 1.0:
        return ">0.999"
    if 0.99 <= value < 1.0:
        return f"{value:.3f}"
    return f"{value:.2f}".replace("-0.00", "0.00").replace("-", "−")


def percentage(share: float) -> str:
    """Return a fraction in percent with two digits; as a multiple if large, a limit if small."""
    if math.isnan(share):
        return number(share)
    if share >= FACTORS:
        return f"{format_multiple(share)} times" if math.isfinite(share) else "∞ %"
    if 0.0 <= share < 1e-6:
        return "<0.0001 %" if share else "0 %"
    if share >= 0.1:
        return f"{100.0 * share:.0f} %"
    return f"{number(100.0 * share, 2)} %"


def extent(data: FRF | ModeSet) -> str:
    """Return the numbers of channels and lines (or of modes and DOFs), and the frequency range."""
    if isinstance(data, ModeSet) and not data.has_shapes:
        found = "frequencies" if len(data) > 1 else "frequency"
        return f"{len(data)} natural {found}, {_span(data.frequency, '')}"
    if isinstance(data, ModeSet):
        modes, dofs = format_count(len(data), "mode"), format_count(len(data.dofs), "DOF")
        return f"{modes} at {dofs}, {_span(data.frequency, '')}"
    frf = data
    responses = format_count(len(frf.responses), "response")
    references = format_count(len(frf.references), "reference")
    lines = format_count(len(frf.freq), "line")
    return f"{responses} × {references}, {lines} {_span(frf.freq, 'from ', 'at ')}"


def _span(freq: RealArray, of_several: str, of_one: str = "") -> str:
    """Return the first and last frequency after a prefix, or the only one."""
    first, last = number(float(freq[0])), number(float(freq[-1]))
    return f"{of_one}{first} Hz" if len(freq) == 1 else f"{of_several}{first} to {last} Hz"


def decibels(value: float) -> str:
    """Return a level difference with its unit."""
    if math.isnan(value):
        return "unknown"
    if 0.0 < abs(value) < 1e-4:
        return "<0.0001 dB"
    digits = 2 if abs(value) < 10 else 3
    return f"{number(value, digits)} dB"


def noise_is_fitted(noise: Mapping[str, object]) -> bool:
    """Whether the noise is estimated from the residual; if so, chi-square cannot assess the fit."""
    return str(noise.get("kind", "")).startswith(("estimated", "spread"))


def chi_hint(noise: Mapping[str, object]) -> str:
    """Return the meaning of a reduced chi-square of 1."""
    if noise_is_fitted(noise):
        return "by construction: noise estimated from the residual"
    return "1: the residual is noise"


def validation_words(result: UpdateResult) -> str:
    """Return the validation set in words; empty if no data were held out."""
    parts = []
    if result.validation_responses:
        names = result.validation_responses
        noun = "response" if len(names) == 1 else "responses"
        more = f" and {len(names) - 4} more" if len(names) > 4 else ""
        parts.append(f"{noun} {', '.join(names[:4])}{more}")
    if result.validation_band is not None:
        low, high = result.validation_band
        parts.append(f"band {number(low)} to {number(high)} Hz")
    return " and ".join(parts)


def option_words(value: object) -> str:
    """Return an option as text: entries of mappings and sequences, without Python's quotes."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return number(value, 6)
    if isinstance(value, Mapping):
        return "; ".join(f"{k}: {option_words(v)}" for k, v in value.items()) or "none"
    if hasattr(value, "tolist"):
        value = value.tolist()
        if not isinstance(value, list):
            return option_words(value)
    if isinstance(value, list | tuple):
        text = ", ".join(map(option_words, value[: REPORT_LIST.written_entries]))
        if len(value) > REPORT_LIST.written_entries:
            text += f", ... ({len(value)} in all)"
        return text or "none"
    return str(value)


def agreement_name(key: str) -> str:
    """Return the table heading of a figure of agreement."""
    return FIGURE_NAMES.get(key, key.replace("_", " "))


def capitalize_first(text: str) -> str:
    """Return a text whose first letter is a capital; the others are unchanged."""
    return text[:1].upper() + text[1:]


def paragraphs(text: str) -> list[str]:
    """Return a text in paragraphs of at most two sentences."""
    sentences = [sentence for sentence in _SENTENCE_END.split(text.strip()) if sentence]
    return [" ".join(sentences[at : at + 2]) for at in range(0, len(sentences), 2)]


def split_more(text: str) -> tuple[str, str, str]:
    """Return a text before, in and after its number of further places, which may be empty."""
    more = _MORE.search(text)
    if more is None:
        return text, "", ""
    return text[: more.start()], more[0], text[more.end() :]
