"""Robust stability of a servo: perturbations of its plant for which stability is guaranteed.

Every channel G_i that the controller reads is perturbed to G_i + r_i delta_i, with any stable
delta_i, |delta_i| <= 1, and the size r_i over frequency. With L broken at the torque, the feedback
K_i through channel i and c_i = K_i r_i, the closed loop is stable for all perturbations times k if
k mu(M) < 1 at every frequency for

    M_ij = -c_i / (1 + L)

(Doyle 1982; Skogestad & Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005, section 8.9).
M has rank one, so det(I - M Delta) = 1 + sum c_i delta_i / (1 + L), and mu = sum |c_i| / |1 + L|.
The perturbed plants have no unstable poles, as the nominal one, and keep its poles at 0.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.arrays import ComplexArray, NumberArray, RealArray
from updyn.control.servo import grid
from updyn.control.servo.loops import Cascade
from updyn.control.servo.margins import RobustMargin
from updyn.control.servo.settings import ROBUST_MARGIN
from updyn.control.servo.stability import JudgedLoop

__all__ = ["error_margin", "family_margin"]

_TWO_PI = 2.0 * np.pi


def family_margin(cascade: Cascade, judged: JudgedLoop, members: Sequence[Cascade]) -> RobustMargin:
    """Return the margin for perturbations as large as the deviations of a family's members.

    r_i is the largest |G_k,i - G_i| over the members k, line by line; `judged` must be stable.
    """

    def deviation(w: RealArray) -> ComplexArray:
        s = 1j * w
        nominal = cascade.feedback_channels(s)
        away = [np.abs(member.feedback_channels(s) - nominal) for member in members]
        return np.asarray(np.max(away, axis=0), dtype=np.complex128)

    sharp = np.concatenate([p.velocity_poles for p in (cascade, *members)])
    w = grid.frequencies(sharp, float(judged.w[0]), float(judged.w[-1]))
    w = np.union1d(judged.w, w)
    margin, at = _margin(judged, deviation, w)
    least, number = np.inf, None
    for k, member in enumerate(members):
        member_margin = _critical_factor(cascade, judged, member, w, least)
        if member_margin < least:
            least, number = member_margin, k
    return RobustMargin("family", margin, at, least, number)


def error_margin(cascade: Cascade, judged: JudgedLoop) -> RobustMargin | None:
    """Return the margin for the relative error of the plant in its band.

    None if the error is unknown, or so large at some line, such as an antiresonance of a plant
    whose tolerance is a share of the peak, that it states nothing on the others.
    """
    plant = cascade.plant
    error, (low, high) = plant.relative_error, plant.band
    w = judged.w[(judged.w >= _TWO_PI * low) & (judged.w <= _TWO_PI * high)]
    if not error < 1.0 or not len(w):
        return None
    ends = np.array([_TWO_PI * f for f in (low, high) if f > 0])
    w = np.union1d(w, ends)
    margin, at = _margin(judged, lambda w: error * cascade.feedback_channels(1j * w), w)
    return RobustMargin("plant error", margin, at)


def _margin(judged: JudgedLoop, feedback: grid.Loop, w: RealArray) -> tuple[float, float | None]:
    """Return 1 over the largest mu and its frequency in Hz; `feedback` gives c_i, shape (n, k)."""

    def largest_mu(w: RealArray) -> tuple[float, float]:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            mu = np.abs(feedback(w)).sum(axis=1) / np.abs(1.0 + judged.loop(1j * w))
        mu = np.where(np.isfinite(mu), mu, -np.inf)
        k = int(np.argmax(mu))
        return float(mu[k]), float(w[k])

    largest, place = largest_mu(w)
    for _ in range(ROBUST_MARGIN.refinements):
        k = int(np.searchsorted(w, place))
        near = w[max(k - 1, 0) : k + 2]
        closer = np.unique(np.linspace(near[:-1], near[1:], ROBUST_MARGIN.refined_parts + 1))
        more, frequency = largest_mu(closer)
        if more > largest:
            largest, place = more, frequency
        w = closer
    if largest <= ROBUST_MARGIN.least_change:
        return np.inf, None
    return 1.0 / largest, place / _TWO_PI


def _critical_factor(
    cascade: Cascade, judged: JudgedLoop, member: Cascade, w: RealArray, known: float
) -> float:
    """Return the factor on a deviation at which the loop is unstable; inf if above `known`."""
    # L + t (L_k - L) = -1 at some frequency: the gain margin of (L_k - L) / (1 + L).

    def loop(s: NumberArray) -> ComplexArray:
        away = (member.feedback_channels(s) - cascade.feedback_channels(s)).sum(axis=1)
        return np.asarray(away / (1.0 + judged.loop(s)))

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        values = loop(1j * w)
        good = np.isfinite(values) & (np.abs(values) > ROBUST_MARGIN.least_change)
        w, values = w[good], values[good]
        if len(w) < 2 or 1.0 / np.abs(values).max() >= known:
            return np.inf
        turns = grid.crossings_of_phase(loop, w, values)
        sizes = np.abs(loop(1j * turns)) if len(turns) else np.zeros(0)
    first = np.abs(values[0])
    if -values[0].real > (1.0 - ROBUST_MARGIN.rest_deviation) * first:  # negative at rest
        sizes = np.append(sizes, first)
    return float(1.0 / sizes.max()) if len(sizes) else np.inf
