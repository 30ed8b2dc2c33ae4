"""Numbers that decide how uncertainties are computed, and when they are reliable."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CountLimitSettings:
    """Largest numbers that users may ask for."""

    #: [draws] Largest number of draws. Effort: their mean is accurate to a thousandth of their
    #: standard deviation; all are kept in memory, 8 MB for each unknown.
    most_draws: int = 1_000_000
    #: [evaluations] Largest number of evaluations of a sampler. Effort: all are kept in memory, 80
    #: MB for each unknown.
    most_evaluations: int = 10_000_000


@dataclass(frozen=True)
class BootstrapSettings:
    """Numbers of the bootstrap."""

    #: [1] Share of failed refits above which the draws are not reliable. Why: as large as both
    #: tails of a 95 % interval together.
    most_failed_share: float = 0.05


@dataclass(frozen=True)
class PosteriorSearchSettings:
    """Numbers of the search for minima of the negative log-likelihood."""

    #: [starts] Default number of random starts. Effort: each costs a fit.
    starts: int = 8
    #: [1] Largest distance of a random start from the estimate, in logarithms of factors. Why: a
    #: factor of e, beyond the usual error of a model.
    start_distance: float = 1.0
    #: [1] Least loss factor of every other random start. Why: more damping widens the basin of a
    #: minimum.
    inflated_loss: float = 0.1
    #: [starts] Number of starts with exchanged parts of the structure, those of lowest cost.
    #: Effort: a rule of thumb.
    exchanges: int = 3
    #: [1] Cost above that of the lowest minimum from which a minimum is dropped. Why: its
    #: likelihood is then 6e-6 of the largest.
    negligible_cost: float = 12.0
    #: [steps] Largest number of steps of a descent. Effort: descents from nearby points take far
    #: fewer.
    descent_steps: int = 60


@dataclass(frozen=True)
class PredictedBandSettings:
    """Numbers of the bands of predicted FRFs."""

    #: [draws] Largest number of draws of which a band is made. Effort: 25 draws are beyond each end
    #: of a 95 % band.
    most_draws: int = 1000
    #: [solutions] Number of solutions of a line from which a reduced model is made. Effort: the
    #: reduction takes about 20.
    least_solves: int = 40
    #: [1] Relative change of H, for a change by a factor e along an undetermined combination, above
    #: which a band is infinite. Rounding: above rounding.
    open_change: float = 1e-6


@dataclass(frozen=True)
class RiceTableSettings:
    """The table of quantiles of the Rice distribution."""

    #: [1] Largest ratio of the magnitude to the standard deviation. Rounding: beyond it the normal
    #: distribution differs by less than 2e-3 of a standard deviation.
    largest_ratio: float = 20.0
    #: [1] Number of ratios. Rounding: linear interpolation is then accurate to 2e-3 of a standard
    #: deviation.
    n_ratios: int = 201


@dataclass(frozen=True)
class ExpansionSettings:
    """Numbers of the expansion of measured shapes."""

    #: [sensors] Least number of sensors in excess of the combined modes. Why: the leave-one-out
    #: error is too random with one or two (a rule of thumb).
    spare_sensors: int = 3
    #: [1] Share of the least error so far below which more modes have to reduce the error. Why:
    #: the smallest of many errors is too small by chance; a rule of thumb.
    least_gain: float = 0.8
    #: [1] Singular values below this share of the largest make modes at the sensors dependent. Why:
    #: the amplitudes would amplify the noise a thousand times.
    rank_tolerance: float = 1e-3
    #: [1] Least variance of a sensor relative to the square of the shape. Rounding: rounding of a
    #: residual without noise.
    least_variance: float = 1e-24


@dataclass(frozen=True)
class ProfileSettings:
    """Numbers of the profiles of the likelihood."""

    #: [1] Decrease of the cost that counts as another minimum. Why: a tenth of a standard
    #: deviation.
    better_cost: float = 0.005
    #: [rounds] Largest number of computations of the profiles, each from the lowest minimum found.
    #: Effort: a rule of thumb.
    most_rounds: int = 3
    #: [std] Distance between two points of a profile. Effort: the level of a 95 % interval, at
    #: 1.96, is four points away.
    step: float = 0.5
    #: [1] Largest step, as a share of the distance between the bounds. Effort: a flat profile has
    #: no other scale.
    most_step_share: float = 0.1
    #: [points] Largest number of points on one side of a minimum. Effort: six times the number from
    #: bound to bound.
    most_points: int = 60
    #: [halvings] Largest number of halvings of a step to a point where the model cannot be solved.
    #: Effort: the step is then 3 % of the first one.
    most_halvings: int = 5
    #: [points] Largest number of points tried for a crossing of the level. Effort: bisection takes
    #: 10 for the tolerance.
    most_crossing_points: int = 40
    #: [1] Tolerance of a crossing, as a share of the level in standard deviations. Effort: the end
    #: is interpolated afterwards, and shown with three digits.
    crossing_tolerance: float = 2e-3
    #: [1] Distance between two points, or from a bound (relative to it), that is rounding.
    #: Rounding: above the rounding of double precision.
    rounding: float = 1e-12


@dataclass(frozen=True)
class SamplerSettings:
    """Numbers of the sampler and of its diagnostics."""

    #: [ensembles] Number of independent ensembles. Why: R-hat needs several chains; four are usual
    #: (Vehtari et al., 2021).
    ensembles: int = 4
    #: [steps] Number of steps of warm-up, whose draws are discarded. Why: the ensembles start near
    #: the posterior (a rule of thumb).
    warm_up_steps: int = 40
    #: [steps] Number of steps between two diagnoses. Effort: a rule of thumb.
    round_steps: int = 25
    #: [1] Weight of proposals from the mixture. Why: they are independent of the walker, so that
    #: their draws are hardly correlated (a rule of thumb).
    mixture_weight: float = 0.7
    #: [1] Weight of differences of two walkers. Why: they follow a posterior that the mixture does
    #: not (a rule of thumb).
    difference_weight: float = 0.2
    #: [1] Weight of snooker updates. Why: they reach other modes (a rule of thumb).
    snooker_weight: float = 0.1
    #: [1] Least length of a chain in autocorrelation times. Why: the effective size is unreliable
    #: for shorter chains (a rule of thumb).
    least_length: int = 20
    #: [draws] Effective size below which draws are reported as too few. Why: 100 for each of four
    #: chains (Vehtari et al., 2021).
    reliable_draws: int = 400
    #: [1] Largest R-hat of ensembles that represent one density. Why: limit of Vehtari et al.
    #: (2021).
    most_r_hat: float = 1.01


@dataclass(frozen=True)
class MixtureSettings:
    """Numbers of the mixture of which proposals are drawn."""

    #: [1] Degrees of freedom of the components; fewer give heavier tails. Why: posteriors within
    #: bounds have lighter tails, and near the centre the density is almost Gaussian (a rule of
    #: thumb).
    degrees_of_freedom: float = 6.0
    #: [1] Least share of a component, times the number of components. Why: each mode keeps being
    #: visited (a rule of thumb).
    least_share: float = 0.1
    #: [draws] Number of distinct draws for each unknown from which the covariance of a component is
    #: estimated. Why: fewer give a poor covariance (a rule of thumb).
    draws_per_unknown: int = 10


@dataclass(frozen=True)
class SurrogateSettings:
    """Numbers of the reduced models about an estimate."""

    #: [points] Number of points at which a basis is enriched. Effort: a rule of thumb.
    points: int = 4
    #: [std] Distance of these points from the estimate, for each unknown. Why: most draws are
    #: nearer.
    distance: float = 2.0
    #: [points] Number of results, those furthest from their mean, at which the error is evaluated.
    #: Effort: a rule of thumb.
    checked_points: int = 4
    #: [enrichments] Largest number of times that the basis is enriched at these points. Effort: the
    #: whole computation is repeated after each.
    most_enrichments: int = 2


@dataclass(frozen=True)
class LevelCandidateSettings:
    """Force levels that are proposed for a further test."""

    #: [1] Lowest level, as a multiple of the lowest one of the tests. Default: about a factor of
    #: two, as steps of levels in tests.
    below: float = 0.5
    #: [1] Highest level, as a multiple of the highest one of the tests. Default: as `below`.
    above: float = 2.0
    #: [1] Relative difference up to which two levels are the same. Rounding: far above rounding,
    #: far below differences of tests.
    same: float = 1e-6


COUNT_LIMITS = CountLimitSettings()
BOOTSTRAP = BootstrapSettings()
POSTERIOR_SEARCH = PosteriorSearchSettings()
PREDICTED_BAND = PredictedBandSettings()
RICE_TABLE = RiceTableSettings()
EXPANSION = ExpansionSettings()
PROFILES = ProfileSettings()
SAMPLER = SamplerSettings()
MIXTURE = MixtureSettings()
SURROGATE = SurrogateSettings()
LEVEL_CANDIDATES = LevelCandidateSettings()
