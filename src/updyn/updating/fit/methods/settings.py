"""Numbers that decide how the methods of a fit iterate, and which answers they fit."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class MaximumLikelihoodSettings:
    """Numbers of the descents of a maximum-likelihood fit."""

    #: [rounds] Largest number of times that the weights are renewed. Effort: a rule of thumb.
    weight_rounds: int = 12
    #: [std] Length of the last move of the estimate above which weights and estimate have not
    #: settled. Why: a move within one standard deviation is not significant.
    unsettled_stds: float = 1.0
    #: [std] Length of a move of the estimate below which the weights are not renewed again. Why: a
    #: hundredth of a standard deviation is negligible.
    settled_stds: float = 1e-2
    #: [1] Decrease of half the chi-square at which a descent ends. Why: a hundredth of a standard
    #: deviation (Bates & Watts, 1981).
    negligible_decrease: float = 5e-5
    #: [tries] Least number of tries with which agreement between tries is required. Why: a rule of
    #: thumb; of fewer tries, agreement cannot be expected.
    agreement_tries: int = 3


MAXIMUM_LIKELIHOOD = MaximumLikelihoodSettings()


@dataclass(frozen=True)
class FurtherDescentSettings:
    """Numbers of the descents from which further answers are fitted."""

    #: [steps] Largest number of steps of the first descent from a further point. Effort: a rule of
    #: thumb.
    most_steps: int = 40
    #: [1] Decrease of half the chi-square at which the first descent ends. Why: a fit follows if
    #: the end is promising; nearly half a standard deviation.
    negligible_decrease: float = 0.1
    #: [1] Decrease of the log-likelihood from the best answer to the end of a first descent up to
    #: which a fit follows. Why: a rule of thumb, above the difference of equal answers, because the
    #: end has the weights of another answer.
    fitted_log_odds: float = 15.0
    #: [1] Difference of log-likelihoods up to which two ends belong to the same answer. Why: the
    #: difference at one standard deviation.
    same_log_odds: float = 0.5
    #: [tries] Largest number of tries near an answer. Effort: a rule of thumb.
    most_nearby_tries: int = 64
    #: [models] Largest number of times that a descent continues in the model of its end. Effort: in
    #: reduced models.
    most_renewals: int = 6
    #: [1] Ratio to which a better model has to lower a misfit for that to count as an error of the
    #: former model. Why: a rule of thumb.
    falling_ratio: float = 0.8
    #: [steps] Largest number of steps of a descent along a valley. Effort: each begins near its
    #: end.
    valley_steps: int = 12
    #: [steps] Largest number of steps of all further descents if the run took fewer before. Effort:
    #: short runs; the others may take as many steps as the run.
    least_limit: int = 50


FURTHER_DESCENTS = FurtherDescentSettings()


@dataclass(frozen=True)
class GlobalSearchSettings:
    """Numbers of the tries of an update to modes."""

    #: [1] Ratio of the largest number of tries to that of a search. Why: of the four answers of a
    #: chain of four springs, the rarest was reached by 4 of 80 tries; 160 tries miss it with a
    #: probability of 3e-4.
    tries_ratio: int = 20
    #: [1] Distance of the tries from the start in logarithms of factors. Why: a rule of thumb: a
    #: factor of 5.
    log_distance: float = math.log(5.0)


GLOBAL_SEARCH = GlobalSearchSettings()


@dataclass(frozen=True)
class LinearStepSettings:
    """Numbers of a plain iteration of linear solves."""

    #: [1] Factor or loss factor above which the iteration has diverged. Why: far beyond any
    #: physical value.
    diverged_value: float = 1e9
    #: [1] Condition number above which a linear problem is called singular in a message. Why:
    #: rounding; the solution has no more than four exact digits.
    singular_condition: float = 1e12
    #: [halvings] Largest number of times that a step is halved. Why: a millionth of a step is
    #: rounding.
    most_halvings: int = 20
    #: [1] Relative difference of lengths up to which columns are equally long. Rounding: rounding,
    #: which differs between processors.
    tie_share: float = 1e-6


LINEAR_STEP = LinearStepSettings()


@dataclass(frozen=True)
class SandwichSettings:
    """Numbers of the covariance of a fit whose weights are not those of the noise."""

    #: [1] Ratio to the rank tolerance of the singular value below which a direction is hardly
    #: determined and keeps its length in the Jacobian. Rounding: both limits are far below any
    #: determined direction.
    clear_ratio: float = 10.0
    #: [1] Ratio of noise to |H| above which curvature biases the logarithm of a value. Why: a rule
    #: of thumb.
    loud_noise: float = 0.5
    #: [1] Share of such values above which a note is given. Why: a rule of thumb.
    noted_share: float = 0.02


SANDWICH = SandwichSettings()


@dataclass(frozen=True)
class ReducedFRFSettings:
    """Numbers of the messages on reduced FRFs."""

    #: [1] Relative error of the reduced FRFs up to which a message calls them correct. Why: a rule
    #: of thumb.
    small_error: float = 0.1


REDUCED_FRF = ReducedFRFSettings()
