"""Numbers that decide which causes of a misfit are tried, found and reported."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class CauseSearchSettings:
    """Numbers of the search for the causes of one test."""

    #: [lines] Lines of the data in the search; more lines take longer. Effort: the size of the
    #: likeliest fault is fitted to all lines afterwards.
    lines: int = 60
    #: [values] Values of the data in the search from which on it has fewer lines, down to
    #: `fewest_lines`. Effort: a sensor of many references has enough values.
    most_values: int = 20_000
    #: [values] Values of the effects of faults that are fitted together. Effort: limit of memory.
    together_values: int = 1_000_000
    #: [lines] Least number of lines of the search. Why: a rule of thumb; delays and filters differ
    #: over the band.
    fewest_lines: int = 20
    #: [lines] Lines with usable values below which a test, a sensor or a pair of FRFs is not
    #: examined. Why: fewer values determine neither a fault nor its odds (a rule of thumb).
    least_lines: int = 8
    #: [lines] Lines on which the model is evaluated for a first look, e.g. in other units. Effort:
    #: the differences that count there are of orders of magnitude.
    glance_lines: int = 8
    #: [faults] Largest number of faults of one test, and of wrong sensors of a rigid body. Why:
    #: more faults at a time are rare, and their combinations explain any data (a rule of thumb).
    most_faults: int = 3
    #: [rounds] Largest number of refinements of the model for one decision. Effort: a rule of
    #: thumb.
    most_refinements: int = 3
    #: [1] Share of the previous mean square misfit above which a further fit has converged. Why: a
    #: rule of thumb.
    converged_share: float = 0.9
    #: [rounds] Rounds in which the best fault is tried at other places. Effort: a rule of thumb.
    place_rounds: int = 3
    #: [places] Other places from each point in one round. Effort: a rule of thumb.
    next_places: int = 3
    #: [1] Ratio of mean square errors up to which the size from all lines replaces that from the
    #: lines of the search. Why: a larger error shows that all lines contradict the held quantities.
    similar_error: float = 1.2
    #: [1] Log misfit (rms) from which model and data have little in common, so that findings are
    #: not reported. Why: an error of a factor of 1.6 at a typical value.
    gross_rms: float = 0.5
    #: [1] Mean square of the log misfit below which the faults found explain all data. Why: an
    #: error of 3 %, the noise of a usual test.
    explained_mean_square: float = 1e-3
    #: [1] Ratio of the mean square misfits with and without the values of a symptom, above which
    #: the faults found do not explain the symptom. Why: a rule of thumb.
    symptom_ratio: float = 1.5
    #: [units] Units of a model that are fitted, after a comparison on few lines. Effort: a rule of
    #: thumb.
    most_units: int = 2
    #: [DOFs] Size of a model above which other units are not tried. Effort: a rule of thumb.
    largest_model: int = 20_000
    #: [causes] Other causes that the statement of a finding names. Drawing: length of a sentence.
    named_causes: int = 2


@dataclass(frozen=True)
class CauseCandidateSettings:
    """Numbers that choose the faults that are fitted together with all unknowns."""

    #: [faults] Largest number of faults that are fitted until convergence. Effort: a rule of thumb.
    most_fitted: int = 4
    #: [faults] Largest number of faults that are tried from each point. Effort: a rule of thumb.
    most_tried: int = 6
    #: [faults] Of these, the largest number of one kind. Why: otherwise one kind with many similar
    #: sizes and places takes all tries.
    most_of_kind: int = 2
    #: [1] Log misfit (rms) below which a residual is nearly noise and faults are chosen by their
    #: odds. Why: changes of 10 % are linear enough for odds to first order.
    small_rms: float = 0.1
    #: [1] Correlation of neighbouring lines below which such a residual shows no gross fault. Why:
    #: a rule of thumb.
    small_correlation: float = 0.3
    #: [1] Remaining share of the mean square misfit up to which a fault of all data explains
    #: everything. Why: a wrong quantity or conjugation leaves a small part only (a rule of thumb).
    least_remaining: float = 0.01
    #: [1] Logarithm of the odds to first order from which a fault is fitted if the residual is
    #: small. Why: changes of the unknowns during the fit have effects of higher order.
    least_log_odds: float = -5.0
    #: [1] Difference of the logarithm of the odds to first order within which another fault is
    #: tried after one that leaves noise only. Why: as for `least_log_odds`, far from the start.
    reach_log_odds: float = 50.0
    #: [lines] Lines on which variants of a model are compared before any fit. Effort: a rule of
    #: thumb.
    variant_lines: int = 20
    #: [variants] Largest number of variants of a model that are fitted. Effort: a rule of thumb.
    most_variants: int = 3
    #: [places] Largest number of other places of one sensor or one force. Effort: a rule of thumb.
    most_places: int = 40
    #: [sensors] Sensors whose pairs are tried for an exchange; of more, the first ones. Effort: 80
    #: sensors have 3,160 pairs.
    most_swapped: int = 80


@dataclass(frozen=True)
class CauseOddsSettings:
    """Numbers that decide which faults are likely, reported and distinguished."""

    #: [1] Logarithm of the odds from which a fault is reported. Why: odds of 100 to 1.
    likely_log_odds: float = math.log(100.0)
    #: [1] Logarithm of the odds between two faults up to which the data do not distinguish them.
    #: Why: odds of 20 to 1, as for a significance of 5 %.
    indistinct_log_odds: float = 3.0
    #: [1] Odds above which a table shows no number. Drawing: larger odds depend on the assumed
    #: noise alone.
    shown_odds: float = 1e6
    #: [places] Least number of places among which the prior odds of a kind are divided. Why: with
    #: few sensors, one place is no more likely than a fault of one sensor.
    least_places: int = 10
    #: [1] Share of the misfit that a reported fault explains at least. Why: any smooth change of
    #: the data explains a smaller part of many small errors of the model.
    least_share: float = 0.1
    #: [1] Share of the misfit below which nothing remains to be explained. Why: a rule of thumb.
    negligible_share: float = 0.05
    #: [std] Distance (rms) of stiffnesses and masses from their start up to which a model is as
    #: good as usual. Why: level of 5 % of one normal error.
    usual_distance: float = 2.0
    #: [1] Share of the squared distance of held quantities from their start that a fault has to
    #: make unnecessary. Why: a rule of thumb.
    least_reduction: float = 0.3
    #: [1] Share of the misfit from which a cause makes an answer implausible. Why: it then explains
    #: more than all other errors together.
    grave_share: float = 0.5
    #: [1] Logarithm of a calibration factor up to which an answer may be used with care. Why: an
    #: error of a third; other channels keep natural frequencies correct (a rule of thumb).
    mild_calibration: float = 0.3


@dataclass(frozen=True)
class CauseMisfitSettings:
    """Numbers of the misfit by which faults are compared, and of its derivatives."""

    #: [1] Log misfit (rms) below which a fit is perfect, with or without a fault. Why: smaller ones
    #: depend on the last steps of a fit.
    perfect_rms: float = 1e-3
    #: [1] Noise, as a share of the level, at which the weight of a value is 0.7. Why: noise of a
    #: usual test (a rule of thumb).
    clear_noise: float = 0.03
    #: [1] Least noise, as a share of the rms of all data of one unit. Why: resolution of sensors.
    sensor_resolution: float = 1e-5
    #: [1] Quantile of the relative noise that the weight of exact values uses. Why: the smallest
    #: values of noise are outliers (a rule of thumb).
    exact_quantile: float = 0.1
    #: [1] Variance of a value without weight, over the square of the largest value. Why: its
    #: deviation is a thousand times all values.
    weightless_variance: float = 1e6
    #: [1] Standard deviation of ln(factor) of stiffnesses and masses about their start. Why: a
    #: factor of 1.5, the error of usual models (a rule of thumb).
    factor_std: float = 0.4
    #: [1] Standard deviation of a loss factor about its start. Why: range of structures and their
    #: joints (a rule of thumb).
    loss_std: float = 0.2
    #: [1] Share of an effect that others do not produce, up to which it depends on them: of faults,
    #: unknowns and rigid-body shapes. Rounding: rounding of normal equations.
    dependent_share: float = 1e-6
    #: [1] Largest entry of the normal equations, in which the prior is 1. Rounding: above it,
    #: rounding hides the prior, e.g. at an undamped resonance on a line.
    largest_entry: float = 1e12
    #: [1] Largest logarithm of a factor by which data are corrected. Rounding: squares of values
    #: remain within the range of numbers, exp(709).
    largest_log_factor: float = 300.0
    #: [1] Relative step in frequency for derivatives. Rounding: truncation and rounding are equal
    #: about the cube root of the rounding error.
    frequency_step: float = 1e-5
    #: [1] Frequency that replaces 0 Hz, as a share of the lowest other line, or of 1 Hz if that is
    #: higher. Why: a mobility has no logarithm at 0 Hz, where it is zero.
    zero_replacement: float = 1e-3


@dataclass(frozen=True)
class HeldQuantitySettings:
    """Numbers of the quantities that are no unknowns but may be slightly wrong."""

    #: [quantities] Largest number that is freed; if there are more, none is. Effort: a rule of
    #: thumb.
    most: int = 60
    #: [1] Standard deviation of ln(stiffness) and ln(mass). Why: 5 %, for parts whose properties
    #: are taken as known (a rule of thumb).
    factor_std: float = 0.05
    #: [1] Standard deviation of a loss factor, as a share of it. Why: loss factors are known to
    #: within a factor of about two.
    loss_share: float = 0.5
    #: [1] Least standard deviation of a loss factor. Why: every structure has damping; otherwise a
    #: model without any would be explained by an exponential window.
    least_loss_std: float = 0.05
    #: [1] Possible errors, as shares of these standard deviations; the evidence uses the best. Why:
    #: 0.1 % to 5 % in steps of about three.
    std_shares: tuple[float, ...] = (0.02, 0.1, 0.3, 1.0)
    #: [1] Standard deviation of the log misfit (rms) due to a fault. Rounding: so large that it has
    #: no effect on the size.
    fault_std: float = 10.0
    #: [steps] Iterations for the level of the residual. Effort: it changes little after three.
    level_steps: int = 3


@dataclass(frozen=True)
class CauseTrialSettings:
    """Numbers of the short fits that compare faults."""

    #: [rounds] Estimates of the size of a fault in a whole trial. Effort: a rule of thumb.
    rounds: int = 5
    #: [steps] Steps of each descent of a whole trial. Effort: a rule of thumb.
    steps: int = 20
    #: [rounds] Estimates of the size in a short trial. Effort: it only orders the faults.
    short_rounds: int = 1
    #: [steps] Steps of a descent in a short trial. Effort: a rule of thumb.
    short_steps: int = 8
    #: [1] Ratio of the mean square misfit to that of a trial that leaves noise, above which a trial
    #: ends. Effort: twice the noise, which further rounds do not remove (a rule of thumb).
    hopeless_ratio: float = 4.0
    #: [1] Relative change of a size below which it has converged. Effort: far below its deviation.
    size_change: float = 1e-3
    #: [1] Tolerance of a descent, relative. Effort: faults are compared by much larger differences.
    tolerance: float = 1e-6
    #: [1] First radius of a descent, in ln(factor). Effort: steps of a third are nearly linear.
    radius: float = 0.3
    #: [1] Predicted decrease of the cost, relative, below which a descent ends. Effort: it changes
    #: log odds by little.
    least_decrease: float = 1e-4
    #: [1] Least loss factor at the start of a descent. Why: resonances then overlap, so that a
    #: descent moves them onto those of the data.
    least_start_loss: float = 0.1
    #: [1] Share of the mean square misfit at the end of a fit down to which the second order is
    #: trusted. Why: at a poor end it may predict any value.
    trusted_share: float = 0.5
    #: [1] Correlation of neighbouring lines below which a residual is noise. Why: with 240 real
    #: values on 30 lines, white noise exceeds it in 7 %.
    white_correlation: float = 0.1
    #: [1] Log misfit (rms) below which such a residual is noise. Why: on few lines an error of the
    #: model resembles noise, except in size.
    noise_rms: float = 0.05
    #: [1] Largest correlation of neighbouring lines that reduces the number of values. Why: keeps
    #: that number above zero (1/39 of all values).
    largest_correlation: float = 0.95


@dataclass(frozen=True)
class CauseModelSettings:
    """Numbers of the reduced models for trials."""

    #: [DOFs] Size above which a model is reduced. Why: smaller models are solved as fast.
    largest_whole: int = 100
    #: [points] Points about the start whose solutions form a basis, and the same number whose
    #: solutions select from it. Effort: a rule of thumb.
    points: int = 8
    #: [1] Root of the share of the energy that compression of a basis drops. Effort: the error is
    #: certified afterwards.
    dropped: float = 1e-4
    #: [vectors] Largest size of a basis after compression. Effort: the time of a trial grows with
    #: the cube of the size.
    most_vectors: int = 100
    #: [1] Shifts of the points in turn, in squares of the highest frequency. Effort: spread over
    #: the band; the error is certified afterwards.
    shifts: tuple[float, ...] = (0.2, 0.5, 0.8)
    #: [moments] Moments of each point in the basis. Effort: a rule of thumb.
    depth: int = 4
    #: [vectors] Random combinations of the sensors at each point. Effort: a rule of thumb.
    combinations: int = 4
    #: [1] Distance in x from a certified point within which its certificate is valid. Why: errors
    #: of a basis change little over 5 % of a stiffness (a rule of thumb).
    near: float = 0.05
    #: [1] Accepted error at points of decisions, as a share of the largest receptance of a line.
    #: Why: below the noise of tests; the error counts as noise.
    accuracy: float = 1e-3
    #: [1] Logarithms of the remaining stiffness of a spring to the ground at points of the basis
    #: without this support. Effort: a fifth and a fiftieth, the first values of a trial; the error
    #: is certified afterwards.
    loose: tuple[float, ...] = (-1.5, -4.0)
    #: [1] Largest loss factor of the points. Effort: range of structures (a rule of thumb); the
    #: error is certified afterwards.
    most_loss: float = 0.3


@dataclass(frozen=True)
class SupportFaultSettings:
    """Numbers of supports: of the model, of the structure, and of a suspension."""

    #: [1] Force of a rigid translation over the largest stiffness, up to which a group resists no
    #: translation. Rounding: rounding of matrices from files with seven digits.
    rounding: float = 1e-6
    #: [1] Standard deviation of ln(stiffness) below which a stiffness is taken as known. Why: twice
    #: that of held quantities.
    known_std: float = 0.1
    #: [1] First values of the remaining share of the stiffness of a missing support. Effort: the
    #: share is fitted from there.
    first_shares: tuple[float, ...] = (0.2, 0.02)
    #: [1] Remaining share of the stiffness up to which a support is reported as missing. Why: a
    #: larger share is an error of the stiffness (a rule of thumb).
    most_share: float = 0.3
    #: [1] Least share of the stiffness in a fit. Why: the support is then soft in any band.
    least_share: float = 1e-4
    #: [1] Prior standard deviation of the logarithm of that share. Why: so large that it has no
    #: effect.
    share_std: float = 5.0
    #: [1] Step of that logarithm for derivatives. Rounding: truncation far below the effect.
    share_step: float = 1e-3
    #: [1] First frequencies of a suspension as shares of the lowest line. Why: rigid-body modes are
    #: below or about the first lines.
    low_shares: tuple[float, ...] = (0.4, 1.1, 3.0)
    #: [1] The same as shares of the highest line. Why: a stiffer support.
    high_shares: tuple[float, ...] = (0.13, 0.4)
    #: [1] Relative step of the frequency of a suspension for derivatives. Rounding: truncation and
    #: rounding are both far below the effect.
    frequency_step: float = 1e-4
    #: [1] Loss factor of a suspension. Why: foam and rubber cords.
    soft_loss: float = 0.05


@dataclass(frozen=True)
class MissingElementSettings:
    """Numbers of the search for springs, dashpots and masses that a model lacks."""

    #: [elements] Elements of a kind that are fitted at a point. Effort: a rule of thumb.
    most: int = 4
    #: [places] Places for comparison after a fit of one. Effort: a rule of thumb.
    next_places: int = 8
    #: [elements] Elements whose products are in memory at a time. Effort: limit of memory.
    chunk: int = 256
    #: [elements] Elements that are tried with several sizes. Effort: a rule of thumb.
    most_sized: int = 24
    #: [1] Trial sizes, as the median over the lines of |D(s) h|, dynamic stiffness times
    #: flexibility. Effort: a size of 1 changes the response there by its own amount; the best is
    #: fitted.
    sizes: tuple[float, ...] = (0.0, 0.1, 0.5, 2.5)
    #: [1] Largest decrease of a size above 0 in one step, as a share of it. Effort: it stays
    #: positive.
    most_decrease: float = 0.9
    #: [1] Largest increase, as a share of it. Effort: up to about the next trial size.
    most_increase: float = 3.0


@dataclass(frozen=True)
class LossExponentSettings:
    """Numbers of loss factors that vary with frequency."""

    #: [1] Largest exponent. Why: a spring with a parallel dashpot has 1 (Kelvin-Voigt), with one in
    #: series -1 (Maxwell); the margin is for the error of an estimate.
    most: float = 1.5
    #: [1] First exponent with a varying storage modulus. Effort: with 0 it is not the model itself;
    #: the exponent is fitted.
    first: float = 0.3
    #: [1] Step of the exponent for derivatives. Rounding: truncation and rounding are both far
    #: below the effect.
    step: float = 1e-4
    #: [lines] Frequencies in the loss table of the remedy. Why: linear interpolation over two
    #: decades is within 4 % of f^0.5 and of f^-0.5.
    table_lines: int = 9
    #: [digits] Significant digits of that table. Why: far more accurate than the exponent.
    table_digits: int = 4


@dataclass(frozen=True)
class MissingModeSettings:
    """Numbers of measured modes that the model lacks."""

    #: [1] Misfit at a line over its median, above which a mode may be missing. Why: a rule of
    #: thumb.
    peak_ratio: float = 3.0
    #: [1] Least log misfit (rms) at such a line. Why: smaller peaks do not affect an answer.
    least_peak: float = 0.1
    #: [modes] Largest number of such lines. Effort: a rule of thumb.
    most_peaks: int = 3
    #: [1] Distance from the mode, as a share of its frequency, of the lines that are fitted. Why:
    #: the residual is nearly constant there, except for the mode (a rule of thumb).
    near_share: float = 0.15
    #: [lines] Least number of lines that are fitted. Why: a mode and a constant have four real
    #: values; twice as many lines and one at the peak.
    least_lines: int = 9
    #: [1] First loss factor. Effort: between welded and bolted structures; the loss factor is
    #: fitted from there.
    first_loss: float = 0.01
    #: [1] Least loss factor. Why: that of a part of metal without joints.
    least_loss: float = 1e-4
    #: [1] Loss factor from which it is no mode. Why: a resonance so wide has no separate peak.
    most_loss: float = 0.5
    #: [steps] Refinements of frequency and loss factor. Effort: steps are halved; six give 2 % of
    #: the spacing of the lines.
    refinements: int = 6
    #: [1] First factor between trial loss factors; its root in each further refinement. Effort:
    #: covers a decade in the first steps.
    loss_factor_step: float = 3.0
    #: [1] Share of the sensors below which the cause is a fault of these. Why: most sensors measure
    #: a mode (a rule of thumb).
    least_sensors: float = 0.6
    #: [lines] Half-power bandwidth up to which the pole describes a single line. Why: a record
    #: whose length is the reciprocal of the spacing does not resolve less.
    narrow_lines: float = 0.03
    #: [1] Share of its frequency on either side that the repair omits if its shape is unknown. Why:
    #: several bandwidths of a usual mode (a rule of thumb).
    omitted_share: float = 0.05
    #: [1] Ratio of the mode to the residual above which the repair omits a line. Why: the line then
    #: contains mostly noise of the mode.
    dominant_ratio: float = 3.0
    #: [entries] Entries of a shape that a remedy prints. Why: length of a sentence.
    named_entries: int = 12
    #: [steps] Largest number of steps of the fit of a pole with all unknowns. Effort: fits end
    #: earlier by `least_decrease`.
    most_steps: int = 30
    #: [steps] Largest number of steps on all lines, if they are many. Effort: the fit to some lines
    #: is its start, and one step ends it.
    last_steps: int = 2
    #: [1] Relative decrease of the misfit that ends the fit. Effort: changes the pole far less than
    #: its deviation.
    least_decrease: float = 1e-6
    #: [lines] Lines near the pole that represent all of these; the same number elsewhere. Effort: a
    #: rule of thumb.
    fitted_lines: int = 120
    #: [1] Distance from the pole in loss factors up to which a line is near. Why: the pole is below
    #: a tenth of its peak beyond.
    near_bandwidths: float = 5.0
    #: [1] Largest change of the logarithm of the frequency. Effort: it stays the same mode.
    frequency_move: float = 0.05
    #: [1] Largest change of the logarithm of the loss factor. Effort: a factor of 20.
    loss_move: float = 3.0


@dataclass(frozen=True)
class ChannelFaultSettings:
    """Numbers of faults of single channels, and of all of them together."""

    #: [1] Least logarithm of a wrong calibration factor. Why: 1.5 %, the accuracy of sensors.
    least_calibration: float = 0.015
    #: [1] Largest one. Why: a factor of 30; larger ones are units.
    most_calibration: float = 3.4
    #: [1] Difference in ln(factor) up to which a unit is compared with a calibration. Why: larger
    #: than errors of calibration and of models together (a rule of thumb).
    near_unit: float = 0.12
    #: [1] Difference in ln(factor) up to which a factor is that of a unit. Why: rounding of
    #: factors in texts.
    same_unit: float = 1e-6
    #: [1] First delays in periods of the highest line. Why: several, because a phase is known up to
    #: whole turns only; the last one bounds the delay between two reciprocal FRFs.
    delay_periods: tuple[float, ...] = (-2.0, -1.5, -1.0, -0.7, -0.4, 0.0, 0.4, 0.7, 1.0, 1.5, 2.0)
    #: [1] First corner frequencies of a low-pass as shares of the highest line. Why: in the band
    #: and above it, in steps of two.
    corner_shares: tuple[float, ...] = (0.25, 0.5, 1.0, 2.0, 4.0)
    #: [1] Least logarithm of the scale of the frequency axis. Why: 0.1 %, above errors of clocks.
    least_scale: float = 1e-3
    #: [1] Largest one. Why: a factor of 2.7 (a rule of thumb).
    most_scale: float = 1.0
    #: [1] First logarithms of the factor between the frequencies of two tests. Why: to first order,
    #: which is valid over about a bandwidth only.
    shifts: tuple[float, ...] = (-0.07, -0.045, -0.025, 0.0, 0.025, 0.045, 0.07)
    #: [1] Half widths of the grids of a search for that logarithm. Effort: each grid covers the
    #: steps of the one before; with sharp resonances a step of first order may increase the misfit.
    grid_half_widths: tuple[float, ...] = (0.15, 0.006, 0.001)
    #: [points] Points of these grids. Effort: the last step is 0.05 %, a tenth of the least shift.
    grid_points: tuple[int, ...] = (41, 9, 5)
    #: [1] Least logarithm of a factor that is reported. Why: 0.5 %, above changes with temperature
    #: (a rule of thumb).
    least_shift: float = 5e-3
    #: [1] Largest one. Why: a factor of 1.35; beyond, it is another structure (a rule of thumb).
    most_shift: float = 0.3
    #: [degrees] Least turn of a sensor. Why: the transverse sensitivity of accelerometers is up to
    #: 5 % according to data sheets: asin(0.05) = 2.9 degrees.
    least_turn: float = 3.0
    #: [degrees] Step of trial angles of a turn. Effort: the correlation to be maximised has at most
    #: two maxima in 360 degrees.
    turn_step: float = 5.0


@dataclass(frozen=True)
class DataFaultSettings:
    """Numbers of dead channels, drive points and reciprocity, which the data show alone."""

    #: [1] Level of the model over its largest channel, above which a channel has a response. Why:
    #: rounding of the solution.
    least_response: float = 1e-8
    #: [std] Deviation of a value above which it has a phase. Why: the phase is then known to within
    #: 0.2 rad, one standard deviation.
    phase_stds: float = 5.0
    #: [std] Deviation above which a value is an outlier: a negative mobility, a mains line. Why:
    #: many values are tested; 0.006 % of normal errors are larger.
    outlier_stds: float = 4.0
    #: [1] Real part of a mobility over its magnitude, above which its sign is significant. Why: an
    #: error of phase of 3 degrees.
    phase_error: float = 0.05
    #: [1] Share of the lines with a significant sign at which correct data are negative. Why: a
    #: rule of thumb.
    negative_by_chance: float = 0.02
    #: [1] Share of all lines that is reported. Why: a few lines do not affect an answer.
    least_negative: float = 0.1
    #: [lines] Largest number of lines that count as independent. Why: neighbouring lines of a
    #: finer spacing share resonances.
    most_independent: int = 60
    #: [1] Trial delays of drive points, in periods of the highest line. Why: from the accuracy of
    #: filters to a sample of a slow converter.
    delay_periods: tuple[float, ...] = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
    #: [1] Relative difference of two reciprocal FRFs of sound tests. Why: mass of sensors and aim
    #: of hammers (a rule of thumb).
    usual_difference: float = 0.07
    #: [1] Remaining share of such a difference up to which a fault explains it. Why: a rule of
    #: thumb.
    explained_difference: float = 0.3
    #: [points] Trial delays between two reciprocal FRFs. Effort: a hundred in a period.
    delay_points: int = 401


@dataclass(frozen=True)
class MainsHumSettings:
    """Numbers of mains hum in FRFs."""

    #: [lines] Neighbouring lines that predict a line, half on either side. Why: twice the number of
    #: coefficients.
    neighbours: int = 8
    #: [1] Degree of their polynomial; a pole replaces the highest power. Why: follows the flank of
    #: a resonance over a few lines.
    degree: int = 3
    #: [1] Largest spacing of lines as a share of the mains frequency. Why: enough lines without hum
    #: between two multiples.
    coarse: float = 0.1
    #: [lines] Distance of a line from a multiple at which it is tested. Why: hum between two lines
    #: affects both.
    near: float = 0.4
    #: [lines] Other lines for comparison. Effort: a rule of thumb.
    most_compared: int = 400
    #: [1] Share of the lines with hum at which a channel is affected. Why: more than half.
    affected_share: float = 0.5
    #: [lines] Half-power bandwidth below which a line is no resonance. Why: a record whose length
    #: is the reciprocal of the spacing does not resolve less.
    sharp_lines: float = 0.05


@dataclass(frozen=True)
class CutRecordSettings:
    """Numbers of the search for the end of cut records."""

    #: [lines] Least number of lines. Why: nine windows of averaged samples.
    least_lines: int = 48
    #: [1] Largest relative variation of the spacing of lines. Why: rounding of frequencies in
    #: files.
    even_spacing: float = 1e-3
    #: [samples] Samples next to the end of the record that the limits of the band blur. Why: main
    #: lobe of the Hann window.
    blurred_samples: int = 3
    #: [samples] Least number of averaged samples. Why: averages the noise of the power.
    least_averaged: int = 5
    #: [1] Averaged samples as a share of all. Why: short against the decay (a rule of thumb).
    averaged_share: float = 1.0 / 16.0
    #: [1] Logarithm of the ratio of powers from which there is an edge. Why: 22 dB, above the
    #: variation of a decay with several modes (a rule of thumb).
    edge: float = 2.2 * math.log(10.0)
    #: [1] Share of the largest drop that identifies the edge. Why: the taper falls after the end as
    #: well.
    edge_share: float = 0.7


@dataclass(frozen=True)
class RigidBodySettings:
    """Numbers of the comparison of sensors with rigid-body motion."""

    #: [1] Lowest and highest line of trial bands over the lowest elastic mode of the model. Why: if
    #: all stiffnesses are three times too large, 0.3 is half of the true lowest elastic mode.
    bands: tuple[tuple[float, float], ...] = (
        (0.0, 0.3),
        (0.15, 0.3),
        (0.0, 0.15),
        (0.075, 0.15),
        (0.0, 0.075),
    )
    #: [lines] Least number of lines of a band. Why: two more than a straight line needs.
    least_lines: int = 4
    #: [1] Standard deviation of a sound sensor over the motion of its node. Why: 3 % in sensitivity
    #: and 2 degrees in direction.
    sensor_std: float = 0.04
    #: [1] Standard deviation due to its position over the rms motion. Why: a rule of thumb.
    position_std: float = 0.02
    #: [std] Deviation above which a sensor does not follow the others. Why: odds of 100 to 1 if one
    #: sensor in 100 is wrong.
    wrong_stds: float = 3.6
    #: [std] Deviation up to which a fault explains the values of a sensor. Why: level of 5 %.
    explained_stds: float = 2.0
    #: [1] Difference of squared deviations that a further wrong sensor has to explain. Why: odds
    #: of 1 to 1000 of a fault of a sensor.
    sensor_cost: float = 7.0
    #: [sensors] Sensors whose combinations are examined. Effort: a rule of thumb.
    most_examined: int = 12
    #: [sets] Sets of wrong sensors that are compared by their explanations. Effort: a rule of
    #: thumb.
    most_compared: int = 10
    #: [1] Share of its deviation that the fit to all sensors leaves, up to which a sensor is not
    #: judged. Why: the others do not determine its motion.
    least_judged: float = 0.05
    #: [1] Strain energy over the sum of its absolute terms up to which a shape is rigid. Rounding:
    #: rounding of the products.
    rigid_energy: float = 1e-10
    #: [degrees] Largest trial turn of a sensor. Why: 90 degrees is another direction.
    most_turn: float = 85.5
    #: [degrees] Step of trial turns. Why: far below the accuracy of a direction.
    turn_step: float = 0.5
    #: [explanations] Explanations in a statement. Drawing: length of a sentence.
    named_explanations: int = 3


CAUSE_SEARCH = CauseSearchSettings()
CAUSE_CANDIDATES = CauseCandidateSettings()
CAUSE_ODDS = CauseOddsSettings()
CAUSE_MISFIT = CauseMisfitSettings()
HELD_QUANTITIES = HeldQuantitySettings()
CAUSE_TRIAL = CauseTrialSettings()
CAUSE_MODEL = CauseModelSettings()
SUPPORT_FAULT = SupportFaultSettings()
MISSING_ELEMENT = MissingElementSettings()
LOSS_EXPONENT = LossExponentSettings()
MISSING_MODE = MissingModeSettings()
CHANNEL_FAULT = ChannelFaultSettings()
DATA_FAULT = DataFaultSettings()
MAINS_HUM = MainsHumSettings()
CUT_RECORD = CutRecordSettings()
RIGID_BODY = RigidBodySettings()
