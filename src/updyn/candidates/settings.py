"""Numbers that decide the comparison of candidate models."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CANDIDATES"]


@dataclass(frozen=True)
class CandidateSettings:
    """Numbers of the ranking of candidates, and of the bands held out."""

    #: [1] Difference of log evidences below which two candidates are equally probable and the one
    #: with fewer unknowns is first. Why: odds of at most e are not worth more than a bare mention
    #: (Kass & Raftery, J. Am. Stat. Assoc. 90 (1995) 773, section 3.2).
    equal_log_odds: float = 1.0
    #: [1] Difference of log evidences from which the first candidate is distinguishable. Why: odds
    #: of 20, strong evidence on the scale of Kass & Raftery (1995, section 3.2).
    strong_log_odds: float = 3.0
    #: [1] Probability of a difference of predictive scores as large between candidates that predict
    #: equally well, below which they are distinguishable. Why: the usual level.
    significance: float = 0.05
    #: [standard errors] Deficit of the predictive score up to which the candidate with fewer
    #: unknowns is first. Why: the rule of one standard error (Breiman, Friedman, Olshen & Stone,
    #: Classification and Regression Trees, 1984, section 3.4.3).
    tied_errors: float = 1.0
    #: [1] Number of bands held out in turn. Default: ten is usual in cross-validation.
    bands: int = 10
    #: [1] Smallest standard deviation of the noise, as a share of the rms of the data of its unit.
    #: Rounding: far above that of a model, far below the noise of a measurement.
    least_noise: float = 1e-7
    #: [1] Smallest information on an unknown, as the inverse variance of a flat density between its
    #: bounds. Rounding: the density is flat below it.
    least_information: float = 1e-10


CANDIDATES = CandidateSettings()
