"""Numbers that decide how a servo is evaluated: loop lines, stability, margins, responses."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LoopLineSettings:
    """Numbers of the lines at which a loop function is computed, and of its crossings."""

    #: [lines] Lines per decade without resonances. Why: a rule of thumb; lines are added where the
    #: phase changes.
    lines_per_decade: int = 80
    #: [half widths] Distances of lines from each resonance, on both sides, in units of half its
    #: half-power width. Why: a rule of thumb; lines are added where the phase changes.
    offsets: tuple[float, ...] = (0.15, 0.3, 0.5, 0.75, 1.0, 1.4, 2.0, 3.0, 5.0, 8.0, 13.0, 25.0)
    #: [1] Smallest half width of a resonance, as a share of its frequency. Why: undamped resonances
    #: have none.
    least_half_width: float = 1e-7
    #: [rad] Largest change of phase between neighbouring lines. Why: a crossing between two lines
    #: is certain to be found below pi / 2.
    largest_turn: float = 0.7
    #: [lines] Number of lines above which no lines are added, and a dead time is refused. Effort: a
    #: rule of thumb.
    most_lines: int = 60_000
    #: [1] Imaginary part of a loop function, as a share of its modulus, below which it is real.
    #: Rounding: rounding of a transfer function.
    real_share: float = 1e-11
    #: [1] Largest value of a function at its root; larger ones are poles. Rounding: a root is
    #: located to 1e-14 of its frequency.
    root_residual: float = 1e-5
    #: [1] Gain above which a crossing is at a pole, and its reciprocal at a zero, on the axis. Why:
    #: the phase jumps there without a crossing.
    infinite_gain: float = 1e8
    #: [1] Ratio of the first line to the lowest pole or zero of the loop. Why: the phase of
    #: that pole or zero is within 1.2 degrees of its value at rest.
    first_line_ratio: float = 0.02
    #: [1] Ratio of the last line to the highest pole or zero. Why: the gain has reached its
    #: asymptote.
    last_line_ratio: float = 10.0
    #: [1] Loop gain below which no further lines are needed. Why: 1 + L is 1 within 5 %.
    vanished_gain: float = 0.05
    #: [1] With dead time: ratio of the last line to the frequency above which the gain stays below
    #: `vanished_gain`. Why: a rule of thumb.
    delay_line_ratio: float = 4.0
    #: [1] Modulus of a pole or zero, as a share of the largest, below which it is 0. Why: rounding
    #: of eigenvalues of a double pole at 0.
    zero_share: float = 1e-7


@dataclass(frozen=True)
class LoopStabilitySettings:
    """Numbers that classify the poles of a closed loop."""

    #: [1] Modulus of a closed-loop pole, as a share of the crossover, below which it is at 0. Why:
    #: rounding of eigenvalues of a double pole at 0.
    zero_pole_share: float = 1e-5
    #: [1] Real part of a pole, as a share of its modulus, above which it is unstable. Why: rounding
    #: of undamped modes that the loop does not control.
    growth_share: float = 1e-9
    #: [1] Modulus of a pole or zero in z below which it belongs to a delay. Rounding: rounding of
    #: 0.
    delay_modulus: float = 1e-9
    #: [log2] Largest logarithm of the scale of a state before eigenvalues are computed. Why: the
    #: scales of subsystems without coupling are unbounded.
    largest_log_scale: float = 40.0
    #: [1] Negative loop gain at half the sampling rate that counts as a crossing. Rounding:
    #: rounding of 0.
    nyquist_gain: float = 1e-9


@dataclass(frozen=True)
class RigidMotionSettings:
    """Numbers of the rigid-body inertia and the gear ratio of a plant."""

    #: [1] Ratio of the smallest circle about the slow poles to the lowest oscillation; poles within
    #: it count as 0. Rounding: the imaginary part of smaller ones is rounding.
    least_radius_ratio: float = 1e-3
    #: [1] Ratio of neighbouring moduli of poles between which a circle lies. Why: the integral
    #: converges by the square root of this ratio for each point.
    least_gap: float = 1.5
    #: [points] Points on a circle. Effort: 1.5^-128 is below rounding.
    circle_points: int = 256
    #: [1] Share of the slow poles in the mobility on the circle above which the structure turns
    #: freely. Why: they are the larger part.
    dominant_share: float = 0.5
    #: [1] Distance of a gear ratio from 1 within which it is 1. Why: the error of a reduced plant.
    unit_ratio_distance: float = 1e-3
    #: [1] Least difference of the controller's gear ratio from that of the plant that is noted.
    #: Why: 0.4 dB of position-loop gain.
    noted_ratio_difference: float = 0.05


@dataclass(frozen=True)
class DriveSettings:
    """Numbers of the figures of a drive."""

    #: [modes] Least number of computed modes. Effort: a rule of thumb; more are computed up to the
    #: end of the band.
    least_modes: int = 10
    #: [1] Largest relative error of a stated gear ratio. Why: a rule of thumb.
    ratio_error: float = 1e-3
    #: [1] Motion, as a share of the largest, below which a DOF is at rest. Rounding: rounding of
    #: eigenvectors.
    rest_motion: float = 1e-9
    #: [1] Distance from a locked-rotor frequency at which the response is computed. Rounding: both
    #: values then lie on the straight line through the zero.
    zero_offset: float = 1e-6


@dataclass(frozen=True)
class RobustMarginSettings:
    """Numbers of the margin of robust stability."""

    #: [1] Change of a loop, as a share of 1 + L, below which it is 0. Rounding: rounding of
    #: transfer functions.
    least_change: float = 1e-6
    #: [1] 1 - |real part| / modulus of the value at the first line below which it is real, as at
    #: rest. Why: the first line is 0.02 of the lowest pole or zero.
    rest_deviation: float = 1e-3
    #: [parts] Number of parts of the intervals next to the largest mu in one refinement. Effort: a
    #: rule of thumb.
    refined_parts: int = 8
    #: [rounds] Number of refinements. Effort: intervals are then 512 times shorter.
    refinements: int = 3


@dataclass(frozen=True)
class ServoVerdictSettings:
    """Numbers that decide whether a stable servo is doubted."""

    #: [1] Modulus margin from which no reservation is stated. Why: the sensitivity is then at most
    #: 2, 6 dB, the usual limit (Skogestad & Postlethwaite, Multivariable Feedback Control, 2nd ed.
    #: 2005, section 2.4.3).
    usual_modulus_margin: float = 0.5
    #: [1] Crossover of the velocity loop relative to the lowest flexible mode, and of the position
    #: loop relative to that of the velocity loop, below which it is questioned. Why: usual ratios
    #: are above a twentieth; wrong units and gear ratios are factors of tens or hundreds.
    questioned_crossover: float = 0.02


@dataclass(frozen=True)
class StepResponseSettings:
    """Numbers of the record of a step response and of its figures."""

    #: [intervals] Approximate least number of intervals of a record. Drawing: a curve without
    #: visible corners.
    least_intervals: int = 1000
    #: [intervals] Largest number of intervals of a record. Effort: a rule of thumb.
    most_intervals: int = 20_000
    #: [intervals] Intervals per radian of the fastest contributing mode. Why: the error of cubic
    #: interpolation is then about 1e-7 of the amplitude.
    intervals_per_radian: float = 12.0
    #: [1] Share of the response of the smallest contributing mode. Why: a twentieth of the settling
    #: band.
    contributing_share: float = 1e-3
    #: [1] Share of the response below which a mode has settled. Why: a tenth of the settling band.
    settled_share: float = 2e-3
    #: [1] Half width of the settling band, as a share of the final value. Why: the usual 2 % of
    #: control engineering.
    settling_band: float = 0.02
    #: [1] Largest final value, as a share of the peak, of a response that returns to zero: a loop
    #: without gain at rest ends at rounding or at the error of the fitted plant. Why: half of the
    #: settling band, so zero and the final value share one band.
    returning_share: float = 1e-2
    #: [1] With exact dead time: factor by which the intervals are refined. Effort: a rule of thumb.
    delay_refinement: float = 4.0
    #: [intervals] With exact dead time: largest number of intervals. Effort: a rule of thumb.
    most_delay_intervals: int = 60_000
    #: [intervals] With exact dead time: least number of intervals per dead time; below it, dead
    #: time is approximated. Why: a rule of thumb.
    least_intervals_per_delay: int = 16
    #: [samples] Approximate number of samples that are stored. Drawing: size of files.
    stored_samples: int = 5000


@dataclass(frozen=True)
class WindSeriesSettings:
    """Numbers of the random series of wind."""

    #: [1] Share of the variance of the error that a series may lack above its highest frequency.
    #: Rounding: an error of 5e-5 of the rms.
    missing_variance: float = 1e-4
    #: [lines] Lines of the spectrum of the error, in addition to those of the loop. Effort: a rule
    #: of thumb.
    spectrum_lines: int = 2000
    #: [samples] Largest number of samples if the wind has no interval. Effort: a rule of thumb.
    most_default_samples: int = 2**16
    #: [samples] Largest number of samples of a series. Effort: memory.
    most_samples: int = 2**20


LOOP_LINES = LoopLineSettings()
LOOP_STABILITY = LoopStabilitySettings()
RIGID_MOTION = RigidMotionSettings()
DRIVE = DriveSettings()
ROBUST_MARGIN = RobustMarginSettings()
SERVO_VERDICT = ServoVerdictSettings()
STEP_RESPONSE = StepResponseSettings()
WIND_SERIES = WindSeriesSettings()
