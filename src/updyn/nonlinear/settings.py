"""Numbers of the describing functions and of the linearisation of nonlinear elements."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DescribingSettings:
    """Inversion of describing functions."""

    #: [steps] Bisections that invert a describing function. Rounding: 2^-52 is the rounding of a
    #: double.
    bisections: int = 52
    #: [1] Smallest ratio of half gap to amplitude; larger amplitudes are not predicted. Rounding:
    #: the describing function then equals that of the mesh without gap to 1e-9.
    least_gap_ratio: float = 1e-9


@dataclass(frozen=True)
class QuadratureSettings:
    """Integrals by bisection of intervals."""

    #: [points] Points of the Gauss-Legendre rule of an interval. Effort: a rule of thumb.
    points: int = 10
    #: [1] Largest error of an interval over the integral. Rounding: far above rounding, far below
    #: the error of statistical linearisation.
    error: float = 1e-11
    #: [halvings] Most halvings of an interval. Rounding: 2^-50 of an interval is the rounding of a
    #: double.
    most_halvings: int = 50


@dataclass(frozen=True)
class LinearisationSettings:
    """Statistical linearisation of an element."""

    #: [1] Deviation, in standard deviations, at which the normal distribution ends. Rounding: its
    #: density there is 1e-22.
    largest_deviation: float = 10.0
    #: [1] Width of the change of sign of dry friction without a transition, over the standard
    #: deviation of the velocity. Rounding: the damping changes by 1e-12 of its value.
    sharp_transition: float = 1e-12
    #: [intervals] Intervals of an integral at its start. Effort: a rule of thumb.
    intervals: int = 10
    #: [points] Points of the integral over amplitudes of elements with memory. Rounding: an error
    #: of 1e-12; the function is smooth.
    inner_points: int = 40


DESCRIBING = DescribingSettings()
QUADRATURE = QuadratureSettings()
LINEARISATION = LinearisationSettings()
