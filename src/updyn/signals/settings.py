"""Numbers that decide how FRFs are estimated from records."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LocalRationalSettings:
    """Numbers of the local rational method."""

    #: [steps] Gauss-Newton steps of the poles. Effort: the first is linear least squares, already
    #: near the optimum for small noise; each later one removes most of the remaining error.
    steps: int = 4
    #: [1] Least assumed share of a residual in the fit without its line. Why: a line that the model
    #: follows regardless of its value does not test the model; a rule of thumb.
    least_omitted_share: float = 0.02
    #: [1] Diagonals of R below this share of the largest are increased by it, for forces that are
    #: linearly dependent. Why: 50 times the rounding of the decomposition.
    dependent_share: float = 1e-14
    #: [1] Least noise relative to the mean square of a response over the band. Why: below that of a
    #: 24-bit converter (3e-15); a response that follows the force exactly would otherwise dominate
    #: the others.
    least_noise: float = 1e-16
    #: [1] The half width of a model over the number of lines for which it is used, around its
    #: centre. Effort: twice as many models, each for half as many lines, take twice the time and
    #: have equal errors.
    half_width_per_use: int = 4
    #: [1] Least degrees of freedom of a residual. Why: its variance is then known to 40 %, 1 /
    #: sqrt(6).
    least_freedom: int = 6
    #: [lines] Number of lines over which models are compared. Why: about two windows of the
    #: narrowest model.
    comparison_lines: int = 33
    #: [1] Least share of the power of a force outside transients and other forces. Why: below it,
    #: errors of the polynomials of a window count ten times (1 / sqrt(share)) in the FRF.
    least_separable_share: float = 0.01
    #: [values] Complex numbers in the largest array of a batch of windows; affects only memory and
    #: time. Effort: 5 MB; larger ones are no faster.
    batch_values: int = 300_000


@dataclass(frozen=True)
class RecordTimeSettings:
    """Numbers of the check that samples are evenly spaced."""

    #: [1] Largest relative difference between the sampling steps of several files. Why: times are
    #: rounded in files.
    step_difference: float = 1e-6
    #: [1] Largest relative variation of the steps in time. Why: times are written with few digits.
    step_variation: float = 1e-3
    #: [1] Printed times may vary by the rounding of their last digit if that digit is below this
    #: share of the step. Why: a coarser digit could hide a missing sample.
    last_digit_share: float = 0.2


@dataclass(frozen=True)
class FRFEstimateSettings:
    """Numbers of the check of forces, and of windows."""

    #: [1] Share of the amplitude of the largest line at which a force is zero. Why: rounding of the
    #: Fourier transform, with a margin.
    zero_force_share: float = 1e-12
    #: [1] Least eigenvalue of the coherence matrix of forces that are linearly independent. Why:
    #: rounding of the averages, with a margin.
    independent_eigenvalue: float = 1e-12
    #: [1] Largest share of a record with 90 % of the energy of a force for which LRM treats it as a
    #: pulse. Why: true over stated variance is 1.2 to 1.4 for random bursts of 2 %, and 1.5 to 1.6
    #: for 1 %, in records of three decay times (benchmarks/records.py); for a hit it is 3 to 500,
    #: depending on its place in the record.
    pulse_share: float = 0.02
    #: [1] Share of the force window over which it falls to zero, as half a cosine. Why: a rule of
    #: thumb; an abrupt end would spread an offset over all lines.
    taper_share: float = 0.1


@dataclass(frozen=True)
class SetupJoiningSettings:
    """Numbers of the check that setups of one structure can be joined."""

    #: [1] Largest relative difference between equal lines. Why: rounding of frequencies.
    line_difference: float = 1e-9
    #: [m] Largest difference, absolute or relative, between equal positions of a node; for
    #: directions [1]. Why: digits of positions in files.
    place_difference: float = 1e-6


LOCAL_RATIONAL = LocalRationalSettings()
RECORD_TIME = RecordTimeSettings()
FRF_ESTIMATE = FRFEstimateSettings()
SETUP_JOINING = SetupJoiningSettings()
