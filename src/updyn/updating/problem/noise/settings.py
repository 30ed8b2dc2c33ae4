"""Numbers that decide how the noise of measured values is estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseLimitSettings:
    """Limits of the noise."""

    #: [1] Least relative noise; keeps the weights of exact data finite. Rounding: rounding of a
    #: model solved in double precision.
    least_noise: float = 1e-12
    #: [1] Least standard deviation of a frequency, shape or loss factor. Rounding: rounding of an
    #: eigensolver.
    least_modal_noise: float = 1e-8
    #: [1] Degrees of freedom from which the size of noise counts as known: two numbers are
    #: estimated instead of one scale, and intervals are those of the normal distribution. Why: a
    #: common rule of thumb; 95 % intervals of Student's distribution are then 4 % wider than normal
    #: ones.
    many_freedoms: int = 30


NOISE_LIMITS = NoiseLimitSettings()


@dataclass(frozen=True)
class EstimatedNoiseSettings:
    """Numbers of the estimate of relative noise and floor from a residual."""

    #: [values] Largest number of values in the estimate; of more, equally spaced ones are used.
    #: Effort: they determine a standard deviation to better than 1 %.
    most_values: int = 20_000
    #: [points] Ratios of relative noise to floor in the search whose best point is refined. Effort:
    #: a rule of thumb; the best is refined.
    ratio_points: int = 40
    #: [1] Margin, in logarithm, of the search range beyond the ratios at which both are equally
    #: large. Rounding: a part of a thousandth of the other is not visible.
    ratio_margin: float = math.log(1e3)
    #: [values] Fewest values of a sensor for an estimate of its noise. Why: they determine its
    #: variance to 20 %.
    least_channel_values: int = 25


ESTIMATED_NOISE = EstimatedNoiseSettings()


@dataclass(frozen=True)
class LineScatterSettings:
    """Numbers of the estimate of the noise floor from the scatter of neighbouring lines."""

    #: [lines] Lines of a window. Why: the least odd number that leaves 2 degrees of freedom about a
    #: parabola.
    window_lines: int = 5
    #: [1] Degree of the fitted polynomial. Why: a parabola follows the flank of a resonance within
    #: a few lines (Pintelon & Schoukens, 2012, chapter 7).
    polynomial_degree: int = 2
    #: [1] Degrees of freedom of Student's distribution of the scatter. Why: up to a third of the
    #: scatter may be the shape of the resonances; the estimate for Gaussian noise is corrected.
    tail_freedoms: float = 1.0
    #: [lines] Fewest lines that distinguish noise from the shape of resonances. Why: four adjacent
    #: windows.
    least_lines: int = 20
    #: [values] Largest number of values of a response in the estimate of its floor. Effort: they
    #: are 400 separate windows of five lines.
    most_response_values: int = 2_000
    #: [1] Logarithm of the odds against the common floor from which a response has its own. Why:
    #: odds of 100 to 1.
    own_floor_log_odds: float = math.log(100.0)


LINE_SCATTER = LineScatterSettings()


@dataclass(frozen=True)
class SmoothVarianceSettings:
    """Numbers of the smoothing of a variance along the lines."""

    #: [averages] Number of averages that is assumed if the data do not state it. Why: a usual
    #: number.
    assumed_averages: int = 10
    #: [1] Degrees of freedom of a smoothed variance. Why: they determine a variance to 15 %.
    smoothed_freedoms: int = 48
    #: [lines] Least width of the window in which outliers are searched for. Why: the median of
    #: fewer lines follows an outlier.
    least_outlier_window: int = 7
    #: [1] Ratio to the median of the surrounding lines above which a variance is an outlier. Why: a
    #: rule of thumb; hum exceeds it.
    outlier_ratio: float = 10.0
    #: [iterations] Iterations of the fit of floor and relative noise. Effort: a rule of thumb.
    iterations: int = 100
    #: [lines] Largest number of lines in that fit. Effort: a rule of thumb.
    most_lines: int = 400
    #: [knots] Largest number of knots along the lines. Why: noise changes slowly with frequency.
    most_knots: int = 8
    #: [values] Number of real values over which the errors of the noise level are correlated. Why:
    #: the smoothing averages over about sixteen lines of complex values.
    correlated_values: float = 32.0


SMOOTH_VARIANCE = SmoothVarianceSettings()


@dataclass(frozen=True)
class RobustNoiseSettings:
    """Numbers of noise with outliers."""

    #: [1] Degrees of freedom of Student's distribution. Why: costs 7 % of efficiency for Gaussian
    #: noise.
    freedoms: float = 5.0
    #: [1] Share of the largest weight below which a weight is reported. Why: values beyond 4.7
    #: standard deviations.
    small_weight: float = 0.1
    #: [1] Share of such values from which a line or channel is reported. Why: the majority.
    reported_share: float = 0.5


ROBUST_NOISE = RobustNoiseSettings()


@dataclass(frozen=True)
class ModalSizeSettings:
    """Numbers of the estimate of the standard deviations of modes."""

    #: [residuals] Weight of the typical size of a kind in the estimate; with fewer degrees of
    #: freedom, the size is the typical one. Why: a rule of thumb.
    typical_weight: float = 2.0
    #: [rounds] Largest number of rounds in which sizes and weights are estimated in turn. Effort: a
    #: rule of thumb.
    most_rounds: int = 100
    #: [1] Relative change of a size below which it has settled. Effort: far below its standard
    #: deviation.
    settled_change: float = 1e-4
    #: [1] Probability below which a residual contradicts the standard deviations of the data. Why:
    #: chi-square test at the level of 5 %.
    contradiction_probability: float = 0.05


MODAL_SIZES = ModalSizeSettings()
