"""Numbers that decide how data, unknowns and residuals of a fit are prepared and evaluated."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationSettings:
    """Numbers of the evaluation of a residual, block by block of lines."""

    #: [bytes] Size of a block of lines. Effort: it fits the processor's cache, and bounds the delay
    #: after Ctrl-C.
    block_bytes: int = 12 * 2**20
    #: [operations] Floating-point operations of one evaluation above which its lines are
    #: distributed over workers; below, whole descents are. Effort: some tenth of a second.
    distributed_work: float = 5e8
    #: [operations] Floating-point operations above which an evaluation is not started after a stop
    #: request. Effort: some ten seconds, which a user would notice.
    long_work: float = 5e10
    #: [bytes] Size of the cache of the most recent evaluations. Effort: a rule of thumb; small for
    #: the memory of a computer.
    cache_bytes: int = 64 * 2**20
    #: [s] Time after a stop request in which evaluations still start. Effort: a rule of thumb;
    #: enough to complete small fits.
    finishing_time: float = 2.0
    #: [s] Interval after which a callback is also asked for a stop before an evaluation. Effort: a
    #: user notices a longer delay; a callback may be slow.
    stop_interval: float = 1.0


EVALUATION = EvaluationSettings()


@dataclass(frozen=True)
class TriangleSettings:
    """Numbers of the QR factorisation of a Jacobian; results agree to rounding."""

    #: [columns] Columns of a panel of reflections. Effort: narrow panels are several times faster
    #: for tall blocks than one panel.
    panel_columns: int = 16
    #: [blocks] Number of blocks stacked at a time. Effort: a limit of the memory.
    stacked_blocks: int = 8
    #: [1] Ratio of rows to columns above which a triangle is found by Cholesky factors. Effort: a
    #: rule of thumb; the preconditioning pays for tall blocks only.
    tall_ratio: int = 20
    #: [1] Ratio of rows to columns of the sample that shows the correlation of the columns. Effort:
    #: a rule of thumb.
    sample_ratio: int = 4
    #: [rows] Number of rows processed at a time. Effort: they fit the processor's cache.
    strip_rows: int = 2048
    #: [1] Smallest ratio of diagonal entries of the Cholesky factor of preconditioned columns;
    #: below, reflections are used. Rounding: rounding; the condition number is about its inverse,
    #: and the square of that times the unit roundoff is the relative error of every singular value.
    least_diagonal_ratio: float = 0.03


TRIANGLE = TriangleSettings()


@dataclass(frozen=True)
class LineDesignSettings:
    """Numbers of the selection of lines by their information."""

    #: [1] Noise floor that is added to relative noise, as a share of the rms of the data of a unit.
    #: Why: a rule of thumb.
    noise_floor: float = 1e-2
    #: [1] Least loss factor at which lines are selected. Why: a peak at a wrong frequency then
    #: selects lines on its flanks.
    least_loss_factor: float = 0.02
    #: [1] Ratio of lines to unknowns up to which lines are exchanged after the greedy selection.
    #: Effort: the first lines, selected when the information was nearly singular, matter among few.
    exchanged_ratio: int = 2


LINE_DESIGN = LineDesignSettings()


@dataclass(frozen=True)
class OptimalDesignSettings:
    """Numbers of the selection of items by their Fisher information."""

    #: [1] Information of each scaled unknown before the first item. Rounding: rounding; a
    #: determinant above 0 is needed, and all items together have the information 1.
    initial_information: float = 1e-9
    #: [items] Number of items that are scored together if few may be the best. Effort: the time of
    #: a call of LAPACK and that of items scored in vain are about equal.
    scored_together: int = 64
    #: [exchanges] Largest number of exchanges. Effort: a rule of thumb.
    most_exchanges: int = 20
    #: [1] Smallest increase of the score (a logarithm) by an exchange. Rounding: rounding of the
    #: score.
    least_increase: float = 1e-6


OPTIMAL_DESIGN = OptimalDesignSettings()


@dataclass(frozen=True)
class ModePairSettings:
    """Numbers that decide which measured modes and modes of the model are compared."""

    #: [1] Smallest MAC at which two modes count as similar. Why: a common rule of thumb.
    similar_mac: float = 0.8
    #: [MAC] Cost in the pairing of a factor of e between two frequencies. Why: a rule of thumb; it
    #: decides between shapes that are similar because sensors are few.
    frequency_cost: float = 0.5
    #: [1] Share of the largest singular value of unit shapes below which another is rounding.
    #: Rounding: rounding of shapes from an eigensolver.
    shape_rounding: float = 1e-9
    #: [1] The same for the projection on the span of shapes and its derivatives. Rounding: unit
    #: roundoff, as in numpy.linalg.pinv.
    span_rounding: float = 1e-15
    #: [1] Multiple of the highest measured frequency up to which modes are computed. Why: a model
    #: may be too stiff by a factor of two.
    frequency_reach: float = 1.5
    #: [1] Residual of a measured mode without a counterpart. Why: a factor of e in frequency, the
    #: whole shape, all damping.
    unpaired_residual: float = 1.0


MODE_PAIRS = ModePairSettings()


@dataclass(frozen=True)
class SearchDataSettings:
    """Numbers of the data and bounds of a search by log error."""

    #: [1] Noise of a value, as a share of it, at which its squared weight is about a half. Why: far
    #: from the truth the misfit exceeds 10 %, so smaller noise does not matter.
    halving_noise: float = 0.1
    #: [1] Multiple of the noise variance that is subtracted from the square of a value. Why: noise
    #: alone exceeds three standard deviations once in 8,000 values.
    subtracted_variances: float = 9.0
    #: [1] Lowest value of a loss factor during a search. Why: a bound at zero stops searches for
    #: lightly damped parts, whose true values are near it.
    least_loss_factor: float = -0.5


SEARCH_DATA = SearchDataSettings()


@dataclass(frozen=True)
class UnknownDefaultSettings:
    """Numbers of the unknowns of a fit."""

    #: [1] Default bounds of a factor with powers. Why: a factor of ten in thickness is one of a
    #: thousand in bending stiffness.
    linked_bounds: tuple[float, float] = (0.1, 10.0)
    #: [1] Default bounds of a parameter of a nonlinear element, as a ratio to its start. Why: as
    #: for factors of stiffness.
    element_ratio: float = 100.0
    #: [rows] Largest number of rows of the text of a set of unknowns. Drawing: about a screen.
    printed_rows: int = 40


UNKNOWN_DEFAULTS = UnknownDefaultSettings()


@dataclass(frozen=True)
class LevelSettings:
    """Numbers of data with a force amplitude."""

    #: [m] Amplitude of the deformation of an element in data without a level. Why: the response is
    #: then that of vanishing amplitude. Rounding: its powers are above the smallest double.
    vanishing_amplitude: float = 1e-30
    #: [1] Distance from the data that is added to an unstable solution. Why: unstable motion is
    #: not observed; the relative distance is at most 2.
    unstable: float = 10.0
    #: [1] Distance from the data above which a line is tried on the branch of a neighbour. Why: far
    #: above the squared noise of measurements.
    far: float = 0.01


LEVELS = LevelSettings()
