"""Numbers that decide which modes are found in measured FRFs, and how accurately."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ChannelFitSettings:
    """Numbers of the linear least squares of all channels."""

    #: [1] Number that replaces a zero divisor, or is added to it. Rounding: negligible compared
    #: with any measured value, and its inverse does not overflow (the largest float is 2e308).
    smallest_divisor: float = 1e-300
    #: [1] Share of a column that must be linearly independent of the previous columns; the
    #: coefficient of a column below it is 0. Rounding: 50 times the rounding of the decomposition.
    independent_share: float = 1e-14
    #: [elements] Largest number of elements of column products in memory at once; affects only
    #: memory and time. Effort: 32 MB of complex numbers, chosen.
    block_elements: int = 2_000_000


@dataclass(frozen=True)
class NoiseEnvelopeSettings:
    """Numbers of the estimate of the correlation of noise over lines."""

    #: [lines] Lines of a part of the band for one estimate, which has as many values over time.
    #: Fewer resolve the power over time less finely. Why: enough to resolve an exponential window
    #: that ends at 1 %.
    part_lines: int = 64
    #: [parts] Least number of parts of residual functions, and of half parts of measured functions;
    #: with fewer, noise is treated as white. Why: each part may contain modes, and the median of
    #: residuals needs several values; a rule of thumb.
    least_parts: int = 8
    #: [1] Degree of the polynomial removed from a part for the modes outside it. Why: the degree of
    #: the polynomial in the fits of windows.
    polynomial_degree: int = 3
    #: [1] Share of the parts that is used, those with the flattest power. A larger share includes
    #: more parts with modes. Why: modes concentrate power at short times; a rule of thumb.
    flattest_share: float = 0.25
    #: [1] Times are estimated if more than this share of the largest power of white noise remains
    #: after removal of the polynomial. Why: below, the estimate is the ratio of two small numbers.
    least_remaining_share: float = 0.5
    #: [times] Times after those without estimate from which the power is extrapolated. Why: with
    #: this many, white noise is raised by less than 5 % at time 0 on average.
    extrapolation_times: int = 12
    #: [1] Largest variation of the line spacing, relative to its mean; with more, noise is treated
    #: as white. Why: rounding of frequencies in files.
    spacing_tolerance: float = 1e-3
    #: [rounds] Rounds of the fixed-point iteration. Why: after the first, the power at the end of
    #: an exponential window is too large, since the taper mixes neighbouring times; more rounds
    #: amplify random errors.
    iterations: int = 2


@dataclass(frozen=True)
class PoleRefinementSettings:
    """Numbers of the maximum-likelihood fit of poles in a window."""

    #: [steps] Largest number of Gauss-Newton steps. Effort: most fits end earlier by
    #: `settled_decrease`.
    most_steps: int = 30
    #: [1] Step, as a share of the width of the pole, at which the iteration ends. Why: rounding,
    #: for data without noise, in which the cost is close to 0.
    settled_step: float = 1e-10
    #: [1] Expected decrease of the cost at which the iteration ends. Why: half of the decrease is
    #: the square of the remaining change in standard deviations, here 0.02 of one.
    settled_decrease: float = 1e-3
    #: [1] As `settled_decrease`, for fits that decide whether a pole is a mode. Effort: 0.4
    #: standard deviations of one pole change the deviance by far less than a mode does.
    rough_decrease: float = 0.3
    #: [rounds] Rounds that alternate between weights from residuals and poles from weights. Why:
    #: chosen; further rounds change estimates less than the noise.
    reweightings: int = 2
    #: [1] Least assumed share of the noise of a value in its residual. Smaller values raise the
    #: noise of lines that the fit follows. Why: avoids division by the small remaining share; a
    #: rule of thumb.
    least_noise_share: float = 0.05
    #: [1] Iterations of the estimate of proportional noise and floor. Effort: chosen; the
    #: multiplicative updates converge slowly, but the weights need no more accuracy.
    noise_iterations: int = 20
    #: [values] Values of channels estimated together; affects only the time. Effort: with their
    #: temporaries they fit into the second-level cache of a processor.
    cached_values: int = 1 << 15
    #: [1] Noise below this share of the largest value of a channel is rounding error. Why: rounding
    #: of sums and solutions in double precision, with a margin.
    noise_rounding: float = 1e-12
    #: [1] Least width of a pole as a share of its size. Why: the width of an undamped pole is 0,
    #: and steps and distances are relative to it.
    least_width_share: float = 1e-6


@dataclass(frozen=True)
class VectorFittingSettings:
    """Numbers of rational fits by vector fitting."""

    #: [poles] Number of initial poles, evenly distributed over the band. Effort: chosen; poles are
    #: added as needed.
    first_poles: int = 4
    #: [1] Loss factor of initial and of added poles. Why: a rule of thumb; the fit relocates the
    #: poles.
    new_loss_factor: float = 0.01
    #: [sweeps] Largest number of relocations of all poles. Effort: vector fitting converges within
    #: a few.
    sweeps: int = 6
    #: [1] Relative change of all poles at which the relocation ends. Effort: rounding of
    #: eigenvalues.
    settled_change: float = 1e-11
    #: [1] Residual, relative to the data, at which no more poles are added. Rounding: rounding of
    #: the data.
    residual_rounding: float = 1e-12
    #: [poles] Poles are added until this number of them does not improve the prediction. Why: a
    #: mode may need more than one additional pole; a rule of thumb.
    patience: int = 4
    #: [1] Relative improvement of the prediction by `patience` poles that justifies more. Why: a
    #: rule of thumb.
    least_improvement: float = 0.02
    #: [1] The fit of the fewest poles is selected whose prediction error is at most this factor
    #: above the least. Why: random differences of prediction errors; a rule of thumb.
    prediction_margin: float = 1.05
    #: [1] Relative error of the prediction that is rounding error. Why: rounding of data and of the
    #: solution.
    exact_prediction: float = 1e-10
    #: [1] Relative rounding of solutions, of infinite eigenvalues, and least damping of a pole.
    #: Why: 50 times the rounding of double precision.
    rounding: float = 1e-14
    #: [1] Imaginary part, as a share of the pole, below which a mirrored pole is real. Why:
    #: rounding of eigenvalues.
    real_pole_share: float = 1e-9


@dataclass(frozen=True)
class DecayRemovalSettings:
    """Numbers of the removal of the damping of an exponential window."""

    #: [poles] Largest number of poles. Effort: a rule of thumb.
    most_poles: int = 40
    #: [lines] Lines for each pole. Why: a pole with a complex residue has four real values, and
    #: each fit uses half of the lines.
    lines_per_pole: int = 4
    #: [1] Channels below this share of the largest are weighted as if they had this level. Why:
    #: they may contain only noise; a rule of thumb.
    least_level: float = 0.1


@dataclass(frozen=True)
class NoiseFreeDataSettings:
    """Numbers of the identification of data without noise."""

    #: [lines] Up to this number of lines, data are first treated as free of noise. Effort: more
    #: lines are dense enough for a search part by part.
    most_lines: int = 160
    #: [1] Largest unexplained share of all modes for which data count as free of noise. Why: the
    #: polynomial of a window leaves errors of this order in data without noise.
    unexplained_share: float = 1e-4
    #: [1] Residual squares, relative to the squared data, of an exact fit. Why: rounding, 1e-9 of
    #: the amplitude.
    exact_squares: float = 1e-18
    #: [1] The exact fit of the fewest poles is selected whose cost is at most this factor above the
    #: least. Why: costs of exact fits are rounding errors, which vary by such factors.
    cost_margin: float = 1e3
    #: [poles] Largest number of additional poles outside the band. Effort: a rule of thumb.
    outside_poles: int = 16
    #: [functions] Number of combinations of the functions from which poles are found. Effort: the
    #: strongest combinations contain all modes of the band.
    strongest_functions: int = 12
    #: [lines] Lines for each pole in the first test, on some of the lines. Effort: more lines than
    #: unknowns, so that noise is noticed; affects only the time.
    test_lines_per_pole: int = 8


@dataclass(frozen=True)
class ModeWindowSettings:
    """Numbers of the windows of lines in which modes are fitted together."""

    #: [lines] Least number of lines of a measurement. Why: one mode has four real values.
    least_lines: int = 4
    #: [lines] Least number of lines for each mode. Why: as `least_lines`.
    lines_per_mode: int = 4
    #: [lines] Least number of lines for each fixed pole of a window. Why: one more than for a mode;
    #: a rule of thumb.
    lines_per_fixed_pole: int = 5
    #: [modes] Largest number of modes in a window. Effort: the cost of a fit rises with its cube.
    most_modes: int = 6
    #: [bandwidths] Extent of a window beyond its modes in half-power bandwidths. Why: there an FRF
    #: has fallen to an eighth of its peak; a rule of thumb.
    bandwidths_beyond: float = 4.0
    #: [lines] Least number of lines of a window, plus `lines_per_mode` for each mode. Why: enough
    #: for the polynomial and an estimate of the noise.
    fewest_window_lines: int = 20
    #: [1] Largest loss factor of a mode. Why: a mode of larger damping has no visible peak.
    largest_loss_factor: float = 0.5
    #: [1] Negative loss factor up to which a pole counts as undamped. Why: rounding of the fit.
    damping_rounding: float = 1e-9


@dataclass(frozen=True)
class StabilisationSettings:
    """Numbers of the stabilisation diagram."""

    #: [lines] Lines of a part of the band, without its overlaps of half a part on either side. Why:
    #: the necessary order increases with the number of modes; a rule of thumb.
    part_lines: int = 200
    #: [1] Largest order. Effort: for parts with up to about ten modes.
    largest_order: int = 32
    #: [1] Step of the orders. Why: one more mode has a pair of poles.
    order_step: int = 2
    #: [lines] Least number of lines for each order. Why: more values than coefficients.
    lines_per_order: int = 5
    #: [1] A pole is stable if the next order has one within this share of its damping. Why: a rule
    #: of thumb.
    damping_distance: float = 0.3
    #: [1] A pole is stable if the next order has one within this share of the line spacing. Why: a
    #: rule of thumb.
    line_distance: float = 0.2
    #: [orders] Number of consecutive orders with the pole of a candidate. Why: a rule of thumb.
    stable_orders: int = 3
    #: [columns] Largest number of columns in a fit; if there are more, their strongest combinations
    #: are fitted. Effort: a rule of thumb.
    most_columns: int = 4
    #: [1] Largest damping ratio of a pole in the diagram. Why: a mode of larger damping has no
    #: visible peak.
    largest_damping_ratio: float = 0.3
    #: [1] Positive real part, as a share of the pole, up to which a pole counts as undamped, not as
    #: unstable. Why: errors of the damping of lightly damped modes.
    unstable_share: float = 1e-4


@dataclass(frozen=True)
class ModeSearchSettings:
    """Numbers of the search for modes, tile by tile."""

    #: [lines] Lines of a tile without candidates. Why: enough for an estimate of the noise; a rule
    #: of thumb.
    tile_lines: int = 60
    #: [lines] Additional lines on either side of such a tile. Why: enough for a polynomial of
    #: degree 3 to follow the modes outside.
    margin_lines: int = 15
    #: [bandwidths] Step of the even grid of trial poles. A pole of half width a explains 4 a b /
    #: ((a + b)^2 + d^2) of one of half width b at a distance d. Why: with d up to a / 2 and b from
    #: a / 2 to 2 a, that is at least 0.8.
    grid_step: float = 0.5
    #: [trials] Largest number of trial poles of one width. Effort: a rule of thumb.
    most_trials: int = 200
    #: [lines] Half-power bandwidths of trial poles if no candidate indicates the width of modes.
    #: Why: from the narrowest visible peak to a clearly resolved one, a factor that the grid
    #: covers.
    trial_widths: tuple[float, ...] = (1.0, 4.0)
    #: [1] Largest loss factor of a trial pole. Why: poles with a loss factor of 2 do not oscillate;
    #: chosen well below.
    largest_trial_loss: float = 0.3
    #: [1] Distance of trial poles from each pole found, as a share of its width. Effort: two close
    #: modes fitted by one pole are to either side of it; trial poles are refined.
    side_distance: float = 0.7
    #: [1] A trial pole is refined if its expected gain is at least this share of the smallest gain
    #: of a mode. Effort: a trial on the grid explains at least 0.8 of a mode (`grid_step`).
    promising_share: float = 0.5
    #: [poles] Number of rejected poles after which the search ends. Effort: a rule of thumb.
    most_rejected: int = 3
    #: [1] Residual squares, relative to the squared data, below which a fit is exact. Rounding:
    #: rounding of the fit, with a margin.
    exact_squares: float = 1e-11
    #: [channels] Channels of the largest response to a pole that are tested before all are. Effort:
    #: affects only the time; a clear mode shows in these.
    strong_channels: int = 64


@dataclass(frozen=True)
class WindowSweepSettings:
    """Numbers of the refinement of the poles of all windows."""

    #: [sweeps] Fits with the noise of the windows, each from the poles of the previous one. Effort:
    #: chosen; further sweeps change the poles less than the noise.
    sweeps: int = 2
    #: [channels] Up to this number of channels, each has its own weights on each line. Effort:
    #: limits memory and time.
    most_weighted_channels: int = 4096
    #: [lines] Lines, including those of neighbouring windows, for the noise of each channel in a
    #: window. Why: more would mix noise levels, which may differ by 60 dB over a band of
    #: accelerances.
    noise_lines: int = 60
    #: [1] A pole with an excess gain of this multiple of the smallest gain is a mode for any noise,
    #: without a fit that omits it. Effort: affects only the time.
    clear_excess: float = 20.0


@dataclass(frozen=True)
class PhysicalModeSettings:
    """Numbers that distinguish modes from artefacts."""

    #: [1] Least share of the residual in its half-power band that a mode explains. Why: the test
    #: against chance decides. A share of 0.5 loses true modes of dense bands, most of which the
    #: neighbours explain (of 40 modes with 5 % noise 96.0 % are found instead of 98.2 %, of 60
    #: modes 88.5 % instead of 91.5 %; of spurious ones there are 15 instead of 16).
    least_explained_share: float = 0.1
    #: [1] Least share of a mode in the amplitude of all channels at its own frequency; its inverse
    #: is the largest amplitude that other modes may cancel. Why: a rule of thumb.
    visible_share: float = 0.1
    #: [1] Least share of a mode of a light part in the amplitude of one channel, for a visible
    #: peak. Why: half of the amplitude is a rise by 6 dB.
    local_peak_share: float = 0.5
    #: [1] A singular value of a residue above this share of the first is another mode at the same
    #: frequency; a residue with more than two is not a mode. Why: errors of shapes are usually 10
    #: %.
    further_shape_share: float = 0.3
    #: [1] Largest second singular value, as a share of the first, of a mode that is visible in
    #: single channels only. Why: such a mode has one shape; errors of shapes are usually 10 %.
    local_shape_share: float = 0.1
    #: [1] MAC from which two shapes are equal. Why: a common limit (R. J. Allemang, Sound and
    #: Vibration 37 (8) (2003) 14-21).
    alike_mac: float = 0.9


@dataclass(frozen=True)
class PoleBundleSettings:
    """Numbers of the test whether close poles are one mode that varies between runs."""

    #: [widths] Poles within this multiple of the sum of their widths may be one mode. Why: the
    #: half-power bands of the poles of one mode overlap, or nearly do; a rule of thumb.
    largest_distance: float = 1.5
    #: [1] Largest ratio of the widths of poles that may be one mode. Why: poles of one mode have
    #: similar damping, a wide pole is background; a rule of thumb.
    largest_width_ratio: float = 4.0
    #: [modes] Largest number of modes with poles for each run that replace a bundle. Effort: a rule
    #: of thumb.
    most_modes: int = 3
    #: [widths] A run does not contain a mode if its pole is further away from the common poles.
    #: Why: beyond, the half-power bands do not overlap; a rule of thumb.
    run_reach: float = 3.0
    #: [1] MAC of equal shapes. Why: poles of one mode have equal shapes apart from noise; more than
    #: the usual 0.9, since the shapes of close modes may be similar.
    same_shape_mac: float = 0.97
    #: [channels] Least number of channels for the comparison of shapes. Why: shapes of few channels
    #: are similar by chance.
    least_channels: int = 4
    #: [1] A mode that explains this share of the residual of all other modes is not part of another
    #: mode. Why: a rule of thumb.
    own_share: float = 0.5
    #: [1] A run contains a pole if the cost increase without it is more than this share of that of
    #: the strongest pole in the run. Why: a tenth of the amplitude; a rule of thumb.
    known_share: float = 0.01
    #: [1] Poles for each run are tried if the expected decrease of a first step is this share of
    #: the required gain. Effort: affects only the time unless a first step predicts less than a
    #: quarter of the gain.
    promised_share: float = 0.25
    #: [runs] Least effective number of runs that contain a mode, from the distribution of its
    #: squares over the runs. Why: a mode in one run only is an artefact; a rule of thumb.
    least_effective_runs: float = 1.2


@dataclass(frozen=True)
class LeaningPeakSettings:
    """Numbers of the test for peaks that lean because the stiffness depends on the level."""

    #: [rounds] Rounds, each with the leaning peaks and the noise of the previous one. Why: the
    #: linear fit of a leaning peak disturbs its neighbours in the first round.
    iterations: int = 2
    #: [poles] Largest number of poles into which a linear fit splits one leaning peak. Effort: a
    #: rule of thumb.
    most_poles: int = 3


@dataclass(frozen=True)
class UnexplainedPeakSettings:
    """Numbers of the search for significant peaks without a mode."""

    #: [dB] Least height of a peak over its surroundings. Why: a peak that a test engineer would
    #: see.
    least_height: float = 10.0
    #: [1] Probability that noise alone has a peak, or makes a peak lean, anywhere in the band. Why:
    #: level 1 % of a statistical test.
    false_alarm: float = 0.01
    #: [lines] Lines on either side for the median level around a narrow peak, and for the weight of
    #: a line in a synthesis. Why: several times the width of a narrow peak.
    narrow_surroundings: int = 15
    #: [lines] Lines on either side for the median level around a wide peak. Why: several times the
    #: width of a wide peak.
    wide_surroundings: int = 60
    #: [lines] Lines on either side that are not higher than a peak. Why: excludes neighbouring
    #: lines of one peak with noise.
    dominated_lines: int = 2
    #: [bandwidths] A peak belongs to a mode within this number of its half-power bandwidths plus
    #: `mode_lines`. Why: the width of a mode.
    mode_bandwidths: float = 1.0
    #: [lines] Lines added to `mode_bandwidths`. Why: a peak of noise moves by a line or two.
    mode_lines: float = 2.0
    #: [peaks] Largest number of peaks in a message. Drawing: chosen for one line of text.
    listed_peaks: int = 8


@dataclass(frozen=True)
class ResonancePeakSettings:
    """Numbers of the search for peaks of the mode indicator as approximate modes."""

    #: [dB] Least height of a peak over the higher of the two adjacent valleys. Why: a factor of 2;
    #: a resonance without overlap by others within 1.7 of its half-power bandwidths is higher.
    least_height: float = 6.0
    #: [1] Least MAC of the FRF matrix at a peak with that of an adjacent line. Why: for noise that
    #: is independent from line to line it is 1 / (number of channels) on average.
    lasting_mac: float = 0.7
    #: [peaks] Largest number of peaks, the highest over their valleys. Why: as many as the modes of
    #: a typical test.
    most_peaks: int = 30
    #: [lines] Least number of lines. Why: with fewer, a valley is not resolved; a rule of thumb.
    least_lines: int = 8
    #: [channels] Least number of channels. Why: with three channels, one in 100 lines of noise is a
    #: peak similar to its neighbour.
    least_channels: int = 4


@dataclass(frozen=True)
class PolePickSettings:
    """Numbers of the poles that a user picks in the diagram."""

    #: [1] Largest relative distance of a pick from a frequency of the diagram. Why: frequencies are
    #: written with six digits.
    diagram_distance: float = 1e-5
    #: [bandwidths] Poles closer than this share of a half-power bandwidth are one. Why: the fit
    #: cannot distinguish them; a rule of thumb.
    merged_distance: float = 0.1
    #: [widths] A pole of the diagram is a pole of the fits up to this share of its width. Why: half
    #: of the half-power band; a rule of thumb.
    same_distance: float = 0.5


@dataclass(frozen=True)
class SynthesisSettings:
    """Numbers of the synthesis of FRFs from modes."""

    #: [bandwidths] Half-power bandwidths from the outer modes up to which lines are explained. Why:
    #: there an FRF has fallen to a tenth of its peak, 1 / sqrt(1 + (2 * 5)^2).
    band_bandwidths: float = 5.0


@dataclass(frozen=True)
class ModeDerivativeSettings:
    """Numbers of modes of a model and their derivatives."""

    #: [DOFs] Models of at most this size are decomposed completely; affects only the time. Effort:
    #: with 14 unknowns and 6 modes, that takes a third of the time of one factorisation per mode at
    #: 16 DOFs and the same time at 180; with 20 modes half at 300.
    most_decomposed_dofs: int = 160
    #: [1] Relative distance below which eigenvalues are equal. Why: errors of the eigenvalue
    #: solver.
    equal_eigenvalues: float = 1e-7
    #: [1] Relative change of an eigenvalue below which a coupling is zero. Why: errors of the
    #: eigenvectors, of about the root of those of the eigenvalues.
    uncoupled_change: float = 1e-6
    #: [eps] Strain energy, in roundings of the sum of its absolute terms, below which it is zero
    #: and the mode is a rigid-body mode. Rounding: rounding of sums over many DOFs.
    zero_energy_roundings: float = 1e3
    #: [1] A measured shape with less than this share of its square in a subspace does not determine
    #: its basis. Why: by Bessel's inequality, a shape is mostly in one of two orthogonal subspaces.
    least_share_within: float = 0.5
    #: [1] Largest relative residual of the equations of a derivative. Rounding: a singular matrix
    #: gives residuals of order 1, a regular one 1e-12.
    largest_residual: float = 1e-6


@dataclass(frozen=True)
class ModeReductionSettings:
    """Numbers of a reduced model for modes and of its error."""

    #: [1] Permitted error of a shape, relative to its size, if only frequencies are measured. Why:
    #: the errors of frequencies are of the order of its square, those of their derivatives of the
    #: order of 0.1 %.
    accuracy: float = 1e-3
    #: [1] The same if shapes are measured. Why: a rule of thumb, far below the errors of measured
    #: shapes.
    accuracy_of_shapes: float = 1e-5
    #: [1] Smallest ratio of the factors of two states up to which the factorised P of one bounds
    #: the errors at the other. Why: a bound is exceeded by at most three; a rule of thumb.
    least_ratio: float = 0.1
    #: [1] Relative distance of eigenvalues above which clusters of close modes end. Why: a rule of
    #: thumb; the error of close modes is bounded for all of them together.
    cluster_gap: float = 0.02
    #: [tries] Largest number of enrichments at a state, before modes of the full model are added.
    #: Effort: a rule of thumb.
    most_tries: int = 8
    #: [vectors] Size above which a basis is begun anew. Effort: a rule of thumb; a dense
    #: eigenproblem of this size takes about as long as that of a sparse model.
    most_vectors: int = 600
    #: [1] Share of the size of a shape above which a derivative by the logarithm of an unknown is
    #: represented. Why: a rule of thumb; derivatives decide the direction of a step, which
    #: tolerates larger errors.
    derivative_error: float = 1e-3
    #: [moments] Number of static solutions for a derivative. Why: the second one corrects for the
    #: inertia of the modes above the basis.
    derivative_moments: int = 2
    #: [1] Permitted error of solutions in single precision. Why: they measure and correct errors,
    #: for which few digits suffice.
    solution_error: float = 1e-5
    #: [1] Largest difference of a frequency at the end of a fit from that of the full model. Why:
    #: far below the errors of measured frequencies.
    frequency_error: float = 1e-6


@dataclass(frozen=True)
class RepeatedTestSettings:
    """Numbers of the correlation between natural frequencies of repeated tests."""

    #: [tests] Least number of tests that found both modes for a correlation; with fewer, the modes
    #: count as uncorrelated. Why: the correlation of two tests is always 1 or -1, and the estimated
    #: error of three is too inexact; a rule of thumb.
    least_common: int = 4
    #: [1] Smallest shrinkage of the correlations. Why: it keeps the matrix positive definite where
    #: a coarse frequency resolution makes frequencies exactly proportional.
    least_shrinkage: float = 1e-3


@dataclass(frozen=True)
class FrequencyCovarianceSettings:
    """Tolerances of a given covariance of frequencies."""

    #: [1] Largest difference of two correlations that a symmetric matrix has twice. Why: rounding
    #: of computed covariances is far smaller.
    asymmetry: float = 1e-9
    #: [1] Largest relative difference of a given standard deviation from the root of its variance.
    #: Why: either may be rounded to seven digits.
    std_difference: float = 1e-6


CHANNEL_FIT = ChannelFitSettings()
NOISE_ENVELOPE = NoiseEnvelopeSettings()
POLE_REFINEMENT = PoleRefinementSettings()
VECTOR_FITTING = VectorFittingSettings()
DECAY_REMOVAL = DecayRemovalSettings()
NOISE_FREE_DATA = NoiseFreeDataSettings()
MODE_WINDOW = ModeWindowSettings()
STABILISATION = StabilisationSettings()
MODE_SEARCH = ModeSearchSettings()
WINDOW_SWEEP = WindowSweepSettings()
PHYSICAL_MODE = PhysicalModeSettings()
POLE_BUNDLE = PoleBundleSettings()
LEANING_PEAK = LeaningPeakSettings()
UNEXPLAINED_PEAK = UnexplainedPeakSettings()
RESONANCE_PEAK = ResonancePeakSettings()
POLE_PICK = PolePickSettings()
SYNTHESIS = SynthesisSettings()
MODE_DERIVATIVE = ModeDerivativeSettings()
MODE_REDUCTION = ModeReductionSettings()
REPEATED_TESTS = RepeatedTestSettings()
FREQUENCY_COVARIANCE = FrequencyCovarianceSettings()
