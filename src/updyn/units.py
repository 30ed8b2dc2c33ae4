"""Units of measured values: the accepted labels and their factors to SI.

A label that is not in the list is an error; it is never interpreted as SI.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from updyn.errors import DataError, suggest

__all__ = [
    "CHANNEL",
    "RATES",
    "Unit",
    "find_ratio",
    "find_unit",
    "merge_units",
    "parse_unit",
    "split_ratio",
    "strip_brackets",
    "suggest_unit",
]

#: Factors to SI, by the names of a unit.
_Factors = Mapping[tuple[str, ...], float]

#: Standard acceleration of gravity, in m/s^2: 3rd CGPM (1901).
_G = 9.80665
#: Pound-force in N: 0.45359237 kg (international yard and pound agreement, 1959) times g.
_LBF = 0.45359237 * _G
#: Inch in m (the same agreement).
_INCH = 0.0254


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: kind, value in SI, and whether it is one of a moment or an angular motion.

    `kind` is "force" (moments included), "receptance", "mobility" or "accelerance" for a
    displacement, velocity or acceleration, "time", "frequency" or "length"; for a ratio
    (`find_ratio`), the quantity of the FRF, "transmissibility" for a motion over a motion.
    """

    kind: str
    factor: float
    angular: bool = False


_FORCES: _Factors = {
    ("N", "newton", "newtons"): 1.0,
    ("mN",): 1e-3,
    ("daN",): 10.0,
    ("kN",): 1e3,
    ("MN",): 1e6,
    ("dyn", "dyne"): 1e-5,
    ("kgf", "kp"): _G,
    ("lbf", "lb", "lbs", "pound", "pounds"): _LBF,
    ("kip", "kips"): 1e3 * _LBF,
    ("ozf",): _LBF / 16,
}
_MOMENTS: _Factors = {
    ("Nm", "N m"): 1.0,
    ("Nmm", "N mm"): 1e-3,
    ("kNm", "kN m"): 1e3,
    ("lbf in", "in lbf"): _LBF * _INCH,
    ("lbf ft", "ft lbf"): _LBF * 12 * _INCH,
}
_LENGTHS: _Factors = {
    ("m", "meter", "metre", "meters", "metres"): 1.0,
    ("nm",): 1e-9,
    ("um", "micron", "microns"): 1e-6,
    ("mm",): 1e-3,
    ("cm",): 1e-2,
    ("km",): 1e3,
    ("mil", "mils", "thou"): 1e-3 * _INCH,
    ("in", "inch", "inches"): _INCH,
    ("ft", "foot", "feet"): 12 * _INCH,
}
_ANGLES: _Factors = {
    ("rad", "radian", "radians"): 1.0,
    ("mrad",): 1e-3,
    ("deg", "degree", "degrees"): math.pi / 180,
}
#: Suffix to the unit of displacement for each quantity of an FRF.
RATES = {"receptance": "", "mobility": "/s", "accelerance": "/s^2"}
_VELOCITIES: _Factors = {("ips",): _INCH}
_ACCELERATIONS: _Factors = {
    ("g", "gn", "g_n", "gs", "g's", "gees"): _G,
    ("mg",): 1e-3 * _G,
    ("gal",): 1e-2,
}
_TIMES: _Factors = {
    ("s", "second", "seconds"): 1.0,
    ("ms", "millisecond", "milliseconds"): 1e-3,
    ("us", "microsecond", "microseconds"): 1e-6,
    ("ns", "nanosecond", "nanoseconds"): 1e-9,
    ("min", "minute", "minutes"): 60.0,
    ("h", "hour", "hours"): 3600.0,
    ("day", "days"): 86400.0,
}
_FREQUENCIES: _Factors = {
    ("Hz", "hertz"): 1.0,
    ("mHz",): 1e-3,
    ("kHz",): 1e3,
    ("MHz",): 1e6,
    ("rpm", "cpm", "1/min"): 1 / 60,
    ("rad/s",): 1 / (2 * math.pi),
}


def _table() -> dict[str, list[Unit]]:
    """Return the units of each name; a name with two meanings, such as rad/s, has two."""
    out: dict[str, list[Unit]] = {}
    groups: list[tuple[str, str, _Factors, bool]] = [
        ("force", "", _FORCES, False),
        ("force", "", _MOMENTS, True),
        *((kind, rate, _LENGTHS, False) for kind, rate in RATES.items()),
        *((kind, rate, _ANGLES, True) for kind, rate in RATES.items()),
        ("mobility", "", _VELOCITIES, False),
        ("accelerance", "", _ACCELERATIONS, False),
        ("time", "", _TIMES, False),
        ("frequency", "", _FREQUENCIES, False),
        ("length", "", _LENGTHS, False),
    ]
    for kind, rate, factors, angular in groups:
        for names, factor in factors.items():
            for name in names:
                out.setdefault(name + rate, []).append(Unit(kind, factor, angular))
    return out


