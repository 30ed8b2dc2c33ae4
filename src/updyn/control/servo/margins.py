"""`Margins` of a loop with every crossing, their range over a family, and `RobustMargin`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from updyn.arrays import RealArray

__all__ = ["FIGURES", "Margins", "Range", "RobustMargin", "ranges"]


#: Figures of `Margins` with a range over a family, and their units.
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
    """Stability and margins of a negative feedback loop with the loop function L.

    The margins are None if the closed loop is unstable; the crossings are given nevertheless.

    Attributes
    ----------
    stable : bool
        Whether all closed-loop poles except `drifting` lie to the left of the imaginary axis.
    unstable_poles : int
        Number of closed-loop poles to the right of the imaginary axis.
    drifting : int
        Number of closed-loop poles at 0, of motions that this loop does not observe or control,
        such as the angle in a velocity loop.
    judged_by : str
        Method of the stability test: ``"eigenvalues"`` or, with dead time, ``"Nyquist count"``.
    phase_crossings, gain_margins : ndarray of float, shape (n,)
        Frequencies in Hz, ascending, at which L is real and negative, and 1 / |L| at these.
    gain_crossings : ndarray of float, shape (m,)
        Frequencies in Hz, ascending, at which |L| = 1.
    phase_margins, delay_margins : ndarray of float, shape (m,)
        180 degrees plus the phase of L at these, above -180 and up to 180 degrees, and the
        additional dead time in s that brings L to -1.
    gain_margin, gain_reduction : float or None
        Smallest factor above 1 and largest below 1 that make the loop unstable; inf and 0 if
        none does.
    phase_margin, delay_margin : float or None
        The `phase_margins` of least size, in degrees, with sign, and the least of
        `delay_margins`, in s; inf without a crossing.
    modulus_margin : float or None
        Smallest |1 + L|: 1 / (largest sensitivity).
    crossover : float or None
        First frequency in Hz at which |L| falls through 1, also of an unstable loop; None
        without one.
    gain_margin_at, gain_reduction_at, phase_margin_at, delay_margin_at, modulus_margin_at
        Frequencies in Hz of these margins; None without one.
    """

    stable: bool
    unstable_poles: int
    drifting: int
    judged_by: str
    phase_crossings: RealArray
    gain_margins: RealArray
    gain_crossings: RealArray
    phase_margins: RealArray
    delay_margins: RealArray
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
        """`gain_margin` in dB; inf if no gain makes the loop unstable."""
        if self.gain_margin is None:
            return None
        return float(20.0 * np.log10(self.gain_margin))

    @property
    def gain_reduction_db(self) -> float | None:
        """`gain_reduction` in dB, negative; -inf if no reduction makes the loop unstable."""
        if self.gain_reduction is None:
            return None
        if self.gain_reduction == 0:
            return -np.inf
        return float(20.0 * np.log10(self.gain_reduction))

    def summary(self) -> str:
        """Return the figures as text, one per line."""
        if not self.stable:
            poles = f"{self.unstable_poles} unstable poles"
            if self.unstable_poles == 1:
                poles = "1 unstable pole"
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
                f"drifting        {self.drifting} {poles} at 0, not observable in this loop"
            )
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Range:
    """Range of a figure over the stable members, with their indices; nan and None without any."""

    smallest: float
    smallest_member: int | None
    largest: float
    largest_member: int | None


@dataclass(frozen=True, slots=True)
class RobustMargin:
    """Largest perturbations of a plant for which the closed loop is guaranteed to be stable.

    Each output of the controller's feedback is perturbed independently, by any stable transfer
    function of limited size at each frequency.

    Attributes
    ----------
    of : {"family", "plant error"}
        Source of the size: the largest deviation of a member from the nominal plant, or the
        relative error of the plant in its band.
    margin : float
        1 / (largest structured singular value): the factor on the size up to which stability is
        guaranteed; inf without perturbation.
    at : float or None
        Frequency of `margin` in Hz; None without perturbation.
    member_margin : float
        Smallest factor on the deviation of a member that makes the loop unstable, an upper bound of
        `margin`. inf if none does, nan for the plant error.
    member : int or None
        Index of that member, from 0.
    """

    of: str
    margin: float
    at: float | None
    member_margin: float = float("nan")
    member: int | None = None

    @property
    def meaning(self) -> str:
        """One sentence on the guarantee of the margin."""
        if self.of == "family":
            size = "the largest deviation of a member"
        else:
            size = "the plant's relative error, in its band"
        if np.isinf(self.margin):
            return f"no perturbation: {size} is 0."
        text = "stable for all deviations of a channel up to"
        return f"{text} {self.margin:.3g} times {size}{self._nearest}."

    @property
    def _nearest(self) -> str:
        if self.member is None:
            return ""
        return (
            f"; unstable with {self.member_margin:.3g} times the deviation of member {self.member}"
        )

    def summary(self) -> str:
        """Return margin, frequency and meaning as text."""
        return f"{_figure(self.margin, '', self.at)}: {self.meaning}"


def ranges(members: Sequence[Margins]) -> dict[str, Range]:
    """Return the range of each figure over the stable members of a family, by name."""
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
