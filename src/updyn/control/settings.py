"""Numbers that decide how a plant is made, measured, sampled and bounded."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AntiresonanceSettings:
    """Numbers of the search for antiresonances of a channel."""

    #: [1] Largest relative width of an antiresonance. Why: wider minima lie between resonances
    #: without a zero near the axis.
    largest_width: float = 0.3
    #: [1] Smallest relative width of an antiresonance; narrower ones count as so wide. Why: a rule
    #: of thumb.
    least_width: float = 1e-2
    #: [1] Relative distance within which lines are neighbours. Why: a fortieth of the smallest
    #: width.
    neighbour_distance: float = 2.5e-4
    #: [rad] Least change of phase between one width below and one above. Why: about half of the 2.2
    #: of a single zero.
    least_turn: float = 1.2
    #: [rounds] Rounds in which antiresonances are located. Effort: each one fits a zero to closer
    #: lines, so the error decreases quadratically.
    rounds: int = 4
    #: [widths] Distances of lines from each antiresonance, on both sides, in units of its width.
    #: Effort: a rule of thumb.
    line_offsets: tuple[float, ...] = (0.1, 0.3, 0.6, 1.0, 2.0)
    #: [1] Distance of lines, as a share of the highest line, below which they are merged. Rounding:
    #: rounding of frequencies.
    merge_distance: float = 1e-12
    #: [1] Largest relative distance between the zeros of structure and plant that match. Why: a
    #: rule of thumb; a larger shift is stated as a missing zero.
    match_distance: float = 0.1


@dataclass(frozen=True)
class PlantTargetSettings:
    """Numbers of the response that a plant approximates, and of its lines."""

    #: [lines] Lines over the band, with even spacing and with even ratios, in addition to those
    #: around poles. Why: a rule of thumb.
    spread_lines: int = 200
    #: [half widths] Distances of lines from each pole, on both sides, in units of half its
    #: half-power width. Why: a rule of thumb.
    line_offsets: tuple[float, ...] = (0.1, 0.3, 0.6, 1.0, 2.0, 4.0)
    #: [1] Height of the smallest resonance that is evaluated, as a share of the highest one of its
    #: channel. Why: a rule of thumb; the error of the channel also limits that of smaller ones.
    counted_height: float = 0.1
    #: [1] Share of the geometric mean of its ports below which a channel is uncoupled. Rounding:
    #: rounding of a response.
    uncoupled_share: float = 1e-7
    #: [1] Error of a reduced model, as a share of the largest receptance of a line, above its
    #: resolution. Rounding: a hundred times the accuracy of its basis.
    reduced_error: float = 1e-6
    #: [1] Largest ratio of the error of a selection to that of all modes of its route, if the route
    #: cannot hold the tolerance next to a sharp peak. Why: a rule of thumb.
    lenient_factor: float = 1.2


@dataclass(frozen=True)
class PoleSettings:
    """Numbers that classify poles and zeros in s."""

    #: [1] Ratio of real part to modulus below which a pole or zero is undamped. Why: rounding of
    #: eigenvalues.
    undamped_ratio: float = 1e-9
    #: [1] Modulus, as a share of that of the fastest pole, below which a pole is at 0. Why:
    #: rounding splits a double pole at 0 by its square root.
    zero_share: float = 1e-6


@dataclass(frozen=True)
class CausalBoundSettings:
    """Numbers of the lower bound on the error of any stable plant."""

    #: [1] Gain permitted outside the band, as a multiple of the largest of the structure there; a
    #: larger one lowers the bound. Why: a rule of thumb; the bound is stated with it.
    outside_gain: float = 10.0
    #: [1] Error below which a bound is not computed. Rounding: rounding of the response.
    error_rounding: float = 1e-6
    #: [log Hz] Width of the margin within the band in which the allowance grows to that outside.
    #: Why: a rule of thumb; within the band, so the bound remains a lower bound.
    margin_width: float = 0.03
    #: [points] Points of the circle in that margin. Why: a rule of thumb.
    margin_points: int = 24
    #: [log2] Exponent of the least number of points of the circle. Effort: a rule of thumb.
    least_exponent: int = 13
    #: [log2] Exponent of the largest number of points of the circle. Effort: the margin is wider
    #: instead.
    most_exponent: int = 16
    #: [1] Ratio of the points of the circle to the size of the section of the Hankel matrix; a
    #: larger one lowers the bound. Effort: a rule of thumb.
    points_per_row: int = 32
    #: [1] Smallest lower end of a band, as a share of its upper end, for the scale of the circle.
    #: Why: a rule of thumb; a band may start at 0.
    least_low_share: float = 1e-3
    #: [1] Relative accuracy of the bound. Effort: it is stated with three digits.
    accuracy: float = 1e-3
    #: [lines] Lines on each side of the band for the gain outside. Effort: a rule of thumb; natural
    #: frequencies are added.
    outside_lines: int = 400
    #: [1] Factor by which these lines extend beyond the band. Effort: a rule of thumb.
    outside_factor: float = 1e3
    #: [lines] Lines whose responses are computed at once. Effort: memory.
    block_lines: int = 4096
    #: [1] Largest limit of a gain. Rounding: that of an undamped resonance outside the band is
    #: infinite.
    gain_limit: float = 1e30


@dataclass(frozen=True)
class ModalSpaceSettings:
    """Numbers of the modes of a model, and of the reduction of a large one."""

    #: [DOFs] Number of DOFs up to which a model is used without reduction. Effort: a rule of thumb.
    whole_dofs: int = 300
    #: [1] Accuracy of a reduced model. Rounding: smaller than for an update, since behind a gear
    #: train the motion of the load is small relative to that of the motor, which normalises the
    #: error.
    basis_accuracy: float = 1e-8
    #: [1] Lines of the check of a basis for several states, as shares of the end of the band.
    #: Effort: a rule of thumb.
    checked_shares: tuple[float, ...] = (1.0, 0.7, 0.35)
    #: [states] Number of states that always enrich such a basis; others do if it lacks them.
    #: Effort: a rule of thumb.
    enriching_states: int = 6
    #: [1] Natural frequency of a motion without mass, as a multiple of the band's upper end. Why:
    #: its dynamic amplification in the band is then below 0.12 %.
    massless_factor: float = 30.0
    #: [1] Share of the band's upper end below which a mode can be a rigid-body motion; its square
    #: is the largest part of a rigid-body motion outside a basis. Why: a rule of thumb.
    slow_share: float = 1e-3
    #: [1] Negative omega^2, as a share of that of the band's upper end, above which a structure is
    #: unstable. Why: rounding of stiffness matrices of rigid bodies.
    unstable_share: float = 1e-6


@dataclass(frozen=True)
class SpectralSettings:
    """Numbers of the spectral decomposition of a damped structure."""

    #: [1] Share of the largest damper below which a damper is 0. Rounding: rounding of eigenvalues.
    damper_share: float = 1e-13
    #: [1] Number of dampers, as a share of the basis vectors, above which lines are solved one by
    #: one. Effort: a rule of thumb.
    most_dampers_share: float = 0.25
    #: [lines] Lines of the band at which the decomposition is compared with a solution. Effort: a
    #: rule of thumb.
    checked_lines: int = 5
    #: [1] Largest difference at these lines, as a share of a channel; else lines are solved one by
    #: one. Rounding: small relative to the error of a plant.
    agreement: float = 1e-7
    #: [lines] Lines that are solved at once. Effort: memory.
    block_lines: int = 32


@dataclass(frozen=True)
class RealModesSettings:
    """Numbers of real modes with relaxation terms (Biot)."""

    #: [terms] Numbers of relaxation terms that are tried in turn. Effort: each term adds states; a
    #: rule of thumb.
    relaxation_terms: tuple[int, ...] = (2, 3, 4, 6, 8)
    #: [lines] Lines at which they are fitted to a loss factor. Effort: a rule of thumb.
    fitted_lines: int = 200
    #: [1] Eigenvalue of a relaxing stiffness, as a share of the largest, below which it is 0.
    #: Rounding: rounding of eigenvalues.
    stiffness_share: float = 1e-12


@dataclass(frozen=True)
class ComplexModesSettings:
    """Numbers of complex modes, and of their fitted outputs."""

    #: [1] Ratio of imaginary part to modulus below which a pole of the structure without structural
    #: damping is real. Rounding: rounding splits a double pole by its square root.
    real_pole_ratio: float = 1e-7
    #: [1] Modulus of a pole, as a share of the largest, below which it is at 0. Rounding: rounding.
    zero_share: float = 1e-9
    #: [1] Frequency of the real pole that removes the feed-through of a velocity, as a multiple of
    #: the band's upper end. Why: a rule of thumb; its phase in the band is up to 6 degrees.
    velocity_pole_factor: float = 10.0
    #: [1] Sum of the residues, as a share of their moduli, below which it is 0. Rounding: rounding.
    residue_rounding: float = 1e-10
    #: [poles] Numbers of real poles that are tried with fitted outputs. Effort: a rule of thumb.
    real_poles: tuple[int, ...] = (0, 2, 4)
    #: [1] Factor by which these extend beyond the band. Why: a rule of thumb.
    band_factor: float = 3.0
    #: [1] Singular value of the fit of outputs, as a share of the largest, below which it is 0; a
    #: smaller one admits large terms that cancel in the band and add up outside. Why: a rule of
    #: thumb.
    singular_share: float = 1e-7


@dataclass(frozen=True)
class RationalFitSettings:
    """Numbers of the rational approximation of a response."""

    #: [iterations] Iterations of vector fitting with the given weights. Effort: a rule of thumb.
    pole_iterations: int = 8
    #: [iterations] Iterations of vector fitting with updated weights. Effort: a rule of thumb.
    weighted_iterations: int = 16
    #: [iterations] Iterations of the outputs with updated weights. Effort: a rule of thumb.
    output_iterations: int = 12
    #: [1] Largest error, as a multiple of the tolerance, of a fit that is refined. Effort: a rule
    #: of thumb.
    refined_error: float = 4.0
    #: [1] Smallest factor on the square of the weight of a line in one iteration. Why: a rule of
    #: thumb; weights do not vanish.
    least_weight: float = 0.02
    #: [steps] Gauss-Newton steps for several inputs. Effort: a rule of thumb; they stop when the
    #: gain is small.
    newton_steps: int = 6
    #: [steps] Gauss-Newton steps of an approximation that starts at the poles of another: none if
    #: its moved poles hold the tolerance. Effort: steps reduce the mean square, but may move real
    #: poles to places with a larger error from the passivity constraint.
    refit_steps: tuple[int, ...] = (0, 2)
    #: [1] Largest relative distance between a pair and the pole of the structure that it
    #: represents. Why: a rule of thumb.
    match_distance: float = 0.02
    #: [1] Damping ratio of an initial pole that represents no mode. Effort: a rule of thumb; vector
    #: fitting relocates the pole.
    free_damping: float = 0.3
    #: [1] Singular value of a least-squares fit, as a share of the largest, below which it is 0.
    #: Rounding: rounding of nearly dependent columns.
    singular_share: float = 1e-10
    #: [states] Largest number of states in addition to those of the modes in the band. Effort: a
    #: rule of thumb.
    most_added_states: int = 16


@dataclass(frozen=True)
class PassivitySettings:
    """Numbers of the passivity of collocated channels."""

    #: [iterations] Iterations in which violations are located and corrected. Effort: a rule of
    #: thumb.
    iterations: int = 12
    #: [1] Relative distance of an eigenvalue from the imaginary axis within which the sign of the
    #: active part may change. Rounding: rounding of a double eigenvalue.
    axis_distance: float = 1e-6
    #: [1] Negative active part, as a share of |G|, that violates passivity. Rounding: rounding of a
    #: response.
    least_violation: float = 1e-9
    #: [1] Smallest active part after a correction, as a share of the channel's magnitude. Rounding:
    #: larger than the least violation, so that a corrected line does not violate again.
    margin: float = 1e-6


@dataclass(frozen=True)
class MeasuredPlantSettings:
    """Numbers of a plant of measured FRFs."""

    #: [lines] Least number of lines in the band. Why: a rule of thumb; one mode has four unknowns.
    least_lines: int = 8
    #: [std] Standard deviations of a measured value within which the plant may lie. Why: 99.7 % of
    #: a normal distribution.
    accepted_stds: float = 3.0


@dataclass(frozen=True)
class PlantFamilySettings:
    """Numbers of a plant and its members."""

    #: [members] Largest number of members. Effort: memory; each is a plant.
    most_members: int = 10_000
    #: [draws] Least number of draws that enrich the basis of all members. Effort: a rule of thumb.
    least_training_draws: int = 6
    #: [draws] Draws per parameter that enrich it. Effort: a rule of thumb.
    draws_per_parameter: float = 2.0 / 3.0
    #: [1] Factor on the spread of these draws. Effort: a rule of thumb; most members then lie
    #: between them.
    training_spread: float = 1.5


@dataclass(frozen=True)
class PlantLineSettings:
    """Numbers of the lines that resolve the poles and zeros of plants."""

    #: [lines] Lines per decade without poles and zeros. Why: a rule of thumb.
    lines_per_decade: int = 60
    #: [half widths] Distances of lines from each pole, on both sides, in units of half its
    #: half-power width. Why: a rule of thumb.
    fine_offsets: tuple[float, ...] = (0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.5, 7.0, 11.0, 20.0)
    #: [half widths] The same for smoother curves. Effort: a rule of thumb.
    coarse_offsets: tuple[float, ...] = (0.5, 1.0, 2.0, 5.0)
    #: [log Hz] Distance of lines within which they are merged. Rounding: rounding of frequencies.
    merge_distance: float = 1e-10
    #: [1] Smallest damping ratio that is resolved. Why: undamped zeros have none.
    least_damping: float = 1e-9
    #: [1] Largest damping ratio of a pole with lines around it. Why: the lines of each decade
    #: resolve the others.
    largest_damping: float = 0.3


@dataclass(frozen=True)
class DiscretisationSettings:
    """Numbers of the sampling of a plant."""

    #: [intervals] Distance of a delay from a whole number of intervals within which it is rounded.
    #: Why: rounding (0.003 / 0.001 is not 3).
    whole_distance: float = 1e-9
    #: [states] Largest number of states with those of the delay. Effort: memory of dense matrices.
    most_states: int = 2000
    #: [lines] Lines in the band for the deviation, in addition to the peaks. Effort: a rule of
    #: thumb.
    deviation_lines: int = 400
    #: [1] Relative distance of a pole from the singularity of the bilinear substitution within
    #: which it is refused. Why: nine digits are lost there.
    singular_distance: float = 1e-9


@dataclass(frozen=True)
class UncertaintyWeightSettings:
    """Numbers of the lines of an uncertainty weight."""

    #: [1] Factor by which the lines extend beyond the slowest and fastest of band, poles and zeros.
    #: Why: a rule of thumb.
    band_factor: float = 10.0
    #: [rounds] Rounds that add lines where a weight is closest to its radius. Effort: a rule of
    #: thumb; the first ones fit the weight again.
    refinements: int = 4
    #: [parts] Parts into which new lines divide the gaps next to such a place. Why: a rule of
    #: thumb.
    gap_parts: int = 8
    #: [places] Largest number of places that are refined at once. Effort: a rule of thumb.
    most_places: int = 40
    #: [log] Distance from the closest place within which others are refined last, in log |W|; five
    #: times this in each earlier round. Why: a rule of thumb.
    close_distance: float = 0.005
    #: [log] Violation at new lines, in log |W|, above which a weight is fitted again. Why: the
    #: order, and not only the gain, may have to change.
    refitted_violation: float = 0.02
    #: [log] Increase of a weight above its lines, in log |W|. Why: very sharp peaks between two
    #: lines.
    margin: float = 1e-3


@dataclass(frozen=True)
class WeightFitSettings:
    """Numbers of the fit of a weight as an upper bound."""

    #: [1] Weight of the largest excess relative to the mean. Why: a rule of thumb.
    largest_share: float = 0.1
    #: [1] Least damping of a section. Why: a sharp resonance.
    least_damping: float = 1e-5
    #: [1] Largest damping of a section. Why: two real roots far apart.
    largest_damping: float = 1e2
    #: [lines] Least number of lines for trial sections. Effort: a rule of thumb.
    least_lines: int = 120
    #: [lines] Largest number of lines for trial sections. Effort: a rule of thumb.
    most_lines: int = 250
    #: [starts] Trial frequencies of a new section. Effort: optimisation moves them.
    trial_frequencies: int = 9
    #: [log rad/s] Half the distance between zero and pole of a new first-order section. Effort: a
    #: factor of four between them; optimisation moves them.
    root_distance: float = 0.7
    #: [1] Damping of the zeros and of the poles of a new section that lifts a peak. Effort: a rule
    #: of thumb; optimisation moves them.
    peak_dampings: tuple[tuple[float, float], ...] = ((1.0, 0.2), (0.2, 1.0), (0.5, 0.05))
    #: [1] The same at the tightest peaks. Effort: a rule of thumb; these are sharp, and
    #: optimisation moves them.
    spike_dampings: tuple[tuple[float, float], ...] = ((0.3, 3e-3), (0.1, 1e-4))
    #: [1] The same of a section that lowers a gap. Effort: a rule of thumb; optimisation moves
    #: them.
    dip_dampings: tuple[tuple[float, float], ...] = ((0.05, 0.2), (0.2, 0.8), (0.3, 3.0))
    #: [places] Numbers of tightest peaks and of widest gaps that are tried. Effort: a rule of
    #: thumb.
    trial_places: int = 3
    #: [1] Share of the largest excess, in log |W|, below which a bound is nearly tight. Why: a rule
    #: of thumb.
    tight_share: float = 0.3
    #: [starts] Starts that are optimised to the end. Effort: a rule of thumb.
    most_starts: int = 2
    #: [steps] Largest number of steps of an optimisation. Effort: it ends earlier when the gain is
    #: small.
    most_steps: int = 60
    #: [rounds] Largest number of times that lines are added to a fit. Effort: a rule of thumb.
    exchanges: int = 3
    #: [log] Distance from the tightest line within which a line is added, in log |W|. Why: a rule
    #: of thumb.
    exchange_distance: float = 0.05
    #: [log] Largest violation that is corrected by the gain alone, in log |W|. Why: 0.2 % of the
    #: weight.
    gain_violation: float = 0.002


@dataclass(frozen=True)
class PlantPictureSettings:
    """Numbers that limit pictures and texts of a plant."""

    #: [channels] Largest number of channels of a Bode diagram; more are refused. Drawing: size of
    #: the figure.
    most_channels: int = 16
    #: [modes] Largest number of natural frequencies in a text. Drawing: length of the text.
    listed_modes: int = 12


ANTIRESONANCES = AntiresonanceSettings()
PLANT_TARGET = PlantTargetSettings()
POLES = PoleSettings()
CAUSAL_BOUND = CausalBoundSettings()
MODAL_SPACE = ModalSpaceSettings()
SPECTRAL = SpectralSettings()
REAL_MODES = RealModesSettings()
COMPLEX_MODES = ComplexModesSettings()
RATIONAL_FIT = RationalFitSettings()
PASSIVITY = PassivitySettings()
MEASURED_PLANT = MeasuredPlantSettings()
PLANT_FAMILY = PlantFamilySettings()
PLANT_LINES = PlantLineSettings()
DISCRETISATION = DiscretisationSettings()
UNCERTAINTY_WEIGHT = UncertaintyWeightSettings()
WEIGHT_FIT = WeightFitSettings()
PLANT_PICTURES = PlantPictureSettings()
