"""Numbers that decide how a fit searches, steps and ends."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class TrustRegionSettings:
    """Numbers of a descent in a trust region."""

    #: [1] Largest component of a step that is rounding; a descent with longer steps goes on. Why:
    #: rounding; above the square root of the unit roundoff, within which a cost is flat about its
    #: minimum.
    step_rounding: float = 1e-6
    #: [1] Predicted decrease, as a share of the cost, below which a point is next to a minimum; a
    #: descent that cannot go on there has converged, elsewhere it has stalled. Why: a rule of
    #: thumb, far below any significant decrease.
    minimum_share: float = 1e-6
    #: [std] Distance of an undetermined combination from its best value up to which it keeps its
    #: value. Why: the 95 % level of a normal distribution.
    kept_stds: float = 2.0


TRUST_REGION = TrustRegionSettings()


@dataclass(frozen=True)
class CurvatureSettings:
    """Numbers that decide when the learnt curvature replaces the Gauss-Newton model."""

    #: [1] Relative error with which the Gauss-Newton model may predict the gain of a step; beyond
    #: it, the learnt curvature is considered. Why: a rule of thumb.
    prediction_error: float = 0.25
    #: [1] Share of the cost that a step has to gain for the Gauss-Newton model to be kept, whatever
    #: it predicted. Why: a rule of thumb; a criterion of the same form is that of Fletcher & Xu
    #: (1987).
    large_decrease: float = 0.02
    #: [1] Longest step after which the learnt curvature is used. Why: a rule of thumb; farther from
    #: a minimum, Gauss-Newton steps reach the right one at least as often.
    longest_step: float = 0.05
    #: [1] Share of the cost below which a predicted gain is rounding and shows nothing about the
    #: model. Why: rounding of a cost summed over many values.
    rounding_share: float = 1e-12
    #: [1] Smallest cosine between a step and the missing change of the gradient for an update.
    #: Rounding: the usual safeguard of the symmetric rank-one update (Conn, Gould & Toint, 1991).
    least_cosine: float = 1e-8


CURVATURE = CurvatureSettings()


@dataclass(frozen=True)
class DescentSettings:
    """Numbers of descents in sequence."""

    #: [descents] Largest number of times that the spread of a residual is estimated in turn with
    #: the unknowns. Effort: a rule of thumb.
    most_scales: int = 8
    #: [descents] Largest number of times that undetermined combinations are pulled back towards the
    #: start. Effort: a rule of thumb.
    most_pulls: int = 4
    #: [1] Cost for each value up to which a residual is rounding, so that a pull may raise it to
    #: that. Rounding: the square of 1e-10, a relative error some digits above the unit roundoff.
    exact_cost: float = 1e-20
    #: [1] Change of each unknown from its start if the model is singular there. Why: moves natural
    #: frequencies off a line, and is far below the errors of a start.
    start_change: float = 1e-3


DESCENT = DescentSettings()


@dataclass(frozen=True)
class CheckpointSettings:
    """Numbers of a file of evaluations."""

    #: [s] Interval between calls of fsync; a loss of power costs the evaluations since the last.
    #: Effort: a rule of thumb; an evaluation may take less time than fsync, and the end of the
    #: process loses nothing.
    sync_interval_s: float = 1.0


CHECKPOINT = CheckpointSettings()


@dataclass(frozen=True)
class NullSpaceSettings:
    """Numbers that decide which combinations of unknowns the data determine."""

    #: [1] Share of the largest singular value of the column-scaled Jacobian below which a singular
    #: value counts as zero. Why: no measurement has the 8 exact digits needed to resolve it.
    rank_tolerance: float = 1e-8
    #: [std] Standard deviation of a direction (of a logarithm, or of a loss factor) above which it
    #: is undetermined. Why: the first order does not hold beyond a factor of e.
    undetermined_std: float = 1.0
    #: [1] Relative excess of a standard deviation over that limit that is rounding. Why: the
    #: standard deviation of a prior may equal the limit; the computed one then differs from it by
    #: the rounding of a singular value decomposition.
    std_rounding: float = 1e-9
    #: [1/std] Inverse of a standard deviation below which there is no information. Rounding: keeps
    #: the covariance finite; a standard deviation of 1e9 is far above any of interest.
    blind_inverse_std: float = 1e-9
    #: [std] Limit to which the standard deviation of a direction is reduced. Rounding: beyond it,
    #: the rounding of a singular value decomposition would hide standard deviations of order one.
    largest_std: float = 1e12
    #: [1] Weight of an unknown in a direction of unit length up to which it takes no part in it.
    #: Why: a rule of thumb; a change by a factor of e along the direction changes it by 0.1 %.
    visible_weight: float = 1e-3


NULL_SPACE = NullSpaceSettings()


@dataclass(frozen=True)
class AcceptanceSettings:
    """Numbers that decide whether the end of a try of a search is the answer."""

    #: [1] Relative difference of costs, or square of the change of the residual as a share of the
    #: cost, up to which two ends are in one basin. Why: a rule of thumb, above the tolerance of a
    #: try.
    same_basin_share: float = 1e-3
    #: [1] Largest serial correlation of a residual that may be noise. Why: a rule of thumb, between
    #: noise (0) and errors of the model (near 1 on dense lines).
    possible_correlation: float = 0.3
    #: [1] Largest serial correlation of a residual that is certainly noise; decides whether one end
    #: is plausible without another that agrees. Why: a rule of thumb.
    certain_correlation: float = 0.1
    #: [1] Ratio of a cost to that expected from noise alone, up to which noise explains it. Why: a
    #: rule of thumb; the cost is quadratic, so it allows for a noise level that is too small by a
    #: fifth.
    explained_ratio: float = 1.5
    #: [1] Log misfit (rms) above which a residual is not noise. Why: a rule of thumb; 30 % of every
    #: value is more than usual noise.
    gross_misfit: float = 0.3
    #: [1] Log misfit (rms) below which a residual is rounding of exact data, so that no better
    #: answer exists. Why: data in single precision have a relative rounding of 6e-8.
    exact_misfit: float = 1e-7
    #: [tries] Tries that have to reach an answer whose residual looks like noise. Why: the least
    #: number that can agree.
    tries_if_noise: int = 2
    #: [tries] Tries that have to reach an answer whose residual may be noise. Why: a rule of
    #: thumb between the other two.
    tries_if_unclear: int = 3
    #: [tries] Tries that have to reach an answer whose residual is not noise. Why: more than the
    #: first tries, which share stiffnesses and masses and can agree on a wrong answer.
    tries_if_not_noise: int = 6


ACCEPTANCE = AcceptanceSettings()


@dataclass(frozen=True)
class AnswerResidualSettings:
    """Numbers that decide whether a residual is more than noise."""

    #: [lines] Least number of lines for a judgement of the serial correlation. Why: a rule of
    #: thumb; with fewer, that of noise is often large.
    least_lines: int = 8
    #: [1] Serial correlation above which the residual of an answer is more than noise. Why: a rule
    #: of thumb.
    largest_correlation: float = 0.2
    #: [1] Probability below which noise of known size does not explain the size of a residual; it
    #: is divided among the tests. Why: chi-square or F test at the level of 0.1 %.
    least_probability: float = 1e-3
    #: [1] Reduced chi-square above which a residual is more than noise, for heavy tails and modes.
    #: Why: a rule of thumb, because the sum of squares of heavy tails has no usual distribution.
    largest_chi_square: float = 1.5


ANSWER_RESIDUAL = AnswerResidualSettings()


@dataclass(frozen=True)
class AnswerSettings:
    """Numbers by which answers are compared."""

    #: [1] Difference of log-likelihoods up to which two answers fit equally well. Why: odds of 100
    #: to 1.
    equal_log_odds: float = math.log(100.0)
    #: [std] Difference of an unknown from which two answers are distinct. Why: the 99.7 % level of
    #: a normal distribution.
    distinct_stds: float = 3.0
    #: [1] Usual distance of factors from their start, in the logarithm. It decides between answers
    #: that fit equally well, and limits the search for further answers and the reduced model of a
    #: search. Why: a rule of thumb: a factor of e.
    log_spread: float = 1.0
    #: [1] The same for loss factors; also the distance of the tries of an update to modes. Why: a
    #: rule of thumb, well above the loss factors of metal structures.
    loss_spread: float = 0.3


ANSWERS = AnswerSettings()


@dataclass(frozen=True)
class FurtherAnswerSettings:
    """Numbers of the starting points from which further answers are searched for."""

    #: [std] Standard deviation from which an unknown is followed along a valley, restarted at
    #: random and moved after a search; a larger value saves work. Why: over changes of 1 %, the
    #: misfit is a parabola.
    uncertain_std: float = 0.01
    #: [std] Standard deviation from which an unknown is moved alone or reset, and the share of the
    #: usual spread from which a move counts. Why: a rule of thumb; saves work for the others.
    movable_std: float = 0.05
    #: [unknowns] Largest number of unknowns that are moved, each alone, or restarted together.
    #: Effort: two descents each.
    most_moved: int = 6
    #: [std] Distance by which unknowns are moved, and over which valleys are followed. Why: far
    #: beyond the confidence interval that the curvature gives.
    reach_stds: float = 8.0
    #: [restarts] Number of points at which the uncertain unknowns are drawn at random. Effort: one
    #: descent each.
    restarts: int = 6
    #: [pairs] Largest number of pairs of groups that are exchanged. Effort: the pairs of twenty
    #: groups.
    most_exchanges: int = 200
    #: [points] Largest number of points that are selected because they fit fairly well before any
    #: descent. Effort: one descent each.
    most_promising: int = 4
    #: [1] Least rise of the negative log-likelihood up to which a point fits fairly well. Why: a
    #: rule of thumb for few values; else the limit is half the number of values.
    fair_rise: float = 50.0
    #: [searches] Largest number of searches for further answers, each around the best so far.
    #: Effort: the second one is made only if the first found a better answer.
    most_searches: int = 2


FURTHER_ANSWERS = FurtherAnswerSettings()


@dataclass(frozen=True)
class ValleySettings:
    """Numbers that decide whether a valley of the misfit is open."""

    #: [std] Size of a step along a valley; halved once where the valley curves. Why: a rule of
    #: thumb, a quarter of the distance followed.
    step_stds: float = 2.0
    #: [1] Largest rise of the misfit at the end of an open valley, as a share of that of the
    #: parabola. Why: a rule of thumb; the valley is then twice as wide as its curvature implies.
    open_share: float = 0.25
    #: [1] Largest rise of the misfit on the way, as a share of that of the parabola. Why: a rule of
    #: thumb, above the share at the end.
    rise_share: float = 0.5


VALLEY = ValleySettings()


@dataclass(frozen=True)
class ScreenSettings:
    """Numbers of the selection of points on few lines."""

    #: [lines] Least number of lines on which points are compared first. Effort: with fewer, single
    #: lines decide.
    first_lines: int = 4
    #: [1] Ratio of a sum of squares to that of the answer above which a point is far off. Why: for
    #: noise of unknown size, its log-likelihood is then lower by a half for each measured number.
    far_ratio: float = math.e
    #: [1] Share of the points kept after each piece in a ranking. Effort: the next piece has twice
    #: as many lines.
    kept_share: float = 0.25
    #: [values] Least number of values assumed in the limit on the sum of squares. Why: a rule of
    #: thumb; with few values or exact data, every point would be rejected.
    least_values: int = 50


SCREEN = ScreenSettings()


@dataclass(frozen=True)
class SearchSettings:
    """Numbers of a search: lines, tries and their ends."""

    #: [lines] Largest number of lines of a search. Why: a basin is as wide on some hundred lines as
    #: on thousands.
    most_lines: int = 400
    #: [lines] Number of these lines on which a try descends first. Why: saves most of the work of a
    #: try; the end is refined on all lines.
    few_lines: int = 32
    #: [values] Least number of measured numbers for each unknown on the few lines. Why: a rule of
    #: thumb; fewer hardly determine the unknowns.
    numbers_per_unknown: int = 4
    #: [tries] Largest number of tries that a user may request. Why: the starts of all tries are
    #: drawn together.
    most_tries: int = 10_000
    #: [steps] Largest number of steps of a try. Effort: the best try continues.
    steps: int = 60
    #: [1] Ratio of the steps of the continued best try to those of a try. Effort: a rule of thumb.
    continued_ratio: int = 5
    #: [1] Relative decrease of the cost at which a try ends. Effort: a rule of thumb; a fit
    #: follows.
    negligible_decrease: float = 1e-5
    #: [tries] Number of tries without a plausible end after which a fault of the data is
    #: considered. Why: the first tries with all levels of loss factors have then failed.
    tries_before_doubt: int = 3
    #: [rounds] Largest number of rounds of tries, each from starts farther away. Effort: a rule of
    #: thumb.
    most_rounds: int = 3
    #: [1] Ratio to the least cost up to which the end of a try is fitted. Why: minima of the log
    #: error are not those of the likelihood, which decides.
    fitted_cost_ratio: float = 1.5
    #: [ends] Largest number of ends that are fitted. Effort: a rule of thumb.
    most_fitted: int = 4
    #: [rounds] Largest number of rounds in which uncertain unknowns are moved after a search.
    #: Effort: the second round is made only if the first found a better minimum.
    most_escapes: int = 2


SEARCH = SearchSettings()


@dataclass(frozen=True)
class TryStartSettings:
    """Numbers of the points at which tries of a search begin."""

    #: [1] Loss factors of the first tries, in turn. Why: 0.3 is best on average; the others reach
    #: some of the answers that it misses (damping equalisation).
    loss_levels: tuple[float, ...] = (0.3, 0.1, 1.0)
    #: [1] Distances from an end, in turn, at which tries near it start, in logarithms of factors.
    #: Why: a rule of thumb; minima occur in groups.
    nearby_logs: tuple[float, ...] = (0.1, 0.2)
    #: [1] The same for loss factors. Why: a rule of thumb.
    nearby_loss: float = 0.02
    #: [tries] Period of those tries near an end that begin with one unknown put back to its start.
    #: Why: a rule of thumb.
    reset_period: int = 3
    #: [1] Share of the lines, drawn at random, on which every other try that begins in an end
    #: descends first. Why: a wrong minimum on all lines is seldom one on a third of them.
    random_share: float = 1.0 / 3.0
    #: [1] Share of the lines, a contiguous band, on which the others descend first. Why: as for the
    #: random lines.
    band_share: float = 0.5
    #: [1] Ratio to the number of tries of the search, of tries near an end that found none better
    #: after which they stop. Effort: a rule of thumb.
    nearby_ratio: int = 2


TRY_STARTS = TryStartSettings()


@dataclass(frozen=True)
class ReducedTierSettings:
    """Numbers that decide when models are reduced and how accurate the reduced models are."""

    #: [DOFs] Size above which models are reduced if no tier is forced. Why: about there the reduced
    #: tier takes less time (benchmarks/tiers.py).
    most_exact_dofs: int = 600
    #: [DOFs] The same for modes. Why: a rule of thumb; for few modes of smaller models, both tiers
    #: take about the same time.
    most_exact_dofs_of_modes: int = 3000
    #: [lines] Least number of lines for that. Why: a rule of thumb; with few lines, a basis costs
    #: more than it saves.
    least_lines: int = 40
    #: [1] Largest accepted error as a share of the faintest channel. Why: a rule of thumb, below
    #: usual noise of that channel.
    faintest_share: float = 1e-3
    #: [1] Smallest error that is ever requested, and share of the loudest channel below which a
    #: channel is rounding. Why: rounding of reduced models.
    finest_error: float = 1e-9
    #: [DOFs] Largest number of DOFs without a sensor whose error is certified too. Effort: they
    #: serve the experiment advice.
    most_other_dofs: int = 200
    #: [1] Ratio of the accepted error at the start to that at the end. Why: the start serves tables
    #: and figures only.
    start_error_ratio: float = 10.0
    #: [fits] Largest number of fits to modes until these agree with the full model. Effort: a
    #: second one is rarely needed.
    most_modal_refits: int = 3


REDUCED_TIER = ReducedTierSettings()


@dataclass(frozen=True)
class ReducedFitSettings:
    """Numbers of the rounds of a fit in a reduced model."""

    #: [1] Trust radius of a basis in logarithms of factors. Why: a rule of thumb.
    radius: float = 0.2
    #: [1] Trust radius for loss factors that are small. Why: a rule of thumb.
    loss_radius: float = 0.05
    #: [steps] Largest number of steps of a round that may leave the trust radius. Effort: the basis
    #: is about to be renewed.
    steps_per_round: int = 12
    #: [rounds] Largest number of rounds of a fit, and of the descents from the start. Effort: a
    #: rule of thumb.
    most_rounds: int = 12
    #: [1] Share of the log error of the round before to which a round has to lower it for the
    #: descents from the start to go on. Why: a rule of thumb; slower descents are far off.
    slow_decrease: float = 0.8
    #: [1] Ratio of the trust radius of the descents from the start to that of a fit. Why: they only
    #: have to end near the answer.
    wider_ratio: float = 4.0
    #: [1] Share of the trust radius within which a basis is enriched. Why: beyond it, a new basis
    #: is smaller and takes less time.
    enriched_share: float = 0.1
    #: [1] The same for heavy models. Why: factorisations dominate their time
    #: (benchmarks/large.py).
    enriched_share_if_heavy: float = 1.0
    #: [DOFs] Size above which a model is heavy. Why: factorisations dominate its time
    #: (benchmarks/large.py).
    heavy_dofs: int = 20_000
    #: [bases] Number of bases that a fit builds anew; later ones are enriched. Why: enriched bases
    #: hold along the whole path, so a fit that keeps moving can go farther.
    most_built: int = 2
    #: [1] Factor by which the trust radius grows in each round with an enriched basis. Why: a rule
    #: of thumb.
    radius_growth: float = 2.0
    #: [vectors] Size above which a basis is compressed. Why: dense solves slow down with the size
    #: of the basis.
    most_vectors: int = 400


REDUCED_FIT = ReducedFitSettings()


@dataclass(frozen=True)
class SearchBasisSettings:
    """Numbers of the reduced model in which a search is made."""

    #: [points] Least number of points around the start that span the basis. Why: a rule of thumb.
    least_points: int = 8
    #: [points] Largest number of points around the start that span the basis; two for each factor
    #: in between. Effort: a rule of thumb.
    most_points: int = 24
    #: [points] Number of sample points whose response fields select among the vectors. Why: a rule
    #: of thumb; more than the points that span the basis, so that they show errors between these.
    samples: int = 40
    #: [1] Square root of the share of the energy of these fields that may be dropped. Why: below
    #: usual noise.
    dropped_energy: float = 1e-4
    #: [1] Factor on the error of these fields in the noise model of a search. Why: unlike noise,
    #: this error has a mean other than 0.
    error_ratio: float = 10.0
    #: [lines] Largest number of lines of a search in the basis. Effort: a rule of thumb.
    most_lines: int = 200


SEARCH_BASIS = SearchBasisSettings()


@dataclass(frozen=True)
class ReducedAnswerSettings:
    """Numbers of a search for further answers in a reduced model."""

    #: [1] Ratio of the accepted error of the basis to that of the fit. Why: the answers found are
    #: fitted and certified afterwards.
    error_ratio: float = 10.0
    #: [vectors] Largest number of vectors added to the basis of the answer before they are dropped.
    #: Why: dense solves slow down with the size of the basis.
    most_added: int = 200
    #: [1] Share of the trust radius of the answer within which its basis is not enriched. Why: a
    #: rule of thumb.
    covered_share: float = 0.25
    #: [1] Rise of the misfit at a point, as a share of that of the quadratic model about an answer,
    #: above which a descent leads back to the answer. Why: a rule of thumb.
    quadratic_share: float = 0.5
    #: [passes] Largest number of times that a basis is enriched at one point, each time at other
    #: lines. Effort: a rule of thumb.
    most_passes: int = 6


REDUCED_ANSWERS = ReducedAnswerSettings()


@dataclass(frozen=True)
class RegularisationSettings:
    """Numbers of the choice of a regularisation."""

    #: [points] Number of strengths on the logarithmic grid whose best point is refined. Effort: a
    #: rule of thumb; the best is refined.
    grid_points: int = 400
    #: [1] First and smallest strength. Why: a prior with a standard deviation of a factor of e
    #: hardly affects determined unknowns.
    weakest: float = 1.0
    #: [fits] Largest number of fits with a new strength. Effort: a rule of thumb.
    most_strengths: int = 8
    #: [fits] Largest number of fits with new directions. Effort: a rule of thumb.
    most_turns: int = 4
    #: [1] Change of the logarithm of a strength below which it has settled. Why: a rule of thumb.
    settled_log: float = 0.05
    #: [1] Cosine above which directions have settled. Why: a rule of thumb; an angle of 0.8
    #: degrees.
    settled_cosine: float = 1.0 - 1e-4
    #: [points] Number of points of the curve in the record. Why: enough for a figure.
    curve_points: int = 41


REGULARISATION = RegularisationSettings()


@dataclass(frozen=True)
class EquivalentStartSettings:
    """Start of a fit by equivalent linear elements."""

    #: [rounds] Renewals of predicted amplitudes. Effort: the fit of the balance does the rest.
    rounds: int = 4
    #: [steps] Steps of each round. Effort: a rule of thumb.
    steps: int = 30
    #: [1] Smallest step. Effort: far below the error of equivalent elements.
    tolerance: float = 1e-6
    #: [1] Change of the unknowns in a round, at which amplitudes are no longer renewed. Effort: a
    #: rule of thumb.
    settled: float = 0.01
    #: [1] Smallest amplitude of an element, over its largest at a level. Why: describing functions
    #: of relays grow without bound towards zero.
    least_amplitude: float = 1e-4


EQUIVALENT_START = EquivalentStartSettings()
