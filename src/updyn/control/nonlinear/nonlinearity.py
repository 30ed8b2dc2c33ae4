"""The nonlinear elements of loops, and when harmonic balance of one harmonic doubts a cycle.

A loop has one of them between one output z of a plant and one input w: w = -T, with the torque T of
the twist z or of the velocity z.
"""

from __future__ import annotations

from updyn.control.nonlinear.settings import HARMONIC_BALANCE
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.friction import CoulombFriction

__all__ = ["Nonlinearity", "find_doubt"]

Nonlinearity = Backlash | CoulombFriction


def find_doubt(nonlinearity: Nonlinearity, amplitude: float, third: float) -> str:
    """Return the reason why a limit cycle is doubtful, else an empty text.

    `amplitude` in rad or rad/s; `third` is the third harmonic over the first.
    """
    if isinstance(nonlinearity, Backlash):
        if amplitude < HARMONIC_BALANCE.least_twist * nonlinearity.half:
            half_gaps = amplitude / nonlinearity.half
            return f"the twist reaches only {half_gaps:.3g} half gaps: bounces, not a sine"
    elif third > HARMONIC_BALANCE.largest_third:
        return f"the loop transmits {third:.2g} of a third harmonic"
    return ""
