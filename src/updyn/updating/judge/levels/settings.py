"""Numbers that decide whether FRFs depend on the level."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LevelTestSettings:
    """Tests of FRFs measured at several levels."""

    #: [1] Probability of reporting a linear structure. Default: half of an accepted share of 2 %.
    significance: float = 0.01
    #: [1] Degrees of freedom of an estimated variance. Why: twice those of a smoothed variance of
    #: complex values, which determine it to 15 %.
    noise_freedoms: float = 96.0
    #: [1] Relative noise in the first fit of modes. Effort: the second fit uses the residual.
    start_noise: float = 0.02
    #: [1] Relative changes of a squared frequency from which its fit may start. Effort: a fit from
    #: no change finds changes below the width of the peak.
    scanned_changes: tuple[float, ...] = (-0.3, -0.2, -0.1, -0.05, -0.02, 0.02, 0.05, 0.1, 0.2, 0.3)
    #: [iterations] Iterations of that fit. Effort: about five are needed.
    most_steps: int = 30
    #: [1] Decrease of its cost below which it ends. Effort: a hundredth of a standard deviation.
    settled_decrease: float = 1e-4


LEVEL_TEST = LevelTestSettings()