_UNITS = _table()


def _fold_names() -> dict[str, list[Unit]]:
    """Return the units by lower-case name, without names whose case matters (mN, MN)."""
    meanings: dict[str, list[list[Unit]]] = {}
    for name, units in _UNITS.items():
        known = meanings.setdefault(name.lower(), [])
        if units not in known:
            known.append(units)
    return {name: known[0] for name, known in meanings.items() if len(known) == 1}


_FOLDED = _fold_names()

#: Kinds of the values of a channel.
CHANNEL = ("force", "receptance", "mobility", "accelerance")
_MOTIONS = CHANNEL[1:]


def _normal(label: str) -> str:
    """Return a label in normal spelling: m/s^2 for m/s**2, (m/s²), m/sec/sec, m/s2."""
    text = strip_brackets(" ".join(label.split()))
    text = text.replace("**", "^").replace("²", "^2").replace("^ 2", "^2")
    text = re.sub("[µμ]", "u", text)
    text = re.sub(r"\s*/\s*", "/", text)
    text = re.sub(r"\s*[*·-]\s*", " ", text)
    text = re.sub(r"/\(s\^2\)", "/s^2", text)
    text = re.sub(r"/sec\b", "/s", text, flags=re.I)
    text = re.sub(r"/sec(?=[\^2])", "/s", text, flags=re.I)
    text = re.sub(r"^([mun]?)sec$", r"\1s", text, flags=re.I)
    return re.sub(r"/s(?:2|/s)$", "/s^2", text, flags=re.I)


def strip_brackets(label: str) -> str:
    """Return a label without enclosing round or square brackets; ``"(m)/(s)"`` is unchanged."""
    text = label.strip()
    while len(text) > 1 and (text[0], text[-1]) in (("(", ")"), ("[", "]")) and _is_pair(text):
        text = text[1:-1].strip()
    return text


def _is_pair(text: str) -> bool:
    """Return whether the last bracket of a text closes its first."""
    depth = 0
    for at, letter in enumerate(text):
        depth += (letter in "([") - (letter in ")]")
        if depth == 0:
            return at == len(text) - 1
    return False


def find_unit(label: str, *kinds: str) -> Unit | None:
    """Return the unit that a label names, by default of a force or a motion; None if unknown."""
    # Case matters only if it changes the meaning, as for ``mN`` and ``MN``. Brackets around the
    # label, ``**`` for ``^`` and ``sec`` for ``s`` are accepted.
    text = _normal(label)
    for unit in _UNITS.get(text) or _FOLDED.get(text.lower(), []):
        if unit.kind in (kinds or CHANNEL):
            return unit
    return None


def find_ratio(label: str) -> Unit | None:
    """Return the unit of an FRF that a label such as ``g/N`` names; None if unknown."""
    found = split_ratio(label)
    if found is None:
        return None
    motion, below = found
    kind = motion.kind if below.kind == "force" else "transmissibility"
    return Unit(kind, motion.factor / below.factor)


def split_ratio(label: str) -> tuple[Unit, Unit] | None:
    """Return the units of a motion over a force or a like motion (``g/N``, ``g/g``), or None."""
    text = _normal(label)
    for at, letter in enumerate(text):
        if letter == "/":
            motion = find_unit(text[:at], *_MOTIONS)
            if motion is None:
                continue
            below = find_unit(text[at + 1 :], "force", motion.kind)
            if below is not None:
                return motion, below
    return None


def suggest_unit(label: str, *kinds: str) -> str:
    """Return ``"did you mean 'lbf'?"`` or ``"valid: 'N', 'kN', ..."`` for a label not accepted."""
    wanted = kinds or CHANNEL
    names = [name for name, units in _UNITS.items() if any(u.kind in wanted for u in units)]
    return suggest(label.strip(), names)


def parse_unit(label: str, channel: str) -> Unit:
    """Return the unit of a force or a motion that a label names; DataError if unknown."""
    found = find_unit(label)
    if found is None:
        what = f"unit {label!r}" if label.strip() else "no unit"
        raise DataError(f"channel {channel!r}: {what}; {suggest_unit(label)}")
    return found


def merge_units(stated: str, found: str, channel: str) -> str:
    """Return the unit that a user gives for a channel; DataError if the file contradicts it."""
    unit = parse_unit(stated, channel)
    other = find_unit(found)
    if other is not None and other != unit:
        raise DataError(f"channel {channel!r}: unit {stated!r} given, the records say {found!r}")
    return stated
