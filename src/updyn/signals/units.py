"""Units of channels: what is measured in them, and how much of the SI unit they are."""

from __future__ import annotations

from dataclasses import dataclass

from updyn.errors import DataError, suggest

__all__ = ["Unit", "agreed", "unit"]

#: Standard acceleration of gravity, in m/s^2: 3rd CGPM (1901).
_G = 9.80665
#: Pound-force in N: 0.45359237 kg (1959) times g.
_LBF = 0.45359237 * _G
_INCH = 0.0254

_FORCE, _MOTION = "force", ("receptance", "mobility", "accelerance")


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit of force or motion.

    Attributes
    ----------
    kind : str
        ``"force"``, or the quantity of an FRF with this motion: ``"receptance"`` for a
        displacement, ``"mobility"`` for a velocity, ``"accelerance"`` for an acceleration.
    factor : float
        Of the SI unit: N (N m for a moment), m or rad and these over s or s^2.
    """

    kind: str
    factor: float


_UNITS = {
    "n": Unit(_FORCE, 1.0),
    "newton": Unit(_FORCE, 1.0),
    "newtons": Unit(_FORCE, 1.0),
    "kn": Unit(_FORCE, 1e3),
    "lbf": Unit(_FORCE, _LBF),
    "nm": Unit(_FORCE, 1.0),
    "n m": Unit(_FORCE, 1.0),
    "g": Unit("accelerance", _G),
}
_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": _INCH, "rad": 1.0}
_RATES = {"": "receptance", "/s": "mobility", "/s^2": "accelerance", "/s2": "accelerance"}
_RATES["/s**2"] = _RATES["/s²"] = "accelerance"
_UNITS |= {
    f"{length}{rate}": Unit(kind, factor)
    for length, factor in _LENGTHS.items()
    for rate, kind in _RATES.items()
}


def unit(text: str, channel: str) -> Unit:
    """Return the unit that a text names; capitals and blanks around it do not matter.

    Parameters
    ----------
    text : str
        ``"N"``, ``"g"``, ``"m/s^2"``, ...
    channel : str
        Whose unit it is, for the message.

    Raises
    ------
    DataError
        If it names none that is known.
    """
    found = _UNITS.get(text.strip().lower())
    if found is None:
        said = f"unit {text!r}" if text.strip() else "no unit"
        raise DataError(
            f"channel {channel!r}: {said}; {suggest(text.strip().lower(), sorted(_UNITS))}"
        )
    return found


def agreed(told: str, said: str, channel: str) -> str:
    """Return the unit of a channel that a user states, where its file says none or the same.

    Parameters
    ----------
    told : str
        By the user.
    said : str
        By the file; empty where it does not say.
    channel : str
        Whose unit it is, for the message.

    Raises
    ------
    DataError
        If the unit is not known, or the file says another that is known.
    """
    stated = unit(told, channel)
    if said.strip().lower() in _UNITS and unit(said, channel) != stated:
        raise DataError(f"channel {channel!r}: unit {told!r} given, the records say {said!r}")
    return told
