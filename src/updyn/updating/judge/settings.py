"""Numbers that decide how a fit is tested, judged and explained."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SignificanceSettings:
    """Numbers shared by the modules of the assessment."""

    #: [std] Deviation above which a difference is not due to chance: of a value from the noise, of
    #: two solutions, of a fit from a bound, of an unknown from its start. Why: 0.3 % of normal
    #: errors are larger.
    stds: float = 3.0
    #: [1] Error of a computation, as a share of the misfit, below which it is neglected; of
    #: rounding and of reduced models. Why: it then changes the misfit by 10 % at most.
    negligible_error: float = 0.1


@dataclass(frozen=True)
class ResidualTestSettings:
    """Numbers of the tests of a residual against noise."""

    #: [1] Accepted share of false alarms among fits to pure noise; a larger value finds smaller
    #: model errors. Why: significance level, stricter than the usual 5 % (chosen).
    alarm_level: float = 0.02
    #: [1] Values of a channel and band below which serial correlation is not tested. Why: the
    #: statistic uses three lags, which need four values.
    least_values: int = 5
    #: [std] Magnitude to which values are clipped before correlations are computed; a smaller limit
    #: makes the test less sensitive to outliers. Why: 1 % of Gaussian values exceed it.
    clip_stds: float = 3.0
    #: [lines] Length of a band above which the eigenvalues of the statistic are those of the symbol
    #: of the Toeplitz matrix, and the number of points of the symbol. Effort: the approximation
    #: improves with the length (Gray, 2006).
    exact_eigenvalue_lines: int = 512
    #: [1] Misfit over the rms of the data below which a fit is exact and not tested. Why:
    #: resolution of files in single precision.
    exact_misfit: float = 1e-7
    #: [1] Reduced chi-square below which stated noise is reported as too large. Why: a factor of 2
    #: in the standard deviation; smaller errors are usual in stated noise (a rule of thumb).
    overstated_chi_square: float = 0.25
    #: [lines] Least length of a band. Why: fewer lines show serial correlation over three
    #: lags poorly (a rule of thumb).
    least_band_lines: int = 8
    #: [bands] Largest number of bands. Why: each further band makes the adjustment for multiple
    #: tests stricter (a rule of thumb).
    most_bands: int = 24
    #: [1] Share of the residual from which one quantity explains it. Why: two errors of equal size
    #: explain half each.
    explained_share: float = 0.5


@dataclass(frozen=True)
class SensorNoiseSettings:
    """Numbers that distinguish noise of single sensors and lines from model errors."""

    #: [1] Noise of a sensor over the median of the sensors from which it is noisy. Why: sensors of
    #: one type differ by less (a rule of thumb).
    noisy_ratio: float = 1.5
    #: [1] Misfit of a sensor over its response above which the residual is not called noise. Why:
    #: larger noise is unusual in a test, so that an error of the model is likelier (a rule of
    #: thumb).
    most_misfit: float = 0.3
    #: [1] p-value of serial correlation of a response above which its lines are too far apart to
    #: show a correlated residual. Why: a smooth response has a p-value far below (a rule of thumb).
    smooth_p_value: float = 1e-3
    #: [1] Squared misfit of an isolated line over those of its neighbours and of the median line.
    #: Why: three times the misfit; a mode that the model lacks also affects the neighbours.
    isolated_ratio: float = 9.0
    #: [1] Share of isolated lines above which none is reported. Why: many isolated lines are
    #: outliers of the noise, not disturbances of single lines (a rule of thumb).
    most_isolated_share: float = 0.05


@dataclass(frozen=True)
class ListLengthSettings:
    """Largest numbers of listed items."""

    #: [items] Largest number of groups, sensors, lines or unknowns that a sentence names. Why: a
    #: sentence with more names is hard to read.
    named_items: int = 3
    #: [combinations] Largest number of undetermined, and of determined combinations in the text of
    #: the identifiability. Drawing: width of a terminal.
    table_combinations: int = 6
    #: [misfits] Largest number of listed channels and bands with a significant misfit. Why: the
    #: list is sorted by size, and a page shows about as many.
    listed_misfits: int = 12


@dataclass(frozen=True)
class ErrorSearchSettings:
    """Numbers of the search for the model error that explains a residual."""

    #: [quantities] Largest number of tried quantities. Effort: a rule of thumb.
    most_quantities: int = 240
    #: [sensors] Number of calibration factors above which none is tried. Effort: a rule of thumb.
    most_sensors: int = 80
    #: [suspects] Largest number of quantities whose effect is confirmed by a short fit. Effort: the
    #: first-order score ranks them.
    most_suspects: int = 8
    #: [lines] Largest number of lines, those with the largest misfit, at which the energy of the
    #: error is computed. Effort: a rule of thumb.
    most_energy_lines: int = 60
    #: [lines] Number of lines for each one at which the energy is computed for expensive models.
    #: Effort: a rule of thumb.
    lines_per_energy_line: int = 4
    #: [1] Least share of the residual that a suspect explains. Why: a quantity that explains less
    #: helps nobody to find the error (a rule of thumb).
    least_share: float = 0.1
    #: [std^2] Least decrease of the sum of squares by a suspect. Why: exceeded by chance with a
    #: probability of 0.05 % by one quantity, so by 10 % if the best of 200 is taken (chi-square
    #: with one degree of freedom).
    least_gain: float = 12.0
    #: [1] Factor by which a quantity can be in error at most. Why: larger errors are found
    #: before an update, by the modes (a rule of thumb).
    most_factor: float = 30.0


@dataclass(frozen=True)
class ShortFitSettings:
    """Numbers of the short fits that confirm an error; plans are in order of decreasing effort."""

    #: [lines] Lines of each test, by plan. Effort: about halved from plan to plan.
    lines: tuple[int, ...] = (120, 60, 30, 30, 15, 15)
    #: [steps] Largest number of steps, by plan. Effort: about halved from plan to plan.
    steps: tuple[int, ...] = (20, 12, 12, 6, 6, 4)
    #: [evaluations] Approximate number of evaluations of a fit, by plan. Why: most fits end before
    #: the largest number of steps.
    evaluations: tuple[int, ...] = (12, 12, 12, 6, 6, 4)
    #: [quantities] Number of affordable short fits from which no shorter fits are planned. Why: the
    #: error is usually among the first three by score (a rule of thumb).
    enough_fits: int = 3
    #: [1] Least number of real values per unknown in a short fit. Why: fewer values let any
    #: quantity explain the residual (a rule of thumb).
    values_per_unknown: int = 4
    #: [std^2] Decrease of the cost by a step below which a short fit ends. Effort: a step of one
    #: standard deviation, far below the least gain.
    settled_gain: float = 0.5
    #: [1] Decrease by a step, as a share of the cost, below which a short fit ends. Effort: only
    #: the first two digits of the explained share are shown.
    settled_share: float = 1e-4
    #: [operations] Largest effort of all short fits. Why: about ten seconds.
    most_operations: float = 1e11
    #: [1] Effort of all short fits over that of one evaluation of all lines. Why: the search takes
    #: less time than a step of the fit.
    operations_share: float = 0.8
    #: [operations] Effort of short fits that is always allowed. Why: less than one second.
    free_operations: float = 5e9
    #: [1] Change of a quantity, as a logarithm, up to which the reduced model is enriched along it.
    #: Why: a larger first-order step is not trusted (a rule of thumb).
    most_enriched_step: float = 0.5


@dataclass(frozen=True)
class ExperimentAdviceSettings:
    """Numbers of the advice on further measurements."""

    #: [lines] Number of candidate lines, in geometric progression over the band. Effort: a rule of
    #: thumb.
    candidate_lines: int = 60
    #: [DOFs] Largest number of candidate sensors, evenly distributed over the model. Effort: a rule
    #: of thumb.
    candidate_sensors: int = 200
    #: [lines] Number of lines at which candidate sensors are compared. Effort: a rule of thumb.
    sensor_lines: int = 20
    #: [lines] Least number of these lines for large models. Effort: the number grows with that of
    #: the undetermined combinations.
    least_sensor_lines: int = 4
    #: [1] Relative change of a measurement, for a change by a factor e along an undetermined
    #: combination, from which it determines the combination. Why: well above rounding; averages can
    #: resolve it.
    visible_change: float = 1e-6
    #: [1] Noise above which the advice recommends less noise. Why: smaller noise is hard to reach
    #: (a rule of thumb).
    much_noise: float = 1e-3
    #: [1] Median relative difference of the FRFs of two solutions at a sensor from which the sensor
    #: distinguishes them. Why: about 1 dB, well above the usual error of a calibration.
    distinct_difference: float = 0.1


@dataclass(frozen=True)
class EffortSettings:
    """Sizes of models from which less is computed."""

    #: [DOFs] Size above which a model is assessed by a reduced model, and at fewer lines. Why:
    #: smaller models are solved in milliseconds.
    small_model_dofs: int = 400
    #: [DOFs] Size above which modes are not computed before a fit, and rounding is checked at one
    #: line. Why: the modes take seconds.
    most_dofs: int = 20_000
    #: [DOFs] Largest number of measured DOFs to which the mass is reduced. Effort: a rule of thumb.
    most_reduced_dofs: int = 300


@dataclass(frozen=True)
class NearbyModelSettings:
    """Numbers of reduced models about an estimate."""

    #: [1] Error at the estimate over the largest receptance of a line. Rounding: below the misfit
    #: of any test by two orders of magnitude.
    accuracy: float = 1e-4
    #: [lines] Number of lines whose fields compress the basis. Effort: a rule of thumb.
    basis_lines: int = 24
    #: [1] Square root of the share of the energy of the fields that a basis for several states may
    #: neglect. Rounding: small compared with the residual that is explained.
    dropped_energy_root: float = 1e-3


@dataclass(frozen=True)
class RoundingCheckSettings:
    """Numbers of the check of the rounding of responses."""

    #: [lines] Number of checked lines. Effort: rounding varies slowly with frequency.
    lines: int = 3
    #: [lines] Number of lines of the data for each checked line of a larger model. Effort: 10 % of
    #: an evaluation.
    lines_per_check: int = 20
    #: [1] Share of a response below which rounding is negligible whatever the misfit. Why: below
    #: the resolution of any measurement.
    negligible_share: float = 1e-6


@dataclass(frozen=True)
class CounterpartSettings:
    """Numbers of the search for counterparts of the measured modes before an update."""

    #: [1] Largest factor between the frequencies of a pair. Why: the frequencies of models before
    #: an update are in error by up to 30 %; 1.5 is a factor of 2.25 in stiffness.
    frequency_factor: float = 1.5
    #: [sensors] Least number of sensors at which shapes are compared. Why: at two sensors, half of
    #: all pairs of shapes have a MAC above one half.
    least_sensors: int = 3
    #: [lines] Least number of lines for which modes are identified. Why: fewer lines do not show a
    #: resonance; the same as in the search for data faults.
    least_lines: int = 8
    #: [1] Probability by chance below which the number of pairs shows a resemblance. Why: the usual
    #: significance level of 5 %.
    chance_level: float = 0.05
    #: [1] Least share of its modes that a test has in common with a model of the structure. Why: a
    #: measured beam has 7 of 12, as torsion and supports are not modelled.
    common_share: float = 0.6
    #: [1] Probability below which a number of pairs is too small for the common share. Why: none of
    #: four modes, one of seven and two of nine are too few.
    few_level: float = 0.03
    #: [sensors] Largest number of sensors that are left out as faulty. Why: with more, the best
    #: choice pairs by chance.
    most_faulty: int = 2
    #: [sensors] Least number of sensors that remain. Why: at three sensors, independent shapes pair
    #: too often by chance.
    least_remaining: int = 4
    #: [1] Least share of modes with a counterpart after a fault is removed. Why: for 240 models
    #: with errors of 30 % in stiffness and 15 % in mass, 98 % of all modes had one.
    explained_share: float = 0.75
    #: [sensors] Number of sensors up to which all pairs are left out; with more, only pairs with
    #: the best single one. Effort: a rule of thumb.
    all_pairs_sensors: int = 12
    #: [values] Largest number of values from which modes are identified; fewer channels are used of
    #: larger data. Effort: 40 us for each value.
    most_values: int = 60_000
    #: [values] Number of values of one reference above which modes are not identified. Why: it
    #: would take over 40 s.
    most_values_per_reference: int = 1_000_000
    #: [1] Largest power of the frequency factor that is tried as a common factor of frequencies.
    #: Why: reaches 1000, the factor of mm in place of m in units of N/m and kg.
    most_power: int = 17
    #: [1] Largest power that is accepted without significance. Why: stiffnesses within the usual
    #: bounds (a factor of 5) can explain it.
    near_power: int = 2


@dataclass(frozen=True)
class DiscrepancySettings:
    """Numbers of the estimate of the model error in standard deviations."""

    #: [DOFs] Largest number of DOFs with local changes. With more, equal changes at all neighbours
    #: cannot be distinguished from a change of the group: the standard deviation of the mass of a
    #: measured beam is 0.3 % with 16 and 34 % with 64. Why: 95 % intervals cover 95.0 % with 8,
    #: 96.7 % with 16 and 96.5 % with 64 (benchmarks/discrepancy.py errors).
    most_dofs: int = 16
    #: [1] Effect of a change over the largest one below which it is rounding. Rounding: above the
    #: rounding of double precision.
    negligible_effect: float = 1e-12
    #: [1] Least logarithm of the ratio of the variances of model error and noise. Rounding: the
    #: effect is then a hundredth of the noise.
    least_log_ratio: float = -9.0
    #: [1] Largest logarithm of this ratio. Rounding: the noise is then below 1e-6 of the effect.
    most_log_ratio: float = 30.0
    #: [1] Number of ratios in the grid in which the maximum of the likelihood is bracketed. Effort:
    #: a step of 0.5; the maximum is then refined between the neighbours.
    n_ratios: int = 79


@dataclass(frozen=True)
class NoiseRatioSettings:
    """Numbers of the covariance over the ratios of relative noise and noise floor."""

    #: [1] Number of ratios. Why: the covariance changes little between neighbours.
    n_ratios: int = 41
    #: [1] Factor of one part of the noise over the other at the ends of the range of ratios. Why: a
    #: part below a tenth adds less than 1 % to the variance.
    dominance: float = 10.0
    #: [1] Largest deficit of the log-likelihood of an admissible ratio. Why: 1.4 standard
    #: deviations on both sides for a normal likelihood; in linear models with 5 to 20 degrees of
    #: freedom, 95 % intervals then cover at least 92 % (benchmarks/discrepancy.py few).
    admissible_deficit: float = 1.0


@dataclass(frozen=True)
class FitEndSettings:
    """Numbers that distinguish a settled fit from one that still decreases."""

    #: [steps] Number of last steps whose decrease is compared with the remaining decrease. Why: one
    #: step may be unusually short (a rule of thumb).
    recent_steps: int = 10
    #: [1] Share of the misfit that a step would remove, above which a fit is not settled. Why: a
    #: smaller change hardly affects the tests of the residual (a rule of thumb).
    moving_share: float = 0.05
    #: [1] Decrease by the last steps over the remaining one, above which a fit is still decreasing.
    #: Why: if less, as many steps again gain next to nothing (a rule of thumb).
    recent_share: float = 0.1
    #: [std] Remaining decrease below which the values are those of a converged fit. Why: a tenth of
    #: a standard deviation is not significant.
    arrived_stds: float = 0.1


@dataclass(frozen=True)
class VerdictSettings:
    """Numbers that decide what the message of a result mentions."""

    #: [lines] Correlation length above which the residual is reported as model error. Why: a
    #: window correlates neighbouring lines of noise (a rule of thumb).
    most_correlation_lines: float = 3.0
    #: [1] Standard deviation, of the logarithm of a factor or of a loss factor, above which an
    #: unknown is reported as weakly determined. Why: a factor of 1.35 (a rule of thumb).
    weak_std: float = 0.3
    #: [1] Reduced chi-square above which noise does not explain the misfit. Why: 1.4 times the
    #: stated noise, whose size is usually known no better (a rule of thumb).
    most_chi_square: float = 2.0
    #: [1] Typical misfit above which the model does not explain data of unknown noise. Why: no
    #: usable test has as much noise (a rule of thumb).
    most_misfit: float = 0.3


@dataclass(frozen=True)
class PlausibilitySettings:
    """Numbers of the claim that a result is plausible."""

    #: [1] Typical misfit above which a result is implausible for any noise model. Why: half of the
    #: values are then in error by half of their level; such a test would not be accepted.
    gross_misfit: float = 0.5
    #: [1] Typical misfit above which a residual that is not noise makes plausibility unknown,
    #: unless held-out data are predicted. Why: the limit for noise in the search for causes.
    rough_misfit: float = 0.05
    #: [1] Typical misfit below which only rounding remains. Why: below the single precision of
    #: files.
    rounding_misfit: float = 1e-8
    #: [1] Usual factor by which stiffnesses and masses of models are in error, as one standard
    #: deviation. Why: as in the search for causes.
    usual_factor: float = 1.5
    #: [1] Share of the stiffnesses and masses at a bound above which the bounds determine the
    #: result. Why: the majority.
    most_at_bound_share: float = 0.5
    #: [unknowns] Least number of stiffnesses and masses at a bound for this. Why: one may be due to
    #: a poor bound.
    least_at_bound: int = 2
    #: [1] Residual, or rms frequency error, after over that before, above which an update did harm.
    #: Why: a rise by a tenth is more than rounding and other weights explain (a rule of thumb).
    harm_ratio: float = 1.1


@dataclass(frozen=True)
class BetweenTestsSettings:
    """Differences between the structures of several tests."""

    #: [1] Share of the misfit that separate estimates explain, above which structures differ. Why:
    #: the majority; an error that all tests share is explained by none.
    separable_share: float = 0.5
    #: [1] Longest step of a separate estimate, in logarithms of factors. Why: the linearisation
    #: holds for factors of about two.
    longest_step: float = 0.7


@dataclass(frozen=True)
class HeldOutSettings:
    """Numbers of the claim that held-out data are predicted."""

    #: [1] Largest relative residual of predicted held-out data. Why: about 2 dB.
    most_residual: float = 0.25
    #: [1] Relative residual of a good prediction and of a good fit, however small the noise. Why:
    #: about 1 dB.
    close_residual: float = 0.1
    #: [1] Residual, or frequency error, of held-out over that of fitted or predicted data, above
    #: which the prediction fails. Why: the noise of sensors of one type differs by less.
    most_ratio: float = 3.0
    #: [std] Rms residual in predicted standard deviations above which the prediction fails. Why: a
    #: sensor with twice the noise of the others passes.
    most_stds: float = 2.0
    #: [1] Predicted residual from which held-out data are inconclusive. Why: half of their level is
    #: then uncertain.
    unclear_residual: float = 0.5


@dataclass(frozen=True)
class ModalTrustSettings:
    """Numbers of the claims from modes."""

    #: [1] Least share of the measured modes with a counterpart in the model. Why: the majority.
    least_paired_share: float = 0.5
    #: [%] Rms frequency error above which no result is plausible. Why: neighbouring modes of
    #: structures are often this close.
    gross_error: float = 10.0
    #: [%] Frequency error up to which an update did no harm. Why: updated models usually have such
    #: errors (a rule of thumb).
    small_error: float = 1.0
    #: [%] Frequency error of held-out or of worsened modes up to which a result is accepted. Why:
    #: three times the small error (a rule of thumb).
    most_error: float = 3.0
    #: [1] Decrease of the MAC that is reported. Why: smaller changes are due to noise of the shapes
    #: (a rule of thumb).
    mac_loss: float = 0.05
    #: [1] MAC from which shapes agree, whatever their change. Why: commonly taken for the same mode
    #: (docs/modes.md).
    agreeing_mac: float = 0.9


@dataclass(frozen=True)
class SeparationSettings:
    """Numbers that decide which unknowns the data separate."""

    #: [1] Collinearity index above which unknowns are not separable. Why: 10 to 15 (Brun, Reichert
    #: & Kuensch, 2001).
    most_collinearity: float = 15.0
    #: [1] Least cosine of the effects of two collinear unknowns. Default: an angle of 8 degrees, at
    #: which a seventh of the effect of either is independent of the other.
    least_cosine: float = 0.99
    #: [1] Weight of an unknown over the largest one, from which it is named as an explanation of
    #: another. Why: smaller weights hardly contribute (a rule of thumb).
    least_explanation_share: float = 0.2


SIGNIFICANCE = SignificanceSettings()
RESIDUAL_TEST = ResidualTestSettings()
SENSOR_NOISE = SensorNoiseSettings()
LIST_LENGTHS = ListLengthSettings()
ERROR_SEARCH = ErrorSearchSettings()
SHORT_FITS = ShortFitSettings()
EXPERIMENT_ADVICE = ExperimentAdviceSettings()
EFFORT = EffortSettings()
NEARBY_MODEL = NearbyModelSettings()
ROUNDING_CHECK = RoundingCheckSettings()
COUNTERPARTS = CounterpartSettings()
DISCREPANCY = DiscrepancySettings()
NOISE_RATIOS = NoiseRatioSettings()
FIT_END = FitEndSettings()
VERDICT = VerdictSettings()
PLAUSIBILITY = PlausibilitySettings()
BETWEEN_TESTS = BetweenTestsSettings()
HELD_OUT = HeldOutSettings()
MODAL_TRUST = ModalTrustSettings()
SEPARATION = SeparationSettings()
