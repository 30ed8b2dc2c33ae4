"""Numbers that decide how periodic responses are computed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BalanceSettings:
    """Harmonic balance at one frequency."""

    #: [harmonics] Highest harmonic. Default: seven cover a strong cubic spring at resonance to
    #: 1e-4; each result states the error by the next ones.
    harmonics: int = 7
    #: [samples] Samples of a period at which the forces of elements are evaluated. Default: the
    #: error at a kink of the force is about 1 / samples^2.
    samples: int = 512
    #: [harmonics] Harmonics after the highest that estimate the truncation error. Why: odd forces
    #: have every other one only.
    next_harmonics: int = 2
    #: [1] Largest residual over the amplitude of an element at which iterations end. Rounding: far
    #: above rounding (1e-16), far below the truncation error.
    residual: float = 1e-11
    #: [iterations] Newton iterations at one frequency. Effort: a start on the branch needs 2 to 5.
    most_iterations: int = 20
    #: [halvings] Halvings of a Newton step whose residual does not fall. Effort: a rule of thumb.
    most_halvings: int = 6
    #: [1] Smallest step of the force amplitude, as a share of its end, of the first solution.
    #: Effort: a rule of thumb.
    least_level_step: float = 1e-4
    #: [1] Largest truncation error without a warning. Why: a rule of thumb; it is below the errors
    #: of measurements at large amplitudes.
    largest_truncation: float = 0.02


@dataclass(frozen=True)
class LineBalanceSettings:
    """Harmonic balance at the lines of a measurement, for an update."""

    #: [harmonics] Highest harmonic. Default: as `BalanceSettings.harmonics`; the errors of FRFs are
    #: far below those of measurements.
    harmonics: int = 7
    #: [samples] Samples of a period. Default: errors of FRFs of sliders are below 1e-4.
    samples: int = 256
    #: [1] Largest residual over the amplitude of an element at which iterations end. Rounding: far
    #: above rounding; derivatives are exact at any residual.
    residual: float = 1e-9
    #: [iterations] Newton iterations. Effort: a start near the solution needs 3 to 5.
    most_iterations: int = 20
    #: [1] The same at which a solution is accepted after the last iteration. Why: far below the
    #: noise of measurements; samples of a force with kinks may alternate.
    accepted_residual: float = 1e-5
    #: [1] Largest Newton step over the amplitude of an element. Effort: a rule of thumb.
    largest_step: float = 0.3
    #: [halvings] Halvings of a Newton step whose residual does not fall. Effort: a rule of thumb.
    most_halvings: int = 4
    #: [steps] Newton steps without a smaller residual, after which a line is given up. Effort: a
    #: step across the corner of an element may need another one.
    most_stalls: int = 3
    #: [1] Smallest step of the force amplitude, as a share of its end. Effort: a rule of thumb.
    least_level_step: float = 0.01
    #: [1] Share of the force from which a branch is followed through turning points of the force.
    #: Effort: below it, most elements do not act yet.
    small_share: float = 0.01
    #: [1] Smallest step from a line to the next, as a share of their distance. Effort: a rule of
    #: thumb.
    least_move: float = 0.05
    #: [1] Logarithm of the ratio of amplitudes at neighbouring lines, from which one line may
    #: continue the branch of the other. Effort: a rule of thumb.
    jump: float = 0.4
    #: [1] Largest difference of the frequencies of two lines, over one of them, for that. Effort: a
    #: rule of thumb.
    farthest: float = 0.1
    #: [steps] Steps from a line to the next. Effort: a rule of thumb.
    most_moves: int = 12
    #: [passes] Continuations of branches over jumps. Effort: the tip of a resonance has few lines.
    jump_passes: int = 4
    #: [1] Amplitudes at which further solutions are looked for, over the largest amplitude of the
    #: element. Why: at smaller ones, a motion is nearly that of vanishing amplitude.
    scanned: tuple[float, float] = (1e-3, 3.0)
    #: [points] Number of these amplitudes. Effort: neighbours differ by 3 %, from where iterations
    #: converge.
    scan_points: int = 240


@dataclass(frozen=True)
class ContinuationSettings:
    """Steps along a branch of solutions, in the scale of amplitude and band."""

    #: [1] First step. Effort: the next steps adapt.
    first_step: float = 0.01
    #: [1] Smallest step. Effort: below, the branch cannot be followed.
    least_step: float = 1e-8
    #: [1] Step below which a corner of the branch is looked for. Effort: a smooth branch needs no
    #: steps as short.
    corner_step: float = 1e-5
    #: [1] Lengths of the first steps beyond a corner, over the distance to it. Effort: a rule of
    #: thumb.
    corner_steps: tuple[float, ...] = (64.0, 16.0, 4.0)
    #: [1] Cosine between a step from a corner and the branch before, above which it goes back.
    #: Effort: a rule of thumb; a wrong direction gives 1.
    backward: float = 0.9
    #: [1] Step below which a line that is not found is left out: the branch turns there.
    #: Effort: longer steps are repeated with half their length.
    least_line_step: float = 1e-4
    #: [1] Largest step. Effort: longer ones could step over narrow resonances.
    largest_step: float = 0.1
    #: [1] Distance of a corrected point from the tangent, as a share of the step, to which steps
    #: adapt. Effort: a rule of thumb.
    wanted_bend: float = 0.05
    #: [1] The same at which a step is repeated with half its length. Effort: a rule of thumb.
    largest_bend: float = 0.3
    #: [1] Largest change of the step from one to the next. Effort: a rule of thumb.
    largest_growth: float = 2.0
    #: [iterations] Newton iterations of a step. Effort: more mean that the step is too long.
    most_iterations: int = 8
    #: [steps] Steps of a branch. Effort: a band of ten resonances takes about a thousand.
    most_steps: int = 20_000
    #: [1] Smallest amplitude in the scale of an element, as a share of its largest so far. Effort:
    #: smaller motions are followed less closely.
    least_amplitude: float = 0.01
    #: [1] Amplitude of an element, over that at the start, at which a branch ends. Effort: only a
    #: resonance without damping exceeds it.
    unbounded: float = 1e9
    #: [1] Share of the band, beyond its ends, within which a branch may turn. Effort: a rule of
    #: thumb.
    beyond_band: float = 0.5


@dataclass(frozen=True)
class StabilitySettings:
    """The harmonic Nyquist criterion."""

    #: [harmonics] Largest harmonic of a perturbation that modes above the lines require. Effort:
    #: determinants take the third power of it.
    most_harmonics: int = 15
    #: [harmonics] Largest number of harmonics of a perturbation above those of the motion. Effort:
    #: most motions need none.
    most_more_harmonics: int = 8
    #: [turns] Largest deviation of a winding from a whole number. Why: a deviation of a half leaves
    #: the count open.
    largest_fraction: float = 0.1
    #: [points] First points on half a period of the determinant. Effort: more follow where its
    #: phase turns.
    first_points: int = 9
    #: [half-widths] Points around the poles of the linear model. Why: the phase turns there by half
    #: a turn.
    pole_offsets: tuple[float, ...] = (-1.0, 1.0)
    #: [1] Loop gain of a mode and the elements from which its pole has such points. Why: a
    #: loop of less than 1 cannot become unstable (small-gain theorem).
    least_gain: float = 1.0
    #: [rad] Largest turn of the phase between points. Why: a fourth of a turn is unambiguous.
    largest_turn: float = 1.2
    #: [halvings] Refinements of the points. Effort: 2^-40 of a period is rounding.
    most_refinements: int = 40
    #: [1] Real part of s over omega. Rounding: exponents below it count as stable.
    offset: float = 1e-7


BALANCE = BalanceSettings()
LINE_BALANCE = LineBalanceSettings()
CONTINUATION = ContinuationSettings()
STABILITY = StabilitySettings()
