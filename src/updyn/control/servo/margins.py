"""`Margins` of a loop with every crossing, their range over a family, and `RobustMargin`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

__all__ = ["FIGURES", "Margins", "Range", "RobustMargin", "ranges"]

_Real = NDArray[np.float64]

#: Figures of `Margins` that a family spreads, with their units.
FIGURES: Mapping[str, str] = MappingProxyType(
    {
        "gain_margin": "",
        "gain_reduction": "",
        "phase_margin": "deg",
        "delay_margin": "s",
        "modulus_margin": "",
        "crossover": "Hz",
    }
)


@dataclass(frozen=True, slots=True, eq=False)
class Margins:
    """What the loop function L of a negative feedback loop says about it.

    The single figures are None where the closed loop is unstable: distances from an instability
    that is there already are no margins. The crossings are given all the same.

    Attributes
    ----------
    stable : bool
        Whether the closed loop has no pole to the right of, or on, the imaginary axis; those of
        `drifting` aside.
    unstable_poles : int
        Poles of the closed loop to the right of the imaginary axis.
    drifting : int
        Poles of the closed loop at 0: what this loop does not see and so not hold, as the angle of
        a velocity loop, another axis, or the angle that goes with a speed of which the position is
        made by integration.
    judged_by : str
        How stability was found: ``"eigenvalues"`` or, with dead time, ``"Nyquist count"``.
    phase_crossings : ndarray of float, shape (n,)
        Lines in Hz, ascending, at which L is real and negative.
    gain_margins : ndarray of float, shape (n,)
        1 / |L| there: the factor on the gain that brings L to -1.
    gain_crossings : ndarray of float, shape (m,)
        Lines in Hz, ascending, at which |L| = 1.
    phase_margins : ndarray of float, shape (m,)
        180 degrees plus the phase of L there, in degrees, above -180 and up to 180.
    delay_margins : ndarray of float, shape (m,)
        Further dead time in s that brings L to -1 there.
    gain_margin : float or None
        The smallest factor above 1 that makes the loop unstable; inf where none does.
    gain_reduction : float or None
        The largest factor below 1 that makes it unstable; 0 where none does.
    phase_margin : float or None
        The smallest of `phase_margins` in size, in degrees, sign kept; inf where there is no
        crossing.
    delay_margin : float or None
        The smallest of `delay_margins`, in s; inf where there is no crossing.
    modulus_margin : float or None
        Smallest |1 + L|: 1 / (largest sensitivity).
    crossover : float or None
        First line in Hz at which |L| falls through 1; None where it does not. Given for unstable
        loops too.
    gain_margin_at, gain_reduction_at, phase_margin_at : float or None
        Lines in Hz of these margins; None where there is none.
    delay_margin_at, modulus_margin_at : float or None
        The same of these.
    """

    stable: bool
    unstable_poles: int
    drifting: int
    judged_by: str
    phase_crossings: _Real
    gain_margins: _Real
    gain_crossings: _Real
    phase_margins: _Real
    delay_margins: _Real
    gain_margin: float | None
    gain_reduction: float | None
    phase_margin: float | None
    delay_margin: float | None
    modulus_margin: float | None
    crossover: float | None
    gain_margin_at: float | None = None
    gain_reduction_at: float | None = None
    phase_margin_at: float | None = None
    delay_margin_at: float | None = None
    modulus_margin_at: float | None = None

    @property
    def gain_margin_db(self) -> float | None:
        """`gain_margin` in dB; inf where no gain makes the loop unstable."""
        if self.gain_margin is None:
            return None
        return float(20.0 * np.log10(self.gain_margin))

    @property
    def gain_reduction_db(self) -> float | None:
        """`gain_reduction` in dB, negative; -inf where none makes the loop unstable."""
        if self.gain_reduction is None:
            return None
        if self.gain_reduction == 0:
            return -np.inf
        return float(20.0 * np.log10(self.gain_reduction))

    @property
    def peak_sensitivity(self) -> float | None:
        """Largest |1 / (1 + L)|, M_s."""
        if self.modulus_margin is None:
            return None
        return 1.0 / self.modulus_margin

    def summary(self) -> str:
        """Return the figures, one a line."""
        if not self.stable:
            poles = f"{self.unstable_poles} poles that grow"
            if self.unstable_poles == 1:
                poles = "1 pole that grows"
            return f"UNSTABLE: the closed loop has {poles}; no margins"
        lines = [
            f"crossover       {_at(self.crossover, 'Hz')}",
            f"phase margin    {_figure(self.phase_margin, 'deg', self.phase_margin_at)}",
            f"gain margin     {_figure(self.gain_margin_db, 'dB', self.gain_margin_at)}",
        ]
        if self.gain_reduction:
            lines.append(
                f"gain reduction  {_figure(self.gain_reduction_db, 'dB', self.gain_reduction_at)}"
            )
        delay = self.delay_margin
        if delay is not None:
            delay *= 1e3
        lines += [
            f"delay margin    {_figure(delay, 'ms', self.delay_margin_at)}",
            f"modulus margin  {_figure(self.modulus_margin, '', self.modulus_margin_at)}",
        ]
        crossings = len(self.gain_crossings), len(self.phase_crossings)
        lines.append(f"crossings       {crossings[0]} of gain 1, {crossings[1]} of -180 deg")
        if self.drifting:
            poles = "pole" if self.drifting == 1 else "poles"
            lines.append(
                f"drifting        {self.drifting} {poles} at 0 that this loop does not see"
            )
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Range:
    """A figure over a family.

    Attributes
    ----------
    smallest, largest : float
        Of the stable members; nan where there is none.
    smallest_member, largest_member : int or None
        Which member has it, counted from 0.
    """

    smallest: float
    smallest_member: int | None
    largest: float
    largest_member: int | None


@dataclass(frozen=True, slots=True)
class RobustMargin:
    """How large the perturbations of a plant may be until the closed loop can be unstable.

    Each channel that the controller reads is perturbed on its own, by any stable transfer function
    of limited size at each frequency.

    Attributes
    ----------
    of : {"family", "plant error"}
        What gives the size: at each frequency the largest deviation of a member of the family from
        the nominal plant, or the relative error of the plant (in its band).
    margin : float
        1 / (largest structured singular value), of its upper bound: by this factor the size may
        grow, and the loop is still stable for sure. Above 1: robustly stable. inf where nothing is
        perturbed.
    at : float or None
        Line in Hz where that is; None where nothing is perturbed.
    member_margin : float
        The factor by which the deviation of a member has to grow until the loop is unstable, the
        smallest of all members: no smaller than `margin`, which cannot be larger. inf where none
        does, nan of the plant error.
    member : int or None
        The member that has it, counted from 0.
    """

    of: str
    margin: float
    at: float | None
    member_margin: float = float("nan")
    member: int | None = None

    @property
    def meaning(self) -> str:
        """One sentence on what the margin guarantees."""
        if self.of == "family":
            size = "the largest deviation of a member"
        else:
            size = "the plant's relative error, in its band"
        if np.isinf(self.margin):
            return f"nothing is perturbed: {size} is 0."
        text = "stable for all deviations of a channel up to"
        return f"{text} {self.margin:.3g} times {size}{self._nearest}."

    @property
    def _nearest(self) -> str:
        if self.member is None:
            return ""
        return (
            f"; unstable with the deviation of member {self.member} taken"
            f" {self.member_margin:.3g} times"
        )

    def summary(self) -> str:
        """Return margin, frequency and meaning as text."""
        return f"{_figure(self.margin, '', self.at)}: {self.meaning}"


def ranges(members: Sequence[Margins]) -> dict[str, Range]:
    """Return the range of each figure over a family, by name; unstable members have none.

    Parameters
    ----------
    members : sequence of Margins
        One a member.
    """
    out = {}
    for name in FIGURES:
        known = []
        for i, member in enumerate(members):
            value = getattr(member, name)
            if member.stable and value is not None:
                size = abs(value) if name == "phase_margin" else value
                known.append((size, value, i))
        if not known:
            out[name] = Range(np.nan, None, np.nan, None)
            continue
        (_, least, least_at), (_, most, most_at) = min(known), max(known)
        out[name] = Range(float(least), least_at, float(most), most_at)
    return out


def _figure(value: float | None, unit: str, at: float | None) -> str:
    if value is None:
        return "none"
    if np.isinf(value):
        return "unlimited"
    text = f"{value:.4g} {unit}".rstrip()
    if at is not None:
        text += f" at {at:.6g} Hz"
    return text


def _at(value: float | None, unit: str) -> str:
    return "none: the gain does not fall through 1" if value is None else f"{value:.6g} {unit}"
